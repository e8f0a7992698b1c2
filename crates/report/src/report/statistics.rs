//! Statistics over the seeds of a row. Replicates are runs, never views, since the views of one run share its weights.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Level of significance, for p values corrected over their family.
pub const SIGNIFICANCE: f64 = 0.05;
/// Part of a Student t distribution below the upper end of a two-sided 95 % interval.
const UPPER: f64 = 1.0 - SIGNIFICANCE / 2.0;

/// Returns the mean, or `None` without values.
pub fn mean(values: &[f64]) -> Option<f64> {
    // Sums distances from the first value, so that the mean of equal values is exact.
    let first = values.first()?;
    Some(first + values.iter().map(|value| value - first).sum::<f64>() / values.len() as f64)
}

/// Returns the sample standard deviation, over n - 1, or `None` for fewer than two values.
pub fn standard_deviation(values: &[f64]) -> Option<f64> {
    let centre = mean(values)?;
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// Returns value minus the baseline's of the same seed, in the order of `values`; seeds that one of them lacks are
/// skipped.
pub fn paired_differences(values: &[(u64, f64)], baseline: &[(u64, f64)]) -> Vec<f64> {
    let partner = |seed| baseline.iter().find(|(other, _)| *other == seed).map(|(_, value)| value);
    values.iter().filter_map(|&(seed, value)| Some(value - partner(seed)?)).collect()
}

/// Returns the ends of the two-sided 95 % Student t interval of the mean, with n - 1 degrees of freedom. `None` for
/// fewer than two differences. If all are equal, both ends are that difference.
pub fn interval(differences: &[f64]) -> Option<(f64, f64)> {
    let (centre, error) = centre_and_error(differences)?;
    let half = error * student(differences.len()).inverse_cdf(UPPER);
    Some((centre - half, centre + half))
}

/// Widens a two-sided 95 % interval of the mean of `n` differences, so that `tests` such intervals hold at once with
/// 95 % (Bonferroni).
pub fn simultaneous((low, high): (f64, f64), n: usize, tests: usize) -> (f64, f64) {
    let quantile = |share: f64| student(n).inverse_cdf(1.0 - share / 2.0);
    let (centre, half) = ((low + high) / 2.0, (high - low) / 2.0);
    let half = half * quantile(SIGNIFICANCE / tests.max(1) as f64) / quantile(SIGNIFICANCE);
    (centre - half, centre + half)
}

/// Returns the p value of the two-sided paired t test that the mean difference is 0, or `None` for fewer than two
/// differences. If all are equal, it is 1 for a difference of 0 and 0 otherwise.
pub fn p_value(differences: &[f64]) -> Option<f64> {
    let (centre, error) = centre_and_error(differences)?;
    Some(match (centre == 0.0, error == 0.0) {
        (true, true) => 1.0,
        (false, true) => 0.0,
        (_, false) => 2.0 * upper_tail(differences.len(), centre.abs() / error),
    })
}

/// Returns the p value of two one-sided paired t tests (Schuirmann 1987) that the mean difference is within `margin`
/// of 0: the larger of the two. `None` for fewer than two differences. If all are equal, it is 0 for a difference
/// within the margin and 1 otherwise.
pub fn equivalence_p_value(differences: &[f64], margin: f64) -> Option<f64> {
    let (centre, error) = centre_and_error(differences)?;
    let room = margin - centre.abs();
    Some(match error == 0.0 {
        true => f64::from(room <= 0.0),
        false => upper_tail(differences.len(), room / error),
    })
}

/// Applies Holm's step-down correction: the k-th smallest of m is multiplied by m - k + 1, made monotone and cut at 1.
/// Missing p values stay missing and do not count.
pub fn holm(p_values: &[Option<f64>]) -> Vec<Option<f64>> {
    let mut known: Vec<(f64, usize)> =
        p_values.iter().enumerate().filter_map(|(index, p)| Some(((*p)?, index))).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut corrected = vec![None; p_values.len()];
    let mut least = 0.0f64;
    for (rank, &(p, index)) in known.iter().enumerate() {
        least = least.max(p * (known.len() - rank) as f64).min(1.0);
        corrected[index] = Some(least);
    }
    corrected
}

/// Returns a p value as text, with enough digits to tell it from the level of significance.
pub fn p_text(p: f64) -> String {
    match format!("{p:.3}").as_str() {
        "0.000" => "< 0.001".into(),
        "0.050" => format!("{p:.5}"),
        text => text.into(),
    }
}

/// Returns the mean and its standard error, or `None` if numbers are too large.
pub(super) fn centre_and_error(differences: &[f64]) -> Option<(f64, f64)> {
    Some((mean(differences)?, standard_error(differences)?)).filter(|(a, b)| a.is_finite() && b.is_finite())
}

/// Returns P(T > t) of `n` differences. Beyond 1e100 it is 0 or 1 to the last digit, and the square would overflow.
fn upper_tail(n: usize, t: f64) -> f64 {
    student(n).sf(t.clamp(-1e100, 1e100))
}

fn standard_error(values: &[f64]) -> Option<f64> {
    Some(standard_deviation(values)? / (values.len() as f64).sqrt())
}

/// Returns the t distribution for `n` differences.
pub(super) fn student(n: usize) -> StudentsT {
    StudentsT::new(0.0, 1.0, (n - 1) as f64).expect("two differences or more")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative. The numbers below are printed to the last digit; two implementations of the incomplete beta function
    /// round differently.
    const TOLERANCE: f64 = 1e-9;

    fn close(value: Option<f64>, expected: f64) {
        let value = value.unwrap();
        assert!((value - expected).abs() <= TOLERANCE * expected.abs(), "{value} is not {expected}");
    }

    fn differences(n: usize) -> Vec<f64> {
        let a = [25.31, 25.02, 25.47, 25.18, 24.96];
        let b = [25.10, 25.05, 25.11, 24.90, 24.99];
        a.iter().zip(b).take(n).map(|(a, b)| a - b).collect()
    }

    #[test]
    fn means_and_deviations_are_numpys() {
        // numpy: np.mean(a), np.std(a, ddof=1)
        let a = [25.31, 25.02, 25.47, 25.18, 24.96];
        close(mean(&a), 25.188);
        close(standard_deviation(&a), 0.20897368255356868);
        assert_eq!((mean(&[]), standard_deviation(&[]), standard_deviation(&[1.0])), (None, None, None));
        assert_eq!(mean(&[2.5]), Some(2.5));
    }

    #[test]
    fn intervals_and_p_values_are_scipys() {
        // scipy 1.17.1: r = scipy.stats.ttest_rel(a[:n], b[:n]); r.pvalue, *r.confidence_interval(0.95)
        let cases = [
            (5, 0.12062188522988912, -0.06505069034353778, 0.38105069034353745),
            (3, 0.25387599493929247, -0.3086874099210928, 0.6686874099210898),
            (2, 0.5903344706017376, -1.4347445683409552, 1.6147445683409514),
        ];
        for (n, p, low, high) in cases {
            close(p_value(&differences(n)), p);
            close(interval(&differences(n)).map(|ends| ends.0), low);
            close(interval(&differences(n)).map(|ends| ends.1), high);
        }
        // scipy.stats.ttest_rel([1.0, 1.001, 0.999, 1.0005], [0, 0, 0, 0]).pvalue
        close(p_value(&[1.0, 1.001, 0.999, 1.0005]), 1.715765118112952e-10);
    }

    #[test]
    fn half_widths_are_scipys_t_quantiles() {
        // scipy 1.17.1: scipy.stats.t.ppf(0.975, df)
        let quantiles = [
            (1, 12.706204736174694),
            (2, 4.302652729749462),
            (4, 2.7764451051977934),
            (9, 2.262157162798205),
            (29, 2.045229642132703),
        ];
        for (freedom, quantile) in quantiles {
            close(Some(student(freedom + 1).inverse_cdf(UPPER)), quantile);
        }
    }

    /// Student's distribution of one degree of freedom is Cauchy's: P(T > t) = 1/2 - atan(t) / pi; of two,
    /// P(T > t) = 1/2 - t / (2 sqrt(t^2 + 2)).
    #[test]
    fn equivalence_has_the_closed_forms_of_small_samples() {
        let above = |n: usize, t: f64| match n {
            2 => 0.5 - t.atan() / std::f64::consts::PI,
            _ => 0.5 - t / (2.0 * (t * t + 2.0).sqrt()),
        };
        for (values, margin) in [
            (&[0.1, 0.2][..], 0.3),
            (&[-0.1, -0.2], 0.3),
            (&[0.1, 0.2], 0.05),
            (&[0.02, -0.01, 0.05], 0.3),
            (&[0.2, 0.25, 0.33], 0.3),
            (&[-0.9, -0.7, -1.1], 0.3),
        ] {
            let (centre, error) = (mean(values).unwrap(), standard_error(values).unwrap());
            // The two tests separately: a mean above -margin, and a mean below margin.
            let [low, high] = [(centre + margin) / error, (margin - centre) / error].map(|t| above(values.len(), t));
            close(equivalence_p_value(values, margin), low.max(high));
        }
        let exact = |values: &[f64]| equivalence_p_value(values, 0.3);
        assert_eq!((exact(&[0.1; 3]), exact(&[0.3; 3]), exact(&[-0.4; 3])), (Some(0.0), Some(1.0), Some(1.0)));
        assert_eq!((exact(&[0.1]), exact(&[])), (None, None));
    }

    #[test]
    fn equal_differences_give_a_degenerate_interval() {
        assert_eq!((interval(&[0.1; 3]), p_value(&[0.1; 3])), (Some((0.1, 0.1)), Some(0.0)));
        assert_eq!((interval(&[0.0; 3]), p_value(&[0.0; 3])), (Some((0.0, 0.0)), Some(1.0)));
    }

    #[test]
    fn numbers_of_any_size_have_a_p_value_or_none() {
        let sizes = [0.0, 5e-324, 1e-308, 1.0, 1e160, 1e308, f64::MAX, f64::NAN, f64::INFINITY];
        for a in sizes {
            for b in sizes.into_iter().chain(sizes.map(|b| -b)) {
                let ps =
                    [p_value(&[a, b]), equivalence_p_value(&[a, b], 0.3), equivalence_p_value(&[a, b, 1.0], 1e300)];
                assert!(ps.into_iter().flatten().all(|p| (0.0..=1.0).contains(&p)), "{a} {b}: {ps:?}");
                assert!(interval(&[a, b]).is_none_or(|(low, high)| low <= high), "{a} {b}");
            }
        }
    }

    #[test]
    fn one_difference_has_neither_interval_nor_p_value() {
        assert_eq!((interval(&[0.1]), p_value(&[0.1])), (None, None));
        assert_eq!((interval(&[]), p_value(&[])), (None, None));
    }

    #[test]
    fn differences_pair_by_seed() {
        let baseline = [(2, 10.0), (0, 20.0), (7, 1.0)];
        assert_eq!(paired_differences(&[(0, 21.0), (1, 5.0), (2, 13.0)], &baseline), [1.0, 3.0]);
    }

    #[test]
    fn holm_is_statsmodels() {
        // statsmodels 0.15.0: multipletests(p, method="holm")[1]
        let cases: [(&[f64], &[f64]); 3] = [
            (&[0.01, 0.04, 0.03, 0.005], &[0.03, 0.06, 0.06, 0.02]),
            (&[0.2, 0.011, 0.6, 0.011, 0.9], &[0.6, 0.055, 1.0, 0.055, 1.0]),
            (&[1e-12, 0.5], &[2e-12, 0.5]),
        ];
        for (p_values, expected) in cases {
            let p_values: Vec<Option<f64>> = p_values.iter().copied().map(Some).collect();
            for (corrected, &expected) in holm(&p_values).into_iter().zip(expected) {
                close(corrected, expected);
            }
        }
    }

    #[test]
    fn missing_p_values_do_not_count() {
        assert_eq!(holm(&[None, Some(0.02), None, Some(0.01)]), [None, Some(0.02), None, Some(0.02)]);
        assert_eq!(holm(&[None]), [None]);
    }
}

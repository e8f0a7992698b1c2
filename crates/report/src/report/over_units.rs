//! Statistics over units that stand for a population, such as scenes. A unit's number is the mean of its own seeds.

use statrs::distribution::{Binomial, ContinuousCDF, DiscreteCDF};

use super::statistics::{SIGNIFICANCE, centre_and_error, standard_deviation, student};

/// How many differences are above and below 0, and whether a fair coin explains it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignTest {
    /// Differences above 0.
    pub above: usize,
    /// Differences below 0.
    pub below: usize,
    /// Two-sided p value of the exact binomial test; differences of 0 do not count.
    pub p: f64,
}

/// Most differences whose exact distribution of ranks is made: the time grows with the third power.
const MOST_RANKS: usize = 1000;

/// Returns the sign test, or `None` if no difference is above or below 0.
pub fn sign_test(differences: &[f64]) -> Option<SignTest> {
    let above = differences.iter().filter(|difference| **difference > 0.0).count();
    let below = differences.iter().filter(|difference| **difference < 0.0).count();
    let coin = Binomial::new(0.5, (above + below) as u64).ok().filter(|_| above + below > 0)?;
    Some(SignTest { above, below, p: (2.0 * coin.cdf(above.min(below) as u64)).min(1.0) })
}

/// Returns the Hodges-Lehmann estimate, which is the median of all means of two differences (each with itself, too), and the
/// ends of its 95 % interval from Wilcoxon's exact distribution (Hollander, Wolfe and Chicken 2014, chapter 3). There is no
/// interval for fewer than six differences, of which no 95 % interval exists, and for more than a thousand. `None` without
/// differences.
pub fn hodges_lehmann(differences: &[f64]) -> Option<(f64, Option<(f64, f64)>)> {
    let n = differences.len();
    let pairs = (0..n).flat_map(|i| (0..=i).map(move |j| (i, j)));
    let mut means: Vec<f64> = pairs.map(|(i, j)| (differences[i] + differences[j]) / 2.0).collect();
    means.sort_by(f64::total_cmp);
    let middle = means.len() / 2;
    let median = match means.len() % 2 {
        _ if means.is_empty() => return None,
        0 => (means[middle - 1] + means[middle]) / 2.0,
        _ => means[middle],
    };
    let cut = if n > MOST_RANKS { 0 } else { signed_rank_quantile(n, SIGNIFICANCE / 2.0) };
    Some((median, (cut > 0).then(|| (means[cut - 1], means[means.len() - cut]))))
}

/// Returns the least sum of signed ranks whose probability to be reached or undercut is at least `share`.
fn signed_rank_quantile(n: usize, share: f64) -> usize {
    // Number of subsets of 1..=n by their sum, as shares of 2^n.
    let mut shares = vec![1.0];
    for rank in 1..=n {
        let mut next: Vec<f64> = shares.iter().map(|share| share / 2.0).collect();
        next.resize(shares.len() + rank, 0.0);
        shares.iter().enumerate().for_each(|(sum, share)| next[sum + rank] += share / 2.0);
        shares = next;
    }
    let mut below = 0.0;
    let reached = shares.iter().position(|own| {
        below += own;
        below >= share
    });
    reached.unwrap_or(0)
}

/// Returns the ends of the 95 % prediction interval of the same mean of one more unit. `None` for fewer than two
/// differences.
pub fn prediction(differences: &[f64]) -> Option<(f64, f64)> {
    let (centre, error) = centre_and_error(differences)?;
    let n = differences.len();
    let half = error * (n as f64 + 1.0).sqrt() * student(n).inverse_cdf(1.0 - SIGNIFICANCE / 2.0);
    Some((centre - half, centre + half))
}

/// Standard deviations of a difference that varies between units and, in each, between seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Components {
    /// Between units, without what their seeds explain; 0 if the seeds explain all.
    pub between: f64,
    /// Within a unit, between its seeds.
    pub within: f64,
}

/// The differences of a unit's seeds in short.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seeds {
    /// Number of seeds.
    pub count: usize,
    /// Mean of their differences.
    pub mean: f64,
    /// Standard deviation of the differences; `None` for one seed.
    pub deviation: Option<f64>,
}

/// Splits differences by unit, by the analysis of variance of unweighted means. With as many seeds in each unit these are the
/// estimates of restricted maximum likelihood where `between` is above 0. `None` for fewer than two units, or if no
/// unit has two seeds.
pub fn components(units: &[Seeds]) -> Option<Components> {
    let means: Vec<f64> = units.iter().map(|unit| unit.mean).collect();
    let squares: f64 = units.iter().filter_map(|unit| Some(unit.deviation?.powi(2) * (unit.count - 1) as f64)).sum();
    let freedom: usize = units.iter().map(|unit| unit.count - 1).sum();
    let of_means = standard_deviation(&means)?.powi(2);
    let within = squares / freedom as f64;
    let seeds = units.iter().map(|unit| 1.0 / unit.count as f64).sum::<f64>() / units.len() as f64;
    (freedom > 0).then(|| Components { between: (of_means - within * seeds).max(0.0).sqrt(), within: within.sqrt() })
}

/// Returns, for each row, the ends of an interval of its mean minus the best mean of the other rows, where more is better.
/// All hold at once with 95 %. A row whose interval ends at 0 is not the best; one whose interval begins there is.
///
/// These are Hsu's constrained intervals (Hsu 1984). Each pair of rows has its own spread over the units, because the spreads
/// of differences differ, and Bonferroni's quantile, because Dunnett's supposes one spread. `rows` have a number for each unit.
/// `None` for fewer than two rows or units.
pub fn to_best(rows: &[Vec<f64>]) -> Option<Vec<(f64, f64)>> {
    let units = rows.first()?.len();
    if rows.len() < 2 || units < 2 {
        return None;
    }
    let quantile = student(units).inverse_cdf(1.0 - SIGNIFICANCE / (rows.len() - 1) as f64);
    let against = |a: &[f64], b: &[f64]| {
        let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
        let (centre, error) = centre_and_error(&differences)?;
        Some((centre - quantile * error, centre + quantile * error))
    };
    let ends = rows.iter().enumerate().map(|(index, row)| {
        let others = rows.iter().enumerate().filter(|(other, _)| *other != index);
        let ends = others.map(|(_, other)| against(row, other)).collect::<Option<Vec<(f64, f64)>>>()?;
        let least = |of: fn(&(f64, f64)) -> f64| ends.iter().map(of).fold(f64::INFINITY, f64::min);
        Some((least(|ends| ends.0).min(0.0), least(|ends| ends.1).max(0.0)))
    });
    ends.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::statistics::mean;

    const SEEDS: [[f64; 2]; 8] = [
        [0.31, 0.52],
        [-0.12, 0.08],
        [0.44, 0.91],
        [0.05, 0.27],
        [0.66, 0.38],
        [-0.25, -0.09],
        [1.02, 0.73],
        [0.18, 0.29],
    ];

    fn means() -> Vec<f64> {
        SEEDS.iter().map(|seeds| mean(seeds).unwrap()).collect()
    }

    #[track_caller]
    fn close(value: f64, expected: f64) {
        assert!((value - expected).abs() <= 1e-7 * expected.abs().max(0.1), "{value} is not {expected}");
    }

    #[track_caller]
    fn ends_close(ends: (f64, f64), expected: (f64, f64)) {
        close(ends.0, expected.0);
        close(ends.1, expected.1);
    }

    #[test]
    fn signs_are_rs() {
        // R 4.2.2: binom.test(6, 8)$p.value
        let signs = sign_test(&means()).unwrap();
        assert_eq!((signs.above, signs.below), (6, 2));
        close(signs.p, 0.2890625);
        assert_eq!(sign_test(&[0.0, 0.0]), None);
        assert_eq!(sign_test(&[0.0, 1.0, -1.0]).unwrap().p, 1.0);
    }

    #[test]
    fn hodges_and_lehmann_are_rs() {
        // R 4.2.2: wilcox.test(m, conf.int = TRUE, exact = TRUE)
        let m = means();
        let (median, ends) = hodges_lehmann(&m).unwrap();
        close(median, 0.33375);
        ends_close(ends.unwrap(), (-0.005, 0.675));
        let (median, ends) = hodges_lehmann(&m[..6]).unwrap();
        close(median, 0.2525);
        ends_close(ends.unwrap(), (-0.170, 0.675));
        let many: Vec<f64> = [(1.0, 0.0), (1.0, 0.013), (0.7, -0.031), (1.3, 0.11)]
            .iter()
            .flat_map(|(scale, shift)| m.iter().map(move |value| value * scale + shift))
            .collect();
        let (median, ends) = hodges_lehmann(&many).unwrap();
        close(median, 0.34025);
        ends_close(ends.unwrap(), (0.20575, 0.48375));
        // 2 / 2^5 is above 0.05.
        assert_eq!(hodges_lehmann(&m[..5]).unwrap().1, None);
        assert_eq!(hodges_lehmann(&[]), None);
    }

    #[test]
    fn a_new_unit_is_rs() {
        // R 4.2.2: predict(lm(m ~ 1), newdata = data.frame(z = 1), interval = "prediction")
        ends_close(prediction(&means()).unwrap(), (-0.5476864687279426, 1.2201864687279425));
        assert_eq!(prediction(&[1.0]), None);
    }

    #[test]
    fn components_are_those_of_a_mixed_model() {
        // lme4 1.1-31: lmer(y ~ 1 + (1 | scene), REML = TRUE), VarCorr
        let unit = |values: &[f64]| Seeds {
            count: values.len(),
            mean: mean(values).unwrap(),
            deviation: standard_deviation(values),
        };
        let units: Vec<Seeds> = SEEDS.iter().map(|seeds| unit(seeds)).collect();
        let Components { between, within } = components(&units).unwrap();
        close(between, 0.3269747699865243);
        close(within, 0.1860107522560633);
        // Seeds that spread more than their units.
        let noisy = [unit(&[-1.0, 1.0]), unit(&[-1.1, 1.1])];
        assert_eq!(components(&noisy).unwrap().between, 0.0);
        assert_eq!((components(&units[..1]), components(&[unit(&[1.0]), unit(&[2.0])])), (None, None));
    }

    #[test]
    fn intervals_to_the_best_are_those_of_a_loop_in_r() {
        let rows = [
            means(),
            vec![0.1, 0.2, -0.1, 0.3, 0.2, -0.3, 0.4, 0.1],
            vec![-0.9, -0.4, -0.6, -0.8, -0.2, -0.7, -0.5, -0.3],
            vec![0.0; 8],
        ];
        let ends = to_best(&rows).unwrap();
        let expected = [
            (-0.07798252426193242, 0.5254825242619324),
            (-0.5254825242619324, 0.07798252426193242),
            (-1.258777557266479, 0.0),
            (-0.665440583019947, 0.0),
        ];
        ends.into_iter().zip(expected).for_each(|(ends, expected)| ends_close(ends, expected));
        assert_eq!((to_best(&rows[..1]), to_best(&[vec![1.0], vec![2.0]])), (None, None));
    }
}

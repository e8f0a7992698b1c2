//! Numbers of seeds that are needed to show a difference. They come from the spread of paired differences without
//! their means, so a study may use them for planning before its last seed.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};
use statrs::function::gamma::ln_gamma;

use super::statistics::SIGNIFICANCE;
use super::tables::{Line, Table, comparisons_to_come};

/// Probability of showing a difference of the given size.
pub const POWER: f64 = 0.8;
/// Least seeds; two differences say almost nothing about their spread.
pub const LEAST_SEEDS: usize = 3;
/// Limit of the search.
pub const MOST_SEEDS: usize = 1000;

/// A line of a table that is compared with another.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// The scene.
    pub scene: String,
    /// The row with its axis values.
    pub label: String,
    /// The row that it is compared with.
    pub baseline: String,
    /// Seeds that both have.
    pub seeds: usize,
    /// Standard deviation of the differences; `None` for fewer than two seeds.
    pub deviation: Option<f64>,
    /// Number of comparisons that p is corrected over.
    pub tests: usize,
    /// Seeds that show the difference with [`POWER`]; `None` for fewer than three seeds, or if [`MOST_SEEDS`] are not
    /// enough.
    pub seeds_needed: Option<usize>,
}

/// Returns the spreads of a table's first metric and the seeds that would show `difference`. P values are corrected
/// over `tests` comparisons (Holm's first step), or over those of the line's scene. Empty if no line is compared with
/// another.
pub fn spreads(table: &Table, difference: f64, tests: Option<usize>) -> Vec<Spread> {
    let of_scene = |scene: &str| {
        let lines: Vec<&Line> = table.lines.iter().filter(|line| line.scene == scene).collect();
        comparisons_to_come(&lines, 0).max(1)
    };
    let spread = |line: &Line| {
        let baseline = line.baseline.clone().filter(|_| !line.quoted)?;
        let comparison = line.cells[0].comparison.as_ref();
        let deviation = comparison.and_then(|comparison| comparison.deviation).filter(|value| value.is_finite());
        let seeds = comparison.map_or(0, |comparison| comparison.pairs);
        let tests = tests.unwrap_or_else(|| of_scene(&line.scene));
        let level = SIGNIFICANCE / tests as f64;
        let told = deviation.filter(|_| seeds >= LEAST_SEEDS);
        Some(Spread {
            scene: line.scene.clone(),
            label: line.label.clone(),
            baseline,
            seeds,
            deviation,
            tests,
            seeds_needed: told.and_then(|deviation| seeds_needed(difference / deviation, level)),
        })
    };
    table.lines.iter().filter_map(spread).collect()
}

/// Returns the fewest seeds that show a difference of `effect` standard deviations with [`POWER`], by a two-sided
/// paired t test at `level`. `None` if [`MOST_SEEDS`] are not enough.
fn seeds_needed(effect: f64, level: f64) -> Option<usize> {
    (LEAST_SEEDS..=MOST_SEEDS).find(|&seeds| power(seeds, effect, level) >= POWER)
}

/// Returns the power of a two-sided paired t test: P(|T| > t) of the noncentral t distribution. Computed as the mean
/// of a normal's tails over the sample standard deviation s; n - 1 times its square has a chi-squared distribution.
fn power(seeds: usize, effect: f64, level: f64) -> f64 {
    const PARTS: usize = 1000;
    let freedom = (seeds - 1) as f64;
    let student = StudentsT::new(0.0, 1.0, freedom).expect("two seeds or more");
    let normal = Normal::standard();
    let critical = student.inverse_cdf(1.0 - level / 2.0);
    // Beyond 1e6 it is shown in any case.
    let shift = (effect * (seeds as f64).sqrt()).min(1e6);
    let tails = |s: f64| normal.sf(critical * s - shift) + normal.cdf(-critical * s - shift);
    // The chi distribution of s, in logarithms: its factors overflow f64 beyond some hundred seeds.
    let half = freedom / 2.0;
    let scale = std::f64::consts::LN_2 + half * half.ln() - ln_gamma(half);
    let density = |s: f64| (scale + (freedom - 1.0) * s.ln() - half * s * s).exp();
    // Nine standard deviations of s about 1; less than 1e-12 is outside.
    let reach = 9.0 / (2.0 * freedom).sqrt();
    let low = (1.0 - reach).max(0.0);
    let step = (1.0 + reach - low) / PARTS as f64;
    let part = |i: usize| {
        let s = low + (i as f64 + 0.5) * step;
        density(s) * tails(s)
    };
    (0..PARTS).map(part).sum::<f64>() * step
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seeds for 80 % at 0.05 and at 0.05 / 13, by scipy's noncentral t: standard deviation, difference.
    #[test]
    fn seeds_are_those_of_the_noncentral_t_distribution() {
        let differences = [0.1, 0.3, 1.0];
        let cases: [(f64, [usize; 3], [usize; 3]); 5] = [
            (0.03, [3, 3, 3], [6, 4, 3]),
            (0.06, [6, 3, 3], [10, 5, 3]),
            (0.10, [10, 4, 3], [19, 6, 4]),
            (0.16, [23, 5, 3], [40, 9, 4]),
            (0.38, [116, 15, 4], [206, 27, 6]),
        ];
        for (deviation, plain, corrected) in cases {
            for (level, seeds) in [(SIGNIFICANCE, plain), (SIGNIFICANCE / 13.0, corrected)] {
                let found = differences.map(|difference| seeds_needed(difference / deviation, level).unwrap());
                assert_eq!(found, seeds, "standard deviation {deviation}, level {level}");
            }
        }
    }

    #[test]
    fn power_without_a_difference_is_the_level() {
        for seeds in [LEAST_SEEDS, 6, 30, MOST_SEEDS] {
            let found = power(seeds, 0.0, 0.05);
            assert!((found - 0.05).abs() < 1e-5, "{seeds} seeds: {found}");
        }
        assert_eq!((seeds_needed(0.0, 0.05), seeds_needed(f64::INFINITY, 0.05)), (None, Some(LEAST_SEEDS)));
    }
}

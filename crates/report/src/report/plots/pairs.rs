//! Which values of an axis differ significantly, over all panels of a figure.

use super::series::{Series, value_text};
use crate::draw::numbers::short;
use crate::metrics::Metric;
use crate::report::statistics::{SIGNIFICANCE, holm, least_provable, p_text, p_value, paired_differences};

/// Two values of a series, with their differences seed by seed.
pub(super) struct Pair<'a> {
    /// Panel and line.
    series: (&'a str, &'a str, &'a str),
    pub(super) values: (&'a str, &'a str),
    differences: Vec<f64>,
    /// P value of the paired t test, after Holm's correction over all pairs of the figure, or `None` for fewer than
    /// two seeds.
    p: Option<f64>,
}

/// The pairs of values of all panels: one family of tests. Values with equal numbers are the same training (such as
/// step sizes that all reach the set's corners). Pairs with equal differences are one test, as if panels share a
/// point.
pub(super) struct Tests<'a>(Vec<Pair<'a>>);

impl<'a> Tests<'a> {
    pub(super) fn new(series: &'a [Series<'a>]) -> Tests<'a> {
        let mut pairs: Vec<Pair> = series.iter().flat_map(pairs).collect();
        let first = |i: usize| (0..i).find(|&j| is_same_test(&pairs[j], &pairs[i])).unwrap_or(i);
        let firsts: Vec<usize> = (0..pairs.len()).map(first).collect();
        let own = |(i, pair): (usize, &Pair)| (firsts[i] == i).then(|| p_value(&pair.differences)).flatten();
        let corrected = holm(&pairs.iter().enumerate().map(own).collect::<Vec<Option<f64>>>());
        pairs.iter_mut().zip(&firsts).for_each(|(pair, first)| pair.p = corrected[*first]);
        Tests(pairs)
    }

    fn of(&self, series: &Series) -> impl Iterator<Item = &Pair<'a>> {
        self.0.iter().filter(|pair| pair.series == series.place())
    }

    /// Returns whether a value differs significantly from another one of its line.
    pub(super) fn tells_apart(&self, series: &Series, value: &str) -> bool {
        let shown = |pair: &Pair| pair.p.is_some_and(|p| p < SIGNIFICANCE);
        self.of(series).any(|pair| shown(pair) && (pair.values.0 == value || pair.values.1 == value))
    }

    /// Returns in words whether any two values of the axis differ significantly, over the seeds that they share. If
    /// none do, adds the least difference that would have been significant.
    pub(super) fn verdict(&self, series: &Series, metric: &str) -> String {
        let seeds = series.points.iter().map(|(_, seeds)| seeds.len()).max().unwrap_or(0);
        let tested = self.of(series).filter_map(|pair| Some((pair.values, pair.p?)));
        match (seeds, tested.min_by(|(_, a), (_, b)| a.total_cmp(b))) {
            (0, _) => "no data".into(),
            (1, _) => "one seed: no spread known".into(),
            (_, Some(((a, b), p))) if p < SIGNIFICANCE => {
                format!("{seeds} seeds: {} and {} differ, p {}", value_text(a), value_text(b), p_text(p))
            }
            _ => {
                let least = self.least_provable(series).zip(Metric::find(metric));
                let least = least.map_or(String::new(), |(least, metric)| {
                    let space = if metric.unit.is_empty() { "" } else { " " };
                    format!("; detectable from {}{space}{}", two_digits(least), metric.unit)
                });
                format!("{seeds} seeds: no difference shown{least}")
            }
        }
    }

    /// Returns the least significant difference between two values of a line. It uses Holm's first step over the
    /// complete figure and the line's pooled spread.
    fn least_provable(&self, series: &Series) -> Option<f64> {
        let family =
            self.0.iter().enumerate().filter(|(i, pair)| {
                pair.p.is_some() && self.0[..*i].iter().all(|earlier| !is_same_test(earlier, pair))
            });
        let differences: Vec<&[f64]> = self.of(series).map(|pair| pair.differences.as_slice()).collect();
        least_provable(&differences, family.count())
    }
}

/// Returns a size by its first two digits.
fn two_digits(value: f64) -> String {
    short(&format!("{value:.1e}"))
}

/// Returns all pairs of a line's values that differ in any number.
pub(super) fn pairs<'a>(series: &'a Series<'a>) -> Vec<Pair<'a>> {
    let points = &series.points;
    let is_new = |i: &usize| points[..*i].iter().all(|(_, seeds)| *seeds != points[*i].1);
    let distinct: Vec<usize> = (0..points.len()).filter(is_new).collect();
    let both = distinct.iter().enumerate().flat_map(|(n, &j)| distinct[..n].iter().map(move |&i| (i, j)));
    let pair = |(i, j): (usize, usize)| Pair {
        series: series.place(),
        values: (points[i].0, points[j].0),
        differences: paired_differences(&points[i].1, &points[j].1),
        p: None,
    };
    both.map(pair).collect()
}

/// Different trainings do not have equal differences, seed by seed.
fn is_same_test(a: &Pair, b: &Pair) -> bool {
    !a.differences.is_empty() && a.differences == b.differences
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A figure has many panels, and a single significant test may be chance.
    #[test]
    fn all_panels_of_a_figure_are_one_family() {
        let panel = |panel: &'static str, differences: [f64; 3]| Series {
            axis: "steps",
            panel,
            row: "r",
            label: "r".into(),
            points: vec![
                ("1", vec![(0, 20.0), (1, 20.0), (2, 20.0)]),
                ("3", (0..).zip(differences.map(|difference| 20.0 + difference)).collect()),
            ],
        };
        let strong = panel("a", [0.5, 0.56, 0.62]);
        let p = p_value(&[0.5, 0.56, 0.62]).unwrap();
        let alone = [strong];
        assert!(p > 0.001 && p < SIGNIFICANCE / 4.0 && Tests::new(&alone).tells_apart(&alone[0], "3"));
        let noise = [0.1, -0.2, 0.05];
        let many = |panels: usize| -> Vec<Series> {
            let names = ["b", "c", "d", "e", "f", "g", "h", "i", "j", "k", "l", "m", "n", "o", "p"];
            let others = (0..panels).map(|i| panel(names[i], noise.map(|x| x * (1.0 + i as f64))));
            std::iter::once(panel("a", [0.5, 0.56, 0.62])).chain(others).collect()
        };
        let few = many(3);
        let tests = Tests::new(&few);
        assert!((tests.0[0].p.unwrap() / (4.0 * p) - 1.0).abs() < 1e-12);
        assert!(tests.tells_apart(&few[0], "3"));
        let all = many(15);
        let tests = Tests::new(&all);
        assert!(
            !tests.tells_apart(&all[0], "3")
                && tests.verdict(&all[0], "psnr").contains("no difference shown; detectable from ")
        );
        // Equal numbers in another panel are the same trainings, and no further test.
        let twice = [panel("a", [0.5, 0.56, 0.62]), panel("b", [0.5, 0.56, 0.62])];
        let tests = Tests::new(&twice);
        assert_eq!(tests.0[0].p, tests.0[1].p);
        assert!((tests.0[0].p.unwrap() / p - 1.0).abs() < 1e-12);
    }
}

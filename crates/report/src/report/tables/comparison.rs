//! A line against its baseline, and the one rule for its verdict: Holm's correction within a scene and metric, at
//! [`SIGNIFICANCE`]. Tables, CSV and figures all use it.

use serde_json::Value;

use super::{Cell, Line};
use crate::report::statistics::{
    SIGNIFICANCE, equivalence_p_value, holm, interval, mean, p_value, simultaneous, standard_deviation,
};

/// A metric of a line against that of its baseline: the mean of their differences seed by seed, or scene by scene. One
/// family is corrected together: a metric's comparisons within a scene, or those over scenes or sweeps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Number of seeds or scenes that both have.
    pub pairs: usize,
    /// Mean of the line's values minus the baseline's.
    pub difference: f64,
    /// Standard deviation of the differences; `None` for one pair.
    pub deviation: Option<f64>,
    /// Ends of the 95 % interval; `None` for one pair.
    pub interval: Option<(f64, f64)>,
    /// P value of the paired t test; `None` for one pair.
    pub p: Option<f64>,
    /// The same after Holm's correction over the family.
    pub p_holm: Option<f64>,
    /// Ends of the interval that holds with 95 % for all of the family at once (Bonferroni).
    pub simultaneous: Option<(f64, f64)>,
    /// Test of equivalence, or `None` if the definition states no margin for the metric.
    pub equivalence: Option<Equivalence>,
}

/// Two one-sided paired t tests that a difference is within a margin of 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equivalence {
    /// Smaller differences, up or down, count as equivalent; in the metric's unit.
    pub margin: f64,
    /// The larger of the two p values; `None` for one pair.
    pub p: Option<f64>,
    /// The same after Holm's correction over the family.
    pub p_holm: Option<f64>,
}

/// Verdict on a difference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The interval contains 0. This does not prove equality; see [`Equivalence`].
    NotDistinguishable,
    /// Above 0, by Holm's p.
    Higher,
    /// Below 0, by Holm's p.
    Lower,
}

impl Verdict {
    /// Returns the words in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::NotDistinguishable => "not distinguishable",
            Verdict::Higher => "higher",
            Verdict::Lower => "lower",
        }
    }

    /// Returns whether the row differs from its baseline.
    pub fn is_difference(self) -> bool {
        self != Verdict::NotDistinguishable
    }
}

impl Equivalence {
    /// Returns whether both tests are significant after Holm's correction: the row is equivalent to its baseline
    /// within the margin.
    pub fn holds(&self) -> bool {
        self.p_holm.is_some_and(|p| p < SIGNIFICANCE)
    }
}

impl Comparison {
    pub(in crate::report) fn new(differences: &[f64], margin: Option<f64>) -> Option<Comparison> {
        let equivalence = |margin| Equivalence { margin, p: equivalence_p_value(differences, margin), p_holm: None };
        Some(Comparison {
            pairs: differences.len(),
            difference: mean(differences)?,
            deviation: standard_deviation(differences),
            interval: interval(differences),
            p: p_value(differences),
            p_holm: None,
            simultaneous: None,
            equivalence: margin.map(equivalence),
        })
    }

    /// Returns the verdict on the difference. `None` for one pair, and if the interval excludes 0 but Holm's p is
    /// [`SIGNIFICANCE`] or more.
    pub fn verdict(&self) -> Option<Verdict> {
        let (low, high) = self.interval?;
        let sure = self.p_holm? < SIGNIFICANCE;
        let holds_zero = low <= 0.0 && high >= 0.0;
        match (sure, holds_zero) {
            (true, _) if self.difference > 0.0 => Some(Verdict::Higher),
            (true, _) => Some(Verdict::Lower),
            (false, true) => Some(Verdict::NotDistinguishable),
            (false, false) => None,
        }
    }

    /// Returns a cell of CSV files by its column, null where there is no number.
    pub(in crate::report) fn cell(&self, column: &str) -> Value {
        let test = self.equivalence;
        match column {
            "pairs" => self.pairs.into(),
            "difference" => self.difference.into(),
            "low" => self.interval.map(|ends| ends.0).into(),
            "high" => self.interval.map(|ends| ends.1).into(),
            "p" => self.p.into(),
            "p_holm" => self.p_holm.into(),
            "simultaneous_low" => self.simultaneous.map(|ends| ends.0).into(),
            "simultaneous_high" => self.simultaneous.map(|ends| ends.1).into(),
            "verdict" => self.verdict().map(Verdict::name).into(),
            "margin" => test.map(|test| test.margin).into(),
            "p_equivalence" => test.and_then(|test| test.p).into(),
            "p_equivalence_holm" => test.and_then(|test| test.p_holm).into(),
            "equivalent" => test.filter(|test| test.p_holm.is_some()).map(|test| test.holds().to_string()).into(),
            _ => Value::Null,
        }
    }

    /// Returns whether the row is shown to be equivalent to its baseline, within the definition's margin.
    pub fn is_equivalent(&self) -> bool {
        self.equivalence.is_some_and(|equivalence| equivalence.holds())
    }
}

/// Corrects each metric of each scene.
pub(super) fn correct_scenes(lines: &mut [Line]) {
    for scene in lines.chunk_by_mut(|a, b| a.scene == b.scene) {
        let firsts = firsts(scene, is_same_experiment);
        for metric in 0..scene[0].cells.len() {
            let family = scene.iter_mut().map(|line| line.cells[metric].comparison.as_mut());
            correct(&mut family.collect::<Vec<_>>(), &firsts);
        }
    }
}

/// Fills in what depends on all comparisons of a family. Each counts once, as the first of `firsts`.
pub(in crate::report) fn correct(family: &mut [Option<&mut Comparison>], firsts: &[usize]) {
    let all = |p: fn(&Comparison) -> Option<f64>| -> Vec<Option<f64>> {
        let alone = family.iter().enumerate().map(|(i, own)| own.as_deref().filter(|_| firsts[i] == i));
        alone.map(|own| own.and_then(p)).collect()
    };
    let (p, of_equivalence) = (all(|own| own.p), holm(&all(|own| own.equivalence?.p)));
    let (tests, p) = (p.iter().flatten().count(), holm(&p));
    for (own, &first) in family.iter_mut().zip(firsts) {
        let Some(own) = own else { continue };
        own.p_holm = p[first];
        own.equivalence.iter_mut().for_each(|equivalence| equivalence.p_holm = of_equivalence[first]);
        own.simultaneous = own.interval.map(|ends| simultaneous(ends, own.pairs, tests));
    }
}

/// Returns, for each item, the first that is the same.
pub(in crate::report) fn firsts<T>(items: &[T], same: impl Fn(&T, &T) -> bool) -> Vec<usize> {
    let first = |i: usize| items[..i].iter().position(|item| same(item, &items[i]));
    (0..items.len()).map(|i| first(i).unwrap_or(i)).collect()
}

/// Returns whether two lines are one comparison, which counts once. Examples are a point in several lines, and
/// settings that give the same training, such as step sizes that all reach the set's corners. Different trainings
/// never agree in every digit of every metric.
fn is_same_experiment(a: &Line, b: &Line) -> bool {
    let numbers = |cell: &Cell| (cell.n, cell.mean, cell.deviation, cell.comparison);
    let equal = || a.cells.iter().map(numbers).eq(b.cells.iter().map(numbers));
    let measured = a.cells.iter().any(|cell| cell.comparison.is_some());
    a.baseline == b.baseline && (!a.ids.is_empty() && a.ids == b.ids || measured && equal())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(differences: &[f64], p_holm: f64, margin: Option<f64>) -> Comparison {
        Comparison { p_holm: Some(p_holm), ..Comparison::new(differences, margin).unwrap() }
    }

    #[test]
    fn words_follow_holm_s_p_and_not_the_interval() {
        let above = [0.5, 0.52, 0.48];
        assert_eq!(of(&above, 0.04, None).verdict(), Some(Verdict::Higher));
        assert_eq!(of(&above.map(|x| -x), 0.04, None).verdict(), Some(Verdict::Lower));
        // The interval excludes 0, but the corrected p is not significant: no verdict.
        assert!(Comparison::new(&above, None).unwrap().interval.unwrap().0 > 0.0);
        assert_eq!(of(&above, SIGNIFICANCE, None).verdict(), None);
        assert_eq!(of(&[0.5, -0.4, 0.1], 1.0, None).verdict(), Some(Verdict::NotDistinguishable));
        assert_eq!(Comparison::new(&[0.5], None).unwrap().verdict(), None);
    }

    #[test]
    fn equivalence_takes_a_stated_margin_and_holm_s_p() {
        let near = [0.01, -0.01, 0.02];
        assert!(!of(&near, 1.0, None).is_equivalent(), "no margin, no claim");
        let mut stated = of(&near, 1.0, Some(0.3));
        let equivalence = stated.equivalence.as_mut().unwrap();
        assert!(equivalence.p.unwrap() < 0.01);
        equivalence.p_holm = Some(0.06);
        assert!(!stated.is_equivalent());
        stated.equivalence.as_mut().unwrap().p_holm = Some(0.02);
        assert!(stated.is_equivalent());
        // A difference may be significant, and too small to matter.
        assert_eq!(of(&[0.1, 0.11, 0.1], 0.01, Some(0.3)).verdict(), Some(Verdict::Higher));
    }
}

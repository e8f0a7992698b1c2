//! A line against its baseline, and the one rule for what may be said of it: what Holm's correction within a scene and
//! metric leaves below [`SIGNIFICANCE`]. Tables, CSV and figures all ask here.

use std::borrow::Borrow;

use super::{Cell, Line};
use crate::report::statistics::{SIGNIFICANCE, equivalence_p_value, holm, interval, mean, p_value, standard_deviation};

/// A metric of a line against that of its baseline, paired by seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Seeds that both have.
    pub pairs: usize,
    /// Mean of ours minus the baseline's.
    pub difference: f64,
    /// Standard deviation of the differences; none of one pair.
    pub deviation: Option<f64>,
    /// Ends of the 95 % interval; none of one pair.
    pub interval: Option<(f64, f64)>,
    /// P value of the paired t test; none of one pair.
    pub p: Option<f64>,
    /// The same after Holm's correction over the scene's lines with a baseline.
    pub p_holm: Option<f64>,
    /// The test of being as good as equal; none where the definition states no margin for the metric.
    pub equivalence: Option<Equivalence>,
}

/// Two one-sided paired t tests that a difference lies within a margin of 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equivalence {
    /// A smaller difference, up or down, counts as none; in the metric's unit.
    pub margin: f64,
    /// The larger of the two p values; none of one pair.
    pub p: Option<f64>,
    /// The same after Holm's correction over the scene's lines with a baseline.
    pub p_holm: Option<f64>,
}

/// What may be said of a difference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The interval holds 0. That is no proof of equality, which is [`Equivalence`]'s to give.
    NotDistinguishable,
    /// Above 0, by Holm's p.
    Higher,
    /// Below 0, by Holm's p.
    Lower,
}

impl Verdict {
    /// The words in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::NotDistinguishable => "not distinguishable",
            Verdict::Higher => "higher",
            Verdict::Lower => "lower",
        }
    }

    /// The row differs from its baseline.
    pub fn is_difference(self) -> bool {
        self != Verdict::NotDistinguishable
    }
}

impl Equivalence {
    /// Both tests pass Holm's correction: the row is equivalent to its baseline within the margin.
    pub fn holds(&self) -> bool {
        self.p_holm.is_some_and(|p| p < SIGNIFICANCE)
    }
}

impl Comparison {
    pub(super) fn new(differences: &[f64], margin: Option<f64>) -> Option<Comparison> {
        let equivalence = |margin| Equivalence { margin, p: equivalence_p_value(differences, margin), p_holm: None };
        Some(Comparison {
            pairs: differences.len(),
            difference: mean(differences)?,
            deviation: standard_deviation(differences),
            interval: interval(differences),
            p: p_value(differences),
            p_holm: None,
            equivalence: margin.map(equivalence),
        })
    }

    /// What may be said of the difference. Nothing of one pair, and nothing where the interval leaves out 0 while Holm's p
    /// is [`SIGNIFICANCE`] or more: there the interval speaks for itself.
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

    /// The row is shown to be equivalent to its baseline, within the margin that the definition states.
    pub fn is_equivalent(&self) -> bool {
        self.equivalence.is_some_and(|equivalence| equivalence.holds())
    }
}

/// Fills the p values after Holm's correction: one family is a metric's comparisons within a scene, and one its tests of
/// equivalence.
pub(super) fn correct_p_values(lines: &mut [Line]) {
    for scene in lines.chunk_by_mut(|a, b| a.scene == b.scene) {
        let firsts = firsts(scene);
        for metric in 0..scene[0].cells.len() {
            correct(scene, &firsts, metric, |c| c.p, |c, p| c.p_holm = p);
            let of_equivalence = |c: &Comparison| c.equivalence.and_then(|equivalence| equivalence.p);
            correct(scene, &firsts, metric, of_equivalence, |c, p| {
                c.equivalence.iter_mut().for_each(|equivalence| equivalence.p_holm = p);
            });
        }
    }
}

/// How many comparisons of the metric the scene's p values are corrected over, once points that are still to come are there.
pub fn comparisons_to_come(scene: &[&Line], metric: usize) -> usize {
    let tested = |line: &Line| {
        let measured = line.cells[metric].comparison.is_some_and(|comparison| comparison.pairs > 1);
        line.baseline.is_some() && !line.quoted && (measured || line.ids.len() < line.points)
    };
    let alone = |(i, first): (usize, &usize)| i == *first && tested(scene[i]);
    firsts(scene).iter().enumerate().filter(|&place| alone(place)).count()
}

/// Of each line the first one that is the same experiment.
fn firsts<L: Borrow<Line>>(scene: &[L]) -> Vec<usize> {
    let first = |i: usize| scene[..i].iter().position(|line| is_same_experiment(line.borrow(), scene[i].borrow()));
    (0..scene.len()).map(|i| first(i).unwrap_or(i)).collect()
}

fn correct(
    scene: &mut [Line],
    firsts: &[usize],
    metric: usize,
    p_value: impl Fn(&Comparison) -> Option<f64>,
    fill: impl Fn(&mut Comparison, Option<f64>),
) {
    let first = |(i, line): (usize, &Line)| {
        line.cells[metric].comparison.as_ref().filter(|_| firsts[i] == i).and_then(&p_value)
    };
    let corrected = holm(&scene.iter().enumerate().map(first).collect::<Vec<Option<f64>>>());
    for (line, first) in scene.iter_mut().zip(firsts) {
        if let Some(comparison) = &mut line.cells[metric].comparison {
            fill(comparison, corrected[*first]);
        }
    }
}

/// Whether two lines are one comparison, which counts once: a point that stands in several lines, as the best one of a
/// figure does, and settings that come to the same training, as step sizes do that all land on the set's corners. Trainings
/// that differ in anything do not agree in every digit of every metric.
fn is_same_experiment(a: &Line, b: &Line) -> bool {
    let numbers = |cell: &Cell| (cell.n, cell.mean, cell.deviation, cell.comparison);
    let equal = || a.cells.iter().map(numbers).eq(b.cells.iter().map(numbers));
    let measured = a.cells.iter().any(|cell| cell.comparison.is_some());
    a.baseline == b.baseline && (a.ids == b.ids || measured && equal())
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
        // The interval leaves out 0, the correction does not pass: no word.
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
        // A difference may be sure, and too small to matter.
        assert_eq!(of(&[0.1, 0.11, 0.1], 0.01, Some(0.3)).verdict(), Some(Verdict::Higher));
    }
}

//! Column headings of metrics for readers, and the one rule for bold numbers.

use super::{Cell, Comparison, Verdict};
use crate::metrics::{Direction, Metric};

/// A metric's name, unit and better direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heading<'a> {
    /// Name as in figures, without its unit.
    pub name: &'a str,
    /// Its unit; empty for a ratio.
    pub unit: &'a str,
    /// `↑` if more is better, `↓` if less is, empty for a descriptive metric.
    pub arrow: &'static str,
}

impl Heading<'_> {
    /// Returns the heading of a metric by its key.
    pub fn of(key: &str) -> Heading<'_> {
        let Some(metric) = Metric::find(key) else { return Heading { name: key, unit: "", arrow: "" } };
        let name = metric.label.strip_suffix(')').and_then(|name| name.strip_suffix(metric.unit));
        let name = name.and_then(|name| name.strip_suffix(" (")).filter(|_| !metric.unit.is_empty());
        let arrow = match metric.direction {
            Direction::Up => "↑",
            Direction::Down => "↓",
            Direction::Neither => "",
        };
        Heading { name: name.unwrap_or(metric.label), unit: metric.unit, arrow }
    }

    /// Returns the unit with raised exponents.
    pub fn unit_text(&self) -> String {
        self.unit.replace("^2", "²").replace("^3", "³")
    }

    /// Returns name, unit and arrow as one text: `PSNR (dB) ↑`.
    pub fn lines_text(&self) -> String {
        let unit = if self.unit.is_empty() { String::new() } else { format!(" ({})", self.unit_text()) };
        let space = if self.arrow.is_empty() { "" } else { " " };
        format!("{}{unit}{space}{}", self.name, self.arrow)
    }
}

/// What a difference to the baseline means for a reader: the one rule for bold numbers, colours and marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judgement {
    /// Better than the baseline, by Holm's p.
    Better,
    /// Worse than the baseline, by Holm's p.
    Worse,
    /// Higher, of a metric that is not better in either direction.
    Higher,
    /// Lower, of such a metric.
    Lower,
    /// No difference is shown.
    NotShown,
}

impl Judgement {
    /// Judges a comparison of a metric.
    pub fn of(metric: &str, comparison: &Comparison) -> Judgement {
        let direction = Metric::find(metric).map_or(Direction::Neither, |metric| metric.direction);
        match (comparison.verdict(), direction) {
            (Some(Verdict::Higher), Direction::Up) | (Some(Verdict::Lower), Direction::Down) => Judgement::Better,
            (Some(Verdict::Higher), Direction::Down) | (Some(Verdict::Lower), Direction::Up) => Judgement::Worse,
            (Some(Verdict::Higher), Direction::Neither) => Judgement::Higher,
            (Some(Verdict::Lower), Direction::Neither) => Judgement::Lower,
            (Some(Verdict::NotDistinguishable) | None, _) => Judgement::NotShown,
        }
    }

    /// Returns the word; empty where no difference is shown.
    pub fn name(self) -> &'static str {
        match self {
            Judgement::Better => "better",
            Judgement::Worse => "worse",
            Judgement::Higher => "higher",
            Judgement::Lower => "lower",
            Judgement::NotShown => "",
        }
    }
}

/// Returns whether a cell is better than the baseline by Holm's p, and so printed bold. Never for a descriptive
/// metric.
pub fn is_better(cell: &Cell) -> bool {
    cell.comparison.is_some_and(|comparison| Judgement::of(&cell.metric, &comparison) == Judgement::Better)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_name_unit_and_better_way() {
        let texts = ["psnr", "gap", "l1", "lpips_vgg", "occupied", "mine"].map(|key| Heading::of(key).lines_text());
        assert_eq!(
            texts,
            [
                "PSNR (dB) ↑",
                "PSNR, training minus held-out (dB)",
                "l1 of density (scene units²)",
                "LPIPS (vgg) ↓",
                "occupied",
                "mine"
            ]
        );
    }
}

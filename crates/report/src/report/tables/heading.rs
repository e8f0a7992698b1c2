//! Column headings of metrics for readers, and the one rule for bold numbers.

use super::{Cell, Verdict};
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

    /// Returns whether a word is one of the arrows.
    pub fn is_arrow(word: &str) -> bool {
        ["↑", "↓"].contains(&word)
    }
}

/// Returns whether a cell is better than the baseline by Holm's p, and so printed bold. Never for a descriptive
/// metric.
pub fn is_better(cell: &Cell) -> bool {
    is_on(cell, [Verdict::Higher, Verdict::Lower])
}

/// Returns whether a cell is worse than the baseline by Holm's p.
pub fn is_worse(cell: &Cell) -> bool {
    is_on(cell, [Verdict::Lower, Verdict::Higher])
}

/// Returns whether the verdict is the first if more is better, the second if less is.
fn is_on(cell: &Cell, [up, down]: [Verdict; 2]) -> bool {
    let wanted = match Metric::find(&cell.metric).map(|metric| metric.direction) {
        Some(Direction::Up) => up,
        Some(Direction::Down) => down,
        Some(Direction::Neither) | None => return false,
    };
    cell.comparison.and_then(|comparison| comparison.verdict()) == Some(wanted)
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
                "l1 of density (scene units²) ↓",
                "LPIPS (vgg) ↓",
                "occupied",
                "mine"
            ]
        );
    }
}

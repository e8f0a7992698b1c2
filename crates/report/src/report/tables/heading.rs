//! A metric at the head of a column for readers, and the one rule for bold numbers.

use super::{Cell, Verdict};
use crate::metrics::{Direction, Metric};

/// A metric's name, unit and better way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heading<'a> {
    /// As figures name it, without its unit.
    pub name: &'a str,
    /// Its unit; empty for a ratio.
    pub unit: &'a str,
    /// `↑` where more is better, `↓` where less is, nothing where it describes.
    pub arrow: &'static str,
}

impl Heading<'_> {
    /// Of a metric by its key.
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

    /// The unit with raised exponents.
    pub fn unit_text(&self) -> String {
        self.unit.replace("^2", "²").replace("^3", "³")
    }

    /// Name, unit and arrow as one text: `PSNR (dB) ↑`.
    pub fn lines_text(&self) -> String {
        let unit = if self.unit.is_empty() { String::new() } else { format!(" ({})", self.unit_text()) };
        let space = if self.arrow.is_empty() { "" } else { " " };
        format!("{}{unit}{space}{}", self.name, self.arrow)
    }

    /// Whether a word is one of the arrows.
    pub fn is_arrow(word: &str) -> bool {
        ["↑", "↓"].contains(&word)
    }
}

/// Better than the baseline by Holm's p: what is printed bold. Nothing is of a metric that describes.
pub fn is_better(cell: &Cell) -> bool {
    is_on(cell, [Verdict::Higher, Verdict::Lower])
}

/// Worse than the baseline by Holm's p.
pub fn is_worse(cell: &Cell) -> bool {
    is_on(cell, [Verdict::Lower, Verdict::Higher])
}

/// The verdict is the first where more is better, the second where less is.
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

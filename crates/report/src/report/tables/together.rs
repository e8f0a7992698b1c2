//! Numbers as readers' tables have them: those that stand together have one number of decimals and one power of ten.

use super::Cell;
use crate::draw::numbers::power;
use crate::metrics::{Digits, Metric};

/// Returns a value with the digits of its metric.
pub(super) fn number(metric: &str, value: f64) -> String {
    Metric::find(metric).map_or_else(|| value.to_string(), |metric| metric.text(value))
}

/// Numbers of one metric that stand together: with one number of decimals and one power of ten.
struct Together {
    texts: Vec<String>,
    /// `×10⁵`; empty without a power.
    power: String,
}

/// Decimals that are added at most, so that a spread has a digit.
const MORE_DECIMALS: usize = 4;

/// Returns numbers with so many decimals that their `spread` has a digit, and at least those of the metric.
fn together(metric: &str, values: &[f64], spread: Option<f64>) -> Together {
    let plain = |decimals: usize| Together {
        texts: values.iter().map(|value| format!("{value:.decimals$}")).collect(),
        power: String::new(),
    };
    let largest = values.iter().map(|value| value.abs()).fold(0.0, f64::max);
    match Metric::find(metric).map(|metric| metric.digits) {
        Some(Digits::Decimals(decimals)) => {
            let shows = |decimals: &usize| spread.is_none_or(|spread| spread * 10f64.powi(*decimals as i32) >= 1.0);
            plain((decimals..=decimals + MORE_DECIMALS).find(shows).unwrap_or(decimals))
        }
        None => Together { texts: values.iter().map(f64::to_string).collect(), power: String::new() },
        Some(Digits::Figures) if largest == 0.0 => plain(0),
        Some(Digits::Figures) if (1e-3..1e5).contains(&largest) => {
            plain((3.0 - largest.log10().floor()).max(0.0) as usize)
        }
        Some(Digits::Figures) => {
            let exponent = largest.log10().floor();
            let texts = values.iter().map(|value| format!("{:.3}", value / 10f64.powf(exponent))).collect();
            // The number is that of the power alone.
            Together { texts, power: format!("×{}", power(10f64.powf(exponent))) }
        }
    }
}

/// Returns mean and standard deviation, each complete, with one number of decimals and one power of ten; the deviation
/// is empty for one seed, both for none.
pub fn mean_and_spread(cell: &Cell) -> (String, String) {
    let Some(mean) = cell.mean else { return Default::default() };
    let values: Vec<f64> = std::iter::once(mean).chain(cell.deviation).collect();
    let Together { texts, power } = together(&cell.metric, &values, cell.deviation);
    let mut texts = texts.into_iter().map(|text| text + &power);
    (texts.next().unwrap_or_default(), texts.next().unwrap_or_default())
}

/// Returns `25.31 ± 0.12 (3)`, or `(4.133 ± 0.383)×10⁵ (3)`; without the deviation for one seed, empty for none.
pub fn mean_text(cell: &Cell) -> String {
    let Some(mean) = cell.mean else { return String::new() };
    let values: Vec<f64> = std::iter::once(mean).chain(cell.deviation).collect();
    let Together { texts, power } = together(&cell.metric, &values, cell.deviation);
    let numbers = texts.join(" ± ");
    let numbers = if texts.len() > 1 && !power.is_empty() { format!("({numbers})") } else { numbers };
    format!("{numbers}{power} ({})", cell.n)
}

/// Returns `+0.31 [+0.10, +0.52]`, without brackets if there is no interval.
pub fn signed_interval(metric: &str, difference: f64, interval: Option<(f64, f64)>) -> String {
    let ends = interval.into_iter().flat_map(|(low, high)| [low, high]);
    let values: Vec<f64> = std::iter::once(difference).chain(ends).collect();
    let Together { texts, power } = together(metric, &values, interval.map(|(low, high)| (high - low) / 2.0));
    let texts: Vec<String> = texts.into_iter().map(signed).collect();
    match texts.as_slice() {
        [difference, low, high] => {
            let space = if power.is_empty() { "" } else { " " };
            format!("{difference} [{low}, {high}]{space}{power}")
        }
        _ => texts.concat() + &power,
    }
}

/// Returns a number with its sign. What shows as 0 has none.
fn signed(text: String) -> String {
    match (text.contains(|digit: char| ('1'..='9').contains(&digit)), text.starts_with('-')) {
        (true, false) => format!("+{text}"),
        (true, true) => text,
        (false, _) => text.trim_start_matches('-').into(),
    }
}

/// Returns `[+0.10, +0.52]`, or nothing.
pub fn interval_text(metric: &str, ends: Option<(f64, f64)>) -> String {
    let Some((low, high)) = ends else { return String::new() };
    let Together { texts, power } = together(metric, &[low, high], Some((high - low) / 2.0));
    let ends: Vec<String> = texts.into_iter().map(|text| signed(text) + &power).collect();
    format!("[{}]", ends.join(", "))
}

/// Returns a difference with its sign, with the decimals of its metric and more where it would be 0.
pub fn signed_text(metric: &str, value: f64) -> String {
    let Together { texts, power } = together(metric, &[value], Some(value.abs()));
    signed(texts.concat()) + &power
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(metric: &str, n: usize) -> Cell {
        Cell { metric: metric.into(), n, mean: Some(1.0), deviation: None, comparison: None, published: None }
    }

    #[test]
    fn numbers_that_stand_together_have_one_exponent_and_one_number_of_decimals() {
        let of = |metric: &str, mean: f64, deviation: f64| {
            mean_text(&Cell { mean: Some(mean), deviation: Some(deviation), ..cell(metric, 3) })
        };
        assert_eq!(of("laplacian", 413300.0, 38340.0), "(4.133 ± 0.383)×10⁵ (3)");
        assert_eq!(of("l1", 76.24, 0.1677), "76.24 ± 0.17 (3)");
        assert_eq!(of("tv", 1065.0, 107.4), "1065 ± 107 (3)");
        assert_eq!(of("psnr", 18.974, 0.05), "18.97 ± 0.05 (3)");
        assert_eq!(of("ssim", 0.29312, 0.0004), "0.2931 ± 0.0004 (3)");
        assert_eq!([of("psnr", 18.974, 0.0), of("psnr", 18.974, 1e-9)], ["18.97 ± 0.00 (3)"; 2]);
        assert_eq!(signed_interval("psnr", -0.002, Some((-0.006, 0.002))), "-0.002 [-0.006, +0.002]");
        assert_eq!(signed_interval("psnr", -0.0, Some((-0.0, 0.0))), "0.00 [0.00, 0.00]");
        assert_eq!(signed_interval("l1", -1.388, Some((-3.259, 0.483))), "-1.388 [-3.259, +0.483]");
        assert_eq!(signed_interval("tv", 2e-6, Some((-1e-7, 4.1e-6))), "+2.000 [-0.100, +4.100] ×10⁻⁶");
        let one = Cell { mean: Some(413300.0), ..cell("laplacian", 1) };
        assert_eq!((mean_text(&one), mean_and_spread(&one).0), ("4.133×10⁵ (1)".into(), "4.133×10⁵".into()));
    }
}

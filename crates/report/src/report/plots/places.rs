//! Where the values of an axis stand along a panel.
//!
//! Numbers stand at their value: on a logarithmic scale if they span more than two decades or are spaced so, with 0
//! apart. Words stand side by side, in the order of the sweep.

use crate::draw::numbers::{short, values};

/// Margins of a scale, as shares of the panel.
const MARGIN: f64 = 0.06;
/// Where the positive values of a logarithmic scale start if 0 stands apart.
const BEYOND_ZERO: f64 = 0.22;
/// Ratio of the largest to the smallest value from which on a scale is logarithmic.
const DECADES: f64 = 100.0;
/// Least ratio of a scale that is logarithmic by the spacing of its values.
const LEAST_RATIO: f64 = 4.0;

/// The values of an axis, from left to right.
pub(super) struct Places<'a> {
    pub(super) values: Vec<&'a str>,
    scale: Scale,
}

enum Scale {
    Words,
    Linear(Vec<f64>),
    /// 0 may be the first.
    Logarithmic(Vec<f64>),
}

impl<'a> Places<'a> {
    pub(super) fn new(values: &[&'a str]) -> Places<'a> {
        let Some(numbers) = numbers(values) else { return Places { values: values.to_vec(), scale: Scale::Words } };
        let mut sorted: Vec<(f64, &str)> = numbers.into_iter().zip(values.iter().copied()).collect();
        sorted.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let (numbers, values): (Vec<f64>, Vec<&str>) = sorted.into_iter().unzip();
        let scale = if is_logarithmic(&numbers) { Scale::Logarithmic(numbers) } else { Scale::Linear(numbers) };
        Places { values, scale }
    }

    /// Returns the place of a value in the order of drawing.
    pub(super) fn index(&self, value: &str) -> usize {
        self.values.iter().position(|known| *known == value).expect("one of the axis's values")
    }

    pub(super) fn is_words(&self) -> bool {
        matches!(self.scale, Scale::Words)
    }

    /// Returns whether 0 stands apart.
    pub(super) fn has_zero_apart(&self) -> bool {
        matches!(&self.scale, Scale::Logarithmic(numbers) if numbers[0] == 0.0)
    }

    /// Returns where a value stands: 0 is the panel's left edge, 1 its right one.
    pub(super) fn share(&self, index: usize) -> f64 {
        let between = |from: f64, share: f64| from + (1.0 - MARGIN - from) * share;
        match &self.scale {
            Scale::Words => (index as f64 + 0.5) / self.values.len() as f64,
            Scale::Linear(numbers) | Scale::Logarithmic(numbers) if numbers.len() == 1 => 0.5,
            Scale::Linear(numbers) => between(MARGIN, position(numbers, index, |value| value)),
            Scale::Logarithmic(numbers) if numbers[0] == 0.0 => match index {
                0 => MARGIN,
                _ => between(BEYOND_ZERO, position(&numbers[1..], index - 1, f64::ln)),
            },
            Scale::Logarithmic(numbers) => between(MARGIN, position(numbers, index, f64::ln)),
        }
    }

    /// Returns whether a line joins a value with the next.
    pub(super) fn is_joined(&self, index: usize) -> bool {
        !self.is_words() && (index > 0 || !self.has_zero_apart())
    }

    /// Returns what stands below each value: one line for each setting that is varied together.
    pub(super) fn texts(&self) -> Vec<Vec<String>> {
        let parts: Vec<Vec<&str>> = self.values.iter().map(|value| value.split(" / ").collect()).collect();
        let number = |text: &str| text.parse::<f64>().ok().filter(|number| number.is_finite());
        let count = parts.iter().map(Vec::len).max().unwrap_or(1);
        // Numbers of one setting are written in one style.
        let of_setting = |part: usize| -> Vec<String> {
            let texts: Vec<&str> = parts.iter().map(|parts| parts.get(part).copied().unwrap_or_default()).collect();
            match texts.iter().map(|text| number(text)).collect::<Option<Vec<f64>>>() {
                Some(numbers) => values(&numbers),
                None => texts.into_iter().map(short).collect(),
            }
        };
        let settings: Vec<Vec<String>> = (0..count).map(of_setting).collect();
        (0..parts.len()).map(|value| settings.iter().map(|texts| texts[value].clone()).collect()).collect()
    }
}

/// Returns where a number lies between the first and the last.
fn position(numbers: &[f64], index: usize, scaled: fn(f64) -> f64) -> f64 {
    let (low, high) = (scaled(numbers[0]), scaled(numbers[numbers.len() - 1]));
    if high > low { (scaled(numbers[index]) - low) / (high - low) } else { 0.5 }
}

/// Returns each value's number, or `None` for words. Of settings that are varied together it is the first that tells
/// all values apart, if the others rise or fall with it.
fn numbers(texts: &[&str]) -> Option<Vec<f64>> {
    let number = |text: &str| text.parse::<f64>().ok().filter(|number| number.is_finite());
    let parts = |text: &&str| text.split(" / ").map(number).collect::<Option<Vec<f64>>>();
    let rows: Vec<Vec<f64>> = texts.iter().map(parts).collect::<Option<_>>()?;
    let count = rows.first()?.len();
    if rows.iter().any(|row| row.len() != count) {
        return None;
    }
    let column = |part: usize| -> Vec<f64> { rows.iter().map(|row| row[part]).collect() };
    let is_distinct = |values: &[f64]| (0..values.len()).all(|i| (0..i).all(|j| values[i] != values[j]));
    let leading = (0..count).map(column).find(|values| is_distinct(values))?;
    let mut order: Vec<usize> = (0..leading.len()).collect();
    order.sort_by(|&a, &b| leading[a].total_cmp(&leading[b]));
    let goes_along = |part: usize| {
        let values: Vec<f64> = order.iter().map(|&row| rows[row][part]).collect();
        values.is_sorted() || values.iter().rev().is_sorted()
    };
    (0..count).all(goes_along).then_some(leading)
}

/// Returns whether ascending numbers belong on a logarithmic scale.
fn is_logarithmic(numbers: &[f64]) -> bool {
    let positive: Vec<f64> = numbers.iter().copied().filter(|number| *number > 0.0).collect();
    let (Some(first), Some(last)) = (positive.first(), positive.last()) else { return false };
    if numbers[0] < 0.0 || positive.len() < 2 {
        return false;
    }
    // The evener of two spacings has the smaller ratio of its widest gap to its narrowest.
    let unevenness = |scaled: fn(f64) -> f64| {
        let gaps = positive.windows(2).map(|pair| scaled(pair[1]) - scaled(pair[0]));
        let (low, high) = gaps.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), gap| (low.min(gap), high.max(gap)));
        high / low
    };
    last / first > DECADES
        || positive.len() > 2 && last / first >= LEAST_RATIO && unevenness(f64::ln) < unevenness(|value| value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shares(values: &[&str]) -> (Vec<String>, Vec<f64>) {
        let places = Places::new(values);
        let texts = places.texts().into_iter().map(|lines| lines.join("|")).collect();
        (texts, (0..values.len()).map(|index| (places.share(index) * 1e3).round() / 1e3).collect())
    }

    #[test]
    fn numbers_stand_at_their_value_and_are_sorted() {
        // A value that was added later stands where it belongs.
        let (texts, places) = shares(&["1e-3", "1e-2", "1e-4", "0.00001"]);
        assert_eq!(texts, ["10⁻⁵", "10⁻⁴", "10⁻³", "10⁻²"]);
        assert_eq!(places, [0.06, 0.353, 0.647, 0.94]);
        let (texts, places) = shares(&["1", "2", "4", "5"]);
        assert_eq!(texts, ["1", "2", "4", "5"]);
        assert_eq!(places, [0.06, 0.28, 0.72, 0.94]);
        assert_eq!(shares(&["7"]).1, [0.5]);
        assert_eq!(shares(&["-10", "0.1", "100"]).1[0], 0.06);
    }

    #[test]
    fn zero_stands_apart_on_a_logarithmic_scale() {
        let places = Places::new(&["1", "0", "3", "10"]);
        assert!(places.has_zero_apart() && !places.is_joined(0) && places.is_joined(1));
        assert_eq!((places.values[0], places.share(0), places.share(1)), ("0", 0.06, 0.22));
        assert!(!Places::new(&["0", "1", "2", "3"]).has_zero_apart());
    }

    #[test]
    fn words_keep_their_order() {
        let places = Places::new(&["worst-case", "1", "random"]);
        assert!(places.is_words() && !places.is_joined(0));
        assert_eq!(places.values, ["worst-case", "1", "random"]);
    }

    #[test]
    fn settings_that_vary_together_stand_below_one_another() {
        let together = ["0.25 / 1.0", "0.0625 / 0.25", "0.5 / 4.0"];
        let (texts, places) = shares(&together);
        assert_eq!(texts, ["0.0625|0.25", "0.25|1", "0.5|4"]);
        assert!(places.is_sorted());
        // Where one rises and another goes up and down, there is no order by value.
        assert!(Places::new(&["1 / 2", "2 / 1", "3 / 5"]).is_words());
        assert_eq!(Places::new(&["1 / tv", "2 / l1"]).texts()[1], ["2", "l1"]);
    }
}

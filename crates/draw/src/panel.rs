//! Round numbers across a range, and rectangles with a vertical scale.

use super::canvas::{Anchor, BLACK, Canvas, GRID, TEXT};
use super::numbers::numbers;
use super::words::text_width;

/// Values beyond are drawn there, and nearer to one another than [`LEAST_SPAN`] as equal: a scale has to have a length.
const MOST: f64 = 1e300;
const LEAST_SPAN: f64 = 1e-200;

/// Round numbers across a range, and the step between them.
pub fn ticks(range: (f64, f64), most: usize) -> (Vec<f64>, f64) {
    // A scale needs two numbers.
    let found = (most..=most + FINER).map(|most| ticks_of(range, most));
    found.into_iter().find(|(values, _)| values.len() > 1).unwrap_or_else(|| ticks_of(range, most))
}

/// Further steps that are tried where a range has only one round number.
const FINER: usize = 4;

fn ticks_of((low, high): (f64, f64), most: usize) -> (Vec<f64>, f64) {
    let raw = (high - low) / most as f64;
    if !(raw > LEAST_SPAN && raw < MOST) {
        return (Vec::new(), 1.0);
    }
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|step| *step >= raw).unwrap_or(raw);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    ((first..=last).map(|i| i as f64 * step).collect(), step)
}

/// Returns as many round numbers across a range as fit side by side along `width`, each with its text.
pub fn tick_texts(range: (f64, f64), width: f64) -> Vec<(f64, String)> {
    const BETWEEN: f64 = 14.0;
    let with = |most: usize| {
        let (values, step) = ticks(range, most);
        let texts = numbers(&values, step);
        (values.into_iter().zip(texts).collect::<Vec<(f64, String)>>(), step)
    };
    let fits = |(texts, step): &(Vec<(f64, String)>, f64)| {
        let widest = texts.iter().map(|(_, text)| text_width(text, TEXT)).fold(0.0, f64::max);
        widest + BETWEEN <= width * step / (range.1 - range.0)
    };
    let most = (width / 50.0) as usize + 1;
    (2..=most.max(3)).rev().map(with).find(fits).unwrap_or_else(|| with(2)).0
}

/// A range with some room around its values; none without finite values.
pub fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let finite: Vec<f64> = values.filter(|value| value.is_finite()).map(|value| value.clamp(-MOST, MOST)).collect();
    let low = finite.iter().copied().reduce(f64::min)?;
    let high = finite.iter().copied().reduce(f64::max)?;
    let size = low.abs().max(high.abs());
    // Less than that is rounding, which has no ticks.
    let differ = high - low > (1e-12 * size).max(LEAST_SPAN);
    let room = if differ { 0.08 * (high - low) } else { 0.05 * size.max(1e-6) };
    Some((low - room, high + room))
}

/// A rectangle with a vertical scale.
pub struct Panel {
    /// Left edge in pixels.
    pub left: f64,
    /// Top edge in pixels.
    pub top: f64,
    /// Width in pixels.
    pub width: f64,
    /// Height in pixels.
    pub height: f64,
    /// Values at the bottom and at the top edge.
    pub range: (f64, f64),
}

impl Panel {
    /// Returns the pixel row of a value.
    pub fn y(&self, value: f64) -> f64 {
        let (low, high) = self.range;
        self.top + self.height * (high - value) / (high - low)
    }

    /// Right edge in pixels.
    pub fn right(&self) -> f64 {
        self.left + self.width
    }

    /// Bottom edge in pixels.
    pub fn bottom(&self) -> f64 {
        self.top + self.height
    }

    /// Horizontal grid lines, their numbers where asked for, and the frame.
    pub fn frame(&self, drawing: &mut Canvas, numbers: bool) {
        let (values, step) = ticks(self.range, (self.height / 40.0) as usize + 1);
        let texts = self::numbers(&values, step);
        for (value, text) in values.into_iter().zip(texts) {
            let y = self.y(value);
            drawing.line(&[(self.left, y), (self.right(), y)], GRID, 1.0);
            if numbers {
                drawing.text((self.left - 6.0, y), &text, TEXT, Anchor::Right, BLACK);
            }
        }
        drawing.line(&[(self.left, self.top), (self.left, self.bottom()), (self.right(), self.bottom())], BLACK, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scale_has_two_numbers() {
        for most in 2..=6 {
            for range in [(0.3, 1.7), (19.9, 21.4), (-0.4, 1.2), (99.0, 104.0), (1e-6, 1.9e-6), (0.16, 0.93)] {
                let (values, _) = ticks(range, most);
                assert!(values.len() > 1 && values.len() <= most + FINER, "{range:?} {most}: {values:?}");
            }
        }
        assert!(ticks((1.0, 1.0), 3).0.is_empty());
    }
}

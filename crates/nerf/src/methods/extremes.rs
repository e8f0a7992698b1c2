//! The extremes of a step's rays, by which a run is seen to be dead.

use candle_core::{DType, Tensor};

use crate::base::Result;

/// Channels of a colour.
const RGB: usize = 3;

/// The extremes of accumulation and colours over the rays of a step. Extremes of parts join into those of the whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremes {
    /// The largest accumulated weight of a ray.
    pub largest_acc: f64,
    /// Lowest and highest value of each channel of the rendered colours, without density noise where it is at hand.
    rendered: [[f64; 2]; RGB],
    /// The same of the photos' colours.
    target: [[f64; 2]; RGB],
}

impl Extremes {
    /// Numbers that [`Extremes::read`] takes.
    const LENGTH: usize = 1 + 4 * RGB;

    /// Returns the extremes of no ray, with an accumulation for methods that accumulate nothing.
    pub const fn none(largest_acc: f64) -> Extremes {
        let none = [[f64::INFINITY, f64::NEG_INFINITY]; RGB];
        Extremes { largest_acc, rendered: none, target: none }
    }

    /// Returns the extremes of rays, of accumulations `[rays, ...]`, and rendered and true colours `[rays, 3]`.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn of(acc: &Tensor, rendered: &Tensor, target: &Tensor) -> Result<Extremes> {
        let highest = |colours: &Tensor| colours.max(0);
        let parts = [
            acc.flatten_all()?.max_keepdim(0)?,
            highest(rendered)?,
            highest(&rendered.neg()?)?,
            highest(target)?,
            highest(&target.neg()?)?,
        ];
        Ok(Extremes::read(&Tensor::cat(&parts, 0)?.detach().to_dtype(DType::F64)?.to_vec1()?))
    }

    /// Reads 13 numbers: the largest accumulation, and the largest of each channel of rendered colours, of their negatives,
    /// of true colours and of theirs.
    ///
    /// # Panics
    /// If there are not 13.
    pub fn read(values: &[f64]) -> Extremes {
        assert_eq!(values.len(), Extremes::LENGTH, "an accumulation, and two extremes of two colours");
        let ranges = |first: usize| std::array::from_fn(|c| [-values[first + RGB + c], values[first + c]]);
        Extremes { largest_acc: values[0], rendered: ranges(1), target: ranges(1 + 2 * RGB) }
    }

    /// Adds a ray's channel to the ranges.
    pub fn add(&mut self, channel: usize, rendered: f64, target: f64) {
        let widen = |[low, high]: [f64; 2], value: f64| [low.min(value), high.max(value)];
        self.rendered[channel] = widen(self.rendered[channel], rendered);
        self.target[channel] = widen(self.target[channel], target);
    }

    /// Returns the extremes of two parts. NaN is dropped; the step's loss is checked for it.
    pub fn join(self, other: Extremes) -> Extremes {
        let union = |a: [[f64; 2]; RGB], b: [[f64; 2]; RGB]| {
            std::array::from_fn(|c| [a[c][0].min(b[c][0]), a[c][1].max(b[c][1])])
        };
        Extremes {
            largest_acc: self.largest_acc.max(other.largest_acc),
            rendered: union(self.rendered, other.rendered),
            target: union(self.target, other.target),
        }
    }

    /// Returns the largest difference of a rendered channel between two rays.
    pub fn rendered_spread(&self) -> f64 {
        spread(&self.rendered)
    }

    /// Returns the same of the photos.
    pub fn target_spread(&self) -> f64 {
        spread(&self.target)
    }
}

fn spread(ranges: &[[f64; 2]; RGB]) -> f64 {
    ranges.iter().map(|[low, high]| high - low).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    /// The extremes of all rays, the same by parts, and single additions agree with each other and with a case worked out by hand.
    #[test]
    fn extremes_of_parts_join_into_those_of_the_whole() {
        let rendered = [[0.1f64, 0.5, 0.9], [0.2, 0.5, 0.4], [0.1, 0.75, 0.4]];
        let target = [[1.0f64, 0.0, 0.0], [1.0, 0.25, 0.0], [1.0, 0.0, 0.0]];
        let acc = [0.25f64, 0.75, 0.5];
        let extremes = |rays: std::ops::Range<usize>| {
            let tensor =
                |colours: &[[f64; 3]]| Tensor::from_vec(colours.concat(), (colours.len(), 3), &Device::Cpu).unwrap();
            let acc = Tensor::new(&acc[rays.clone()], &Device::Cpu).unwrap();
            Extremes::of(&acc, &tensor(&rendered[rays.clone()]), &tensor(&target[rays])).unwrap()
        };
        let all = extremes(0..3);
        assert_eq!(all.largest_acc, 0.75);
        assert_eq!((all.rendered_spread(), all.target_spread()), (0.9 - 0.4, 0.25));
        assert_eq!(extremes(0..1).join(extremes(1..3)), all);
        let mut added = Extremes::none(0.75);
        for (rendered, target) in rendered.iter().zip(&target) {
            (0..3).for_each(|channel| added.add(channel, rendered[channel], target[channel]));
        }
        assert_eq!(added, all);
    }
}

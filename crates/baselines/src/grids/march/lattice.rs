//! Where a point lies among a grid's cells: the fast path of [`super::super::trilinear`].

use candle_core::WithDType;

/// A corner of the cell around a point.
pub(super) struct Corner<T> {
    pub(super) cell: usize,
    /// 0 if there is no such cell.
    pub(super) weight: T,
}

/// The size of a grid, along z, y, x. Around it are zeros.
#[derive(Clone, Copy)]
pub(super) struct Lattice {
    pub(super) sides: [usize; 3],
}

/// The location of a point among the cells.
pub(super) struct Location<T> {
    /// Index of the corner before the point, along z, y, x.
    low: [isize; 3],
    /// Distance of the point from it, 0..1.
    part: [T; 3],
    /// Change of the location, in cells, per unit of the coordinate.
    scale: [T; 3],
    sides: [usize; 3],
}

impl Lattice {
    /// Returns the location of the point x, y, z.
    #[inline(always)]
    pub(super) fn place<T: WithDType>(&self, point: [T; 3]) -> Location<T> {
        let along: [(isize, T, T); 3] = std::array::from_fn(|axis| {
            let last = (self.sides[axis] - 1) as f64;
            let at = (point[2 - axis].to_f64() + 1.0) * 0.5 * last;
            let held = at.clamp(-2.0, last + 2.0);
            (held.floor() as isize, T::from_f64(held - held.floor()), T::from_f64(0.5 * last))
        });
        Location {
            low: along.map(|(low, ..)| low),
            part: along.map(|(_, part, _)| part),
            scale: along.map(|(.., scale)| scale),
            sides: self.sides,
        }
    }
}

impl<T: WithDType> Location<T> {
    /// Returns the weight of the nearer (0) or farther (1) cells along an axis.
    #[inline(always)]
    fn along(&self, axis: usize, side: usize) -> T {
        if side == 1 { self.part[axis] } else { T::one() - self.part[axis] }
    }

    #[inline(always)]
    fn cell(&self, corner: usize) -> Option<usize> {
        let at = |axis: usize| self.low[axis] + (corner >> (2 - axis) & 1) as isize;
        let inside = (0..3).all(|axis| (at(axis) as usize) < self.sides[axis]);
        inside.then(|| (at(0) as usize * self.sides[1] + at(1) as usize) * self.sides[2] + at(2) as usize)
    }

    /// Returns the eight corners.
    #[inline(always)]
    pub(super) fn corners(&self) -> [Corner<T>; 8] {
        std::array::from_fn(|corner| match self.cell(corner) {
            Some(cell) => {
                let [z, y, x] = [0, 1, 2].map(|axis| self.along(axis, corner >> (2 - axis) & 1));
                Corner { cell, weight: z * y * x }
            }
            None => Corner { cell: 0, weight: T::zero() },
        })
    }

    /// Returns the gradient in x, y, z of the interpolated value.
    #[inline(always)]
    pub(super) fn slope(&self, value: impl Fn(usize) -> T) -> [T; 3] {
        let mut slope = [T::zero(); 3];
        for corner in 0..8 {
            let Some(cell) = self.cell(corner) else { continue };
            let value = value(cell);
            let side = |axis: usize| corner >> (2 - axis) & 1;
            let weights = [0, 1, 2].map(|axis| self.along(axis, side(axis)));
            for axis in 0..3 {
                let others = weights[(axis + 1) % 3] * weights[(axis + 2) % 3] * value * self.scale[axis];
                slope[2 - axis] = if side(axis) == 1 { slope[2 - axis] + others } else { slope[2 - axis] - others };
            }
        }
        slope
    }
}

//! The part of space that a hash grid covers.

use serde::{Deserialize, Serialize};

use super::{Operator, Real};

/// What happens to points outside the box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Contraction {
    /// They are empty: their density is 0.
    None,
    /// Contracts each axis separately, so that boxes stay boxes: all of space maps into twice the box.
    Axes,
    /// Contracts all axes together (Barron et al. 2022, equation 10): all of space maps into a ball of twice the box's
    /// size.
    Ball,
}

/// A box of the scene's space, and the map of it and the space around it into the unit cube.
///
/// Without a contraction the box fills the cube. Contracted by axes, it fills the middle half of the cube along each
/// axis, and infinity maps to the cube's faces. Contracted to a ball, the ball within the box fills the ball of half
/// the cube's size. It is an ellipsoid if the box's sides differ. Infinity then maps to the ball within the cube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Domain {
    low: [f64; 3],
    high: [f64; 3],
    contraction: Contraction,
}

impl Domain {
    /// Creates the box from `low` to `high`, in scene units.
    ///
    /// # Panics
    /// If a side is not finite and longer than 0. Settings are checked before.
    pub fn new(low: [f64; 3], high: [f64; 3], contraction: Contraction) -> Domain {
        let side = |axis: usize| high[axis] - low[axis];
        assert!(
            (0..3).all(|axis| side(axis) > 0.0 && side(axis).is_finite()),
            "a box without inside: {low:?} {high:?}"
        );
        Domain { low, high, contraction }
    }

    /// Returns the lower and the upper corner of the box.
    pub fn corners(&self) -> ([f64; 3], [f64; 3]) {
        (self.low, self.high)
    }

    /// Returns the treatment of the space around the box.
    pub fn contraction(&self) -> Contraction {
        self.contraction
    }

    /// Maps scene points `points [n, 3]` to the cube, `unit [n, 3]`, with whether each is inside, `inside [n]`. Points
    /// outside are moved to the cube's faces. A point that is not finite becomes NaN and counts as inside, to be found
    /// and reported.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn map<T: Real>(&self, points: &[T], unit: &mut [T], inside: &mut [bool]) {
        assert!(points.len() == 3 * inside.len() && unit.len() == points.len(), "one place a point");
        let rows = points.as_chunks::<3>().0.iter().zip(unit.as_chunks_mut::<3>().0);
        for ((point, unit), inside) in rows.zip(inside) {
            let point = point.map(Into::into);
            *inside = !self.is_outside(point);
            *unit = self.place(point).map(T::nearest);
        }
    }

    /// Returns whether each of `points [n, 3]` is in the box, or space has no outside. A point that is not finite
    /// counts as inside.
    pub fn inside<T: Real>(&self, points: &[T]) -> Vec<bool> {
        points.as_chunks::<3>().0.iter().map(|point| !self.is_outside(point.map(Into::into))).collect()
    }

    /// Returns the scene point that is at `unit` of the cube. `None` where there is none: at infinity, and beyond it.
    pub fn point_at(&self, unit: [f64; 3]) -> Option<[f64; 3]> {
        let [low, high] = [self.low, self.high];
        if self.contraction == Contraction::None {
            return Some(std::array::from_fn(|axis| low[axis] + unit[axis] * (high[axis] - low[axis])));
        }
        let contracted: [f64; 3] = unit.map(|unit| 4.0 * unit - 2.0);
        let norm = length(contracted);
        let factor = |size: f64| match size {
            ..=1.0 => Some(1.0),
            size => (size < 2.0).then(|| 1.0 / (size * (2.0 - size))),
        };
        let mut point = [0.0; 3];
        for axis in 0..3 {
            let size = if self.contraction == Contraction::Ball { norm } else { contracted[axis].abs() };
            let normalized = contracted[axis] * factor(size)?;
            point[axis] = 0.5 * (normalized * (high[axis] - low[axis]) + low[axis] + high[axis]);
        }
        Some(point)
    }

    /// Computes the gradient in the scene, `d_points [n, 3]`, from that in the cube, `d_unit [n, 3]`. It is 0 at points
    /// outside.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn backward<T: Real>(&self, points: &[T], d_unit: &[T], d_points: &mut [T]) {
        assert!(points.len() == d_unit.len() && d_points.len() == points.len(), "one gradient a point");
        let rows = points.as_chunks::<3>().0.iter().zip(d_unit.as_chunks::<3>().0);
        for ((point, d_unit), d_point) in rows.zip(d_points.as_chunks_mut::<3>().0) {
            let jacobian = self.jacobian(point.map(Into::into));
            let d_unit = d_unit.map(Into::into);
            for axis in 0..3 {
                d_point[axis] = T::nearest((0..3).map(|row| d_unit[row] * jacobian[row][axis]).sum());
            }
        }
    }

    /// Returns `d unit[row] / d point[column]` at a scene point. It is 0 outside a box without contraction.
    pub fn jacobian(&self, point: [f64; 3]) -> [[f64; 3]; 3] {
        if self.is_outside(point) {
            return [[0.0; 3]; 3];
        }
        let y = self.normalized(point);
        let norm = length(y);
        let entry = |row: usize, column: usize| {
            let same = if row == column { 1.0 } else { 0.0 };
            let side = self.high[column] - self.low[column];
            match self.contraction {
                Contraction::None => same / side,
                Contraction::Axes => 0.5 * same / y[row].abs().max(1.0).powi(2) / side,
                Contraction::Ball if norm <= 1.0 => 0.5 * same / side,
                // Of (2 - 1/|y|) y/|y|.
                Contraction::Ball => {
                    let along = y[row] * y[column] / (norm * norm);
                    0.5 * ((2.0 * norm - 1.0) * same - 2.0 * (norm - 1.0) * along) / (norm * norm) / side
                }
            }
        };
        std::array::from_fn(|row| std::array::from_fn(|column| entry(row, column)))
    }

    /// Returns an operator in the cube for a scene point: `value` times a function's value, plus `gradient` times its
    /// gradient in the scene, plus `laplacian` times its Laplacian there. Derivatives are 0 outside a box without
    /// contraction.
    ///
    /// Let J be the Jacobian and l the Laplacians of the cube's coordinates in the scene's. With the gradient g and the
    /// second derivatives H in the cube, the scene's gradient is J^T g. Its Laplacian is the sum of (J J^T)_jk H_jk and
    /// of l_j g_j.
    pub fn operator(&self, point: [f64; 3], value: f64, gradient: [f64; 3], laplacian: f64) -> Operator<f64> {
        let jacobian = self.jacobian(point);
        let bends = self.laplacians(point);
        let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| a[axis] * b[axis]).sum::<f64>();
        let first = |row: usize| dot(jacobian[row], gradient) + laplacian * bends[row];
        let second = |j: usize, k: usize| laplacian * dot(jacobian[j], jacobian[k]);
        let mixed = |j, k| 2.0 * second(j, k);
        let along = [second(0, 0), second(1, 1), second(2, 2)];
        let ([x, y, z], [xx, yy, zz]) = ([first(0), first(1), first(2)], along);
        [value, x, y, z, xx, yy, zz, mixed(0, 1), mixed(0, 2), mixed(1, 2)]
    }

    /// Returns the Laplacian in the scene of each of the cube's coordinates. It is 0 within the box.
    fn laplacians(&self, point: [f64; 3]) -> [f64; 3] {
        let y = self.normalized(point);
        let r = length(y);
        // Of the contracted coordinate in y, a quarter of which is the cube's; d y / d point = 2 / side.
        let scale = |axis: usize| (2.0 / (self.high[axis] - self.low[axis])).powi(2);
        std::array::from_fn(|row| match self.contraction {
            Contraction::None => 0.0,
            Contraction::Axes if y[row].abs() <= 1.0 => 0.0,
            // Of 2 - 1/y, or -2 - 1/y if y is negative.
            Contraction::Axes => -0.5 * scale(row) / y[row].powi(3),
            Contraction::Ball if r <= 1.0 => 0.0,
            // Of h(r) y with h = 2/r - 1/r^2.
            Contraction::Ball => {
                let (slope, bend) = (-2.0 / r.powi(2) + 2.0 / r.powi(3), 4.0 / r.powi(3) - 6.0 / r.powi(4));
                let along = |axis: usize| {
                    let share = (y[axis] / r).powi(2);
                    let both = if axis == row { 2.0 } else { 0.0 };
                    scale(axis) * (bend * share + slope * ((1.0 - share) / r + both / r))
                };
                0.25 * y[row] * (0..3).map(along).sum::<f64>()
            }
        })
    }

    /// Returns whether a point is outside of the covered space.
    fn is_outside(&self, point: [f64; 3]) -> bool {
        let beyond = |axis: usize| point[axis] < self.low[axis] || point[axis] > self.high[axis];
        self.contraction == Contraction::None && is_finite(point) && (0..3).any(beyond)
    }

    /// Returns the point in coordinates where the box is -1..1 along each axis.
    fn normalized(&self, point: [f64; 3]) -> [f64; 3] {
        let [low, high] = [self.low, self.high];
        std::array::from_fn(|axis| (2.0 * point[axis] - low[axis] - high[axis]) / (high[axis] - low[axis]))
    }

    fn place(&self, point: [f64; 3]) -> [f64; 3] {
        if !is_finite(point) {
            return [f64::NAN; 3];
        }
        let [low, high] = [self.low, self.high];
        let y = self.normalized(point);
        let norm = length(y);
        let unit = |axis: usize| match self.contraction {
            Contraction::None => ((point[axis] - low[axis]) / (high[axis] - low[axis])).clamp(0.0, 1.0),
            Contraction::Axes => 0.25 * (contracted(y[axis].abs()).copysign(y[axis]) + 2.0),
            Contraction::Ball if norm <= 1.0 => 0.25 * (y[axis] + 2.0),
            Contraction::Ball => 0.25 * (contracted(norm) * y[axis] / norm + 2.0),
        };
        std::array::from_fn(unit)
    }
}

fn is_finite(point: [f64; 3]) -> bool {
    point.iter().all(|x| x.is_finite())
}

fn length(y: [f64; 3]) -> f64 {
    y.iter().map(|y| y * y).sum::<f64>().sqrt()
}

/// Returns `2 - 1 / norm` beyond 1.
fn contracted(norm: f64) -> f64 {
    if norm <= 1.0 { norm } else { 2.0 - 1.0 / norm }
}

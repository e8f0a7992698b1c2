//! The vertices around points with their weights, in f64: for fields in f64 and on devices, and for tests.

use super::operator::ORDERS;
use super::{HashGrid, Level, Operator};

/// Number types of points.
pub trait Real: Copy + Into<f64> {
    /// Returns the nearest number of the type.
    fn nearest(value: f64) -> Self;
}

impl Real for f32 {
    fn nearest(value: f64) -> f32 {
        value as f32
    }
}

impl Real for f64 {
    fn nearest(value: f64) -> f64 {
        value
    }
}

/// A vertex of a point's cell.
pub struct Vertex {
    /// Its entry, counted over all tables.
    pub entry: usize,
    /// Its weight along each axis, with the first and second derivative in the point's coordinate.
    along: [[f64; 3]; 3],
}

impl Vertex {
    /// Returns the derivative of its weight, of `order` along each axis.
    fn weight(&self, order: [usize; 3]) -> f64 {
        (0..3).map(|axis| self.along[axis][order[axis]]).product()
    }

    /// Returns its weight, or the result of an operator on it.
    pub fn operated(&self, operator: Option<&Operator<f64>>) -> f64 {
        match operator {
            None => self.weight([0; 3]),
            Some(operator) => operator.iter().zip(ORDERS).map(|(factor, order)| factor * self.weight(order)).sum(),
        }
    }
}

impl HashGrid {
    /// Returns the eight vertices around a point.
    fn vertices(&self, level: &Level, point: [f64; 3]) -> [Vertex; 8] {
        let resolution = f64::from(level.resolution);
        std::array::from_fn(|k| {
            let mut vertex = [0; 3];
            let mut along = [[0.0; 3]; 3];
            for axis in 0..3 {
                let scaled = point[axis] * resolution;
                let cell = scaled.floor().clamp(0.0, resolution - 1.0);
                let up = k >> axis & 1;
                let [share, slope, bend] = self.interpolation.share(scaled - cell);
                vertex[axis] = cell as u32 + up as u32;
                along[axis] = match up {
                    0 => [1.0 - share, -slope * resolution, -bend * resolution * resolution],
                    _ => [share, slope * resolution, bend * resolution * resolution],
                };
            }
            Vertex { entry: level.offset + level.entry(vertex), along }
        })
    }

    /// Returns the eight vertices around each of `points [n, 3]` in each level.
    pub fn corners(&self, points: &[f64]) -> Vec<Vertex> {
        let levels = |point| self.levels.iter().flat_map(move |level| self.vertices(level, point));
        points.as_chunks().0.iter().copied().flat_map(levels).collect()
    }
}

//! The encoding as the paper writes it, in f64, vertex by vertex. It is the reference for tests, and serves fields of
//! f64.

use super::operator::ORDERS;
use super::{HashGrid, Level, Operator};

/// Number types of the reference.
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

    /// Calls `visit` with each point's number, channel, entry in the tables' array, and vertex.
    fn each_vertex<T: Real>(&self, points: &[T], mut visit: impl FnMut(usize, usize, usize, &Vertex)) {
        for (i, point) in points.as_chunks::<3>().0.iter().enumerate() {
            for (l, level) in self.levels.iter().enumerate() {
                for vertex in self.vertices(level, point.map(Into::into)) {
                    for feature in 0..self.features {
                        let entry = vertex.entry * self.features + feature;
                        visit(i, l * self.features + feature, entry, &vertex);
                    }
                }
            }
        }
    }

    /// Computes [`HashGrid::encode`] as the sum over vertices.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn encode_reference<T: Real>(
        &self,
        tables: &[T],
        points: &[T],
        operators: Option<&[Operator<f64>]>,
        out: &mut [T],
    ) {
        let count = self.check(tables.len(), points.len(), out.len());
        assert!(operators.is_none_or(|operators| operators.len() == count), "one operator a point");
        let mut sums = vec![0.0; out.len()];
        self.each_vertex(points, |point, channel, entry, vertex| {
            let weight = vertex.operated(operators.map(|operators| &operators[point]));
            sums[point * self.channels() + channel] += weight * tables[entry].into();
        });
        write(&sums, out);
    }

    /// Computes [`HashGrid::point_gradient`].
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn point_gradient_reference<T: Real>(&self, tables: &[T], points: &[T], d_out: &[T], d_points: &mut [T]) {
        self.check(tables.len(), points.len(), d_out.len());
        let mut sums = vec![0.0; points.len()];
        self.each_vertex(points, |point, channel, entry, vertex| {
            let d = d_out[point * self.channels() + channel].into() * tables[entry].into();
            for (axis, order) in [[1, 0, 0], [0, 1, 0], [0, 0, 1]].into_iter().enumerate() {
                sums[3 * point + axis] += d * vertex.weight(order);
            }
        });
        write(&sums, d_points);
    }

    /// Computes the gradient in the tables, `sum [entries, features]`, of one record.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn table_gradient_reference<T: Real>(
        &self,
        points: &[T],
        operators: Option<&[Operator<f64>]>,
        d_out: &[T],
        sum: &mut [T],
    ) {
        let count = self.check(sum.len(), points.len(), d_out.len());
        assert!(operators.is_none_or(|operators| operators.len() == count), "one operator a point");
        let mut sums = vec![0.0; sum.len()];
        self.each_vertex(points, |point, channel, entry, vertex| {
            let weight = vertex.operated(operators.map(|operators| &operators[point]));
            sums[entry] += weight * d_out[point * self.channels() + channel].into();
        });
        write(&sums, sum);
    }
}

fn write<T: Real>(values: &[f64], out: &mut [T]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out = T::nearest(*value);
    }
}

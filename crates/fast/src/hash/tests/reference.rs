//! The encoding and its gradients as the paper writes them, in f64, vertex by vertex. The tests of `augnerf-gpu` include
//! this file, too.

use super::{HashGrid, Vertex};

/// Calls `visit` with each point's number, channel, entry in the tables' array, and vertex.
fn each_vertex(grid: &HashGrid, points: &[f64], mut visit: impl FnMut(usize, usize, usize, &Vertex)) {
    let (levels, features) = (grid.levels().len(), grid.features());
    for (i, vertex) in grid.corners(points).iter().enumerate() {
        let (point, level) = (i / (8 * levels), i / 8 % levels);
        for feature in 0..features {
            visit(point, level * features + feature, vertex.entry * features + feature, vertex);
        }
    }
}

/// Returns the encodings of points, or results of operators on them, `[n, channels]`.
pub fn encode(grid: &HashGrid, tables: &[f64], points: &[f64], operators: Option<&[[f64; 10]]>) -> Vec<f64> {
    let mut sums = vec![0.0; points.len() / 3 * grid.channels()];
    each_vertex(grid, points, |point, channel, entry, vertex| {
        let weight = vertex.operated(operators.map(|operators| &operators[point]));
        sums[point * grid.channels() + channel] += weight * tables[entry];
    });
    sums
}

/// Returns the gradient in points, `[n, 3]`.
pub fn point_gradient(grid: &HashGrid, tables: &[f64], points: &[f64], d_out: &[f64]) -> Vec<f64> {
    let slopes = [1, 2, 3].map(|along| std::array::from_fn(|i| if i == along { 1.0 } else { 0.0 }));
    let mut sums = vec![0.0; points.len()];
    each_vertex(grid, points, |point, channel, entry, vertex| {
        let d = d_out[point * grid.channels() + channel] * tables[entry];
        (0..3).for_each(|axis| sums[3 * point + axis] += d * vertex.operated(Some(&slopes[axis])));
    });
    sums
}

/// Returns the gradient in the tables, `[entries, features]`.
pub fn table_gradient(grid: &HashGrid, points: &[f64], operators: Option<&[[f64; 10]]>, d_out: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; grid.entries() * grid.features()];
    each_vertex(grid, points, |point, channel, entry, vertex| {
        let weight = vertex.operated(operators.map(|operators| &operators[point]));
        sums[entry] += weight * d_out[point * grid.channels() + channel];
    });
    sums
}

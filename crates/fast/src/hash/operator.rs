//! Derivatives of the encoding in space, and the tables' gradients of functions of them.
//!
//! An encoding is linear in the tables. The weight of each vertex is a function of the point, and a derivative of the
//! encoding is the same sum with that function's derivative. One linear differential operator per point is therefore
//! enough. It can be the derivative along an axis of the scene, the Laplacian there, or the sum of a loss's derivatives
//! in each of them.

use super::cell::{BLOCK, Cells};
use super::{HashGrid, Level};
use crate::simd::{LANES, Lanes, Simd};

/// A linear differential operator at a point of the unit cube, of at most second order. It has the coefficients of the
/// value, of the derivatives along x, y, z, of those along xx, yy, zz, and of those along xy, xz, yz.
pub type Operator<T> = [T; 10];

/// The order of each of an operator's derivatives along each axis.
pub const ORDERS: Operator<[usize; 3]> =
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0], [1, 0, 1], [0, 1, 1]];

/// A block's operators, coefficient by coefficient, if there are some. Missing ones in the last group are 0.
pub struct Operators<'a> {
    groups: Option<[Operator<Lanes>; BLOCK / LANES]>,
    rest: &'a [Operator<f32>],
}

impl<'a> Operators<'a> {
    #[inline(always)]
    pub fn new(operators: Option<&'a [Operator<f32>]>) -> Operators<'a> {
        let groups = operators.map(|_| [[[0.0; LANES]; 10]; BLOCK / LANES]);
        Operators { groups, rest: operators.unwrap_or_default() }
    }

    /// Goes on to the next [`BLOCK`] points.
    #[inline(always)]
    pub fn advance(&mut self) {
        let Some(groups) = &mut self.groups else { return };
        let (here, rest) = self.rest.split_at(BLOCK.min(self.rest.len()));
        for (group, operators) in groups.iter_mut().zip(here.chunks(LANES)) {
            *group = [[0.0; LANES]; 10];
            for (i, operator) in operators.iter().enumerate() {
                for (lanes, number) in group.iter_mut().zip(operator) {
                    lanes[i] = *number;
                }
            }
        }
        self.rest = rest;
    }

    /// Returns those of the points from `start` on.
    #[inline(always)]
    pub fn group(&self, start: usize) -> Option<&Operator<Lanes>> {
        self.groups.as_ref().map(|groups| &groups[start / LANES])
    }
}

/// Returns the weight of each corner's features in an operator's value.
#[inline(always)]
pub fn weights<S: Simd>(
    simd: S,
    grid: &HashGrid,
    level: &Level,
    cells: &Cells<S>,
    operator: &Operator<Lanes>,
) -> [S::Floats; 8] {
    let along = along(simd, grid, level, cells);
    let mut c = [simd.splat(0.0); 10];
    for (c, lanes) in c.iter_mut().zip(operator) {
        *c = simd.load(lanes);
    }
    let mut weights = [simd.splat(0.0); 8];
    for k in 0..4 {
        let ([x, x1, x2], [y, y1, y2]) = (along[0][k & 1], along[1][k >> 1]);
        let (xy, x1y, xy1) = (simd.mul(x, y), simd.mul(x1, y), simd.mul(x, y1));
        // The terms for z itself, for its first derivative, and for its second derivative.
        let mut flat = simd.mul(c[0], xy);
        flat = simd.mul_add(c[1], x1y, flat);
        flat = simd.mul_add(c[2], xy1, flat);
        flat = simd.mul_add(c[4], simd.mul(x2, y), flat);
        flat = simd.mul_add(c[5], simd.mul(x, y2), flat);
        flat = simd.mul_add(c[7], simd.mul(x1, y1), flat);
        let slope = simd.mul_add(c[9], xy1, simd.mul_add(c[8], x1y, simd.mul(c[3], xy)));
        let bend = simd.mul(c[6], xy);
        for (up, [z, z1, z2]) in along[2].into_iter().enumerate() {
            weights[k + 4 * up] = simd.mul_add(bend, z2, simd.mul_add(slope, z1, simd.mul(flat, z)));
        }
    }
    weights
}

/// Returns the weights of the lower and the upper vertex along each axis, with first and second derivative in the unit
/// cube.
#[inline(always)]
fn along<S: Simd>(simd: S, grid: &HashGrid, level: &Level, cells: &Cells<S>) -> [[[S::Floats; 3]; 2]; 3] {
    let zero = simd.splat(0.0);
    let resolution = simd.splat(level.resolution as f32);
    let shares = grid.interpolation.shares(simd, cells.position);
    let slopes = grid.interpolation.slopes(simd, cells.position);
    let bends = grid.interpolation.bends(simd, cells.position);
    let mut along = [[[zero; 3]; 2]; 3];
    for axis in 0..3 {
        let slope = simd.mul(slopes[axis], resolution);
        let bend = simd.mul(simd.mul(bends[axis], resolution), resolution);
        along[axis][0] = [simd.sub(simd.splat(1.0), shares[axis]), simd.sub(zero, slope), simd.sub(zero, bend)];
        along[axis][1] = [shares[axis], slope, bend];
    }
    along
}

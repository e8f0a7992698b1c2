//! Interpolation between the cells of a grid.
//!
//! A grid fills [-1, 1] along each axis, with its outermost cells at the ends. The value at a point is the mean of the
//! eight corners around it, each weighted with the volume of the box between the point and the opposite corner.

use candle_core::backend::BackendStorage;
use candle_core::{CpuStorage, CustomOp2, DType, Device, Layout, Result, Shape, Tensor, WithDType};

use crate::base::place::is_ours;
use rayon::prelude::*;

use super::values::{Values, each_kind, slice, summed};

/// Points per thread and iteration.
const POINTS: usize = 1024;
/// Parts of a grid's gradient, each with a grid of its own, which are summed in order.
pub(super) const PARTS: usize = 4;

/// The values around a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outside {
    /// Zeros: values fade over the width of one cell.
    Zeros,
    /// The value at the nearest point of the grid.
    Border,
}

/// A corner of the cell around a point.
pub(super) struct Corner<T> {
    pub(super) cell: usize,
    /// 0 if there is no such cell.
    pub(super) weight: T,
}

/// The size of a grid, along z, y, x, and the values around it.
#[derive(Clone, Copy)]
pub(super) struct Lattice {
    pub(super) sides: [usize; 3],
    pub(super) outside: Outside,
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
    pub(super) fn cells(&self) -> usize {
        self.sides.iter().product()
    }

    /// Returns the location of the point x, y, z.
    #[inline(always)]
    pub(super) fn place<T: WithDType>(&self, point: [T; 3]) -> Location<T> {
        let along: [(isize, T, T); 3] = std::array::from_fn(|axis| {
            let last = (self.sides[axis] - 1) as f64;
            let at = (point[2 - axis].to_f64() + 1.0) * 0.5 * last;
            let (first, end) = match self.outside {
                Outside::Zeros => (-2.0, last + 2.0),
                Outside::Border => (0.0, last),
            };
            let held = at.clamp(first, end);
            let free = self.outside == Outside::Zeros || (at > first && at < end);
            let scale = if free { 0.5 * last } else { 0.0 };
            (held.floor() as isize, T::from_f64(held - held.floor()), T::from_f64(scale))
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

/// Returns values `[n, channels]` of a grid `[z, y, x, channels]` at points `[n, 3]`, each x, y, z.
pub fn trilinear(grid: &Tensor, points: &Tensor, outside: Outside) -> Result<Tensor> {
    let (z, y, x, _) = grid.dims4()?;
    let lattice = Lattice { sides: [z, y, x], outside };
    if points.dims2()?.1 != 3 || lattice.cells() == 0 {
        candle_core::bail!("trilinear: grid {:?}, points {:?} do not fit", grid.shape(), points.shape());
    }
    if !is_ours(grid) {
        return plain(grid, points, outside);
    }
    let operation = Sampled { lattice, wants_grid: grid.track_op(), wants_points: points.track_op() };
    grid.contiguous()?.apply_op2(&points.contiguous()?, operation)
}

/// The same in candle's own operations.
pub fn plain(grid: &Tensor, points: &Tensor, outside: Outside) -> Result<Tensor> {
    let (depth, height, width, channels) = grid.dims4()?;
    let (n, cells) = (points.dim(0)?, depth * height * width);
    let nothing = Tensor::zeros((1, channels), grid.dtype(), grid.device())?;
    let rows = Tensor::cat(&[&grid.reshape((cells, channels))?, &nothing], 0)?;
    let mut along = Vec::new();
    for (axis, side) in [(2, depth), (1, height), (0, width)] {
        let last = side as f64 - 1.0;
        let at = ((points.narrow(1, axis, 1)? + 1.0)? * (0.5 * last))?;
        let at = match outside {
            Outside::Zeros => at.clamp(-2.0, last + 2.0)?,
            Outside::Border => at.clamp(0.0, last)?,
        };
        let low = at.detach().floor()?;
        along.push((low.clone(), (at - low)?, side as f64));
    }
    let mut sum = Tensor::zeros((n, channels), grid.dtype(), grid.device())?;
    for corner in 0..8usize {
        let mut weight = Tensor::ones((n, 1), grid.dtype(), grid.device())?;
        let mut flat = Tensor::zeros((n, 1), grid.dtype(), grid.device())?;
        let mut inside = flat.ones_like()?;
        for (axis, (low, part, side)) in along.iter().enumerate() {
            let far = (corner >> (2 - axis) & 1) as f64;
            weight = (weight * if far == 1.0 { part.clone() } else { (1.0 - part)? })?;
            let at = (low + far)?;
            let is_in = (at.ge(0.0)?.to_dtype(grid.dtype())? * at.lt(*side)?.to_dtype(grid.dtype())?)?;
            inside = (inside * is_in)?;
            flat = ((flat * *side)? + at)?;
        }
        let cell = ((flat * &inside)? + (1.0 - &inside)? * cells as f64)?;
        let cell = cell.squeeze(1)?.to_dtype(DType::F64)?.to_dtype(DType::U32)?;
        sum = (sum + rows.index_select(&cell, 0)?.broadcast_mul(&weight)?)?;
    }
    Ok(sum)
}

struct Sampled {
    lattice: Lattice,
    wants_grid: bool,
    wants_points: bool,
}

fn point<T: WithDType>(at: &[T]) -> [T; 3] {
    [at[0], at[1], at[2]]
}

impl Sampled {
    fn values<T: WithDType>(&self, grid: &[T], points: &[T], channels: usize) -> Vec<T> {
        let mut out = vec![T::zero(); points.len() / 3 * channels];
        out.par_chunks_mut(POINTS * channels).zip(points.par_chunks(POINTS * 3)).for_each(|(out, points)| {
            for (out, at) in out.chunks_exact_mut(channels).zip(points.chunks_exact(3)) {
                for Corner { cell, weight } in self.lattice.place(point(at)).corners() {
                    let values = &grid[cell * channels..][..channels];
                    out.iter_mut().zip(values).for_each(|(out, value)| *out += weight * *value);
                }
            }
        });
        out
    }

    fn grid_gradient<T: WithDType>(&self, points: &[T], gradient: &[T], channels: usize) -> Vec<T> {
        let cells = self.lattice.cells();
        let points_a_part = (points.len() / 3).div_ceil(PARTS).max(1);
        let parts = points.par_chunks(3 * points_a_part).zip(gradient.par_chunks(channels * points_a_part));
        let of_part = |(points, gradient): (&[T], &[T])| {
            let mut sum = vec![T::zero(); cells * channels];
            for (at, gradient) in points.chunks_exact(3).zip(gradient.chunks_exact(channels)) {
                for Corner { cell, weight } in self.lattice.place(point(at)).corners() {
                    let sums = &mut sum[cell * channels..][..channels];
                    sums.iter_mut().zip(gradient).for_each(|(sum, gradient)| *sum += weight * *gradient);
                }
            }
            sum
        };
        summed(parts.map(of_part).collect(), cells * channels)
    }

    fn point_gradient<T: WithDType>(&self, grid: &[T], points: &[T], gradient: &[T], channels: usize) -> Vec<T> {
        let mut out = vec![T::zero(); points.len()];
        let work = out.par_chunks_mut(3 * POINTS).zip(points.par_chunks(3 * POINTS));
        work.zip(gradient.par_chunks(channels * POINTS)).for_each(|((out, points), gradient)| {
            let rows = out.chunks_exact_mut(3).zip(points.chunks_exact(3)).zip(gradient.chunks_exact(channels));
            for ((out, at), gradient) in rows {
                let dot = |cell: usize| {
                    let values = &grid[cell * channels..][..channels];
                    values.iter().zip(gradient).fold(T::zero(), |sum, (value, gradient)| sum + *value * *gradient)
                };
                out.copy_from_slice(&self.lattice.place(point(at)).slope(dot));
            }
        });
        out
    }
}

impl CustomOp2 for Sampled {
    fn name(&self) -> &'static str {
        "trilinear"
    }

    fn cpu_fwd(
        &self,
        grid: &CpuStorage,
        grid_layout: &Layout,
        points: &CpuStorage,
        points_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (n, channels) = (points_layout.dims()[0], grid_layout.dims()[3]);
        let out = each_kind!(grid.dtype(), T => {
            let (grid, points) = (slice::<T>(grid, grid_layout)?, slice::<T>(points, points_layout)?);
            T::to_cpu_storage_owned(self.values(grid, points, channels))
        });
        Ok((out, Shape::from((n, channels))))
    }

    fn bwd(
        &self,
        grid: &Tensor,
        points: &Tensor,
        _out: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let channels = grid.dim(3)?;
        let gradient = gradient.contiguous()?;
        each_kind!(grid.dtype(), T => {
            let (of_grid, of_points, of_gradient) = (Values::of(grid), Values::of(points), Values::of(&gradient));
            let (values, at, cotangent) = (of_grid.slice::<T>()?, of_points.slice::<T>()?, of_gradient.slice::<T>()?);
            let like = |values: Vec<T>, tensor: &Tensor| Tensor::from_vec(values, tensor.shape(), &Device::Cpu);
            let d_grid = self.wants_grid.then(|| like(self.grid_gradient(at, cotangent, channels), grid));
            let d_points = self.wants_points.then(|| like(self.point_gradient(values, at, cotangent, channels), points));
            Ok((d_grid.transpose()?, d_points.transpose()?))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grids::reference::{check_differences, error, fixture, on_any_threads, ramp};
    use candle_core::Var;

    type Sampler = fn(&Tensor, &Tensor, Outside) -> Result<Tensor>;

    /// Values and gradients of `sum(out * cotangent)` in the lattice and the points.
    fn all_of(sample: Sampler, grid: &Tensor, points: &Tensor, cotangent: &Tensor, outside: Outside) -> Vec<Tensor> {
        let [grid, points] = [grid, points].map(|tensor| Var::from_tensor(tensor).unwrap());
        let out = sample(&grid, &points, outside).unwrap();
        let gradients = (&out * cotangent).unwrap().sum_all().unwrap().backward().unwrap();
        vec![out, gradients.get(&grid).unwrap().clone(), gradients.get(&points).unwrap().clone()]
    }

    /// Numbers of torch's `grid_sample` with aligned corners, in f64 to 1e-12, in f32 to 1e-5, and the plain path's.
    #[test]
    fn values_and_gradients_are_those_of_torch() {
        let last = |x: Tensor| x.squeeze(0).unwrap().permute([1, 2, 3, 0]).unwrap().contiguous().unwrap();
        for (name, mode, outside) in [
            ("nv.sample", "zeros", Outside::Zeros),
            ("nv.sample", "border", Outside::Border),
            ("nv.sample.oblong", "zeros", Outside::Zeros),
            ("nv.sample.oblong", "border", Outside::Border),
        ] {
            let (grid, points) = (last(fixture(&format!("{name}.grid"))), fixture(&format!("{name}.points")));
            let of = |what: &str| fixture(&format!("{name}.{mode}.{what}"));
            let expected = [of("out"), last(of("grad.grid")), of("grad.points")];
            let single = |tensor: &Tensor| tensor.to_dtype(DType::F32).unwrap();
            let cotangent = of("cotangent");
            let found = all_of(trilinear, &grid, &points, &cotangent, outside);
            let by_candle = all_of(plain, &grid, &points, &cotangent, outside);
            let fast =
                on_any_threads(|| all_of(trilinear, &single(&grid), &single(&points), &single(&cotangent), outside));
            for (index, expected) in expected.iter().enumerate() {
                let of = |found: &[Tensor]| error(&found[index], expected);
                assert!(of(&found) < 1e-12, "{name} {mode} {index}: {}", of(&found));
                assert!(of(&by_candle) < 1e-12, "{name} {mode} {index}, plain: {}", of(&by_candle));
                assert!(of(&fast) < 1e-5, "{name} {mode} {index}, fast: {}", of(&fast));
            }
        }
    }

    #[test]
    fn gradients_are_those_of_differences() {
        for outside in [Outside::Zeros, Outside::Border] {
            let grid = Var::from_tensor(&ramp(&[3, 4, 2, 2], 0.3)).unwrap();
            let points = Var::from_tensor(&(ramp(&[9, 3], 0.2) * 1.2).unwrap()).unwrap();
            check_differences(&[grid.clone(), points.clone()], 1e-7, || {
                trilinear(&grid, &points, outside).unwrap().sqr().unwrap().sum_all().unwrap()
            });
        }
    }

    /// What is linear in x, y and z is met exactly, more points than a part has among them.
    #[test]
    fn linear_functions_are_met_everywhere() {
        let side = |n: usize, i: usize| -1.0 + 2.0 * i as f64 / (n as f64 - 1.0);
        let value = |x: f64, y: f64, z: f64| 0.3 + 0.5 * x - 0.7 * y + 0.2 * z;
        let cells = (0..60).map(|i| value(side(5, i % 5), side(4, i / 5 % 4), side(3, i / 20)));
        let grid = Tensor::from_vec(cells.collect::<Vec<f64>>(), (3, 4, 5, 1), &Device::Cpu).unwrap();
        let points = ramp(&[5000, 3], 0.4);
        let found = trilinear(&grid, &points, Outside::Zeros).unwrap();
        let rows = points.to_vec2::<f64>().unwrap();
        let expected: Vec<f64> = rows.iter().map(|row| value(row[0], row[1], row[2])).collect();
        assert!(error(&found, &Tensor::from_vec(expected, (5000, 1), &Device::Cpu).unwrap()) < 1e-14);
    }

    #[test]
    fn points_that_are_no_numbers_show() {
        let grid = ramp(&[2, 2, 2, 1], 0.0);
        let points = Tensor::new(&[[f64::NAN, 0.0, 0.0], [f64::INFINITY, 0.0, 0.0]], &Device::Cpu).unwrap();
        let found = trilinear(&grid, &points, Outside::Zeros).unwrap().to_vec2::<f64>().unwrap();
        assert!(found[0][0].is_nan() && found[1][0] == 0.0, "{found:?}");
    }
}

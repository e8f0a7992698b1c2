//! Interpolation between the cells of a grid.
//!
//! A grid fills [-1, 1] along each axis, with its outermost cells at the ends. The value at a point is the mean of the
//! eight corners around it, each weighted with the volume of the box between the point and the opposite corner.

use candle_core::{DType, Result, Tensor};

/// The values around a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outside {
    /// Zeros: values fade over the width of one cell.
    Zeros,
    /// The value at the nearest point of the grid.
    Border,
}

/// Returns values `[n, channels]` of a grid `[z, y, x, channels]` at points `[n, 3]`, each x, y, z.
pub fn trilinear(grid: &Tensor, points: &Tensor, outside: Outside) -> Result<Tensor> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grids::reference::{channels_last, error, fixture, ramp, single, with_gradients};
    use candle_core::Device;

    /// Numbers of torch's `grid_sample` with aligned corners, in f64 to 1e-12 and in f32 to 1e-5.
    #[test]
    fn values_and_gradients_are_those_of_torch() {
        for (name, mode, outside) in [
            ("nv.sample", "zeros", Outside::Zeros),
            ("nv.sample", "border", Outside::Border),
            ("nv.sample.oblong", "zeros", Outside::Zeros),
            ("nv.sample.oblong", "border", Outside::Border),
        ] {
            let given = [channels_last(&fixture(&format!("{name}.grid"))), fixture(&format!("{name}.points"))];
            let of = |what: &str| fixture(&format!("{name}.{mode}.{what}"));
            let expected = [of("out"), channels_last(&of("grad.grid")), of("grad.points")];
            let sample = |[grid, points]: [&Tensor; 2]| trilinear(grid, points, outside);
            let found = with_gradients(&given, &of("cotangent"), sample);
            let fast = with_gradients(&given.each_ref().map(single), &single(&of("cotangent")), sample);
            for (index, expected) in expected.iter().enumerate() {
                let of = |found: &[Tensor]| error(&found[index], expected);
                assert!(of(&found) < 1e-12, "{name} {mode} {index}: {}", of(&found));
                assert!(of(&fast) < 1e-5, "{name} {mode} {index}, fast: {}", of(&fast));
            }
        }
    }

    #[test]
    fn points_that_are_no_numbers_show() {
        let grid = ramp(&[2, 2, 2, 1], 0.0);
        let points = Tensor::new(&[[f64::NAN, 0.0, 0.0], [f64::INFINITY, 0.0, 0.0]], &Device::Cpu).unwrap();
        let found = trilinear(&grid, &points, Outside::Zeros).unwrap().to_vec2::<f64>().unwrap();
        assert!(found[0][0].is_nan() && found[1][0] == 0.0, "{found:?}");
    }
}

//! The positions at which a pass queries its field: points of rays, or Gaussians that stand for parts of cones and
//! cylinders.

use candle_core::{D, Tensor};

use crate::base::Result;
use crate::data::{RayParts, Rays};
use crate::field::Field;

use super::volume::middles;

/// Returns the positions of `field` on `rays` with `t_vals`.
///
/// - Points `[rays, samples, 3]` at `t_vals [rays, samples]`.
/// - With an integrated encoding, Gaussians `[rays, samples, 6]` of the intervals between `t_vals [rays, samples + 1]`.
/// - On a hash grid, the middles of those intervals.
pub fn positions_at(field: &Field, rays: &Rays, t_vals: &Tensor) -> Result<Tensor> {
    if field.config().encoding.queries_gaussians() {
        return gaussians_at(rays, t_vals);
    }
    points_at(rays, &middles(t_vals, sample_count(field, t_vals)?)?)
}

/// Returns the parts of rays that passes of `field` need.
pub fn ray_parts(field: &Field) -> RayParts {
    RayParts { footprint: field.config().encoding.queries_gaussians(), tangents: false }
}

/// Returns the number of samples of a pass of `field` with this many columns of `t_vals`.
pub fn sample_count(field: &Field, t_vals: &Tensor) -> Result<usize> {
    Ok(field.config().encoding.samples(t_vals.dim(1)?))
}

/// Returns origin + t * direction, `[rays, samples, 3]`.
pub fn points_at(rays: &Rays, t_vals: &Tensor) -> Result<Tensor> {
    let along = t_vals.unsqueeze(2)?.broadcast_mul(&rays.directions.unsqueeze(1)?)?;
    Ok(along.broadcast_add(&rays.origins.unsqueeze(1)?)?)
}

/// Returns mean and diagonal variance `[rays, samples, 6]` of the uniform distribution in each part of a ray's solid
/// between `edges [rays, samples + 1]` (Barron et al. 2021, equations 7, 8 and 16).
pub fn gaussians_at(rays: &Rays, edges: &Tensor) -> Result<Tensor> {
    let samples = edges.dim(1)? - 1;
    let (start, end) = (edges.narrow(1, 0, samples)?, edges.narrow(1, 1, samples)?);
    let (middle, half) = (((&start + &end)? * 0.5)?, ((&end - &start)? * 0.5)?);
    let missing = || candle_core::Error::Msg("these rays have no footprint to cast".into());
    let footprint = rays.footprint.as_ref().ok_or_else(missing)?;
    let radius_squared = footprint.radii.sqr()?; // [rays, 1]
    let (t, along, across) = if footprint.cylinders {
        let across = (radius_squared * 0.25)?.broadcast_as(middle.shape())?;
        (middle, (half.sqr()? / 3.0)?, across)
    } else {
        let [t, along, across] = cone(&middle, &half)?;
        (t, along, across.broadcast_mul(&radius_squared)?)
    };
    let mean = points_at(rays, &t)?;
    // The fraction of each axis along the ray, d^2, and across it, 1 - d^2 / |d|^2.
    let squared = rays.directions.sqr()?;
    let across_fraction = squared.broadcast_div(&squared.sum_keepdim(D::Minus1)?)?.affine(-1.0, 1.0)?;
    let per_axis = |variance: &Tensor, fraction: &Tensor| variance.unsqueeze(2)?.broadcast_mul(&fraction.unsqueeze(1)?);
    let variance = (per_axis(&along, &squared)? + per_axis(&across, &across_fraction)?)?;
    Ok(Tensor::cat(&[mean, variance], 2)?)
}

/// Returns mean and variance of t, and variance across the axis for radius 1 at t = 1, in frustums around `middle` of
/// half length `half`. The formulas do not subtract nearly equal numbers.
fn cone(middle: &Tensor, half: &Tensor) -> Result<[Tensor; 3]> {
    let (m, h) = (middle.sqr()?, half.sqr()?);
    let sum = ((&m * 3.0)? + &h)?;
    let t = (middle + ((middle * 2.0)? * &h)?.div(&sum)?)?;
    let fourth = h.sqr()?;
    let along = ((&h / 3.0)? - ((&fourth * (4.0 / 15.0))? * ((&m * 12.0)? - &h)?)?.div(&sum.sqr()?)?)?;
    let across = (((m * 0.25)? + (h * (5.0 / 12.0))?)? - (fourth * (4.0 / 15.0))?.div(&sum)?)?;
    Ok([t, along, across])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use crate::data::Footprint;
    use crate::data::rays::tangents;
    use candle_core::{DType, Device};

    fn ray(direction: [f64; 3], radius: f64, cylinders: bool) -> Rays {
        let row = |v: [f64; 3]| Tensor::new(&[v], &Device::Cpu).unwrap();
        let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        let radii = Tensor::new(&[[radius]], &Device::Cpu).unwrap();
        let rays = Rays::new(row([0.3, -0.2, 0.5]), row(direction), row(direction.map(|d| d / length))).unwrap();
        Rays { footprint: Some(Footprint { radii, cylinders }), ..rays }
    }

    /// Mean and diagonal variance of points drawn uniformly in the solid.
    fn drawn(direction: [f64; 3], radius: f64, cylinders: bool, [from, to]: [f64; 2]) -> [f64; 6] {
        let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        let (u, w) = tangents(direction.map(|d| d / length));
        let mut random = Random::new(1, Stream::Init, 0);
        let (mut sum, mut squares) = ([0f64; 3], [0f64; 3]);
        let draws = 400_000;
        for _ in 0..draws {
            let t = if cylinders {
                from + (to - from) * random.uniform()
            } else {
                // Area grows with t^2.
                (from.powi(3) + (to.powi(3) - from.powi(3)) * random.uniform()).cbrt()
            };
            let r = radius * if cylinders { 1.0 } else { t } * random.uniform().sqrt();
            let (sin, cos) = (std::f64::consts::TAU * random.uniform()).sin_cos();
            for axis in 0..3 {
                let x = t * direction[axis] + r * (cos * u[axis] + sin * w[axis]);
                sum[axis] += x;
                squares[axis] += x * x;
            }
        }
        let n = f64::from(draws);
        let mean = sum.map(|s| s / n);
        let variance: [f64; 3] = std::array::from_fn(|axis| squares[axis] / n - mean[axis].powi(2));
        [mean[0] + 0.3, mean[1] - 0.2, mean[2] + 0.5, variance[0], variance[1], variance[2]]
    }

    #[test]
    fn moments_are_those_of_uniform_points_in_the_solid() {
        let direction = [0.6, -1.1, 0.4];
        for (cylinders, radius) in [(false, 0.2), (true, 0.3)] {
            for stretch in [[0.5, 1.5], [2.0, 2.4]] {
                let edges = Tensor::new(&[stretch], &Device::Cpu).unwrap();
                let rays = ray(direction, radius, cylinders);
                let moments = gaussians_at(&rays, &edges).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
                for (i, (moment, expected)) in
                    moments.iter().zip(drawn(direction, radius, cylinders, stretch)).enumerate()
                {
                    let tolerance = if i < 3 { 2e-3 } else { 0.02 * expected };
                    assert!((moment - expected).abs() < tolerance, "{cylinders} {stretch:?} {i}: {moment} {expected}");
                }
            }
        }
    }

    /// In single precision a thin frustum far away keeps its digits; the textbook form, made of fifth powers, has none.
    #[test]
    fn thin_frustums_keep_their_digits() {
        let edges = Tensor::new(&[[5.0f64, 5.001]], &Device::Cpu).unwrap();
        let at = |dtype: DType| {
            let (from, to) = (edges.narrow(1, 0, 1).unwrap(), edges.narrow(1, 1, 1).unwrap());
            let middle = ((&from + &to).unwrap() * 0.5).unwrap().to_dtype(dtype).unwrap();
            let half = ((&to - &from).unwrap() * 0.5).unwrap().to_dtype(dtype).unwrap();
            let scalar = |tensor: Tensor| {
                tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap()[0]
            };
            cone(&middle, &half).unwrap().map(scalar)
        };
        for (single, exact) in at(DType::F32).into_iter().zip(at(DType::F64)) {
            assert!((single / exact - 1.0).abs() < 1e-5, "{single} {exact}");
        }
    }
}

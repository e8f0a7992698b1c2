//! Pixel rays: host buffers that cameras fill, and the tensors that the renderer takes.

use candle_core::{DType, Device, Tensor};
use rayon::prelude::*;

use crate::config::PixelOrigin;
use crate::data::{Camera, Ndc};
use crate::error::Result;

/// A batch of rays as tensors.
#[derive(Clone)]
pub struct Rays {
    /// `[rays, 3]`, scene units (NDC where the scene uses it).
    pub origins: Tensor,
    /// `[rays, 3]`, not normalised: points are origin + t * direction.
    pub directions: Tensor,
    /// `[rays, 3]`, unit direction of the world ray, under NDC, too.
    pub viewdirs: Tensor,
    /// `[rays, 3]`, the first of two unit vectors that span the plane across `viewdirs`.
    pub tangents_u: Tensor,
    /// `[rays, 3]`, the second one.
    pub tangents_w: Tensor,
    /// `[rays, 1]`, length of `directions`.
    pub direction_norm: Tensor,
}

/// A batch of rays in memory; each vector holds `[rays, 3]`.
#[derive(Clone, Debug, Default)]
pub struct RayBuffer {
    /// See [`Rays::origins`].
    pub origins: Vec<f32>,
    /// See [`Rays::directions`].
    pub directions: Vec<f32>,
    /// See [`Rays::viewdirs`].
    pub viewdirs: Vec<f32>,
}

/// Two unit vectors that with the unit vector `n` form an orthonormal basis, without a branch that
/// fails for any n (Duff et al., Building an Orthonormal Basis, Revisited, JCGT 2017).
pub fn tangents(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let sign = 1f64.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    ([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]])
}

impl RayBuffer {
    /// The rays through the pixels `(camera, x, y)`.
    pub fn new(pixels: &[(&Camera, u32, u32)], ndc: Option<&Ndc>, origin: PixelOrigin) -> RayBuffer {
        let shift = match origin {
            PixelOrigin::Corner => 0.0,
            PixelOrigin::Centre => 0.5,
        };
        let rays: Vec<[[f64; 3]; 3]> = pixels
            .par_iter()
            .with_min_len(1024)
            .map(|&(camera, x, y)| {
                let (origin, direction) = camera.ray(f64::from(x) + shift, f64::from(y) + shift);
                let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
                let viewdir = direction.map(|d| d / length);
                let (origin, direction) = ndc.map_or((origin, direction), |ndc| ndc.map(origin, direction));
                [origin, direction, viewdir]
            })
            .collect();
        let gather = |i: usize| rays.iter().flat_map(|ray| ray[i].map(|v| v as f32)).collect();
        RayBuffer { origins: gather(0), directions: gather(1), viewdirs: gather(2) }
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.origins.len() / 3
    }

    /// No rays at all.
    pub fn is_empty(&self) -> bool {
        self.origins.is_empty()
    }

    /// The rays as tensors.
    pub fn to_tensors(&self, dtype: DType, device: &Device) -> Result<Rays> {
        let tensor = |values: &[f32]| Tensor::from_slice(values, (values.len() / 3, 3), device)?.to_dtype(dtype);
        let bases = self.viewdirs.chunks_exact(3).map(|v| tangents([v[0].into(), v[1].into(), v[2].into()]));
        let (u, w): (Vec<_>, Vec<_>) = bases.unzip();
        let flat = |vectors: Vec<[f64; 3]>| vectors.into_iter().flatten().map(|v| v as f32).collect::<Vec<f32>>();
        Rays::new(
            tensor(&self.origins)?,
            tensor(&self.directions)?,
            tensor(&self.viewdirs)?,
            tensor(&flat(u))?,
            tensor(&flat(w))?,
        )
    }
}

impl Rays {
    /// Rays from tensors, each `[rays, 3]`.
    pub fn new(
        origins: Tensor,
        directions: Tensor,
        viewdirs: Tensor,
        tangents_u: Tensor,
        tangents_w: Tensor,
    ) -> Result<Rays> {
        let direction_norm = directions.sqr()?.sum_keepdim(1)?.sqrt()?;
        Ok(Rays { origins, directions, viewdirs, tangents_u, tangents_w, direction_norm })
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.origins.dims()[0]
    }

    /// No rays at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Rays `start..start + count`.
    pub fn narrow(&self, start: usize, count: usize) -> Result<Rays> {
        let part = |tensor: &Tensor| tensor.narrow(0, start, count)?.contiguous();
        Ok(Rays {
            origins: part(&self.origins)?,
            directions: part(&self.directions)?,
            viewdirs: part(&self.viewdirs)?,
            tangents_u: part(&self.tangents_u)?,
            tangents_w: part(&self.tangents_w)?,
            direction_norm: part(&self.direction_norm)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tangents_are_orthonormal_in_every_direction() {
        for n in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.6, -0.8, 0.0], [0.48, 0.6, -0.64]] {
            let (u, w) = tangents(n);
            let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            for (value, expected) in
                [(dot(u, u), 1.0), (dot(w, w), 1.0), (dot(u, w), 0.0), (dot(u, n), 0.0), (dot(w, n), 0.0)]
            {
                assert!((value - expected).abs() < 1e-12, "{n:?}");
            }
        }
    }
}

//! Pixel rays: host buffers from cameras, and the tensors for the renderer.

use candle_core::{DType, Device, Tensor};
use rayon::prelude::*;

use crate::settings::PixelOrigin;
use crate::vector::{length, sub};
use crate::{Camera, Ndc};
use augnerf_base::Result;

/// A batch of rays as tensors.
#[derive(Clone)]
pub struct Rays {
    /// `[rays, 3]`, scene units (in NDC if the scene uses it).
    pub origins: Tensor,
    /// `[rays, 3]`, not normalized. Points are origin + t * direction.
    pub directions: Tensor,
    /// `[rays, 3]`, unit direction of the world ray, also in NDC.
    pub viewdirs: Tensor,
    /// `[rays, 1]`, length of `directions`.
    pub direction_norm: Tensor,
    /// Two unit vectors, each `[rays, 3]`, that span the plane perpendicular to `viewdirs`; see [`RayParts::tangents`].
    pub tangents: Option<[Tensor; 2]>,
    /// The solid of a pixel; see [`RayParts::footprint`].
    pub footprint: Option<Footprint>,
}

/// Additional parts of rays. They cost time, so that only needed ones are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayParts {
    /// Needed by fields that are queried at intervals.
    pub footprint: bool,
    /// Needed by deltas of the view direction.
    pub tangents: bool,
}

impl RayParts {
    /// All parts.
    pub const ALL: RayParts = RayParts { footprint: true, tangents: true };
}

/// The solid that a pixel's ray stands for (MipNeRF).
#[derive(Clone)]
pub struct Footprint {
    /// `[rays, 1]`. The radius of a cone at t = 1, or of a cylinder: that of the disc with the variance of the pixel,
    /// its width times 2 / sqrt(12).
    pub radii: Tensor,
    /// Whether they are cylinders: in NDC rays do not spread.
    pub cylinders: bool,
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
    /// See [`Footprint::radii`], `[rays]`. Empty if no footprint is needed.
    pub radii: Vec<f32>,
    /// See [`Footprint::cylinders`].
    pub cylinders: bool,
    /// The additional parts that [`RayBuffer::to_tensors`] makes.
    parts: RayParts,
}

/// Returns two unit vectors that form an orthonormal basis with the unit vector `n`. No `n` fails (Duff et al.,
/// Building an Orthonormal Basis, Revisited, JCGT 2017).
pub fn tangents(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let sign = 1f64.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    ([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]])
}

impl RayBuffer {
    /// Creates the rays through the pixels `(camera, x, y)`.
    pub fn new(pixels: &[(&Camera, u32, u32)], ndc: Option<&Ndc>, origin: PixelOrigin, parts: RayParts) -> RayBuffer {
        let shift = origin.shift();
        let at = |x: u32, y: u32| (f64::from(x) + shift, f64::from(y) + shift);
        let line = |&(camera, x, y): &(&Camera, u32, u32)| {
            let (x, y) = at(x, y);
            let (origin, direction) = camera.ray(x, y);
            let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
            let viewdir = direction.map(|d| d / length);
            let (origin, direction) = ndc.map_or((origin, direction), |ndc| ndc.map(origin, direction));
            [origin, direction, viewdir]
        };
        let radius =
            |&(camera, x, y): &(&Camera, u32, u32)| (pixel_width(camera, at(x, y), ndc) * 2.0 / 12f64.sqrt()) as f32;
        let each = || pixels.par_iter().with_min_len(1024);
        let lines: Vec<[[f64; 3]; 3]> = each().map(line).collect();
        let gather = |i: usize| lines.iter().flat_map(|ray| ray[i].map(|v| v as f32)).collect();
        let radii = if parts.footprint { each().map(radius).collect() } else { Vec::new() };
        let cylinders = ndc.is_some();
        RayBuffer { origins: gather(0), directions: gather(1), viewdirs: gather(2), radii, cylinders, parts }
    }

    /// Returns the number of rays.
    pub fn len(&self) -> usize {
        self.origins.len() / 3
    }

    /// Returns whether there are no rays.
    pub fn is_empty(&self) -> bool {
        self.origins.is_empty()
    }

    /// Returns the rays as tensors.
    pub fn to_tensors(&self, dtype: DType, device: &Device) -> Result<Rays> {
        let tensor = |values: &[f32]| Tensor::from_slice(values, (values.len() / 3, 3), device)?.to_dtype(dtype);
        let mut rays = Rays::new(tensor(&self.origins)?, tensor(&self.directions)?, tensor(&self.viewdirs)?)?;
        if self.parts.tangents {
            let bases = self.viewdirs.chunks_exact(3).map(|v| tangents([v[0].into(), v[1].into(), v[2].into()]));
            let (u, w): (Vec<_>, Vec<_>) = bases.unzip();
            let flat = |vectors: Vec<[f64; 3]>| vectors.into_iter().flatten().map(|v| v as f32).collect::<Vec<f32>>();
            rays.tangents = Some([tensor(&flat(u))?, tensor(&flat(w))?]);
        }
        if self.parts.footprint {
            let radii = Tensor::from_slice(&self.radii, (self.len(), 1), device)?.to_dtype(dtype)?;
            rays.footprint = Some(Footprint { radii, cylinders: self.cylinders });
        }
        Ok(rays)
    }
}

/// Returns the width of a pixel at t = 1: the distance to the next row's direction. In NDC it is the mean distance of
/// its origin to those of the next column and row.
fn pixel_width(camera: &Camera, (x, y): (f64, f64), ndc: Option<&Ndc>) -> f64 {
    let of = |x: f64, y: f64| {
        let (origin, direction) = camera.ray(x, y);
        ndc.map_or(direction, |ndc| ndc.map(origin, direction).0)
    };
    let here = of(x, y);
    let below = length(sub(of(x, y + 1.0), here));
    if ndc.is_some() { 0.5 * (length(sub(of(x + 1.0, y), here)) + below) } else { below }
}

impl Rays {
    /// Creates rays from tensors, each `[rays, 3]`.
    pub fn new(origins: Tensor, directions: Tensor, viewdirs: Tensor) -> Result<Rays> {
        let direction_norm = directions.sqr()?.sum_keepdim(1)?.sqrt()?;
        Ok(Rays { origins, directions, viewdirs, direction_norm, tangents: None, footprint: None })
    }

    /// Returns the number of rays.
    pub fn len(&self) -> usize {
        self.origins.dims()[0]
    }

    /// Returns whether there are no rays.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns rays `start..start + count`.
    pub fn narrow(&self, start: usize, count: usize) -> Result<Rays> {
        // If the complete tensors are contiguous, they are shared, not copied.
        self.map(|tensor| tensor.narrow(0, start, count)?.contiguous())
    }

    /// Returns the rays of these numbers, in their order.
    pub fn select(&self, numbers: &Tensor) -> Result<Rays> {
        self.map(|tensor| tensor.index_select(numbers, 0))
    }

    fn map(&self, part: impl Fn(&Tensor) -> candle_core::Result<Tensor>) -> Result<Rays> {
        let tangents = match &self.tangents {
            Some([u, w]) => Some([part(u)?, part(w)?]),
            None => None,
        };
        let footprint = match &self.footprint {
            Some(Footprint { radii, cylinders }) => Some(Footprint { radii: part(radii)?, cylinders: *cylinders }),
            None => None,
        };
        Ok(Rays {
            origins: part(&self.origins)?,
            directions: part(&self.directions)?,
            viewdirs: part(&self.viewdirs)?,
            direction_norm: part(&self.direction_norm)?,
            tangents,
            footprint,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pixel is 1/f wide at t = 1; of NDC's square, which is 2 wide and high, it is one column and one row.
    #[test]
    fn radii_are_those_of_pixels() {
        let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let camera = Camera { width: 40, height: 30, focal: [20.0; 2], centre: [20.0, 15.0], pose };
        let ndc = Ndc { width: 40.0, height: 30.0, focal: 20.0 };
        let radius = |ndc: Option<&Ndc>| {
            let rays = RayBuffer::new(&[(&camera, 3, 7)], ndc, PixelOrigin::Corner, RayParts::ALL);
            assert_eq!(rays.cylinders, ndc.is_some());
            f64::from(rays.radii[0]) * 12f64.sqrt() / 2.0
        };
        assert!((radius(None) - 1.0 / 20.0).abs() < 1e-7);
        assert!((radius(Some(&ndc)) - 0.5 * (2.0 / 40.0 + 2.0 / 30.0)).abs() < 1e-7);
    }

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

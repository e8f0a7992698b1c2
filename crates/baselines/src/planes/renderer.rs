//! Rendering of multiplane images from other cameras.

use std::sync::Arc;

use candle_core::{DType, Tensor};

use crate::base::Result;
use crate::data::Rays;
use crate::data::vector::Vec3;
use crate::methods::{RenderedRays, Renderer};

use super::blend::{EMPTY, LEAST, blend_weight};
use super::geometry::{Viewpoint, nearest};
use super::mpi::{Mpi, MpiSample, Mpis};

/// Renders rays from the multiplane images nearest to their origin.
pub struct PlanesRenderer {
    pub(super) mpis: Arc<Mpis>,
    pub(super) eyes: Vec<Viewpoint>,
    /// Number of blended images.
    pub(super) blend: usize,
    /// The scene's background, if it has one.
    pub(super) background: Option<[f32; 3]>,
}

impl PlanesRenderer {
    /// Returns the views that are blended for rays from `origin`, with their weights.
    fn blended(&self, origin: Vec3) -> Vec<(usize, f64)> {
        let near = nearest(&self.eyes, origin);
        let first = near[0].1;
        let weight = |&(view, distance): &(usize, f64)| {
            (view, blend_weight(&self.eyes[view], distance, first, &self.mpis.depths))
        };
        near.iter().take(self.blend).map(weight).collect()
    }

    /// The same with the views' planes.
    fn planes(&self, origin: Vec3) -> Result<Vec<(&Mpi, f64)>> {
        self.blended(origin).into_iter().map(|(view, weight)| Ok((self.mpis.of(view)?, weight))).collect()
    }

    /// Renders one ray: colour, sum of weights times t, accumulation.
    fn ray(&self, blended: &[(&Mpi, f64)], (origin, direction): (Vec3, Vec3)) -> ([f64; 3], f64, f64) {
        let mut places = vec![([0.0; 2], 0.0); self.mpis.depths.len()];
        let (mut sum, mut weights) = (MpiSample::default(), 0.0);
        for (mpi, weight) in blended {
            let sample = mpi.sample(origin, direction, &self.mpis.depths, &mut places);
            sum.rgb.iter_mut().zip(sample.rgb).for_each(|(sum, rgb)| *sum += weight * rgb);
            sum.acc += weight * sample.acc;
            sum.depth += weight * sample.depth;
            weights += weight;
        }
        let acc = sum.acc / weights;
        let rgb = match acc < EMPTY {
            true => self.background.unwrap_or_default().map(f64::from),
            false => sum.rgb.map(|value| value / (LEAST + sum.acc)),
        };
        (rgb, sum.depth / weights, acc.min(1.0))
    }
}

fn vectors(tensor: &Tensor) -> Result<Vec<Vec3>> {
    let flat = tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
    Ok(flat.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect())
}

impl Renderer for PlanesRenderer {
    fn prepare(&self, rays: &Rays) -> Result<()> {
        let views = vectors(&rays.origins)?.into_iter().flat_map(|origin| self.blended(origin));
        views.into_iter().try_for_each(|(view, _)| self.mpis.make(view))
    }

    fn render(&self, rays: &Rays) -> Result<RenderedRays> {
        let (origins, directions) = (vectors(&rays.origins)?, vectors(&rays.directions)?);
        let count = origins.len();
        let [mut rgb, mut depth, mut acc] = [3 * count, count, count].map(Vec::<f64>::with_capacity);
        // Rays of one camera have one origin, which is looked up once.
        let mut known: Option<(Vec3, Vec<(&Mpi, f64)>)> = None;
        for ray in origins.into_iter().zip(directions) {
            if known.as_ref().is_none_or(|(origin, _)| *origin != ray.0) {
                known = Some((ray.0, self.planes(ray.0)?));
            }
            let (_, blended) = known.as_ref().expect("just made");
            let (colour, along, full) = self.ray(blended, ray);
            rgb.extend(colour);
            depth.push(along);
            acc.push(full);
        }
        let (dtype, device) = (rays.origins.dtype(), rays.origins.device());
        let tensor = |values: Vec<f64>, shape: &[usize]| Tensor::from_vec(values, shape, device)?.to_dtype(dtype);
        Ok(RenderedRays {
            rgb: tensor(rgb, &[count, 3])?,
            depth: tensor(depth, &[count])?,
            acc: tensor(acc, &[count])?,
        })
    }
}

//! Rendering of radiance fields that leaves empty space out.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::{RayParts, Rays, Scene};
use crate::field::{Field, Queried};
use crate::methods::{Fields, RenderedRays, Renderer};
use crate::render::sampling::{even_u, stratified};
use crate::render::volume::{intervals, weights_from_density};
use crate::render::{Pass, PlacedSamples, clean_pass, positions_at, ray_parts, resample, sample_count, t_vals_per_ray};
use crate::runtime::Runtime;
use crate::settings::{Config, SamplingConfig};

use super::empty_space::EmptySpace;

/// Renders rays as [`crate::methods::FieldRenderer`] does, without asking the fields where space is empty. Pictures differ in their
/// last digits.
pub struct SkippingRenderer {
    fields: Fields,
    /// Of the coarse field, and of the fine one if it is another.
    spaces: (EmptySpace, Option<EmptySpace>),
    sampling: SamplingConfig,
    bounds: (f64, f64),
    background: Option<[f32; 3]>,
}

impl SkippingRenderer {
    /// Creates a renderer of fields with their current weights. Returns `None` for fields whose empty space is not known: see
    /// [`EmptySpace::of`], which `pause` is of, too. Nothing is left out before [`SkippingRenderer::set_least_alpha`].
    ///
    /// # Errors
    /// Those of candle and of `pause`.
    pub fn new(
        fields: &Fields,
        config: &Config,
        scene: &Scene,
        runtime: &Runtime,
        pause: &mut dyn FnMut() -> Result<()>,
    ) -> Result<Option<SkippingRenderer>> {
        let fields = fields.frozen()?;
        let mut space_of = |field: &Field| EmptySpace::of(field, config, scene, runtime, pause);
        let Some(coarse) = space_of(fields.coarse())? else { return Ok(None) };
        let fine = fields.get("fine").map(space_of).transpose()?.flatten();
        let (sampling, bounds, background) = (config.sampling.clone(), scene.bounds(), scene.background);
        Ok(Some(SkippingRenderer { fields, spaces: (coarse, fine), sampling, bounds, background }))
    }

    /// Counts space as empty where an interval of the coarse pass stops less than `least_alpha` of the light.
    pub fn set_least_alpha(&mut self, least_alpha: f64) {
        self.spaces.0.set_least_alpha(least_alpha);
        self.spaces.1.iter_mut().for_each(|space| space.set_least_alpha(least_alpha));
    }

    /// Returns the fraction of space that is not empty, 0..=1, by the evaluated field.
    pub fn occupied(&self) -> f64 {
        self.spaces.1.as_ref().unwrap_or(&self.spaces.0).share()
    }

    /// Composites a pass at `t_vals` of the samples that are not in empty space.
    fn pass(&self, field: &Field, space: &EmptySpace, rays: &Rays, t_vals: &Tensor) -> Result<RenderedRays> {
        let (_, queried) = points_of_interest(field, space, rays, t_vals)?;
        let queried = Some(Queried::new(queried, rays.len() * sample_count(field, t_vals)?));
        let samples = PlacedSamples { t_vals: t_vals.clone(), queried };
        let out = clean_pass(field, Pass::noiseless(rays, &samples, self.background))?.composite;
        Ok(RenderedRays { rgb: out.rgb, depth: out.depth, acc: out.acc })
    }

    /// Returns the weights of the coarse pass, `[rays, samples]`, from densities alone.
    fn coarse_weights(&self, rays: &Rays, t_vals: &Tensor) -> Result<Tensor> {
        let field = self.fields.coarse();
        let samples = sample_count(field, t_vals)?;
        let (points, queried) = points_of_interest(field, &self.spaces.0, rays, t_vals)?;
        let mut density = vec![0f32; rays.len() * samples];
        if !queried.is_empty() {
            let found = field.activate_density(&field.raw_density(&points)?)?.to_vec1::<f32>()?;
            queried.iter().zip(found).for_each(|(&sample, found)| density[sample as usize] = found);
        }
        let density = Tensor::from_vec(density, (rays.len(), samples), t_vals.device())?;
        weights_from_density(&density, &intervals(t_vals, &rays.direction_norm, samples)?)
    }
}

impl Renderer for SkippingRenderer {
    fn ray_parts(&self) -> RayParts {
        ray_parts(self.fields.evaluated())
    }

    fn render(&self, rays: &Rays) -> Result<RenderedRays> {
        let coarse = self.fields.coarse();
        let (columns, fine_columns) = t_vals_per_ray(coarse, &self.sampling);
        let t_vals = stratified(self.bounds, self.sampling.spacing, rays.len(), columns, None, &rays.origins)?;
        let Some(fine) = self.fields.fine() else { return self.pass(coarse, &self.spaces.0, rays, &t_vals) };
        let weights = self.coarse_weights(rays, &t_vals)?;
        let u = even_u(rays.len(), fine_columns, &t_vals)?;
        let t_fine = resample(coarse, &self.sampling, &t_vals, &weights, &u)?;
        self.pass(fine, self.spaces.1.as_ref().unwrap_or(&self.spaces.0), rays, &t_fine)
    }
}

/// Returns the points of a pass that count, `[n, 3]`, and their numbers among all samples, ray by ray.
fn points_of_interest(field: &Field, space: &EmptySpace, rays: &Rays, t_vals: &Tensor) -> Result<(Tensor, Vec<u32>)> {
    let points = positions_at(field, rays, t_vals)?.flatten_all()?.to_vec1::<f32>()?;
    let (mut kept, mut queried) = (Vec::<f32>::with_capacity(points.len()), Vec::with_capacity(points.len() / 3));
    for (sample, point) in points.as_chunks::<3>().0.iter().enumerate() {
        if space.is_occupied(point) {
            kept.extend_from_slice(point);
            queried.push(sample as u32);
        }
    }
    Ok((Tensor::from_vec(kept, (queried.len(), 3), t_vals.device())?, queried))
}

//! Rendering of radiance fields.

use crate::base::Result;
use crate::data::{RayParts, Rays, Scene};
use crate::methods::renderer::{RenderedRays, Renderer};
use crate::render::ray_parts;
use crate::render::settings::SamplingConfig;
use crate::settings::Config;

use super::networks::Fields;

/// Renders rays through the coarse and the fine field.
pub struct FieldRenderer {
    fields: Fields,
    sampling: SamplingConfig,
    bounds: (f64, f64),
    background: Option<[f32; 3]>,
}

impl FieldRenderer {
    /// Creates a renderer of fields with their current weights, in their scene.
    pub fn new(fields: &Fields, config: &Config, scene: &Scene) -> Result<FieldRenderer> {
        Ok(FieldRenderer {
            fields: fields.frozen()?,
            sampling: config.sampling.clone(),
            bounds: scene.bounds(),
            background: scene.background,
        })
    }
}

impl Renderer for FieldRenderer {
    fn ray_parts(&self) -> RayParts {
        ray_parts(self.fields.evaluated())
    }

    fn render(&self, rays: &Rays) -> Result<RenderedRays> {
        let composite = self.fields.evaluation(&self.sampling, self.bounds, self.background).render(rays)?;
        Ok(RenderedRays { rgb: composite.rgb, depth: composite.depth, acc: composite.acc })
    }
}

//! Rendering of rays by a method.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::{RayParts, Rays};

/// The rendered colours and depths of rays.
pub struct RenderedRays {
    /// Colours composited over the background, `[rays, 3]`.
    pub rgb: Tensor,
    /// Sum of weights times t, `[rays]`, in the units of `t_vals`. Divided by `acc` it is the mean distance.
    pub depth: Tensor,
    /// Accumulated weight, `[rays]`, 0..=1. It is 1 if a method has no empty space.
    pub acc: Tensor,
}

/// Renders rays, without randomness. What all rays need alike is prepared when the renderer is created.
pub trait Renderer: Send + Sync {
    /// Returns the parts of rays that it needs.
    fn ray_parts(&self) -> RayParts {
        RayParts::default()
    }

    /// Prepares what rays from the origins of `rays` need in addition. One thread calls it with a ray of each camera,
    /// before images of that camera are rendered.
    ///
    /// # Errors
    /// If weights are NaN; those of candle.
    fn prepare(&self, _rays: &Rays) -> Result<()> {
        Ok(())
    }

    /// Returns the number of rays that it renders best at once, if that is not the configuration's.
    fn chunk(&self) -> Option<usize> {
        None
    }

    /// Renders `rays`, whose origins are prepared.
    fn render(&self, rays: &Rays) -> Result<RenderedRays>;
}

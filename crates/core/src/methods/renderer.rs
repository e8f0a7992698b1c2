//! How a method shows its scene.

use candle_core::Tensor;

use crate::base::Result;
use crate::data::{RayParts, Rays};

/// The image of some rays.
pub struct RenderedRays {
    /// Colours with the background behind them, `[rays, 3]`.
    pub rgb: Tensor,
    /// Sum of weights times t, `[rays]`, in the units of `t_vals`; over `acc`, the mean distance.
    pub depth: Tensor,
    /// Accumulated weight, `[rays]`, 0..=1; 1 where a method knows no empty space.
    pub acc: Tensor,
}

/// Turns rays into their image, without randomness. What a method needs for all rays alike is prepared when the renderer
/// is made.
pub trait Renderer: Send + Sync {
    /// What it needs of rays.
    fn ray_parts(&self) -> RayParts {
        RayParts::default()
    }

    /// Makes what rays from the origins of `rays` need beside themselves. It is called by one thread with a ray of each camera
    /// before pictures of that camera are rendered.
    ///
    /// # Errors
    /// Weights that are not numbers; those of candle.
    fn prepare(&self, _rays: &Rays) -> Result<()> {
        Ok(())
    }

    /// The image of `rays`, whose origins are prepared.
    fn render(&self, rays: &Rays) -> Result<RenderedRays>;
}

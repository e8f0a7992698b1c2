//! A method without a radiance field, as the trainer sees it.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};

use crate::base::Result;
use crate::data::{RayParts, Scene};
use crate::field::Density;
use crate::settings::{Config, Resolved};

use super::batches::Batches;
use super::learner::Learner;
use super::renderer::Renderer;

/// The parameters of one experiment with a method that is not a radiance field.
pub trait Network: Send + Sync {
    /// Returns all parameters with their names, in their fixed order. They are shared: a learner's updates show in
    /// them.
    fn variables(&self) -> Vec<(String, Var)>;

    /// Returns a learner of these parameters on the training views of `scene`.
    ///
    /// # Errors
    /// If settings do not suit the scene.
    fn learner(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>>;

    /// Returns a renderer of `scene` with the current parameters.
    ///
    /// # Errors
    /// If weights are NaN; those of candle.
    fn renderer(&self, config: &Config, scene: &Scene) -> Result<Box<dyn Renderer>>;

    /// Returns the density in space with the current parameters, or `None` for a method without density.
    ///
    /// # Errors
    /// Those of candle.
    fn density(&self) -> Result<Option<Box<dyn Density>>>;
}

/// Creates the parameters of a method.
pub trait Family: Sync {
    /// Returns the name of its network.
    fn part(&self) -> &'static str;

    /// Returns names and shapes of all parameters, in their fixed order.
    fn parameter_names(&self, config: &Config) -> Vec<(String, Vec<usize>)>;

    /// Checks a new run's settings against its scene. It makes no network.
    ///
    /// # Errors
    /// If settings do not suit the scene.
    fn check(&self, config: &Resolved, scene: &Scene) -> Result<()> {
        Batches::new(config, scene, RayParts::default()).map(drop)
    }

    /// Returns random initial parameters.
    ///
    /// # Errors
    /// Those of candle.
    fn init(&self, config: &Resolved, dtype: DType, device: &Device) -> Result<Arc<dyn Network>>;

    /// Returns a network with given values, in the order of [`Family::parameter_names`].
    ///
    /// # Errors
    /// If their number or shapes are wrong.
    #[allow(clippy::wrong_self_convention, reason = "the family is a table of functions, and has no data")]
    fn from_parameters(&self, config: &Config, values: Vec<Tensor>) -> Result<Arc<dyn Network>>;
}

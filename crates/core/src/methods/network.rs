//! A method that is not a radiance field, as trainings see it.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};

use crate::base::Result;
use crate::data::Scene;
use crate::field::Density;
use crate::settings::{Config, Resolved};

use super::learner::Learner;
use super::renderer::Renderer;

/// The parameters of one experiment with a method that is not a radiance field.
pub trait Network: Send + Sync {
    /// All parameters with their names, in their fixed order. They are shared: a learner's updates show.
    fn variables(&self) -> Vec<(String, Var)>;

    /// Returns a learner of these parameters from the training views of `scene`.
    ///
    /// # Errors
    /// Settings that do not suit the scene.
    fn learner(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>>;

    /// Returns the learner of a new run. A method checks here what only a run's start can tell.
    ///
    /// # Errors
    /// Settings that do not suit the scene.
    fn start(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>> {
        self.learner(config, scene, dtype, device)
    }

    /// Returns a renderer of `scene` with the current parameters.
    ///
    /// # Errors
    /// Weights that are not numbers; those of candle.
    fn renderer(&self, config: &Config, scene: &Scene) -> Result<Box<dyn Renderer>>;

    /// Returns the density in space with the current parameters, or `None` for a method without density.
    ///
    /// # Errors
    /// Those of candle.
    fn density(&self) -> Result<Option<Box<dyn Density>>>;
}

/// How the parameters of a method are made.
pub trait Family: Sync {
    /// Name of its network.
    fn part(&self) -> &'static str;

    /// Names and shapes of all parameters, in their fixed order.
    fn parameter_names(&self, config: &Config) -> Vec<(String, Vec<usize>)>;

    /// Returns freshly drawn parameters.
    ///
    /// # Errors
    /// Those of candle.
    fn init(&self, config: &Resolved, dtype: DType, device: &Device) -> Result<Arc<dyn Network>>;

    /// Returns a network over given values, in the order of [`Family::parameter_names`].
    ///
    /// # Errors
    /// Values of another number or shape.
    fn from_parameters(&self, config: &Config, values: Vec<Tensor>) -> Result<Arc<dyn Network>>;
}

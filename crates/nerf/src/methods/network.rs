//! A method without a radiance field, as the trainer sees it.

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
    fn density(&self) -> Result<Option<Box<dyn Density>>> {
        Ok(None)
    }
}

/// Names and shapes of parameters, in their fixed order.
pub type NamedShapes = Vec<(String, Vec<usize>)>;
/// A network, or why there is none.
pub type AnyNetwork = Result<Arc<dyn Network>>;

/// A method: how its parameters are named and made.
pub struct Family {
    /// The name of its network.
    pub part: &'static str,
    /// Returns names and shapes of all parameters.
    pub parameter_names: fn(&Config) -> NamedShapes,
    /// Checks a new run's settings against its scene, and makes no network. Returns an error if settings do not suit
    /// the scene.
    pub check: fn(&Resolved, &Scene) -> Result<()>,
    /// Returns random initial parameters, or candle's errors.
    pub init: fn(&Resolved, DType, &Device) -> AnyNetwork,
    /// Returns a network with given values, in the order of `parameter_names`, or an error if their number or shapes
    /// are wrong.
    pub from_parameters: fn(&Config, Vec<Tensor>) -> AnyNetwork,
}

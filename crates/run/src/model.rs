//! The parameters of one experiment. This is the one module that tells radiance fields from baselines.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};

use crate::accelerator;
use crate::base::{Error, Result};
use crate::data::Scene;
use crate::field::{Density, Field, FieldDensity};
use crate::methods::{Family, FieldLearner, FieldRenderer, Fields, Learner, Network, Renderer};
use crate::render::OccupiedDensity;
use crate::runtime::Runtime;
use crate::settings::{Capability, Config, Representation, Resolved};

/// The parameters of one experiment.
#[derive(Clone)]
pub enum Model {
    /// NeRF and MipNeRF, augmented or not.
    Fields(Fields),
    /// Another representation: Scene Representation Networks, Neural Volumes, the network of LLFF.
    Baseline(Representation, Arc<dyn Network>),
}

/// Returns how a representation's parameters are made, or `None` for radiance fields and if baselines are not built
/// in.
fn family(representation: Representation) -> Option<&'static Family> {
    #[cfg(feature = "baselines")]
    return augnerf_baselines::family(representation);
    #[cfg(not(feature = "baselines"))]
    return {
        let _ = representation;
        None
    };
}

/// Returns the same for a representation that is not a radiance field.
fn baseline(config: &Config) -> Result<&'static Family> {
    family(config.representation()).ok_or_else(|| {
        Error::Config(format!(
            "method {}: this program was built without baselines; build it with `--features baselines`",
            config.method.name()
        ))
    })
}

impl Model {
    /// Returns the initial parameters of a run, and how often each of [`Model::parts`] was initialized again because it
    /// started dead.
    ///
    /// # Errors
    /// Settings do not suit the scene; every initialization is dead; the method is not built in.
    pub fn start(config: &Resolved, scene: &Scene, dtype: DType, runtime: &Runtime) -> Result<(Model, Vec<u64>)> {
        let device = runtime.device();
        if config.method.has_fields() {
            let (learner, redraws) = FieldLearner::start(config, scene, dtype, device)?;
            return Ok((Model::Fields(learner.fields().clone()), redraws));
        }
        let family = baseline(config)?;
        (family.check)(config, scene)?;
        Ok((Model::Baseline(config.representation(), (family.init)(config, dtype, device)?), vec![0]))
    }

    /// Checks that a run can start, from initial or other parameters. It makes no model.
    ///
    /// # Errors
    /// Those of [`Model::start`], except a dead start.
    pub fn check(config: &Resolved, scene: &Scene, dtype: DType, runtime: &Runtime) -> Result<()> {
        if !config.method.has_fields() {
            return (baseline(config)?.check)(config, scene);
        }
        FieldLearner::check(config, scene, dtype, runtime.device())
    }

    /// Returns the names of a configuration's networks, in the fixed order of parameters.
    pub fn parts(config: &Config) -> Vec<&'static str> {
        match config.method.has_fields() {
            true => Fields::roles(config),
            false => family(config.representation()).map(|family| family.part).into_iter().collect(),
        }
    }

    /// Returns names and shapes of all parameters, in their fixed order; empty for a method that is not built in.
    pub fn parameter_names(config: &Config) -> Vec<(String, Vec<usize>)> {
        match config.method.has_fields() {
            true => Fields::parameter_names(config),
            false => family(config.representation()).map(|family| (family.parameter_names)(config)).unwrap_or_default(),
        }
    }

    /// Returns a model over given values, in the order of [`Model::parameter_names`].
    ///
    /// # Errors
    /// Values have another number or shape; the method is not built in.
    pub fn from_parameters(config: &Config, values: Vec<Tensor>) -> Result<Model> {
        if config.method.has_fields() {
            return Ok(Model::Fields(Fields::from_parameters(config, values)?));
        }
        let representation = config.representation();
        Ok(Model::Baseline(representation, (baseline(config)?.from_parameters)(config, values)?))
    }

    /// Returns all parameters with their names, in the fixed order. They are shared, so a learner's updates are
    /// visible.
    pub fn variables(&self) -> Vec<(String, Var)> {
        match self {
            Model::Fields(fields) => fields.variables(),
            Model::Baseline(_, network) => network.variables(),
        }
    }

    /// Returns the same model as it is after `step` finished steps (see [`Fields::at_step`]).
    ///
    /// # Errors
    /// Errors of candle.
    pub fn at_step(&self, config: &Config, step: u64) -> Result<Model> {
        match self {
            Model::Fields(fields) => Ok(Model::Fields(fields.at_step(config, step)?)),
            Model::Baseline(..) => Ok(self.clone()),
        }
    }

    /// Returns a learner of these parameters from the training views of `scene`.
    ///
    /// # Errors
    /// Settings do not suit the scene.
    pub fn learner(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>> {
        match self {
            Model::Fields(fields) => Ok(Box::new(FieldLearner::new(config, scene, fields.clone(), dtype, device)?)),
            Model::Baseline(_, network) => network.learner(config, scene, dtype, device),
        }
    }

    /// Returns a renderer of `scene` on `runtime` with the current parameters. This is the one place that chooses it.
    ///
    /// # Errors
    /// A weight is not a number; errors of candle; the runtime's accelerator does not render the method.
    pub fn renderer(&self, config: &Config, scene: &Scene, runtime: &Runtime) -> Result<Box<dyn Renderer>> {
        if let Some(accelerator) = runtime.accelerator() {
            return accelerator.renderer(self.fields_on_accelerator(config)?, config, scene);
        }
        match self {
            Model::Fields(fields) => Ok(Box::new(FieldRenderer::new(fields, config, scene)?)),
            Model::Baseline(_, network) => network.renderer(config, scene),
        }
    }

    /// Returns whether the method has a density in space.
    pub fn has_density(&self) -> bool {
        match self {
            Model::Fields(_) => true,
            Model::Baseline(representation, _) => representation.lacks(Capability::Density).is_none(),
        }
    }

    /// Returns the density in space on `runtime` with the current parameters.
    ///
    /// # Errors
    /// The method has no density; the runtime's accelerator does not compute it.
    pub fn density(&self, runtime: &Runtime) -> Result<Box<dyn Density>> {
        match self {
            Model::Fields(fields) => match fields.occupancy() {
                // The processor alone knows occupied cells.
                Some(occupancy) => Ok(Box::new(OccupiedDensity::new(fields.evaluated(), occupancy)?)),
                None => density(runtime, fields.evaluated()),
            },
            Model::Baseline(representation, network) => {
                let density = network.density()?;
                density.ok_or_else(|| unsupported(*representation, Capability::Density, "no density"))
            }
        }
    }

    /// Returns the radiance fields, which alone an accelerator trains and renders.
    ///
    /// # Errors
    /// The method has no radiance fields.
    pub(crate) fn fields_on_accelerator(&self, config: &Config) -> Result<&Fields> {
        match self {
            Model::Fields(fields) => Ok(fields),
            Model::Baseline(..) => Err(accelerator::refused(config)),
        }
    }

    /// Returns the radiance fields.
    ///
    /// # Errors
    /// The method has no radiance fields.
    pub fn fields(&self) -> Result<&Fields> {
        match self {
            Model::Fields(fields) => Ok(fields),
            Model::Baseline(representation, _) => {
                Err(unsupported(*representation, Capability::Samples, "no radiance fields"))
            }
        }
    }
}

/// Returns the density of a field, on the runtime's accelerator where it has one. The processor alone has that of Gaussians.
pub(crate) fn density(runtime: &Runtime, field: &Field) -> Result<Box<dyn Density>> {
    match runtime.accelerator() {
        Some(accelerator) if !field.config().encoding.queries_gaussians() => accelerator.density(field),
        _ => Ok(Box::new(FieldDensity::new(field)?)),
    }
}

/// Returns the error for an operation that the representation does not support.
///
/// # Panics
/// If the representation has the capability.
fn unsupported(representation: Representation, capability: Capability, what: &str) -> Error {
    let why = representation.lacks(capability).expect("a capability that it lacks");
    Error::Config(format!("{what}: {why}"))
}

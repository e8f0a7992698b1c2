//! What is trained: the model of each method, how it learns and how it shows its scene.
//!
//! A method is its [`Model`], a [`Learner`] that draws a step's work and turns it into gradients, and a [`Painter`] that
//! turns rays into colours; some have fields, some have a density. To add one, write its file beside `fields`, name it in
//! [`Model`] and among the [`crate::settings::Method`]s.

use candle_core::{DType, Device, Tensor, Var};

use crate::base::{Error, Result};
use crate::data::Scene;
use crate::field::{Density, FieldDensity};
use crate::settings::{Ability, Config, Representation, Resolved};

mod batches;
mod diagnostics;
mod fields;
mod gradients;
mod learner;
mod painter;
mod planes;
mod srn;
mod volume;

pub use batches::{Batch, Batches};
pub use diagnostics::{SiteDiagnostics, SiteSummary};
pub use fields::{Balance, FieldLearner, FieldPainter, Fields, parts, step_over_radius};
pub use gradients::Gradients;
pub use learner::{Learned, Learner, LogColumns, Term, UnlessStopped};
pub use painter::{Painted, Painter};
pub use planes::{MpiNetwork, PlanesLearner, PlanesPainter};
pub use srn::{March, Srn, SrnLearner, SrnPainter};
pub use volume::{NeuralVolume, VolumeDensity, VolumeLearner, VolumePainter};

/// The parameters of one experiment. The one place that tells methods apart.
#[derive(Clone)]
#[expect(clippy::large_enum_variant, reason = "a run has one, and never moves it often")]
pub enum Model {
    /// NeRF and MipNeRF, augmented or not.
    Fields(Fields),
    /// Scene Representation Networks.
    Srn(Srn),
    /// Neural Volumes.
    Volume(NeuralVolume),
    /// The network of LLFF, trained on the scene.
    Planes(MpiNetwork),
}

/// What a run begins with.
pub struct Start {
    /// The freshly drawn parameters.
    pub model: Model,
    /// What learns them.
    pub learner: Box<dyn Learner>,
    /// How often each of [`Model::parts`] was drawn again before it was fit to learn.
    pub redraws: Vec<u64>,
}

impl Model {
    /// A run at step 0, dead starts drawn again.
    ///
    /// # Errors
    /// Settings that do not suit the scene; no draw that is fit to learn.
    pub fn start(config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Start> {
        match config.representation() {
            Representation::Nerf | Representation::MipNerf | Representation::HashNerf => {
                let (learner, redraws) = FieldLearner::start(config, scene, dtype, device)?;
                let model = Model::Fields(learner.fields().clone());
                Ok(Start { model, learner: Box::new(learner), redraws })
            }
            Representation::Srn => {
                let srn = Srn::init(&config.srn, config.seed, dtype, device)?;
                let model = Model::Srn(srn);
                let learner = model.learner(config, scene, dtype, device)?;
                Ok(Start { model, learner, redraws: vec![0] })
            }
            Representation::Volume => {
                let model = Model::Volume(NeuralVolume::init(config, dtype, device)?);
                let learner = model.learner(config, scene, dtype, device)?;
                Ok(Start { model, learner, redraws: vec![0] })
            }
            Representation::Planes => {
                let network = MpiNetwork::init(config, dtype, device)?;
                let learner = PlanesLearner::start(config, scene, network.clone())?;
                Ok(Start { model: Model::Planes(network), learner: Box::new(learner), redraws: vec![0] })
            }
        }
    }

    /// Names of the networks that a configuration has, in the fixed order of parameters.
    pub fn parts(config: &Config) -> Vec<&'static str> {
        match config.representation() {
            Representation::Nerf | Representation::MipNerf | Representation::HashNerf => Fields::roles(config),
            Representation::Srn => vec!["srn"],
            Representation::Volume => vec!["volume"],
            Representation::Planes => vec!["planes"],
        }
    }

    /// Names and shapes of all parameters, in their fixed order.
    pub fn parameter_names(config: &Config) -> Vec<(String, Vec<usize>)> {
        match config.representation() {
            Representation::Nerf | Representation::MipNerf | Representation::HashNerf => {
                Fields::parameter_names(config)
            }
            Representation::Srn => Srn::parameter_names(&config.srn),
            Representation::Volume => NeuralVolume::parameter_names(config),
            Representation::Planes => MpiNetwork::parameter_names(config),
        }
    }

    /// A model over given values, in the order of [`Model::parameter_names`].
    pub fn from_parameters(config: &Config, values: Vec<Tensor>) -> Result<Model> {
        match config.representation() {
            Representation::Nerf | Representation::MipNerf | Representation::HashNerf => {
                Ok(Model::Fields(Fields::from_parameters(config, values)?))
            }
            Representation::Srn => Ok(Model::Srn(Srn::from_parameters(&config.srn, values)?)),
            Representation::Volume => Ok(Model::Volume(NeuralVolume::from_parameters(config, values)?)),
            Representation::Planes => Ok(Model::Planes(MpiNetwork::from_parameters(config, values)?)),
        }
    }

    /// All parameters with their names, in the fixed order. They are shared: a learner's updates show.
    pub fn variables(&self) -> Vec<(String, Var)> {
        match self {
            Model::Fields(fields) => fields.variables(),
            Model::Srn(srn) => srn.variables().to_vec(),
            Model::Volume(volume) => volume.variables(),
            Model::Planes(network) => network.variables(),
        }
    }

    /// What learns these parameters from the training views of `scene`.
    pub fn learner(&self, config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<Box<dyn Learner>> {
        Ok(match self {
            Model::Fields(fields) => Box::new(FieldLearner::new(config, scene, fields.clone(), dtype, device)?),
            Model::Srn(srn) => Box::new(SrnLearner::new(config, scene, srn.clone(), dtype, device)?),
            Model::Volume(volume) => Box::new(VolumeLearner::new(config, scene, volume.clone(), dtype, device)?),
            Model::Planes(network) => Box::new(PlanesLearner::new(config, scene, network.clone())?),
        })
    }

    /// What shows `scene` with the parameters as they are now.
    pub fn painter(&self, config: &Config, scene: &Scene) -> Result<Box<dyn Painter>> {
        Ok(match self {
            Model::Fields(fields) => Box::new(FieldPainter::new(fields, config, scene)?),
            Model::Srn(srn) => Box::new(SrnPainter::new(srn)?),
            Model::Volume(volume) => Box::new(VolumePainter::new(volume, config, scene)?),
            Model::Planes(network) => Box::new(network.painter(config, scene)?),
        })
    }

    /// Density in space, with the parameters as they are now.
    ///
    /// # Errors
    /// A method that has none.
    pub fn density(&self) -> Result<Box<dyn Density>> {
        Ok(match self {
            Model::Fields(fields) => Box::new(FieldDensity::new(fields.evaluated())?),
            Model::Srn(_) => return Err(lacking(Representation::Srn, Ability::Density, "there is no density")),
            Model::Volume(volume) => Box::new(VolumeDensity::new(volume)?),
            Model::Planes(_) => return Err(lacking(Representation::Planes, Ability::Density, "there is no density")),
        })
    }

    /// The radiance fields.
    ///
    /// # Errors
    /// A method that has none.
    pub fn fields(&self) -> Result<&Fields> {
        match self {
            Model::Fields(fields) => Ok(fields),
            Model::Srn(_) => Err(lacking(Representation::Srn, Ability::Samples, "there are no radiance fields")),
            Model::Volume(_) => Err(lacking(Representation::Volume, Ability::Samples, "there are no radiance fields")),
            Model::Planes(_) => Err(lacking(Representation::Planes, Ability::Samples, "there are no radiance fields")),
        }
    }
}

/// Of a question to a model whose representation has no answer: `what` is asked for.
///
/// # Panics
/// Where the representation has the ability.
fn lacking(representation: Representation, ability: Ability, what: &str) -> Error {
    let why = representation.lacks(ability).expect("an ability that it lacks");
    Error::Config(format!("{what}: {why}"))
}

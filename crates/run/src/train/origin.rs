//! Runs that start from existing weights.

use std::path::Path;

use candle_core::{DType, Tensor};

use super::checkpoint::{State, Tensors, load_state};
use super::{Adam, AdamSettings, Moments, Trainer, check_memory};
use crate::base::Result;
use crate::data::Scene;
use crate::model::{Model, Start};
use crate::runtime::Runtime;
use crate::settings::Resolved;

/// Source of a run's initial weights.
pub enum Origin<'a> {
    /// A checkpoint of another run with the same networks.
    Checkpoint {
        /// Its folder.
        folder: &'a Path,
        /// If `true`, step and optimizer moments continue; otherwise both start at 0.
        goes_on: bool,
    },
    /// Values from any source, in the order of [`Model::parameter_names`].
    Weights {
        /// The values.
        values: Vec<Tensor>,
        /// The step of the weights; moments are 0.
        step: u64,
    },
}

impl Trainer {
    /// Creates a run that starts from existing weights. They are never initialized again, even if dead.
    ///
    /// # Errors
    /// [`Error::Checkpoint`](crate::base::Error::Checkpoint): the checkpoint is damaged or has other networks; weights
    /// have another shape; more memory is needed than is free.
    pub fn begin_from(
        origin: Origin,
        config: &Resolved,
        scene: &Scene,
        dtype: DType,
        runtime: &Runtime,
    ) -> Result<Trainer> {
        check_memory(config, scene, runtime)?;
        runtime.install(|| match origin {
            Origin::Checkpoint { folder, goes_on } => {
                Trainer::from_checkpoint(folder, goes_on, config, scene, dtype, runtime)
            }
            Origin::Weights { values, step } => {
                let model = Model::from_parameters(config, values)?;
                let redraws = vec![0; Model::parts(config).len()];
                let learner = model.learner(config, scene, dtype, runtime.device())?;
                Ok(Trainer {
                    step,
                    adam_since: step,
                    ..Trainer::with(config, Start { model, learner, redraws }, runtime)?
                })
            }
        })
    }

    fn from_checkpoint(
        folder: &Path,
        goes_on: bool,
        config: &Resolved,
        scene: &Scene,
        dtype: DType,
        runtime: &Runtime,
    ) -> Result<Trainer> {
        let state = load_state(folder)?;
        let (tensors, names) = (Tensors::open(folder, dtype, runtime.device())?, Model::parameter_names(config));
        let model = Model::from_parameters(config, tensors.all("", &names)?)?;
        let moments = if goes_on { Some(tensors.moments(&names)?) } else { None };
        let variables = model.variables();
        let State { step, adam_since, empty_steps, redraws, revisions, devices, instructions, .. } = state;
        let learner = model.learner(config, scene, dtype, runtime.device())?;
        let fresh = Trainer::with(config, Start { model, learner, redraws }, runtime)?;
        let trainer = Trainer { revisions, devices, instructions, ..fresh };
        let Some(moments) = moments else { return Ok(trainer) };
        let adam = Adam::restore(AdamSettings::of(&config.train), variables, moments);
        Ok(Trainer { adam, step, adam_since, empty_steps, ..trainer })
    }
}

impl Tensors {
    /// Returns the optimizer's moments of parameters.
    pub(super) fn moments(&self, names: &[(String, Vec<usize>)]) -> Result<Vec<Moments>> {
        let (first, second) = (self.all("adam.first.", names)?, self.all("adam.second.", names)?);
        Ok(first.into_iter().zip(second).map(|(first, second)| Moments { first, second }).collect())
    }
}

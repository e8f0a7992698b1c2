//! Runs that start from existing weights.

use std::path::Path;

use candle_core::{DType, Tensor};

use super::checkpoint::{State, Tensors, load_state};
use super::{Inputs, Moments, Trainer, check_memory};
use crate::accelerator;
use crate::base::Result;
use crate::data::Scene;
use crate::model::Model;
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
    /// have another shape. Those of [`Trainer::new`], but for a dead start.
    pub fn begin_from(
        origin: Origin,
        config: &Resolved,
        scene: &Scene,
        dtype: DType,
        runtime: &Runtime,
    ) -> Result<Trainer> {
        check_memory(config, scene, runtime)?;
        accelerator::check(config, runtime)?;
        let inputs = Inputs { config, scene, dtype, runtime };
        let redraws = vec![0; Model::parts(config).len()];
        runtime.install(|| {
            let (model, moments, state) = match origin {
                Origin::Checkpoint { folder, goes_on } => {
                    let state = load_state(folder)?;
                    let state = match goes_on {
                        true => state,
                        false => State { step: 0, adam_since: 0, empty_steps: 0, redraws, ..state },
                    };
                    let (model, moments) = inputs.restore(folder, state.step, goes_on)?;
                    (model, moments, state)
                }
                Origin::Weights { values, step } => {
                    let state = State { step, adam_since: step, redraws, ..State::default() };
                    (Model::from_parameters(config, values)?, None, state)
                }
            };
            Model::check(config, scene, dtype, runtime)?;
            let steps = inputs.steps(&model, moments)?;
            Ok(inputs.trainer(model, steps, state))
        })
    }
}

impl Tensors {
    /// Returns the optimizer's moments of parameters.
    pub(super) fn moments(&self, names: &[(String, Vec<usize>)]) -> Result<Vec<Moments>> {
        let (first, second) = (self.all("adam.first.", names)?, self.all("adam.second.", names)?);
        Ok(first.into_iter().zip(second).map(|(first, second)| Moments { first, second }).collect())
    }
}

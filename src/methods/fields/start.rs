//! The start of a run: fields that are alive.

use candle_core::{DType, Device, Tensor};

use crate::base::{Error, Result};
use crate::data::Scene;
use crate::render::positions_at;
use crate::settings::{DensityActivation, Resolved};

use super::learner::FieldLearner;
use super::networks::Fields;
use super::regularized;

/// Times that a dead start is drawn again before the configuration is blamed.
const MOST_REDRAWS: u64 = 100;

impl FieldLearner {
    /// Draws the fields of a run, dead starts again. Returns how often each field of [`Fields::roles`] was drawn again,
    /// too.
    pub fn start(config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<(FieldLearner, Vec<u64>)> {
        if config.regularizer.has_space_terms() {
            regularized::lattice(&config.regularizer).check_meets(scene, "regularizer.domain")?;
        }
        let mut redraws = vec![0; Fields::roles(config).len()];
        let fields = Fields::init(config, &redraws, dtype, device)?;
        let mut learner = FieldLearner::new(config, scene, fields, dtype, device)?;
        let first = learner.draw(0)?;
        let positions = positions_at(&learner.fields.coarse, &first.rays, &first.t_coarse)?.flatten(0, 1)?;
        loop {
            let dead = learner.dead_fields(&positions)?;
            if dead.is_empty() {
                break;
            }
            for field in dead {
                redraws[field] += 1;
                if redraws[field] > MOST_REDRAWS {
                    return Err(Error::Diverged(format!(
                        "{MOST_REDRAWS} draws of the {} field all start with under {} of densities positive; \
                         lower train.dead_start_share or change field.init",
                        Fields::roles(config)[field],
                        config.train.dead_start_share
                    )));
                }
            }
            learner.fields = Fields::init(config, &redraws, dtype, device)?;
            learner.variables = learner.fields.variables();
        }
        learner.check_duration(&learner.terms, &config.regularizer, config.train.steps)?;
        Ok((learner, redraws))
    }

    /// Fields whose share of positive densities at `positions` is under the configured one. Softplus has none: it is
    /// positive, and has a slope, everywhere.
    fn dead_fields(&self, positions: &Tensor) -> Result<Vec<usize>> {
        if self.config.field.density_activation == DensityActivation::Softplus {
            return Ok(Vec::new());
        }
        let mut dead = Vec::new();
        for (index, (_, field)) in self.fields.by_role().into_iter().enumerate() {
            let positive = field.frozen()?.raw_density(positions)?.gt(0f64)?.to_dtype(DType::F64)?;
            if positive.mean_all()?.to_scalar::<f64>()? < self.config.train.dead_start_share {
                dead.push(index);
            }
        }
        Ok(dead)
    }
}

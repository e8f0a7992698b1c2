//! The start of a run: fields that are not dead.

use candle_core::{DType, Device, Tensor};

use crate::base::{Error, Result};
use crate::data::{PointRays, RayParts, Scene};
use crate::field::settings::{Contraction, DensityActivation, Encoding, FieldConfig};
use crate::losses::WeightedTerm;
use crate::methods::batches::Batches;
use crate::render::settings::Placing;
use crate::render::{positions_at, sampling};
use crate::settings::Resolved;
use crate::space::Lattice;

use super::learner::{FieldLearner, check_device, unseen_cameras};
use super::networks::Fields;
use super::rays::StepRays;
use super::space;

/// Number of redraws of a dead start before the run fails.
const MOST_REDRAWS: u64 = 100;

impl FieldLearner {
    /// Initializes the fields of a run, and draws dead ones again. Also returns the number of redraws of each field of
    /// [`Fields::roles`].
    ///
    /// # Errors
    /// Those of [`FieldLearner::check`]; every initialization of a field is dead.
    pub fn start(config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<(FieldLearner, Vec<u64>)> {
        FieldLearner::check(config, scene, dtype, device)?;
        let mut redraws = vec![0; Fields::roles(config).len()];
        let fields = Fields::init(config, &redraws, dtype, device)?.at_step(config, 0)?;
        let mut learner = FieldLearner::new(config, scene, fields, dtype, device)?;
        let first = StepRays::batch(&mut learner, 0)?;
        let t_vals = match config.sampling.kind {
            Placing::Resampled => first.t_coarse().clone(),
            Placing::Occupancy => {
                let (edges, like) = (config.sampling.even() + 1, &first.rays.origins);
                sampling::stratified(scene.bounds(), config.sampling.spacing, first.rays.len(), edges, None, like)?
            }
        };
        let positions = positions_at(learner.fields.coarse(), &first.rays, &t_vals)?.flatten(0, 1)?;
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
            learner.fields = Fields::init(config, &redraws, dtype, device)?.at_step(config, 0)?;
            learner.variables = learner.fields.variables();
        }
        Ok((learner, redraws))
    }

    /// Checks the settings of a new run against its scene and device. It makes no field, so that it takes milliseconds.
    ///
    /// # Errors
    /// Those of [`FieldLearner::new`]; no ray meets a box of the settings.
    pub fn check(config: &Resolved, scene: &Scene, dtype: DType, device: &Device) -> Result<()> {
        config.regularizer.check_lattice()?;
        if config.regularizer.has_space_terms() {
            space::lattice(&config.regularizer).check_meets(scene, "regularizer.domain")?;
        }
        check_grid(config, scene)?;
        check_device(config, dtype, device)?;
        let batches = Batches::new(config, scene, RayParts::default())?;
        let points = PointRays::of(scene, config.data.origin_of_pixels());
        unseen_cameras(config, batches.cameras(), &points, &WeightedTerm::all(&config.regularizer)).map(drop)
    }

    /// Returns the fields whose fraction of positive densities at `positions` is below the configured one. Positions
    /// where density cannot be do not count. Softplus and the exponential are never dead: they are positive, and have a
    /// slope, everywhere.
    fn dead_fields(&self, positions: &Tensor) -> Result<Vec<usize>> {
        match self.config.field.density_activation {
            DensityActivation::Relu => {}
            DensityActivation::Softplus | DensityActivation::Exp => return Ok(Vec::new()),
        }
        let mut dead = Vec::new();
        for (index, (_, field)) in self.fields.by_role().enumerate() {
            let sum = |tensor: &Tensor| tensor.to_dtype(DType::F64)?.sum_all()?.to_scalar::<f64>();
            let positive = sum(&field.frozen()?.raw_density(positions)?.gt(0f64)?)?;
            let positions_inside = match field.inside(positions)? {
                Some(inside) => sum(&inside)?,
                None => positions.dim(0)? as f64,
            };
            // Without positions nothing is known. 0 times infinity is NaN, which is not below any fraction.
            if positive * positions_inside.recip() < self.config.train.dead_start_share {
                dead.push(index);
            }
        }
        Ok(dead)
    }
}

/// Returns an error for a hash grid's box that no ray meets. Everything outside of it is empty.
fn check_grid(config: &Resolved, scene: &Scene) -> Result<()> {
    let FieldConfig { encoding, hash, .. } = &config.field;
    match (encoding, hash.contraction, hash.bounds) {
        (Encoding::Hash, Some(Contraction::None), Some(domain)) => {
            Lattice { domain, side: 1 }.check_meets(scene, "field.hash.bounds")
        }
        _ => Ok(()),
    }
}

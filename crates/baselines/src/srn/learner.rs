//! Training of an SRN: random rays of the training views, complete marches, and the two terms of the original's loss.

use candle_core::{DType, Device};

use crate::base::Result;
use crate::base::rng::{Random, Stream};
use crate::data::{RayParts, Scene};
use crate::methods::Batches;
use crate::methods::{Learner, LogColumns, StepReport, StepResult, StopCheck, Term};
use crate::runtime::over_parts;
use crate::settings::Resolved;

use super::network::Srn;
use super::step::{StepWork, Sums, Weights};

/// Number of parts of a step, which threads share.
const PARTS: usize = 16;

/// Trains the SRN of one scene.
pub struct SrnLearner {
    config: Resolved,
    srn: Srn,
    batches: Batches,
    dtype: DType,
    device: Device,
}

impl SrnLearner {
    /// Creates a learner of `srn` on the training views of `scene`.
    ///
    /// # Errors
    /// If batches are larger than the training views allow.
    pub fn new(config: &Resolved, scene: &Scene, srn: Srn, dtype: DType, device: &Device) -> Result<SrnLearner> {
        Ok(SrnLearner {
            batches: Batches::new(config, scene, RayParts::default())?,
            config: config.clone(),
            srn,
            dtype,
            device: device.clone(),
        })
    }

    /// Returns the rays of a step, their targets, and their initial depths.
    fn draw(&mut self, step: u64) -> StepWork {
        let batch = self.batches.batch(step);
        let (mean, noise) = (self.config.srn.start_depth, self.config.srn.start_noise);
        let mut random = Random::new(self.config.seed, Stream::March, step);
        let normal = random.normal_values(batch.rays.len());
        let z_0 = normal.into_iter().map(|normal| (mean + noise * f64::from(normal)) as f32).collect();
        let target = batch.target.iter().map(|value| 2.0 * value - 1.0).collect();
        StepWork { rays: batch.rays, target, z_0 }
    }

    /// Processes the chunks of a step, in parallel parts.
    fn march(&self, work: &StepWork, stop_check: &StopCheck) -> Result<Sums> {
        let (rays, size) = (work.z_0.len(), self.config.train.chunk);
        let srn = &self.config.srn;
        let weights = Weights { image: srn.image_weight / (3 * rays) as f64, depth: srn.depth_weight / rays as f64 };
        let of_part = |starts: &[usize]| -> Result<Sums> {
            let mut sums = Sums::new(&self.srn);
            for &start in starts {
                stop_check()?;
                let chunk = start..rays.min(start + size);
                work.march(&self.srn, chunk, weights, (self.dtype, &self.device), &mut sums)?;
            }
            Ok(sums)
        };
        let starts: Vec<usize> = (0..rays).step_by(size).collect();
        // Parts are the same whatever the number of threads, and are added up in their order: it changes no bit.
        Sums::sum(over_parts(&self.device, &starts, starts.len().div_ceil(PARTS), of_part)?)
    }
}

impl Learner for SrnLearner {
    fn columns(&self) -> LogColumns {
        let further = ["loss_depth", "depth_deviation"].map(String::from).to_vec();
        LogColumns { photometric: vec!["loss_image".into()], further }
    }

    fn step(&mut self, step: u64, _log: bool, stop_check: &StopCheck) -> Result<StepResult> {
        let work = self.draw(step);
        let sums = self.march(&work, stop_check)?;
        let (rays, srn) = (work.z_0.len() as f64, &self.config.srn);
        let [image, depth] = [sums.image / (3.0 * rays), sums.behind / rays];
        let mean = sums.z / rays;
        let deviation = (sums.z_squared / rays - mean * mean).max(0.0).sqrt() / srn.scale;
        let term = |name: &str, described: &str, value: f64, weight: f64| Term {
            name: name.into(),
            described: described.into(),
            value,
            weight,
        };
        let terms = vec![
            term("loss_image", "loss of the colours", image, srn.image_weight),
            term("loss_depth", "loss of depths behind the camera", depth, srn.depth_weight),
            // If all rays end at one depth, the image is blank. This is a diagnostic, not part of the loss.
            term("depth_deviation", "deviation of the rays' depths", deviation, 0.0),
        ];
        let loss = srn.image_weight * image + srn.depth_weight * depth;
        let report = StepReport::new(terms, loss, sums.error / (3.0 * rays), sums.extremes);
        Ok(StepResult { gradients: sums.gradients, report })
    }
}

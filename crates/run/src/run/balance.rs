//! Weights that balance a regularizer with the photometric loss: the grid for a search.

use candle_core::DType;
use serde::Serialize;

use crate::base::{Error, Event, Listener, Result};
use crate::methods::FieldLearner;
use crate::runtime::Runtime;
use crate::settings::{Capability, Config, Method, Resolved};
use crate::space::Lattice;
use crate::train::Trainer;

use super::load_scene;

/// Gradient norm of the middle weight, as a fraction of the photometric gradient norm.
const MIDDLE_SHARE: f64 = 0.1;
/// The grid: two decades on each side of the middle.
const GRID: [f64; 5] = [1e-2, 1e-1, 1.0, 1e1, 1e2];

/// One weight of one term.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BalancedWeight {
    /// The term's name.
    pub term: String,
    /// Norm of the photometric loss's gradient with respect to all weights.
    pub photometric_norm: f64,
    /// Norm of the unweighted term's gradient.
    pub term_norm: f64,
    /// Norm of the weighted term's gradient divided by that of the photometric loss.
    pub share: f64,
    /// The weight that gives this ratio, or `None` if the term has no gradient.
    pub weight: Option<f64>,
}

/// Trains plain NeRF on `config`'s scene for `steps` steps. For each term, returns the weights that give it 0.1 %, 1
/// %, 10 %, 100 % and 1000 % of the photometric loss's gradient norm. Section `regularizer` says where terms are
/// evaluated; the training itself has no regularizer. Also returns the settings of the training.
///
/// # Errors
/// The method is not NeRF; the box misses the scene's rays; training diverges.
pub fn balance(
    config: Config,
    steps: u64,
    runtime: &Runtime,
    events: &dyn Listener,
) -> Result<(Resolved, Vec<BalancedWeight>)> {
    runtime.install(|| balance_here(config, steps, runtime, events))
}

fn balance_here(
    mut config: Config,
    steps: u64,
    runtime: &Runtime,
    events: &dyn Listener,
) -> Result<(Resolved, Vec<BalancedWeight>)> {
    if !config.method.has_fields() {
        config.require_capability(Capability::Derivatives, "--balance", "omit the method")?;
    }
    if config.method != Method::Nerf {
        return Err(Error::Config(format!(
            "--balance compares regularizers with the loss of plain NeRF; omit method {}",
            config.method.name()
        )));
    }
    let regularizer = std::mem::take(&mut config.regularizer);
    let (config, scene) = load_scene(config, events)?;
    // The training names no term that reads unseen rays, so it has lost where they are.
    let config = config.with_unseen(regularizer.unseen_rays, regularizer.unseen_poses)?;
    Lattice { domain: regularizer.domain, side: regularizer.lattice }.check_meets(&scene, "regularizer.domain")?;
    let mut trainer = Trainer::new(&config, &scene, DType::F32, runtime)?;
    // It shares the trainer's weights.
    let fields = trainer.model()?.fields()?.clone();
    let mut learner = FieldLearner::new(&config, &scene, fields, DType::F32, runtime.device())?;
    events.on(Event::TrainingStarted { first: 0, steps, rays: config.train.rays });
    for _ in 0..steps {
        let stats = trainer.step(false)?;
        events.on(Event::Stepped { step: stats.step, loss: stats.loss, psnr: stats.psnr() });
    }
    events.on(Event::TrainingFinished);
    // Brings the trained weights into the shared ones.
    trainer.model()?;
    let lines = learner.balance(&regularizer, steps)?.into_iter().flat_map(|balance| {
        GRID.map(|factor| {
            let share = MIDDLE_SHARE * factor;
            // A term without a gradient has no weight: there is nothing to divide by.
            let weight = Some(share * balance.photometric_norm / balance.term_norm).filter(|weight| weight.is_finite());
            let (photometric_norm, term_norm) = (balance.photometric_norm, balance.term_norm);
            BalancedWeight { term: balance.term.clone(), photometric_norm, term_norm, share, weight }
        })
    });
    let lines = lines.collect();
    Ok((config, lines))
}

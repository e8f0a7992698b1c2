//! Which weights balance a regularizer with the photometric loss: the grid for a search.

use candle_core::DType;
use serde::Serialize;

use crate::base::{Error, Event, Listener, Result};
use crate::losses::{LossTerm, WeightedTerm};
use crate::methods::FieldLearner;
use crate::runtime::Runtime;
use crate::settings::{Capability, Config, Method, REGULARIZERS, Resolved};
use crate::space::Lattice;
use crate::train::Trainer;

use super::load_scene;

/// The share of the photometric pull that the middle of a grid of weights has.
const MIDDLE_SHARE: f64 = 0.1;
/// The grid: two decades to each side of the middle.
const GRID: [f64; 5] = [1e-2, 1e-1, 1.0, 1e1, 1e2];

/// One weight of one term.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BalancedWeight {
    /// The term's name.
    pub term: String,
    /// Length of the photometric loss's gradient with respect to all weights.
    pub photometric_norm: f64,
    /// Length of the unweighted term's.
    pub term_norm: f64,
    /// The weighted term's length over the photometric loss's.
    pub share: f64,
    /// The weight that gives this share; none where the term has no pull.
    pub weight: Option<f64>,
}

/// Trains `config`'s scene for `steps` steps of plain NeRF and gives, for each term, the weights at which its gradient is 0.1 %, 1 %,
/// 10 %, 100 % and 1000 % as long as the photometric loss's. Where terms are evaluated is in the section `regularizer`; the
/// training itself is without any. Also gives the settings that it trained with.
///
/// # Errors
/// Another method than NeRF; a box that the scene's rays do not meet; a measurement that would take too long; training that goes
/// non-finite.
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
        config.require_capability(Capability::Derivatives, "balance", "leave the method out")?;
    }
    if config.method != Method::Nerf {
        return Err(Error::Config(format!(
            "balance measures regularizers beside the loss of plain NeRF: leave method {} out",
            config.method.name()
        )));
    }
    let regularizer = std::mem::take(&mut config.regularizer);
    let (config, scene) = load_scene(config, events)?;
    Lattice { domain: regularizer.domain, side: regularizer.lattice }.check_meets(&scene, "regularizer.domain")?;
    let mut trainer = Trainer::new(&config, &scene, DType::F32, runtime)?;
    // It shares the trainer's weights.
    let fields = trainer.model().fields()?.clone();
    let mut learner = FieldLearner::new(&config, &scene, fields, DType::F32, runtime.device())?;
    let in_space: Vec<WeightedTerm> =
        REGULARIZERS.map(|term| WeightedTerm { term: LossTerm::of(term), weight: 1.0 }).into();
    // Each term in space takes a pass of its own.
    let passes = REGULARIZERS.iter().filter(|term| term.in_space()).count();
    learner.check_duration(&in_space, &regularizer, passes as u64)?;
    events.on(Event::TrainingStarted { first: 0, steps, rays: config.train.rays });
    for _ in 0..steps {
        let stats = trainer.step(false)?;
        events.on(Event::Stepped { step: stats.step, loss: stats.loss, psnr: stats.psnr() });
    }
    events.on(Event::TrainingFinished);
    let lines = learner.balance(&regularizer, steps)?.into_iter().flat_map(|balance| {
        GRID.map(|factor| {
            let share = MIDDLE_SHARE * factor;
            // Nothing to divide by where the term has no pull: no weight, rather than a wrong one.
            let weight = Some(share * balance.photometric_norm / balance.term_norm).filter(|weight| weight.is_finite());
            let (photometric_norm, term_norm) = (balance.photometric_norm, balance.term_norm);
            BalancedWeight { term: balance.term.clone(), photometric_norm, term_norm, share, weight }
        })
    });
    let lines = lines.collect();
    Ok((config, lines))
}

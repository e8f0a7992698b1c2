//! What a step costs, and how many steps of one row cost as much as another row's.

use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::settings::{
    Config, DeltaSource, LatticePoints, PerturbConfig, RegularizedFields, RegularizerConfig, SecondPass,
};

use super::definition::BudgetKind;

/// Seconds of a step, wherever they come from.
pub trait StepCosts {
    /// Seconds of one training step of a configuration.
    fn seconds_per_step(&self, config: &Config) -> Result<f64>;

    /// Told once, before: all configurations, of distinct shapes, whose seconds will be asked for. They are compared with one
    /// another, and so should come from one source.
    fn prepare(&self, _configs: &[&Config]) -> Result<()> {
        Ok(())
    }

    /// What they are measured on; none where nothing is known of it.
    fn clock(&self) -> Option<Clock> {
        None
    }
}

/// What seconds were measured on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// The processor's model, or `unknown`.
    pub processor: String,
    /// The device, as `cpu`.
    pub device: String,
    /// Threads that worked.
    pub threads: usize,
    /// The code's revision.
    pub code_revision: String,
}

impl std::fmt::Display for Clock {
    /// `12th Gen Intel(R) Core(TM) i5 (cpu, 2 threads, revision 21b6470)`.
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Clock { processor, device, threads, code_revision } = self;
        write!(f, "{processor} ({device}, {threads} threads, revision {code_revision})")
    }
}

/// Steps of `config` that cost as much as all steps of `like`; at least 1.
pub fn steps_within(kind: BudgetKind, config: &Config, like: &Config, costs: &dyn StepCosts) -> Result<u64> {
    let (own, other) = match kind {
        BudgetKind::Evaluations => (evaluations_per_step(config), evaluations_per_step(like)),
        BudgetKind::Seconds => (costs.seconds_per_step(config)?, costs.seconds_per_step(like)?),
    };
    Ok(((like.train.steps as f64 * other / own).round() as u64).max(1))
}

/// Network evaluations of one step: passes through a network at one point, where a forward pass
/// counts one, and a backward pass one for the gradient of the layers' inputs and one for that of
/// the weights. A coarse pass that only places samples has no backward pass, and is neither searched nor perturbed.
pub fn evaluations_per_step(config: &Config) -> f64 {
    let (coarse, fine) = config.samples();
    match config.representation().has_coarse_loss() {
        true => evaluations(config, 0, coarse + fine),
        false => evaluations(config, coarse, fine),
    }
}

/// [`evaluations_per_step`] as revisions up to 8c7f6dc counted it: a pass that only places samples as one that is trained.
pub(super) struct PlacingCountedAsTrained;

impl StepCosts for PlacingCountedAsTrained {
    fn seconds_per_step(&self, config: &Config) -> Result<f64> {
        let (coarse, fine) = config.samples();
        Ok(evaluations(config, 0, coarse + fine))
    }
}

/// Of a step with so many samples a ray that are only placed by, and so many that are trained.
fn evaluations(config: &Config, placing: usize, trained: usize) -> f64 {
    let points = |samples: usize| (config.train.rays * samples) as f64;
    let clean = points(placing) + 3.0 * points(trained);
    let second = match (config.method.is_augmented(), config.perturb.second) {
        (false, _) => 0.0,
        (true, SecondPass::Clean) => clean,
        (true, SecondPass::Perturbed(DeltaSource::WorstCase)) => {
            (3.0 + 2.0 * f64::from(search_steps(&config.perturb))) * points(trained)
        }
        (true, SecondPass::Perturbed(_)) => 3.0 * points(trained),
    };
    clean + second + regularizer_evaluations(config)
}

/// Ascent steps of the search: a site with fewer waits for the one with most.
fn search_steps(perturb: &PerturbConfig) -> u32 {
    // Steps do not depend on the scene.
    let resolved = perturb.clone().resolve(1.0, 1, 1);
    resolved.numbers.iter().filter(|(_, site)| site.on()).map(|(_, site)| site.steps).max().unwrap_or(0) as u32
}

/// Forward pass, adjoint and the two products of its backward pass; the colour head counts as if it were there.
fn regularizer_evaluations(config: &Config) -> f64 {
    let RegularizerConfig { kind, points, points_per_step, lattice, fields, .. } = &config.regularizer;
    if !kind.iter().any(|kind| kind.in_space()) {
        return 0.0;
    }
    let points = match points {
        LatticePoints::Sampled => *points_per_step,
        LatticePoints::Full => lattice.pow(3),
    };
    let fields = if *fields == RegularizedFields::Both && config.sampling.fine > 0 { 2.0 } else { 1.0 };
    4.0 * fields * points as f64
}

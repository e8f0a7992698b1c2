//! Costs of training steps, and the steps that give two rows the same cost.

use crate::base::{Error, Result};
use crate::data::RayGroup;
use crate::settings::{
    Config, LatticePoints, PerturbConfig, Placing, RegularizedFields, RegularizerConfig, SecondPass, TermNeeds,
    TermRays,
};

use super::definition::BudgetKind;
use super::step_seconds::StepSeconds;

/// The error for a budget of evaluations with occupied cells.
const UNKNOWN: &str = "a budget of evaluations with sampling.kind = \"occupancy\": the samples of a step are not known before it; \
    take budget.kind = \"seconds\"";

/// Samples of a ray in occupied cells, and those of them that are seen, on average over trainings of the chair.
const OCCUPIED: (usize, usize) = (10, 6);

/// Returns the steps of `config` that cost as much as all steps of `like`; at least 1.
///
/// # Errors
/// The budget is in seconds, and `seconds` has none of a configuration; it is in evaluations, and occupied cells place samples.
pub(super) fn steps_within(kind: BudgetKind, config: &Config, like: &Config, seconds: &StepSeconds) -> Result<u64> {
    let cost = |config: &Config| match kind {
        BudgetKind::Evaluations if config.sampling.kind == Placing::Occupancy => Err(Error::Config(UNKNOWN.into())),
        BudgetKind::Evaluations => Ok(evaluations_per_step(config)),
        BudgetKind::Seconds => seconds.of(config).ok_or_else(|| Error::Config("its step was not measured".into())),
    };
    Ok(((like.train.steps as f64 * cost(like)? / cost(config)?).round() as u64).max(1))
}

/// Returns the network evaluations of one step. One evaluation is one pass through a network at one point. A forward
/// pass counts one. A backward pass counts two: one for the gradient of the layers' inputs, one for that of the
/// weights. A coarse pass that only places samples has no backward pass, and no PGD perturbs it.
///
/// How many samples occupied cells have depends on the scene and the step: it is an estimate then.
pub fn evaluations_per_step(config: &Config) -> f64 {
    if config.sampling.kind == Placing::Occupancy {
        let (placing, trained) = OCCUPIED;
        return evaluations(config, placing, trained);
    }
    let (coarse, fine) = config.samples();
    match config.representation().has_coarse_loss() {
        true => evaluations(config, 0, coarse + fine),
        false => evaluations(config, coarse, fine),
    }
}

/// Returns the evaluations of a step with `placing` samples a ray that only place others, and `trained` samples.
fn evaluations(config: &Config, placing: usize, trained: usize) -> f64 {
    let points = |samples: usize| (config.train.rays * samples) as f64;
    let clean = points(placing) + 3.0 * points(trained);
    let second = match (config.method.is_augmented(), config.perturb.second) {
        (false, _) => 0.0,
        (true, SecondPass::FreshJitter) => clean,
        (true, second) if second.searches() => (3.0 + 2.0 * f64::from(search_steps(&config.perturb))) * points(trained),
        (true, _) => 3.0 * points(trained),
    };
    // A sharpness-aware step computes everything twice.
    let times = if config.train.sam_radius > 0.0 { 2.0 } else { 1.0 };
    times * (clean + second + unseen_evaluations(config, placing, trained) + regularizer_evaluations(config))
}

/// Returns the PGD steps of the search: the largest number of any site.
fn search_steps(perturb: &PerturbConfig) -> u32 {
    // The number of steps does not depend on the scene.
    let numbers = perturb.clone().fill(1.0, 1, 1);
    numbers.iter().filter(|(_, site)| site.on()).map(|(_, site)| site.pgd.steps).max().unwrap_or(0) as u32
}

/// Counts the clean passes of unseen rays. A coarse pass in which no term counts only places samples.
fn unseen_evaluations(config: &Config, placing: usize, trained: usize) -> f64 {
    let RegularizerConfig { kind, fields, unseen_rays, .. } = &config.regularizer;
    let rays = unseen_rays.unwrap_or(config.train.rays);
    let (coarse, _) = config.samples();
    let of_group = |group: RayGroup| {
        let mut terms = kind.iter().filter(|term| term.group() == Some(group));
        let trains_coarse = *fields == RegularizedFields::Both && terms.any(|term| !term.is_of_evaluated_pass());
        let has_fine = config.sampling.fine > 0;
        let (placing, trained) = match placing == 0 && has_fine && !trains_coarse {
            true => (coarse, trained - coarse),
            false => (placing, trained),
        };
        (rays * placing) as f64 + 3.0 * (rays * trained) as f64
    };
    config.regularizer.unseen_groups().into_iter().map(of_group).sum()
}

/// Counts a forward pass, its adjoint, and the two products of the backward pass. The colour head is included in the
/// count.
fn regularizer_evaluations(config: &Config) -> f64 {
    let RegularizerConfig { kind, points, points_per_step, lattice, fields, rays, unseen_rays, .. } =
        &config.regularizer;
    let of_slopes = match kind.iter().any(|kind| kind.needs() == TermNeeds::Slopes) {
        true => {
            let rays = if *rays == TermRays::Unseen { *unseen_rays } else { None };
            let (coarse, fine) = config.samples();
            4.0 * (rays.unwrap_or(config.train.rays) * if fine > 0 { fine } else { coarse }) as f64
        }
        false => 0.0,
    };
    if !config.regularizer.has_space_terms() {
        return of_slopes;
    }
    let points = match points {
        LatticePoints::Sampled => *points_per_step,
        LatticePoints::Full => lattice.pow(3),
    };
    let fields = if *fields == RegularizedFields::Both && config.sampling.fine > 0 { 2.0 } else { 1.0 };
    of_slopes + 4.0 * fields * points as f64
}

//! What a step of fields consists of. The plan is made once from settings; the steps of the CPU and of a GPU execute it.

use std::sync::Arc;

use crate::losses::{RegularizedFields, WeightSchedule};
use crate::perturb::settings::{Objective, PerturbField, Resample, SecondPass};
use crate::perturb::{PaperSite, Site};
use crate::render::settings::Placing;
use crate::settings::Resolved;

/// The passes of a step in their order. Each list has a coarse pass, a fine one, or both.
pub struct Plan {
    /// The clean passes (paper, algorithm 1, lines 6 to 11).
    pub clean: Vec<PassPlan>,
    /// The passes after them: perturbed (lines 9 to 13), or clean again as the control of equal loss weight. `perturb.kind`
    /// chooses. Empty for methods that are not augmented.
    pub second: Vec<PassPlan>,
    objective: Objective,
    lambda: (f64, WeightSchedule),
}

/// One pass of a step.
#[derive(Clone)]
pub struct PassPlan {
    /// It is a coarse pass, or the fine one.
    pub is_coarse: bool,
    /// The field that it queries, one of [`Fields::roles`](super::Fields::roles).
    pub field: &'static str,
    /// Where its samples come from.
    pub samples: SampleSource,
    /// Number of samples of a ray.
    pub sample_count: usize,
    /// Weight of its squared error beside that of the other pass of the list.
    pub weight: f64,
    /// Its colours are those of an evaluation.
    pub is_evaluated: bool,
    /// The terms on rays that count in it.
    pub terms: CountedTerms,
    /// The deltas of a perturbed pass.
    pub deltas: Option<DeltaPlan>,
}

/// Where the samples of a pass come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleSource {
    /// Bins between near and far, with jitter.
    Stratified,
    /// The inverse CDF of the weights of the coarse pass before it.
    Resampled,
    /// The same, of the coarse field's density at stratified samples. That field has no pass of its own.
    PlacedByDensity,
    /// Even intervals in occupied cells, up to where the light ends.
    Occupied,
    /// They are those of the clean pass of its kind, coarse or fine.
    OfCleanPass,
}

/// The terms on rays that count in a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CountedTerms {
    /// All.
    All,
    /// All but those that count in the evaluated pass alone.
    ButOfEvaluated,
    /// None.
    None,
}

/// The deltas of a perturbed pass.
#[derive(Clone)]
pub struct DeltaPlan {
    /// Where they come from: not [`SecondPass::FreshJitter`], which has none.
    pub source: SecondPass,
    /// The sites with a delta, each with its PGD steps and its set.
    pub sites: Vec<Arc<dyn Site>>,
}

impl PassPlan {
    /// Returns whether a term on rays counts in it. Some count in the evaluated pass alone.
    pub fn counts(&self, is_of_evaluated_pass: bool) -> bool {
        match self.terms {
            CountedTerms::All => true,
            CountedTerms::ButOfEvaluated => !is_of_evaluated_pass,
            CountedTerms::None => false,
        }
    }
}

impl Plan {
    /// Returns the plan of a configuration.
    pub fn of(config: &Resolved) -> Plan {
        let clean = Plan::clean(config, config.regularizer.fields);
        let second = match (config.method.is_augmented(), config.perturb.second) {
            (false, _) => Vec::new(),
            (true, SecondPass::FreshJitter) => clean.iter().cloned().map(without_terms).collect(),
            (true, source) => {
                clean.iter().cloned().map(|pass| perturbed(config, source, without_terms(pass))).collect()
            }
        };
        let lambda = (config.perturb.lambda, config.perturb.lambda_schedule);
        Plan { clean, second, objective: config.perturb.objective, lambda }
    }

    /// Returns the clean passes, with terms in the passes of `fields`.
    pub fn clean(config: &Resolved, fields: RegularizedFields) -> Vec<PassPlan> {
        let (has_coarse, has_fine) = (config.representation().has_coarse_loss(), config.sampling.fine > 0);
        let (coarse, fine) = config.samples();
        let is_for_both = fields == RegularizedFields::Both;
        let coarse_pass = PassPlan {
            is_coarse: true,
            field: "coarse",
            samples: SampleSource::Stratified,
            sample_count: coarse,
            weight: if has_fine { config.train.coarse_weight } else { 1.0 },
            is_evaluated: !has_fine,
            terms: match (has_fine, is_for_both) {
                (false, _) => CountedTerms::All,
                (true, true) => CountedTerms::ButOfEvaluated,
                (true, false) => CountedTerms::None,
            },
            deltas: None,
        };
        let fine_pass = PassPlan {
            is_coarse: false,
            field: if config.representation().has_fine_field() { "fine" } else { "coarse" },
            samples: match config.sampling.kind {
                Placing::Occupancy => SampleSource::Occupied,
                Placing::Resampled if has_coarse => SampleSource::Resampled,
                Placing::Resampled => SampleSource::PlacedByDensity,
            },
            sample_count: fine,
            weight: 1.0,
            is_evaluated: true,
            terms: CountedTerms::All,
            deltas: None,
        };
        let passes = [(has_coarse || !has_fine).then_some(coarse_pass), has_fine.then_some(fine_pass)];
        passes.into_iter().flatten().collect()
    }

    /// Returns the passes of unseen rays, where `counts` says whether terms that read them count in a pass. A coarse pass
    /// without terms only places samples.
    pub fn unseen(clean: &[PassPlan], counts: impl Fn(&PassPlan) -> bool) -> Vec<PassPlan> {
        match clean {
            [coarse, fine] if !counts(coarse) => {
                vec![PassPlan { samples: SampleSource::PlacedByDensity, ..fine.clone() }]
            }
            _ => clean.to_vec(),
        }
    }

    /// Returns the factors of the photometric losses of the clean and of the second passes, in the step after `step` finished
    /// ones. Terms are not multiplied by them.
    pub fn loss_weights(&self, step: u64) -> (f64, f64) {
        let lambda = self.lambda.1.at(self.lambda.0, step);
        match (self.second.is_empty(), self.objective) {
            (true, _) => (1.0, 0.0),
            (false, Objective::Paper) => (1.0, lambda),
            (false, Objective::Released) => (1.0 - lambda, lambda),
        }
    }

    /// Adds a site of the user's own to the perturbed passes.
    pub fn add_site(&mut self, site: &Arc<dyn Site>) {
        let delta_plans = self.second.iter_mut().filter_map(|pass| pass.deltas.as_mut());
        delta_plans.for_each(|delta_plan| delta_plan.sites.push(site.clone()));
    }

    /// Returns the sites that were added.
    pub fn user_sites(&self) -> impl Iterator<Item = &Arc<dyn Site>> {
        let delta_plan = self.second.first().and_then(|pass| pass.deltas.as_ref());
        delta_plan.into_iter().flat_map(DeltaPlan::user_sites)
    }
}

impl DeltaPlan {
    /// Returns the sites of the user's own.
    pub fn user_sites(&self) -> impl Iterator<Item = &Arc<dyn Site>> {
        self.sites.iter().filter(|site| PaperSite::of_name(site.name()).is_none())
    }
}

/// Returns a pass without terms, which nothing is evaluated by.
fn without_terms(pass: PassPlan) -> PassPlan {
    PassPlan { is_evaluated: false, terms: CountedTerms::None, ..pass }
}

/// Returns the same pass with deltas, at the clean pass's samples. With `perturb.resample = "perturbed"`, the weights of the
/// perturbed coarse pass place the fine ones.
fn perturbed(config: &Resolved, source: SecondPass, pass: PassPlan) -> PassPlan {
    let resamples = config.perturb.resample == Resample::Perturbed && pass.samples == SampleSource::Resampled;
    PassPlan {
        field: match config.perturb.field {
            PerturbField::Shared => pass.field,
            PerturbField::Separate => "adversarial",
        },
        samples: if resamples { SampleSource::Resampled } else { SampleSource::OfCleanPass },
        deltas: Some(DeltaPlan { source, sites: config.perturb.sites_of_pass(&config.numbers, pass.is_coarse) }),
        ..pass
    }
}

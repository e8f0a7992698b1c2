//! What a step leaves to be read, and the report made of it.

use augnerf_nerf::methods::{Extremes, PassPlan, SiteDiagnostics, StepLosses, StepReport};
use augnerf_nerf::perturb::PaperSite;
use augnerf_nerf::settings::Regularizer;

use crate::record::{FIRST_TERM, ON_RAYS, SLOT};

use super::Steps;

const EIGHT_BIT: f64 = 255.0;

/// In a slot: mean squared error, 13 extremes, terms on rays.
const MSE: usize = 0;
/// In the slot of a field's terms in space; `integrals.wgsl` says which.
const L1: usize = 0;
const TV: usize = 1;
const LAPLACIAN: usize = FIRST_TERM;

/// Slots: clean passes, perturbed passes, terms in space of the coarse and the fine field, diagnostics.
pub(super) const SPACE: usize = 4;
pub(super) const DIAGNOSED: usize = 6;
/// Slots of a pass's diagnostics: without deltas, and of each site with its deltas, their shift, and with random ones.
const OF_PASS: usize = 1 + 3 * PaperSite::ALL.len();
pub(super) const SLOTS: usize = DIAGNOSED + 2 * OF_PASS;

/// Words of the flags: what is broken, and the first broken number of each field's weights and tables.
pub(super) const FLAGS: usize = 8;
/// Counts of a pass's and site's numbers at their bound, and of those that may move.
pub(super) const COUNTS: usize = 2 * 2 * PaperSite::ALL.len();

/// Words that a step leaves: results, flags and counts.
pub(super) const LEFT: usize = SLOTS * SLOT + FLAGS + COUNTS;

/// What a step left.
pub(super) struct Left {
    results: Vec<f32>,
    pub(super) flags: Vec<u32>,
    /// Counts of a step with diagnostics.
    counts: Option<Vec<u32>>,
}

impl Left {
    pub(super) fn of(bytes: &[u8], diagnosed: bool) -> Left {
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(bytes);
        let (results, words) = words.split_at(SLOTS * SLOT);
        let (flags, counts) = words.split_at(FLAGS);
        Left {
            results: results.iter().map(|word| f32::from_bits(*word)).collect(),
            flags: flags.to_vec(),
            counts: diagnosed.then(|| counts.to_vec()),
        }
    }
}

pub(super) fn no_flags() -> [u32; FLAGS] {
    let mut flags = [u32::MAX; FLAGS];
    flags[0] = 0;
    flags
}

/// The slot of a pass.
pub(super) fn slot(plan: &PassPlan, is_second: bool) -> usize {
    2 * usize::from(is_second) + usize::from(!plan.is_coarse)
}

/// The slot of a pass (0 coarse, 1 fine) without deltas.
pub(super) fn first_of(pass: usize) -> usize {
    DIAGNOSED + pass * OF_PASS
}

/// The slot of a pass with one site's deltas alone.
pub(super) fn alone(first: usize, site: PaperSite) -> usize {
    first + 1 + 3 * site as usize
}

/// The slot of a pass with random deltas of one site alone.
pub(super) fn at_random(first: usize, site: PaperSite) -> usize {
    alone(first, site) + 1
}

/// The slot of the shift of colours by one site's deltas.
pub(super) fn shift_of(first: usize, site: PaperSite) -> usize {
    alone(first, site) + 2
}

/// The place of a site's counts at bounds.
pub(super) fn bounded(pass: usize, site: PaperSite) -> usize {
    2 * (pass * PaperSite::ALL.len() + site as usize)
}

impl Steps {
    /// The slots of passes that a step has.
    pub(super) fn slots(&self, log: bool) -> Vec<usize> {
        let (clean, second) = (self.plan.clean.iter(), self.plan.second.iter());
        let mut slots: Vec<usize> =
            clean.map(|pass| slot(pass, false)).chain(second.map(|pass| slot(pass, true))).collect();
        if log {
            for (pass, sets) in self.sets.iter().enumerate() {
                let Some(sets) = sets else { continue };
                let first = first_of(pass);
                slots.push(first);
                slots.extend(sets.sites().flat_map(|site| [alone(first, site), at_random(first, site)]));
            }
        }
        slots
    }

    /// Makes the report of the step after `step` finished ones from its results.
    pub(super) fn report(&self, Left { results, counts, .. }: &Left, step: u64) -> StepReport {
        let (config, plan) = (&self.config, &self.plan);
        let value = |slot: usize, what: usize| f64::from(results[slot * SLOT + what]);
        let mse = |pass: &PassPlan, is_second: bool| value(slot(pass, is_second), MSE);
        let clean = |is_coarse: bool| plan.clean.iter().find(|pass| pass.is_coarse == is_coarse);
        let of_second = plan.second.iter().map(|pass| pass.weight * mse(pass, true));
        let losses = StepLosses {
            coarse: clean(true).map(|pass| mse(pass, false)),
            fine: clean(false).map(|pass| mse(pass, false)),
            perturbed: (!plan.second.is_empty()).then(|| of_second.sum()),
        };
        let terms = config.regularizer.terms_at(step).into_iter();
        let further: Vec<(&str, f64, f64)> =
            terms.map(|(term, weight)| (term.name(), weight, self.value_of(term, &value))).collect();
        let evaluated = plan.clean.iter().find(|pass| pass.is_evaluated).expect("a pass is evaluated");
        let extremes: Vec<f64> = (1..FIRST_TERM).map(|what| value(slot(evaluated, false), what)).collect();
        let sites = |clean| counts.as_ref().map_or_else(Vec::new, |counts| self.diagnose(&value, counts, clean));
        losses.report(plan, step, &further, Extremes::read(&extremes), sites)
    }

    /// The value of a regularizer, summed over its fields.
    fn value_of(&self, term: Regularizer, value: &impl Fn(usize, usize) -> f64) -> f64 {
        let in_space = |what: usize| self.regularized().map(|(role, _)| value(SPACE + role, what)).sum();
        match term {
            Regularizer::L1 => in_space(L1),
            Regularizer::Tv => in_space(TV),
            Regularizer::Laplacian => in_space(LAPLACIAN),
            _ => {
                let index = ON_RAYS.iter().position(|(known, _)| *known == term).expect("others are refused");
                let counting = self.plan.clean.iter().filter(|pass| pass.counts(term.is_of_evaluated_pass()));
                counting.map(|pass| value(slot(pass, false), FIRST_TERM + index)).sum()
            }
        }
    }

    /// Makes the diagnostics of each site from the losses of its passes.
    fn diagnose(&self, value: &impl Fn(usize, usize) -> f64, counts: &[u32], clean: f64) -> Vec<SiteDiagnostics> {
        let mut found = Vec::new();
        for (site, numbers) in self.config.numbers.iter() {
            if !numbers.on() {
                continue;
            }
            let (mut gain, mut over_random, mut shifts, mut passes) = (0.0, 0.0, 0.0, 0.0);
            let mut shares = Vec::new();
            for plan in &self.plan.second {
                let pass = slot(plan, false);
                let Some(sets) = &self.sets[pass] else { continue };
                if !sets.sites().any(|on| on == site) {
                    // Switched on with a set of size 0: there is no perturbation, and no gain.
                    passes += if numbers.perturbs() { 0.0 } else { 1.0 };
                    continue;
                }
                let first = first_of(pass);
                let loss = |slot: usize| plan.weight * value(slot, MSE);
                gain += loss(alone(first, site)) - loss(first);
                over_random += loss(alone(first, site)) - loss(at_random(first, site));
                shifts += EIGHT_BIT * value(shift_of(first, site), 0);
                passes += 1.0;
                let at = bounded(pass, site);
                if counts[at + 1] > 0 {
                    shares.push(f64::from(counts[at]) / f64::from(counts[at + 1]));
                }
            }
            if passes > 0.0 {
                let mean = shares.iter().sum::<f64>() / shares.len() as f64;
                let share = (!shares.is_empty()).then_some(mean);
                found.push(SiteDiagnostics::new(site.name(), [gain, over_random, shifts / passes], share, clean));
            }
        }
        found
    }

    /// Names what is not finite.
    pub(super) fn broken(&self, report: &StepReport, flags: &[u32]) -> Option<String> {
        if let Some(term) = report.terms.iter().find(|term| !term.value.is_finite()) {
            return Some(term.described.clone());
        }
        if flags[0] == 0 {
            return None;
        }
        let what = if flags[0] & 4 != 0 { "parameter" } else { "gradient" };
        let name = (0..2 * self.roles.len()).find_map(|i| {
            let at = flags[1 + i];
            (at != u32::MAX).then(|| {
                let part = if i % 2 == 0 { "weights" } else { "table" };
                format!("{}.{part}", self.roles[i / 2])
            })
        });
        Some(match name {
            Some(name) => format!("{what} of {name}"),
            None => "gradient of a table, which must be below 64,".into(),
        })
    }
}

//! The terms in space of a step, and the size of their gradients.

use candle_core::{DType, Tensor};

use crate::base::{Error, Result};
use crate::data::{RayGroup, UnseenCameras};
use crate::field::{Field, Order};
use crate::losses::{HashDecay, LossTerm, SpaceTerm, TermSource, WeightedTerm, estimate_seconds, regularize_unless};
use crate::methods::gradients::Gradients;
use crate::methods::learner::StopCheck;
use crate::settings::{
    CorruptionKind, Encoding, LatticePoints, REGULARIZERS, RegularizedFields, Regularizer, RegularizerConfig,
    TermNeeds, TermRays,
};
use crate::space::{Lattice, Quadrature};

use super::learner::FieldLearner;
use super::networks::Fields;
use super::terms::{StepLoss, in_space};

/// Longest time of regularizers in days. A run with more is rejected.
const MOST_DAYS: f64 = 30.0;
/// Longest time of a single step in minutes. There is no checkpoint within a step.
const MOST_MINUTES_A_STEP: f64 = 10.0;
const SECONDS_PER_MINUTE: f64 = 60.0;
const SECONDS_PER_DAY: f64 = 86_400.0;
/// With this few points per step no estimate is needed.
const SURELY_FINISHED: usize = 1 << 16;

/// The gradient norm of a term at weight 1, next to that of the photometric loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Balance {
    /// The term's name.
    pub term: String,
    /// Norm of the photometric loss's gradient in all weights of the coarse and the fine field.
    pub photometric_norm: f64,
    /// Norm of the term's gradient in the same weights.
    pub term_norm: f64,
}

/// Returns the sampling grid of a configuration.
pub(super) fn lattice(config: &RegularizerConfig) -> Lattice {
    Lattice { domain: config.domain, side: config.lattice }
}

/// Returns whether a check of a run measures how long its terms in space take.
pub fn is_timed(config: &RegularizerConfig) -> bool {
    config.has_space_terms() && points_per_step(config) > SURELY_FINISHED
}

/// Returns the points of a step's terms in space.
fn points_per_step(config: &RegularizerConfig) -> usize {
    match config.points {
        LatticePoints::Sampled => config.points_per_step,
        LatticePoints::Full => lattice(config).cells(),
    }
}

/// Returns whether terms in space count for the field of this role, one of `roles`.
pub fn is_regularized(config: &RegularizerConfig, roles: &[&str], role: &str) -> bool {
    let evaluated = if roles.contains(&"fine") { "fine" } else { "coarse" };
    match config.fields {
        RegularizedFields::Both => role != "adversarial",
        RegularizedFields::Fine => role == evaluated,
    }
}

impl FieldLearner {
    /// Returns unweighted values (f64 `[terms]`) and gradients of the weighted terms in space after `step` finished
    /// steps. `None` if there are no such terms.
    pub(super) fn regularize(
        &self,
        terms: &[(&dyn SpaceTerm, f64)],
        config: &RegularizerConfig,
        step: u64,
        stop_check: &StopCheck,
    ) -> Result<Option<(Tensor, Gradients)>> {
        if terms.is_empty() {
            return Ok(None);
        }
        let points = Quadrature::draw(config, self.config.seed, step);
        let mut values = Tensor::zeros(terms.len(), DType::F64, &self.device)?;
        let mut gradients = Vec::new();
        for (role, field) in self.fields.by_role() {
            if !self.regularizes(config, role) {
                gradients.extend(vec![None; field.variables().len()]);
                continue;
            }
            let regularized = regularize_unless(field, &points, terms, stop_check)?;
            values = (values + regularized.values)?;
            gradients.extend(regularized.gradients);
        }
        Ok(Some((values, Gradients(gradients))))
    }

    /// Returns the value of the tables' decay, and the gradients of `weight` times it in the entries that `reached`,
    /// gradients of the step, are not 0 at.
    pub(super) fn decay(
        &self,
        decay: HashDecay,
        weight: f64,
        config: &RegularizerConfig,
        reached: &Gradients,
    ) -> Result<(f64, Gradients)> {
        let (mut value, mut gradients) = (0.0, Vec::new());
        let mut rest = &reached.0[..];
        for (role, field) in self.fields.by_role() {
            let variables = field.variables();
            let (own, others) = rest.split_at(variables.len());
            rest = others;
            let mut of_field = vec![None; variables.len()];
            if let (Some(grid), Some(reached), true) = (field.hash_grid(), &own[0], self.regularizes(config, role)) {
                let (of_table, gradient) =
                    decay.value_and_gradient(grid, &variables[0].1.as_detached_tensor(), reached)?;
                value += of_table;
                of_field[0] = Some((gradient * weight)?);
            }
            gradients.extend(of_field);
        }
        Ok((value, Gradients(gradients)))
    }

    fn regularizes(&self, config: &RegularizerConfig, role: &str) -> bool {
        is_regularized(config, &Fields::roles(&self.config), role)
    }

    /// Returns an error if this run's terms in space would take this machine too long.
    ///
    /// # Errors
    /// They take more than 10 minutes a step, or 30 days.
    pub fn check_own_duration(&self) -> Result<()> {
        self.check_duration(&self.terms, &self.config.regularizer, self.config.train.steps)
    }

    /// Returns an error for terms in space whose points would take this machine too long in `steps` steps.
    pub fn check_duration(&self, terms: &[WeightedTerm], config: &RegularizerConfig, steps: u64) -> Result<()> {
        let terms = in_space(terms);
        let (lattice, points) = (lattice(config), points_per_step(config));
        if points <= SURELY_FINISHED || terms.is_empty() {
            return Ok(());
        }
        let fields: Vec<&Field> =
            self.fields.by_role().into_iter().filter(|(role, _)| self.regularizes(config, role)).map(|f| f.1).collect();
        let step = estimate_seconds(fields[0], &lattice, points, &terms)? * fields.len() as f64;
        let days = step * steps as f64 / SECONDS_PER_DAY;
        if days <= MOST_DAYS && step <= MOST_MINUTES_A_STEP * SECONDS_PER_MINUTE {
            return Ok(());
        }
        Err(Error::Config(format!(
            "regularizer.lattice = {}, points = \"{}\" queries {} points per step: about {step:.0} s per step here, \
             {days:.0} days for {steps} steps (at most {MOST_MINUTES_A_STEP} minutes and {MOST_DAYS} days are allowed); set \
             regularizer.points = \"sampled\" with \
             fewer points_per_step, or a smaller lattice",
            lattice.side,
            if config.points == LatticePoints::Full { "full" } else { "sampled" },
            points * fields.len()
        )))
    }

    /// Measures the gradient norm of every term at weight 1, and that of the photometric loss, on the batch of the step
    /// after `step` finished ones. `config` says where terms are evaluated. It changes no weights.
    pub fn balance(&mut self, config: &RegularizerConfig, step: u64) -> Result<Vec<Balance>> {
        self.fields = self.fields.at_step(&self.config, step)?;
        let whole = self.draw(step)?;
        let photometric = StepLoss {
            clean: 1.0,
            perturbed: 0.0,
            terms: &[],
            source: TermSource::TrainingRays,
            fields: config.fields,
        };
        let to_its_end: &StopCheck = &|| Ok(());
        let photometric_gradients = self.passes(&whole, photometric, false, to_its_end)?.gradients;
        let photometric_norm = photometric_gradients.norm()?;
        let field = self.config.field.clone();
        let has_unseen = UnseenCameras::of(self.batches.cameras(), self.config.unseen_poses).is_ok();
        let unseen_rays = self.config.unseen_rays;
        // A moved camera sees them elsewhere than its photo does.
        let is_moved = self.config.data.corruption.kind == CorruptionKind::Poses;
        let has_points = self.points.count() > 0 && !is_moved;
        let has_slopes = self.config.representation().has_derivatives_at_points();
        let measurable = |term: &Regularizer| match term.needs() {
            TermNeeds::Density(Order::Laplacian) => field.has_laplacian(),
            TermNeeds::Tables => field.encoding == Encoding::Hash,
            TermNeeds::Slopes if !has_slopes => false,
            TermNeeds::Samples(RayGroup::One) | TermNeeds::Slopes if config.rays == TermRays::Training => true,
            TermNeeds::Samples(RayGroup::Point) => has_points,
            TermNeeds::Samples(group) => has_unseen && unseen_rays >= group.rays(),
            TermNeeds::Slopes => has_unseen,
            TermNeeds::Density(_) => true,
        };
        let mut alone = |term: LossTerm| -> Result<Balance> {
            let name = term.name().to_string();
            let terms = [WeightedTerm::constant(term, 1.0)];
            let gradients = match &terms[0].term {
                LossTerm::InSpace(_) => {
                    self.regularize(&in_space(&terms), config, step, to_its_end)?.expect("a term").1
                }
                LossTerm::OnTables(decay) => self.decay(*decay, 1.0, config, &photometric_gradients)?.1,
                LossTerm::OnRays(term, TermRays::Unseen) => {
                    self.place_unseen_cameras(&terms)?;
                    self.on_unseen(term.group(), &terms, step, to_its_end)?.gradients
                }
                LossTerm::OnRays(..) => {
                    let alone = StepLoss { clean: 0.0, terms: &terms, ..photometric };
                    self.passes(&whole, alone, false, to_its_end)?.gradients
                }
            };
            Ok(Balance { term: name, photometric_norm, term_norm: gradients.norm()? })
        };
        REGULARIZERS.into_iter().filter(measurable).map(|term| alone(LossTerm::of(term, config))).collect()
    }
}

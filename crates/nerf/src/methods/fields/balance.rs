//! The gradient norms of terms beside that of the photometric loss.

use crate::base::Result;
use crate::data::settings::CorruptionKind;
use crate::data::{RayGroup, UnseenCameras};
use crate::field::Order;
use crate::field::settings::Encoding;
use crate::losses::{LossTerm, TermSource, WeightedTerm};
use crate::losses::{REGULARIZERS, Regularizer, RegularizerConfig, TermNeeds, TermRays};

use super::learner::FieldLearner;
use super::plan::{PassPlan, Plan};
use super::rays::StepRays;
use super::space::{space_terms, table_terms};
use super::step::{StepPasses, on_unseen};
use super::terms::in_space;

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

/// The check of a step that nothing stops.
const TO_ITS_END: fn() -> Result<()> = || Ok(());

/// Returns the clean passes of a step with their photometric loss alone.
fn photometric<'a>(learner: &'a FieldLearner, clean: &'a [PassPlan]) -> StepPasses<'a> {
    StepPasses {
        learner,
        clean,
        second: &[],
        weights: (1.0, 0.0),
        terms: &[],
        source: TermSource::TrainingRays,
        log: false,
        stop_check: &TO_ITS_END,
    }
}

impl FieldLearner {
    /// Measures the gradient norm of every term at weight 1, and that of the photometric loss, on the batch of the step
    /// after `step` finished ones. `config` says where terms are evaluated. It changes no weights.
    pub fn balance(&mut self, config: &RegularizerConfig, step: u64) -> Result<Vec<Balance>> {
        self.fields = self.fields.at_step(&self.config, step)?;
        let batch = StepRays::batch(self, step)?;
        let clean = Plan::clean(&self.config, config.fields);
        let of_photos = photometric(self, &clean).over(&batch)?.gradients;
        let photometric_norm = of_photos.norm()?;
        let field = self.config.field.clone();
        let (unseen, unseen_rays) =
            (UnseenCameras::of(self.batches.cameras(), self.config.unseen_poses).ok(), self.config.unseen_rays);
        let sees = |group: RayGroup| {
            unseen_rays >= group.rays() && unseen.as_ref().is_some_and(|cameras| cameras.check(group).is_ok())
        };
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
            TermNeeds::Samples(group) => sees(group),
            TermNeeds::Slopes => sees(RayGroup::One),
            TermNeeds::Density(_) => true,
        };
        let mut alone = |term: LossTerm| -> Result<Balance> {
            let name = term.name().to_string();
            let terms = [WeightedTerm::constant(term, 1.0)];
            if matches!(terms[0].term.source(), TermSource::UnseenRays(_)) {
                self.place_unseen_cameras(&terms)?;
            }
            let alone = StepPasses { weights: (0.0, 0.0), terms: &terms, ..photometric(self, &clean) };
            let gradients = match &terms[0].term {
                LossTerm::InSpace(_) => {
                    space_terms(self, &in_space(&terms), config, step, &TO_ITS_END)?.expect("a term").1
                }
                LossTerm::OnTables(term) => table_terms(self, *term, 1.0, config, &of_photos)?.1,
                LossTerm::OnRays(term, TermRays::Unseen) => on_unseen(alone, term.group(), step)?.gradients,
                LossTerm::OnRays(..) => alone.over(&batch)?.gradients,
            };
            Ok(Balance { term: name, photometric_norm, term_norm: gradients.norm()? })
        };
        REGULARIZERS.into_iter().filter(measurable).map(|term| alone(LossTerm::of(term, config))).collect()
    }
}

//! The gradient norms of terms beside that of the photometric loss.

use crate::base::Result;
use crate::data::RayGroup;
use crate::data::settings::CorruptionKind;
use crate::losses::{LossTerm, REGULARIZERS, RegularizerConfig, TermRays, TermSource, WeightedTerm};

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
        loss_weights: (1.0, 0.0),
        terms: &[],
        source: TermSource::TrainingRays,
        log: false,
        stop_check: &TO_ITS_END,
    }
}

impl FieldLearner {
    /// Measures the gradient norm of every term at weight 1, and that of the photometric loss, on the batch of the step
    /// after `step` finished ones. `config` says where terms are evaluated. Terms that need what the fields or the scene
    /// lack are left out. It changes no weights.
    pub fn balance(&mut self, config: &RegularizerConfig, step: u64) -> Result<Vec<Balance>> {
        self.fields = self.fields.at_step(&self.config, step)?;
        let batch = StepRays::batch(self, step)?;
        let clean = Plan::clean(&self.config, config.fields);
        let of_photos = photometric(self, &clean).over(&batch)?.gradients;
        let photometric_norm = of_photos.norm()?;
        // A moved camera sees points elsewhere than its photo does.
        let is_moved = self.config.data.corruption.kind == CorruptionKind::Poses;
        let alone = |term: LossTerm| -> Result<Option<Balance>> {
            let name = term.name().to_string();
            let misses_points = is_moved && term.source() == TermSource::UnseenRays(RayGroup::Point);
            let is_lacking = misses_points || self.check_term(&term).is_err();
            let terms = [WeightedTerm::constant(term, 1.0)];
            if is_lacking || self.place_unseen_cameras(&terms).is_err() {
                return Ok(None);
            }
            let alone = StepPasses { loss_weights: (0.0, 0.0), terms: &terms, ..photometric(self, &clean) };
            let gradients = match &terms[0].term {
                LossTerm::InSpace(_) => {
                    space_terms(self, &in_space(&terms), config, step, &TO_ITS_END)?.expect("a term").1
                }
                LossTerm::OnTables(term) => table_terms(self, *term, 1.0, config, &of_photos)?.1,
                LossTerm::OnRays(term, TermRays::Unseen) => on_unseen(alone, term.group(), step)?.gradients,
                LossTerm::OnRays(..) => alone.over(&batch)?.gradients,
            };
            Ok(Some(Balance { term: name, photometric_norm, term_norm: gradients.norm()? }))
        };
        let found = REGULARIZERS.iter().map(|term| LossTerm::of(*term, config)).map(alone);
        found.filter_map(Result::transpose).collect()
    }
}

//! The explicit regularizers of a step, and how hard they pull on the weights.

use candle_core::{DType, Tensor};

use crate::base::{Error, Result};
use crate::field::Field;
use crate::losses::{Regularized, estimate_seconds, regularize};
use crate::methods::gradients::Gradients;
use crate::settings::{LatticePoints, REGULARIZERS, RegularizedFields, Regularizer, RegularizerConfig};
use crate::space::{Lattice, Points};

use super::learner::FieldLearner;

/// A run whose regularizers alone would take longer is refused.
const MOST_DAYS: f64 = 30.0;
const SECONDS_PER_DAY: f64 = 86_400.0;
/// So few points a step need no estimate.
const SURELY_FINISHED: usize = 1 << 16;

/// How hard a term at weight 1 pulls on the weights, beside the photometric loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Balance {
    /// The term.
    pub term: Regularizer,
    /// Norm of the photometric loss's gradient in all weights of coarse and fine field.
    pub photometric_norm: f64,
    /// Norm of the term's gradient in the same weights.
    pub term_norm: f64,
}

/// The lattice that a configuration trains on.
pub(super) fn lattice(config: &RegularizerConfig) -> Lattice {
    Lattice { domain: config.domain, side: config.lattice }
}

impl FieldLearner {
    /// Unweighted values (f64 `[terms]`) and gradients of the weighted terms after `step` finished steps; none without terms.
    pub(super) fn regularize(&self, config: &RegularizerConfig, step: u64) -> Result<Option<(Tensor, Gradients)>> {
        let terms: Vec<(Regularizer, f64)> = config.terms().collect();
        if terms.is_empty() {
            return Ok(None);
        }
        let lattice = lattice(config);
        let points = Points::draw(config, &lattice, self.config.seed, step);
        let mut values = Tensor::zeros(terms.len(), DType::F64, &self.device)?;
        let mut gradients = Vec::new();
        for (role, field) in self.fields.by_role() {
            if !self.regularizes(config, role) {
                gradients.extend(vec![None; field.variables().len()]);
                continue;
            }
            let Regularized { values: of_field, gradients: its } =
                regularize(field, &lattice, &points, &terms, (self.dtype, &self.device))?;
            values = (values + of_field)?;
            gradients.extend(its);
        }
        Ok(Some((values, Gradients(gradients))))
    }

    fn regularizes(&self, config: &RegularizerConfig, role: &str) -> bool {
        let evaluated = if self.fields.fine().is_some() { "fine" } else { "coarse" };
        match config.fields {
            RegularizedFields::Both => role != "adversarial",
            RegularizedFields::Fine => role == evaluated,
        }
    }

    /// Refuses terms whose points this machine would not get through in `steps` steps.
    pub fn check_duration(&self, config: &RegularizerConfig, steps: u64) -> Result<()> {
        let lattice = lattice(config);
        let points = match config.points {
            LatticePoints::Sampled => config.points_per_step,
            LatticePoints::Full => lattice.cells(),
        };
        if points <= SURELY_FINISHED {
            return Ok(());
        }
        let fields: Vec<&Field> =
            self.fields.by_role().into_iter().filter(|(role, _)| self.regularizes(config, role)).map(|f| f.1).collect();
        let step =
            estimate_seconds(fields[0], &lattice, points, true, (self.dtype, &self.device))? * fields.len() as f64;
        let days = step * steps as f64 / SECONDS_PER_DAY;
        if days <= MOST_DAYS {
            return Ok(());
        }
        Err(Error::Config(format!(
            "regularizer.lattice = {}, points = \"{}\" asks for {} points in every step: about {step:.0} s a step here, \
             {days:.0} days for {steps} steps (at most {MOST_DAYS} are allowed); set regularizer.points = \"sampled\" with \
             fewer points_per_step, or a smaller lattice",
            lattice.side,
            if config.points == LatticePoints::Full { "full" } else { "sampled" },
            points * fields.len()
        )))
    }

    /// Measures the pull of every term at weight 1 and that of the photometric loss, on the batch
    /// of the step after `step` finished ones. `config` says where terms are evaluated. Moves nothing.
    pub fn balance(&mut self, config: &RegularizerConfig, step: u64) -> Result<Vec<Balance>> {
        let whole = self.draw(step)?;
        let photometric_norm = self.passes(&whole, false)?.gradients.norm()?;
        let of_term = |term: Regularizer| {
            let alone = RegularizerConfig { kind: vec![term], weight: vec![1.0], ..config.clone() };
            let (_, gradients) = self.regularize(&alone, step)?.expect("one term");
            Ok(Balance { term, photometric_norm, term_norm: gradients.norm()? })
        };
        REGULARIZERS.into_iter().map(of_term).collect()
    }
}

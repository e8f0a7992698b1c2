//! A learner's steps with Adam, on a device of candle: gradients, perhaps at weights that moved, and the update.

use candle_core::{DType, Tensor, Var};

use super::sharpness::{Draw, Sharpness, at_moved, clipped};
use super::{Adam, AdamSettings, Moments};
use crate::base::Result;
use crate::methods::{
    Gradients, Learner, LogColumns, StepAt, StepReport, StepResult, StopCheck, colour_shift, not_finite,
};
use crate::settings::{Config, TrainConfig};

/// The loss at moved weights minus that where they are, and minus that of weights that moved as far at random.
const GAIN: &str = "gain.weights";
const GAIN_OVER_RANDOM: &str = "gain_over_random.weights";
/// The mean absolute change of the rays' colours, in 8-bit steps.
const SHIFT: &str = "shift.weights";

/// A learner and Adam.
pub(super) struct Descent {
    pub(super) learner: Box<dyn Learner>,
    pub(super) adam: Adam,
    train: TrainConfig,
    sharpness: Option<Sharpness>,
}

impl Descent {
    pub(super) fn new(
        config: &Config,
        learner: Box<dyn Learner>,
        variables: Vec<(String, Var)>,
        moments: Option<Vec<Moments>>,
    ) -> Result<Descent> {
        let settings = AdamSettings::of(&config.train);
        let adam = match moments {
            Some(moments) => Adam::restore(settings, variables, moments),
            None => Adam::new(settings, variables)?,
        };
        Ok(Descent { learner, adam, train: config.train.clone(), sharpness: Sharpness::of(config) })
    }

    pub(super) fn columns(&self) -> LogColumns {
        let mut columns = self.learner.columns();
        if self.sharpness.is_some() {
            columns.further.extend([GAIN, GAIN_OVER_RANDOM].map(String::from));
            columns.further.extend(self.learner.has_colours().then(|| SHIFT.into()));
        }
        columns
    }

    /// Takes a step, and returns its report.
    pub(super) fn step(&mut self, at: StepAt, stop_check: &StopCheck) -> Result<StepReport> {
        let StepResult { gradients, report } = self.compute(at.step, at.log, stop_check)?;
        self.adam.update(&gradients.0, at.learning_rate, at.updates)?;
        self.check_parameters(at.step + 1)?;
        self.learner.updated(at.step + 1)?;
        Ok(report)
    }

    /// Computes all of a step but its update.
    pub(super) fn compute(&mut self, step: u64, log: bool, stop_check: &StopCheck) -> Result<StepResult> {
        let mut result = self.learner.step(step, log, stop_check)?;
        self.check_step(step + 1, &result.report, &result.gradients)?;
        if let Some(sharpness) = &self.sharpness {
            let (learner, variables) = (&mut *self.learner, self.adam.variables());
            result = at_moved_weights(sharpness, learner, variables, (step, log), result, stop_check)?;
            self.check_step(step + 1, &result.report, &result.gradients)?;
        }
        result.gradients = clipped(result.gradients, self.train.clip_value, self.train.clip_norm)?;
        Ok(result)
    }

    /// Returns an error if a term or a gradient of a step is not finite.
    fn check_step(&self, step: u64, report: &StepReport, gradients: &Gradients) -> Result<()> {
        let term = report.terms.iter().find(|term| !term.value.is_finite());
        let broken = match term {
            Some(term) => Some(term.described.clone()),
            None => self.find_non_finite(&gradients.0)?.map(|name| format!("gradient of {name}")),
        };
        broken.map_or(Ok(()), |tensor| Err(not_finite(step, &tensor, self.train.learning_rate)))
    }

    /// Returns an error if a parameter is not finite after an update.
    fn check_parameters(&self, step: u64) -> Result<()> {
        let parameters: Vec<Option<Tensor>> =
            self.adam.variables().iter().map(|(_, var)| Some(var.as_detached_tensor())).collect();
        let broken = self.find_non_finite(&parameters)?;
        broken.map_or(Ok(()), |name| Err(not_finite(step, &format!("parameter {name}"), self.train.learning_rate)))
    }

    /// Returns the name of the first parameter whose tensor is not finite. `tensors` are in the order of the variables.
    fn find_non_finite(&self, tensors: &[Option<Tensor>]) -> Result<Option<String>> {
        let variables = self.adam.variables().iter();
        let named = variables.zip(tensors).filter_map(|((name, _), g)| g.as_ref().map(|g| (name, g)));
        let (names, sums): (Vec<&String>, Vec<_>) = named.map(|(name, g)| (name, g.sum_all())).unzip();
        let sums: Vec<Tensor> = sums.into_iter().collect::<candle_core::Result<_>>()?;
        let sums: Vec<f64> = Tensor::stack(&sums, 0)?.to_dtype(DType::F64)?.to_vec1()?;
        Ok(names.into_iter().zip(sums).find(|(_, sum)| !sum.is_finite()).map(|(name, _)| name.clone()))
    }
}

/// Returns the gradients at weights that moved, with the report of where they are, and what the move gained.
fn at_moved_weights(
    sharpness: &Sharpness,
    learner: &mut dyn Learner,
    variables: &[(String, Var)],
    (step, log): (u64, bool),
    StepResult { gradients, mut report }: StepResult,
    stop_check: &StopCheck,
) -> Result<StepResult> {
    let displacement = sharpness.displacement(&gradients, step)?;
    let result = at_moved(variables, &displacement, || learner.step(step, false, stop_check))?;
    report.weight_columns.push((GAIN.into(), result.report.loss - report.loss));
    if log {
        let random = sharpness.random(&gradients, step, Draw::Compared)?;
        let random = at_moved(variables, &random, || learner.step(step, false, stop_check))?;
        report.weight_columns.push((GAIN_OVER_RANDOM.into(), result.report.loss - random.report.loss));
        let colours = at_moved(variables, &displacement, || learner.colours(step))?;
        if let Some((moved, unmoved)) = colours.zip(learner.colours(step)?) {
            report.weight_columns.push((SHIFT.into(), colour_shift(&moved, &unmoved)?));
        }
    }
    // A comparison that is not a number ends no training.
    report.weight_columns.retain(|(_, found)| found.is_finite());
    Ok(StepResult { gradients: result.gradients, report })
}

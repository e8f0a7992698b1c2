//! Steps of a learner with Adam, on a device of candle.

use candle_core::{DType, Tensor, Var};

use crate::base::Result;
use crate::losses::LossTerm;
use crate::optimizer::{Adam, AdamSettings, Moments};
use crate::settings::TrainConfig;

use super::gradients::Gradients;
use super::learner::{Learner, LogColumns, StepResult, StopCheck};
use super::stepper::{StepAt, StepReport, Stepper, not_finite};

/// A learner and Adam, whose parameters are the model's variables.
pub struct HostStepper {
    learner: Box<dyn Learner>,
    adam: Adam,
    /// As configured, for messages.
    learning_rate: f64,
    /// That of the last step.
    report: Option<StepReport>,
}

impl HostStepper {
    /// Creates a stepper of the learner's `variables`. Without saved `moments`, which are in the order of the
    /// variables, they are 0.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(
        train: &TrainConfig,
        learner: Box<dyn Learner>,
        variables: Vec<(String, Var)>,
        moments: Option<Vec<Moments>>,
    ) -> Result<HostStepper> {
        let settings = AdamSettings::of(train);
        let adam = match moments {
            Some(moments) => Adam::restore(settings, variables, moments),
            None => Adam::new(settings, variables)?,
        };
        Ok(HostStepper { learner, adam, learning_rate: train.learning_rate, report: None })
    }

    /// Returns an error if a term or a gradient of a step is not finite.
    fn check_step(&self, step: u64, report: &StepReport, gradients: &Gradients) -> Result<()> {
        let term = report.terms.iter().find(|term| !term.value.is_finite());
        let broken = match term {
            Some(term) => Some(term.described.clone()),
            None => self.find_non_finite(&gradients.0)?.map(|name| format!("gradient of {name}")),
        };
        broken.map_or(Ok(()), |tensor| Err(not_finite(step, &tensor, self.learning_rate)))
    }

    /// Returns an error if a parameter is not finite after an update.
    fn check_parameters(&self, step: u64) -> Result<()> {
        let parameters: Vec<Option<Tensor>> =
            self.adam.variables().iter().map(|(_, var)| Some(var.as_detached_tensor())).collect();
        let broken = self.find_non_finite(&parameters)?;
        broken.map_or(Ok(()), |name| Err(not_finite(step, &format!("parameter {name}"), self.learning_rate)))
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

impl Stepper for HostStepper {
    fn columns(&self) -> LogColumns {
        self.learner.columns()
    }

    fn add_term(&mut self, term: LossTerm, weight: f64) -> Result<()> {
        self.learner.add_term(term, weight)
    }

    fn step(&mut self, at: StepAt, stop_check: &StopCheck) -> Result<()> {
        let StepResult { gradients, report } = self.learner.step(at.step, at.log, stop_check)?;
        self.check_step(at.step + 1, &report, &gradients)?;
        self.adam.update(&gradients.0, at.learning_rate, at.updates)?;
        self.check_parameters(at.step + 1)?;
        self.report = Some(report);
        Ok(())
    }

    fn reports(&mut self) -> Result<Vec<StepReport>> {
        Ok(self.report.take().into_iter().collect())
    }

    fn try_step(&mut self, step: u64, stop_check: &StopCheck) -> Result<()> {
        self.learner.step(step, false, stop_check).map(drop)
    }

    fn fetch(&mut self) -> Result<()> {
        Ok(())
    }

    fn moments(&self) -> &[Moments] {
        self.adam.moments()
    }
}

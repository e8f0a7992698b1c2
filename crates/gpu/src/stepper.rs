//! The trainer's view of the steps on the device.

use augnerf_core::base::{Error, Result};
use augnerf_core::data::Scene;
use augnerf_core::losses::LossTerm;
use augnerf_core::methods::{Fields, LogColumns, StepAt, StepReport, Stepper, StopCheck};
use augnerf_core::optimizer::Moments;
use augnerf_core::settings::Resolved;

use crate::device::Gpu;
use crate::step::{MOST_REPORTS, Steps};

/// Takes steps on the device. Parameters and moments are there until they are fetched.
pub(crate) struct GpuStepper {
    steps: Steps,
    moments: Vec<Moments>,
}

impl GpuStepper {
    pub(crate) fn new(
        gpu: &Gpu,
        config: &Resolved,
        scene: &Scene,
        fields: &Fields,
        moments: Option<Vec<Moments>>,
    ) -> Result<GpuStepper> {
        let of_device = moments.as_ref().map(|moments| {
            let of = |moment: fn(&Moments) -> &candle_core::Tensor| moments.iter().map(|m| moment(m).clone()).collect();
            [of(|m| &m.first), of(|m| &m.second)]
        });
        let zero = || -> Result<Vec<Moments>> {
            let zeros = fields
                .variables()
                .into_iter()
                .map(|(_, var)| Ok(Moments { first: var.zeros_like()?, second: var.zeros_like()? }));
            zeros.collect()
        };
        let steps = Steps::new(gpu, config, scene, fields, of_device)?;
        Ok(GpuStepper { steps, moments: moments.map_or_else(zero, Ok)? })
    }
}

impl Stepper for GpuStepper {
    fn columns(&self) -> LogColumns {
        self.steps.columns()
    }

    fn add_term(&mut self, term: LossTerm, _weight: f64) -> Result<()> {
        Err(Error::Config(format!(
            "the term '{}' is your own, which device gpu does not compute; use cpu",
            term.name()
        )))
    }

    fn step(&mut self, at: StepAt, stop_check: &StopCheck) -> Result<()> {
        stop_check()?;
        self.steps.step(at.step, at.updates, at.learning_rate, at.log)
    }

    fn reports(&mut self) -> Result<Vec<StepReport>> {
        self.steps.reports()
    }

    fn most_reports(&self) -> usize {
        MOST_REPORTS
    }

    fn try_step(&mut self, step: u64, stop_check: &StopCheck) -> Result<()> {
        stop_check()?;
        self.steps.try_step(step, false).map(drop)
    }

    fn fetch(&mut self) -> Result<()> {
        let [first, second] = self.steps.fetch()?;
        let pairs = first.into_iter().zip(second);
        self.moments = pairs.map(|(first, second)| Moments { first, second }).collect();
        Ok(())
    }

    fn moments(&self) -> &[Moments] {
        &self.moments
    }
}

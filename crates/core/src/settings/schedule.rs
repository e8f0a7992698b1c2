//! How the weight of a term moves during training.

use serde::{Deserialize, Serialize};

use super::types::{Range, Settable};

/// A weight as a function of the step. Its setting's weight is that of `constant`, the end of `linear`, and the start of
/// `halved`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum WeightSchedule {
    /// The same in all steps.
    #[default]
    Constant,
    /// From a weight to the setting's in so many steps, along a line.
    Linear {
        /// Weight of the first step.
        from: f64,
        /// Number of steps.
        steps: u64,
    },
    /// Half as much after every so many steps.
    Halved {
        /// Number of steps.
        every: u64,
    },
}

impl WeightSchedule {
    /// Returns the weight of the step after `step` finished ones, where the setting's is `weight`.
    ///
    /// ```
    /// # use augnerf_core::settings::WeightSchedule;
    /// let falls = WeightSchedule::Linear { from: 400.0, steps: 512 };
    /// assert_eq!([0, 256, 512, 9000].map(|step| falls.at(0.0, step)), [400.0, 200.0, 0.0, 0.0]);
    /// let halves = WeightSchedule::Halved { every: 5000 };
    /// assert_eq!([0, 4999, 5000, 10_000].map(|step| halves.at(2.0, step)), [2.0, 2.0, 1.0, 0.5]);
    /// ```
    pub fn at(self, weight: f64, step: u64) -> f64 {
        match self {
            WeightSchedule::Constant => weight,
            WeightSchedule::Linear { from, steps } => from + (weight - from) * (step.min(steps) as f64 / steps as f64),
            WeightSchedule::Halved { every } => weight * 0.5f64.powf((step / every) as f64),
        }
    }

    /// Returns it as tables show it after a weight; nothing if the weight is constant.
    pub fn described(self) -> String {
        match self {
            WeightSchedule::Constant => String::new(),
            WeightSchedule::Linear { from, steps } => format!(" from {from} in {steps} steps"),
            WeightSchedule::Halved { every } => format!(" halved every {every} steps"),
        }
    }
}

impl Settable for WeightSchedule {
    fn kind() -> String {
        "constant, { linear = { from, steps } }, { halved = { every } }".into()
    }

    fn outside(&self, _: &Range) -> Option<String> {
        let is_possible = match *self {
            WeightSchedule::Constant => true,
            WeightSchedule::Linear { from, steps } => from.is_finite() && from >= 0.0 && steps > 0,
            WeightSchedule::Halved { every } => every > 0,
        };
        (!is_possible).then(|| self.described().trim_start().to_string())
    }
}

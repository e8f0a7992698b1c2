//! How the weight of a term moves during training.

use serde::{Deserialize, Serialize};

/// A weight as a function of the step. Its setting's weight is that of `constant`, the end of `from`, and the start of
/// `halved`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
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

const FORMS: &str = "constant, from WEIGHT in N steps, halved every N steps";

/// The schedules that a weight may have, in words.
pub(crate) const SCHEDULES: &str =
    "constant, from WEIGHT (at least 0) in N steps, or halved every N steps (N at least 1)";

impl TryFrom<String> for WeightSchedule {
    type Error = String;

    /// Reads what [`WeightSchedule::described`] writes.
    fn try_from(text: String) -> Result<WeightSchedule, String> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let read = match words[..] {
            ["constant"] => Some(WeightSchedule::Constant),
            ["from", from, "in", steps, "steps"] => {
                from.parse().ok().zip(steps.parse().ok()).map(|(from, steps)| WeightSchedule::Linear { from, steps })
            }
            ["halved", "every", every, "steps"] => every.parse().ok().map(|every| WeightSchedule::Halved { every }),
            _ => None,
        };
        read.ok_or_else(|| format!("\"{text}\" is no schedule of a weight; allowed are: {FORMS}"))
    }
}

impl From<WeightSchedule> for String {
    fn from(schedule: WeightSchedule) -> String {
        schedule.described()
    }
}

impl WeightSchedule {
    /// Returns the weight of the step after `step` finished ones, where the setting's is `weight`.
    ///
    /// ```
    /// # use augnerf_nerf::losses::WeightSchedule;
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

    /// Returns whether a text is a schedule with numbers that it may have.
    pub(crate) fn is_possible(text: &str) -> bool {
        WeightSchedule::try_from(text.to_string()).is_ok_and(|schedule| match schedule {
            WeightSchedule::Constant => true,
            WeightSchedule::Linear { from, steps } => from.is_finite() && from >= 0.0 && steps > 0,
            WeightSchedule::Halved { every } => every > 0,
        })
    }

    /// Returns it in words, as files and tables have it.
    pub fn described(self) -> String {
        match self {
            WeightSchedule::Constant => "constant".into(),
            WeightSchedule::Linear { from, steps } => format!("from {from} in {steps} steps"),
            WeightSchedule::Halved { every } => format!("halved every {every} steps"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_read_as_they_are_written() {
        for schedule in [
            WeightSchedule::Constant,
            WeightSchedule::Linear { from: 4e-7, steps: 512 },
            WeightSchedule::Halved { every: 5000 },
        ] {
            assert_eq!(WeightSchedule::try_from(schedule.described()), Ok(schedule));
        }
        for text in ["", "halved", "from 1 in x steps", "halved every -1 steps", "from 1 to 2"] {
            assert!(WeightSchedule::try_from(text.to_string()).unwrap_err().contains("halved every N steps"), "{text}");
        }
    }
}

//! The size of a delta's constraint set: a number, or the reach of its PGD steps.

use std::fmt;

use serde::{Deserialize, Serialize};
use toml::Value;

/// Size of a delta's constraint set.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Value", into = "Value")]
pub enum Epsilon {
    /// A number in the site's unit ([`super::settings::PerturbConfig`]); 0 is no perturbation.
    Units(f64),
    /// The reach of PGD, steps x step size, in the delta's own unit. `t` also keeps the order of samples.
    Reach,
}

/// The word for [`Epsilon::Reach`] in files.
pub const REACH: &str = "reach";

impl From<f64> for Epsilon {
    fn from(units: f64) -> Epsilon {
        Epsilon::Units(units)
    }
}

impl fmt::Display for Epsilon {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Epsilon::Units(units) => units.fmt(f),
            Epsilon::Reach => f.write_str(REACH),
        }
    }
}

impl From<Epsilon> for Value {
    fn from(epsilon: Epsilon) -> Value {
        match epsilon {
            Epsilon::Units(units) => units.into(),
            Epsilon::Reach => REACH.into(),
        }
    }
}

impl TryFrom<Value> for Epsilon {
    type Error = String;

    fn try_from(value: Value) -> Result<Epsilon, String> {
        match value {
            Value::Float(units) => Ok(Epsilon::Units(units)),
            Value::Integer(units) => Ok(Epsilon::Units(units as f64)),
            Value::String(word) if word == REACH => Ok(Epsilon::Reach),
            other => Err(format!("{other} is neither a number nor \"{REACH}\", which is steps x step size")),
        }
    }
}

//! The size of a delta's constraint set: a number, or the reach of its PGD steps.

use std::fmt;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Size of a delta's constraint set.
#[derive(Clone, Copy, Debug, PartialEq)]
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

impl Serialize for Epsilon {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Epsilon::Units(units) => serializer.serialize_f64(*units),
            Epsilon::Reach => serializer.serialize_str(REACH),
        }
    }
}

impl<'de> Deserialize<'de> for Epsilon {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Epsilon, D::Error> {
        deserializer.deserialize_any(NumberOrWord)
    }
}

struct NumberOrWord;

impl Visitor<'_> for NumberOrWord {
    type Value = Epsilon;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "a number, or \"{REACH}\" for steps x step size")
    }

    fn visit_f64<E: Error>(self, units: f64) -> Result<Epsilon, E> {
        Ok(Epsilon::Units(units))
    }

    fn visit_i64<E: Error>(self, units: i64) -> Result<Epsilon, E> {
        Ok(Epsilon::Units(units as f64))
    }

    fn visit_u64<E: Error>(self, units: u64) -> Result<Epsilon, E> {
        Ok(Epsilon::Units(units as f64))
    }

    fn visit_str<E: Error>(self, word: &str) -> Result<Epsilon, E> {
        if word == REACH { Ok(Epsilon::Reach) } else { Err(E::invalid_value(serde::de::Unexpected::Str(word), &self)) }
    }
}

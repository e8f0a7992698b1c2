//! The types of settings, and their ranges.

use crate::perturb::{Epsilon, REACH};
use serde::de::{DeserializeOwned, Deserializer, Visitor, value::Error as Unread};

/// The largest whole number that TOML can hold.
const MOST: u64 = i64::MAX as u64;

/// The values that a setting may have by itself.
#[derive(Clone, Copy, Debug)]
pub enum Range {
    /// All values of the type.
    Any,
    /// Whole numbers, including both ends.
    Whole(u64, u64),
    /// Finite numbers for which the function is true.
    Real(fn(f64) -> bool),
    /// Text for which the function is true.
    Text(fn(&str) -> bool),
    /// Two corners, with each number of the first below that of the second.
    Box,
}

/// Returns a number as people write it: a very large or small one with an exponent, such as 1e30.
pub(super) fn number_text(number: f64) -> String {
    let plain = number == 0.0 || !number.is_finite() || (1e-5..1e16).contains(&number.abs());
    if plain { number.to_string() } else { format!("{number:e}") }
}

/// A type of a setting.
pub trait Settable {
    /// Whether the setting may be left open.
    const OPTIONAL: bool = false;
    /// Returns the type in words, with its choices.
    fn kind() -> String;
    /// Returns the value's text if it is not in the range.
    fn outside(&self, range: &Range) -> Option<String>;
}

macro_rules! whole {
    ($($Type:ty),*) => {$(
        impl Settable for $Type {
            fn kind() -> String {
                "whole number".into()
            }

            fn outside(&self, range: &Range) -> Option<String> {
                let (least, most) = if let Range::Whole(least, most) = *range { (least, most) } else { (0, MOST) };
                (!(least..=most.min(MOST)).contains(&(*self as u64))).then(|| self.to_string())
            }
        }
    )*};
}
whole!(u32, u64, usize);

impl Settable for f64 {
    fn kind() -> String {
        "number".into()
    }

    fn outside(&self, range: &Range) -> Option<String> {
        let Range::Real(holds) = range else { return None };
        (!(self.is_finite() && holds(*self))).then(|| number_text(*self))
    }
}

impl Settable for Epsilon {
    fn kind() -> String {
        format!("number, or {REACH}")
    }

    fn outside(&self, range: &Range) -> Option<String> {
        match self {
            Epsilon::Units(units) => units.outside(range),
            Epsilon::Reach => None,
        }
    }
}

impl Settable for bool {
    fn kind() -> String {
        "true or false".into()
    }

    fn outside(&self, _: &Range) -> Option<String> {
        None
    }
}

impl Settable for String {
    fn kind() -> String {
        "text".into()
    }

    fn outside(&self, range: &Range) -> Option<String> {
        let Range::Text(holds) = range else { return None };
        (!holds(self)).then(|| format!("\"{self}\""))
    }
}

impl Settable for [[f64; 3]; 2] {
    fn kind() -> String {
        "[[x, y, z], [x, y, z]]".into()
    }

    fn outside(&self, _: &Range) -> Option<String> {
        let [lower, upper] = self;
        let is_box = lower.iter().zip(upper).all(|(a, b)| a.is_finite() && b.is_finite() && a < b);
        (!is_box).then(|| format!("{self:?}"))
    }
}

impl<T: Settable> Settable for Option<T> {
    const OPTIONAL: bool = true;

    fn kind() -> String {
        T::kind()
    }

    fn outside(&self, range: &Range) -> Option<String> {
        self.as_ref().and_then(|value| value.outside(range))
    }
}

impl<T: Settable> Settable for Vec<T> {
    fn kind() -> String {
        format!("list of: {}", T::kind())
    }

    fn outside(&self, range: &Range) -> Option<String> {
        self.iter().find_map(|value| value.outside(range))
    }
}

/// Returns the names of an enum's variants, or of a struct's fields, that serde knows.
pub(super) fn choices<T: DeserializeOwned>() -> &'static [&'static str] {
    let mut names: &'static [&'static str] = &[];
    // It always ends with an error, because there is nothing to read.
    let _ = T::deserialize(Names(&mut names));
    names
}

/// Reads nothing but records what was expected: the variants of an enum, or the fields of a struct.
struct Names<'a>(&'a mut &'static [&'static str]);

impl<'de> Deserializer<'de> for Names<'_> {
    type Error = Unread;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        Err(serde::de::Error::custom("nothing to read"))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Unread> {
        *self.0 = variants;
        self.deserialize_any(visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Unread> {
        *self.0 = fields;
        self.deserialize_any(visitor)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map identifier ignored_any
    }
}

/// Makes enums types of settings: one of their names.
macro_rules! choice {
    ($($Type:ty),* $(,)?) => {$(
        impl $crate::settings::types::Settable for $Type {
            fn kind() -> String {
                $crate::settings::types::choices::<$Type>().join(", ")
            }

            fn outside(&self, _: &$crate::settings::types::Range) -> Option<String> {
                None
            }
        }
    )*};
}

pub(super) use choice;

/// Returns a choice as files have it.
pub fn word(choice: impl serde::Serialize) -> String {
    let value = toml::Value::try_from(choice).expect("a choice is plain data");
    value.as_str().expect("a choice is a word").to_string()
}

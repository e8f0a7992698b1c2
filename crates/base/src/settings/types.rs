//! The types of settings in words, and the values that settings may have.

use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, SeqAccess, Visitor, value::Error as Unread};
use serde::{Deserialize, Serialize};
use toml::Value;

use crate::number_text;

/// The values that a setting may have by itself. In a list each value counts.
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
    /// Values, also lists, for which the function is true.
    Values(fn(&Value) -> bool),
}

impl Range {
    /// Returns the text of the value, or of the first one of a list, that is not in the range.
    pub(super) fn outside(&self, value: &Value) -> Option<String> {
        let is_inside = match (self, value) {
            (Range::Values(holds), value) => holds(value),
            (_, Value::Array(values)) => return values.iter().find_map(|value| self.outside(value)),
            (Range::Whole(least, most), Value::Integer(number)) => {
                u64::try_from(*number).is_ok_and(|number| (*least..=*most).contains(&number))
            }
            (Range::Real(holds), Value::Float(number)) => number.is_finite() && holds(*number),
            (Range::Text(holds), Value::String(text)) => holds(text),
            _ => true,
        };
        (!is_inside).then(|| match value {
            Value::Float(number) => number_text(*number),
            Value::String(text) => format!("\"{text}\""),
            other => other.to_string(),
        })
    }
}

/// Returns whether a value is a box: two corners, with each number of the first below that of the second.
pub(super) fn is_box(value: &Value) -> bool {
    let corners: Option<[[f64; 3]; 2]> = value.clone().try_into().ok();
    corners.is_some_and(|[lower, upper]| {
        lower.iter().zip(&upper).all(|(lower, upper)| lower.is_finite() && upper.is_finite() && lower < upper)
    })
}

/// Reads a list, or one value of it.
pub fn one_or_many<'de, T: DeserializeOwned, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    let value = Value::deserialize(deserializer)?;
    let values = if value.is_array() { value } else { Value::Array(vec![value]) };
    values.try_into().map_err(|error: toml::de::Error| serde::de::Error::custom(error.message()))
}

/// A type as serde reads it.
#[derive(Default)]
pub(super) struct Kind {
    /// The type in words. A choice is its names. Empty for a type that reads several forms.
    pub words: String,
    /// Whether a value may be left open.
    pub is_optional: bool,
    /// The names of an enum's variants, or of a struct's fields.
    pub names: &'static [&'static str],
}

/// Returns what serde asks for when it reads the type.
pub(super) fn kind_of<T: DeserializeOwned>() -> Kind {
    let mut kind = Kind::default();
    // It always ends with an error, because there is nothing to read.
    let _ = T::deserialize(Probe(&mut kind));
    kind
}

/// Returns the name of a choice in files: variant number `index` of the enum.
pub fn name_of<T: DeserializeOwned>(index: usize) -> &'static str {
    kind_of::<T>().names[index]
}

/// Returns all choices, in the order of the enum.
///
/// # Panics
/// A variant is not read from its name.
pub fn all_of<T: DeserializeOwned>() -> Vec<T> {
    let read = |name: &&str| Value::from(*name).try_into().expect("a choice is a name");
    kind_of::<T>().names.iter().map(read).collect()
}

/// Reads nothing, and records what was asked for.
struct Probe<'a>(&'a mut Kind);

impl Probe<'_> {
    fn found<T>(self, words: &str) -> Result<T, Unread> {
        self.0.words += words;
        Err(serde::de::Error::custom("nothing to read"))
    }
}

impl<'de> Deserializer<'de> for Probe<'_> {
    type Error = Unread;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        self.found("")
    }

    fn deserialize_bool<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        self.found("true or false")
    }

    fn deserialize_u32<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        self.found("whole number")
    }

    fn deserialize_u64<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        self.found("whole number")
    }

    fn deserialize_f64<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        self.found("number")
    }

    fn deserialize_string<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Unread> {
        self.found("text")
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unread> {
        self.0.is_optional = true;
        visitor.visit_some(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Unread> {
        self.0.words += "list of: ";
        visitor.visit_seq(self)
    }

    /// The only arrays are corners of boxes.
    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, _: V) -> Result<V::Value, Unread> {
        self.found("[[x, y, z], [x, y, z]]")
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Unread> {
        self.0.names = variants;
        self.found(&variants.join(", "))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Unread> {
        self.0.names = fields;
        self.found("")
    }

    serde::forward_to_deserialize_any! {
        i8 i16 i32 i64 i128 u8 u16 u128 f32 char str bytes byte_buf unit unit_struct newtype_struct tuple_struct map
        identifier ignored_any
    }
}

impl<'de> SeqAccess<'de> for Probe<'_> {
    type Error = Unread;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Unread> {
        seed.deserialize(Probe(self.0)).map(Some)
    }
}

/// Returns a choice as files have it.
pub fn word(choice: impl Serialize) -> String {
    let value = Value::try_from(choice).expect("a choice is plain data");
    value.as_str().expect("a choice is a word").to_string()
}

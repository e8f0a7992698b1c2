//! Fields of a JSON document, with messages that name the file and the key.

use std::cell::Cell;
use std::f64::consts::PI;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::Deserializer;
use serde::de::{self, DeserializeSeed, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

use super::pose::{self, Pose};
use super::{LARGEST, SMALLEST, brief};
use crate::base::input::read_bytes;
use crate::base::{Error, Result};

/// Most bytes of a scene's poses: those of some ten thousand views.
const MOST_BYTES: u64 = 32 << 20;

/// One object of a JSON file and where it stands.
#[derive(Clone, Copy)]
pub(super) struct Object<'a> {
    file: &'a Path,
    /// `""` for the document, `"frame 3: "` for a frame.
    place: Option<usize>,
    value: &'a Value,
}

/// Most values of a scene's poses, a hundred for each of some ten thousand views: a short text can hold millions, each of
/// which takes memory.
const MOST_VALUES: usize = 1 << 20;

/// Reads a JSON file.
pub(super) fn read(file: &Path) -> Result<Value> {
    let text = read_bytes(file, MOST_BYTES).map_err(|e| Error::unreadable(file, &e))?;
    let invalid = |e| Error::Data(format!("{} is not valid JSON: {e}", file.display()));
    let mut reader = serde_json::Deserializer::from_slice(&text);
    let value = Counted(&Cell::new(0)).deserialize(&mut reader).map_err(invalid)?;
    reader.end().map_err(invalid)?;
    Ok(value)
}

/// Reads a value as it stands, while those that it counts are not too many.
#[derive(Clone, Copy)]
struct Counted<'a>(&'a Cell<usize>);

impl<'de> DeserializeSeed<'de> for Counted<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, input: D) -> std::result::Result<Value, D::Error> {
        self.0.set(self.0.get() + 1);
        if self.0.get() > MOST_VALUES {
            return Err(de::Error::custom(format!("more than {MOST_VALUES} values, which no scene has")));
        }
        input.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Counted<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> std::result::Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_str<E>(self, value: &str) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> std::result::Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = list.next_element_seed(self)? {
            values.push(value);
        }
        Ok(Value::Array(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> std::result::Result<Value, A::Error> {
        let mut map = serde_json::Map::new();
        while let Some(key) = entries.next_key::<String>()? {
            map.insert(key, entries.next_value_seed(self)?);
        }
        Ok(Value::Object(map))
    }
}

impl<'a> Object<'a> {
    /// The document itself.
    pub(super) fn document(file: &'a Path, value: &'a Value) -> Result<Object<'a>> {
        let object = Object { file, place: None, value };
        if !value.is_object() {
            return Err(object.error(&format!("the document is {}, but it must be an object", kind(value))));
        }
        Ok(object)
    }

    /// An error about this object.
    pub(super) fn error(&self, what: &str) -> Error {
        let place = self.place.map(|i| format!("frame {i} (counted from 0): ")).unwrap_or_default();
        Error::Data(format!("{}: {place}{what}", self.file.display()))
    }

    /// The elements of `frames`, at least one.
    pub(super) fn frames(&self) -> Result<Vec<Object<'a>>> {
        self.objects("frames")
    }

    /// The elements of a list of views, at least one.
    pub(super) fn objects(&self, key: &str) -> Result<Vec<Object<'a>>> {
        let frames = self.required(key)?;
        let list = frames.as_array().ok_or_else(|| self.wrong(key, frames, "an array"))?;
        if list.is_empty() {
            return Err(self.error(&format!("\"{key}\" is empty, but at least one view is needed")));
        }
        let frame = |(i, value)| {
            let object = Object { file: self.file, place: Some(i), value };
            let found = kind(value);
            value.is_object().then_some(object).ok_or_else(|| object.error(&format!("{found} instead of an object")))
        };
        list.iter().enumerate().map(frame).collect()
    }

    /// A key that may be missing or null.
    pub(super) fn get(&self, key: &str) -> Option<&'a Value> {
        self.value.get(key).filter(|value| !value.is_null())
    }

    /// A number of the size that scenes have; it may be missing.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let number = value.as_f64().filter(|v| v.abs() <= LARGEST);
        number
            .map(Some)
            .ok_or_else(|| self.wrong(key, value, &format!("a finite number from -{LARGEST:e} to {LARGEST:e}")))
    }

    /// A text that may be missing.
    pub(super) fn text(&self, key: &str) -> Result<Option<&'a str>> {
        let Some(value) = self.get(key) else { return Ok(None) };
        value.as_str().map(Some).ok_or_else(|| self.wrong(key, value, "a text"))
    }

    /// `camera_angle_x` or `camera_angle_y`: a field of view in radians, if it is there.
    pub(super) fn angle(&self, key: &str) -> Result<Option<f64>> {
        let angle = self.number(key)?;
        match angle {
            Some(v) if !(SMALLEST..=PI - SMALLEST).contains(&v) => Err(self.error(&format!(
                "\"{key}\" is {}, but a field of view lies between 0 and pi radians, {SMALLEST:e} away from both",
                brief(v)
            ))),
            angle => Ok(angle),
        }
    }

    /// `transform_matrix`: camera to world, 4x4 or 3x4.
    pub(super) fn pose(&self) -> Result<Pose> {
        self.pose_at("transform_matrix")
    }

    /// A rigid pose under any key, 4x4 or 3x4.
    pub(super) fn pose_at(&self, key: &str) -> Result<Pose> {
        let value = self.required(key)?;
        let needed = format!("a 4x4 matrix of finite numbers from -{LARGEST:e} to {LARGEST:e}");
        let wrong = || self.wrong(key, value, &needed);
        let rows = value.as_array().filter(|rows| (3..=4).contains(&rows.len())).ok_or_else(wrong)?;
        let mut pose = [[0.0; 4]; 3];
        for (row, target) in rows.iter().zip(&mut pose) {
            let numbers = row.as_array().filter(|row| row.len() == 4).ok_or_else(wrong)?;
            for (number, target) in numbers.iter().zip(target) {
                *target = number.as_f64().filter(|v| v.abs() <= LARGEST).ok_or_else(wrong)?;
            }
        }
        pose::check_rotation(&pose).map_err(|what| {
            self.error(&format!("the left 3x3 part of \"{key}\" must be a rotation, but it has {what}"))
        })?;
        Ok(pose)
    }

    /// The image file that `file_path` names, relative to the JSON file, with or without an ending.
    pub(super) fn image(&self) -> Result<PathBuf> {
        let value = self.required("file_path")?;
        let text = value.as_str().ok_or_else(|| self.wrong("file_path", value, "a text"))?;
        let relative = text.replace('\\', "/");
        let folder = self.file.parent().unwrap_or(Path::new(""));
        let path = folder.join(relative.trim_start_matches("./"));
        if path.is_file() && super::images::is_image(&path) {
            return Ok(path);
        }
        for ending in ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"] {
            let candidate = PathBuf::from(format!("{}.{ending}", path.display()));
            if candidate.is_file() {
                return Ok(candidate);
            }
        }
        Err(self.error(&format!(
            "\"file_path\" is \"{text}\", but there is no image {} (also not with .png, .jpg or .jpeg added)",
            path.display()
        )))
    }

    /// A key that must be there.
    pub(super) fn required(&self, key: &str) -> Result<&'a Value> {
        self.get(key).ok_or_else(|| self.error(&format!("the key \"{key}\" is missing")))
    }

    fn wrong(&self, key: &str, found: &Value, needed: &str) -> Error {
        let mut shown = found.to_string();
        if let Some((end, _)) = shown.char_indices().nth(60) {
            shown.truncate(end);
            shown.push_str("...");
        }
        self.error(&format!("\"{key}\" is {shown}, but it must be {needed}"))
    }
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "an array",
        Value::Object(_) => "an object",
    }
}

//! Fields of a JSON document, with messages that name the file and the key.

use std::borrow::Cow;
use std::cell::Cell;
use std::f64::consts::PI;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::Deserializer;
use serde::de::{self, DeserializeSeed, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

use super::images::{ENDINGS, is_image};
use super::pose::{self, Pose};
use super::{LARGEST, SMALLEST, brief};
use crate::base::input::read_bytes;
use crate::base::{Error, Result};
use crate::settings::Axes;

/// Largest size of a scene's poses in bytes: those of some ten thousand views.
const MOST_BYTES: u64 = 32 << 20;

/// An object of a JSON file and its location.
#[derive(Clone, Copy)]
pub(super) struct Object<'a> {
    file: &'a Path,
    /// `None` for the document, the number of a frame otherwise.
    place: Option<usize>,
    value: &'a Value,
}

/// Largest number of values in a scene's poses: a hundred for each of some ten thousand views. A short text can hold
/// millions, each of which takes memory.
const MOST_VALUES: usize = 1 << 20;

/// Reads a JSON file. A byte order mark is ignored. `NaN` and the like, as Python writes them, become strings: they
/// matter only where a number is needed.
pub(super) fn read(file: &Path) -> Result<Value> {
    parse(file, &read_bytes(file, MOST_BYTES).map_err(|e| Error::unreadable(file, &e))?)
}

/// Parses the text of a JSON file as [`read`] does.
pub(super) fn parse(file: &Path, text: &[u8]) -> Result<Value> {
    let text = quote_no_numbers(text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text));
    let invalid = |e| Error::Data(format!("{} is not valid JSON: {e}", file.display()));
    let mut reader = serde_json::Deserializer::from_slice(&text);
    let value = Counted(&Cell::new(0)).deserialize(&mut reader).map_err(invalid)?;
    reader.end().map_err(invalid)?;
    Ok(value)
}

/// Returns whether a JSON file lists frames, as a scene's poses do.
pub(super) fn lists_frames(file: &Path) -> bool {
    read(file).is_ok_and(|value| value["frames"].as_array().is_some_and(|frames| !frames.is_empty()))
}

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
/// What Python's and JavaScript's writers write for numbers that are not finite.
const NO_NUMBERS: [&[u8]; 3] = [b"-Infinity", b"Infinity", b"NaN"];

/// Returns the text with quotes around `NaN`, `Infinity` and `-Infinity` outside of strings.
fn quote_no_numbers(text: &[u8]) -> Cow<'_, [u8]> {
    let mut quoted = Vec::new();
    let (mut copied, mut at, mut in_text) = (0, 0, false);
    while at < text.len() {
        match text[at] {
            b'\\' if in_text => at += 1,
            b'"' => in_text = !in_text,
            b'-' | b'I' | b'N' if !in_text => {
                if let Some(word) = NO_NUMBERS.iter().find(|word| text[at..].starts_with(word)) {
                    quoted.extend_from_slice(&text[copied..at]);
                    quoted.extend([b"\"", *word, b"\""].concat());
                    at += word.len() - 1;
                    copied = at + 1;
                }
            }
            _ => {}
        }
        at += 1;
    }
    if copied == 0 {
        return text.into();
    }
    quoted.extend_from_slice(&text[copied..]);
    quoted.into()
}

/// Reads a value, and counts values up to a limit.
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

    /// Returns an error about this object.
    pub(super) fn error(&self, what: &str) -> Error {
        let place = self.place.map(|i| format!("frame {i} (counted from 0): ")).unwrap_or_default();
        Error::Data(format!("{}: {place}{what}", self.file.display()))
    }

    /// Returns the elements of `frames`, at least one.
    pub(super) fn frames(&self) -> Result<Vec<Object<'a>>> {
        self.objects("frames")
    }

    /// Returns the elements of a list of views, at least one.
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

    /// Returns whether a list is there and empty.
    pub(super) fn is_empty(&self, key: &str) -> bool {
        self.value.get(key).and_then(Value::as_array).is_some_and(Vec::is_empty)
    }

    /// Returns the first key that says that cameras are orthographic: by its name, such as `ortho_scale`, or by its text.
    pub(super) fn orthographic(&self) -> Option<&'a str> {
        let says = |text: &str| text.to_lowercase().contains("ortho");
        let is_said = |(key, value): &(&'a String, &Value)| match value {
            Value::String(text) => says(text) || says(key),
            Value::Bool(yes) => *yes && says(key),
            Value::Number(number) => says(key) && number.as_f64() != Some(0.0),
            _ => false,
        };
        self.value.as_object()?.iter().find(is_said).map(|(key, _)| &**key)
    }

    /// Returns whether a key is there and null.
    pub(super) fn is_null(&self, key: &str) -> bool {
        self.value.get(key).is_some_and(Value::is_null)
    }

    /// Returns the folder of the object's file.
    pub(super) fn folder(&self) -> &'a Path {
        self.file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
    }

    /// Returns the value of a key, or `None` if it is missing or null.
    pub(super) fn get(&self, key: &str) -> Option<&'a Value> {
        self.value.get(key).filter(|value| !value.is_null())
    }

    /// Returns a number within the limits of scenes, if it is there.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let number = value.as_f64().filter(|v| v.abs() <= LARGEST);
        number
            .map(Some)
            .ok_or_else(|| self.wrong(key, value, &format!("a finite number from -{LARGEST:e} to {LARGEST:e}")))
    }

    /// Returns a string, if it is there.
    pub(super) fn text(&self, key: &str) -> Result<Option<&'a str>> {
        let Some(value) = self.get(key) else { return Ok(None) };
        value.as_str().map(Some).ok_or_else(|| self.wrong(key, value, "a text"))
    }

    /// Returns `camera_angle_x` or `camera_angle_y`, a field of view in radians, if it is there.
    pub(super) fn angle(&self, key: &str) -> Result<Option<f64>> {
        let angle = self.number(key)?;
        match angle {
            Some(v) if !(SMALLEST..=PI - SMALLEST).contains(&v) => Err(self.error(&format!(
                "\"{key}\" is {}, but a field of view must be between 0 and pi radians, {SMALLEST:e} away from both",
                brief(v)
            ))),
            angle => Ok(angle),
        }
    }

    /// Returns `transform_matrix`, camera to world, 4x4 or 3x4, in OpenGL's axes. `axes` are those of the file.
    pub(super) fn pose(&self, axes: Axes) -> Result<Pose> {
        let pose = self.pose_at("transform_matrix")?;
        Ok(match axes {
            Axes::Opengl => pose,
            Axes::Opencv => pose::flipped(&pose),
        })
    }

    /// Returns a rigid pose under any key, 4x4 or 3x4.
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
        let last = rows.get(3).and_then(Value::as_array).map(|row| row.iter().map(Value::as_f64).collect::<Vec<_>>());
        let is_last = |row: &Vec<Option<f64>>| {
            let near = |(found, wanted): (&Option<f64>, f64)| found.is_some_and(|found| (found - wanted).abs() < 1e-6);
            row.len() == 4 && row.iter().zip([0.0, 0.0, 0.0, 1.0]).all(near)
        };
        if last.as_ref().is_some_and(|row| !is_last(row)) {
            return Err(self.error(&format!(
                "the last row of \"{key}\" is {}, but it must be [0, 0, 0, 1]: the matrix is probably transposed",
                rows[3]
            )));
        }
        pose::check_rotation(&pose).map_err(|what| {
            self.error(&format!("the left 3x3 part of \"{key}\" must be a rotation, but it has {what}"))
        })?;
        Ok(pose)
    }

    /// Returns the image file that `key` names; see [`Picture`].
    pub(super) fn picture(&self, key: &str) -> Result<Picture> {
        let value = self.required(key)?;
        let text = value.as_str().ok_or_else(|| self.wrong(key, value, "a text"))?;
        let written = text.replace('\\', "/");
        let written = written.trim_start_matches("./").to_string();
        let folder = self.file.parent().unwrap_or(Path::new(""));
        let named = folder.join(&written);
        if let Some(path) = image_at(&named) {
            if path.is_file() {
                return Ok(Picture { place: path.clone(), path: Some(path), written });
            }
            let found = path.display();
            let what = format!("\"{key}\" is \"{text}\", but {found} is a device or a pipe, where a file is needed");
            return Err(self.error(&what));
        }
        if named.is_file() {
            return Err(self.error(&format!(
                "\"{key}\" is \"{text}\", and {} is there, but only PNG, JPEG and WebP files are read: convert it",
                named.display()
            )));
        }
        // A path from the machine that wrote the file: the capture may be below the file's own folder here.
        let path =
            if is_absolute(&written) { parts(&written).find_map(|part| image_at(&folder.join(part))) } else { None };
        Ok(Picture { place: path.clone().unwrap_or(named), path, written })
    }

    /// Iterates over the keys of the object in their order.
    pub(super) fn keys(&self) -> impl Iterator<Item = &'a str> {
        self.value.as_object().into_iter().flat_map(|map| map.keys().map(String::as_str))
    }

    /// Returns a list of strings, if it is there.
    pub(super) fn texts(&self, key: &str) -> Result<Option<Vec<&'a str>>> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let texts = value.as_array().and_then(|list| list.iter().map(Value::as_str).collect());
        texts.map(Some).ok_or_else(|| self.wrong(key, value, "a list of texts"))
    }

    /// Returns a boolean, if it is there.
    pub(super) fn truth(&self, key: &str) -> Result<Option<bool>> {
        let Some(value) = self.get(key) else { return Ok(None) };
        value.as_bool().map(Some).ok_or_else(|| self.wrong(key, value, "true or false"))
    }

    /// Returns the value of a key that must be there.
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

/// An image that a file names, relative to itself, with or without an extension. For an absolute path that does not
/// exist here, the longest end of it below the file's folder counts.
#[derive(Clone)]
pub(super) struct Picture {
    /// Its path, if it exists.
    pub(super) path: Option<PathBuf>,
    /// The path where it is, or would be.
    pub(super) place: PathBuf,
    /// The name as written, with slashes and without `./` in front.
    pub(super) written: String,
}

/// Returns the image at a path, or at the path with an image's extension.
fn image_at(path: &Path) -> Option<PathBuf> {
    let is_there = |path: &Path| path.exists() && !path.is_dir();
    if is_there(path) && is_image(path) {
        return Some(path.to_path_buf());
    }
    let endings = ENDINGS.iter().flat_map(|ending| [ending.to_string(), ending.to_ascii_uppercase()]);
    endings.map(|ending| PathBuf::from(format!("{}.{ending}", path.display()))).find(|path| is_there(path))
}

/// Returns whether a path starts at a root: `/home/me/a.png`, `C:/a.png`.
fn is_absolute(written: &str) -> bool {
    let drive = written
        .as_bytes()
        .first_chunk::<2>()
        .is_some_and(|[letter, colon]| letter.is_ascii_alphabetic() && *colon == b':');
    written.starts_with('/') || drive
}

/// Iterates over the ends of a path, from everything after the root to the file's name.
fn parts(written: &str) -> impl Iterator<Item = &str> {
    written
        .match_indices('/')
        .map(|(at, _)| &written[at + 1..])
        .filter(|part| !part.starts_with('/') && !part.is_empty())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_becomes_a_text_and_texts_stay() {
        let quoted = |text: &'static str| String::from_utf8(quote_no_numbers(text.as_bytes()).into_owned()).unwrap();
        assert_eq!(quoted(r#"[NaN, -Infinity,Infinity, -3]"#), r#"["NaN", "-Infinity","Infinity", -3]"#);
        for same in [r#"{"NaN": "a \" NaN", "b": null}"#, "", "N", "\"\\"] {
            assert_eq!(quoted(same), same);
        }
    }

    #[test]
    fn paths_of_another_machine_end_in_ever_less() {
        assert!(is_absolute("/a/b.png") && is_absolute("C:/a/b.png") && !is_absolute("a/b.png") && !is_absolute("C"));
        assert_eq!(parts("/a//b/c.png").collect::<Vec<_>>(), ["a//b/c.png", "b/c.png", "c.png"]);
        assert_eq!(parts("C:/a/c.png").collect::<Vec<_>>(), ["a/c.png", "c.png"]);
    }
}

//! Fields of a JSON document, with messages that name the file and the key.

use std::borrow::Cow;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::found::slashes;
use super::images::{ENDINGS, is_image};
use super::pose::{self, Pose};
use super::{LARGEST, SMALLEST, foreign};
use crate::settings::Axes;
use augnerf_base::input::read_text;
use augnerf_base::{Error, Result, number_text};

/// Largest size of a scene's poses in bytes: those of some ten thousand views.
const MOST_BYTES: u64 = 32 << 20;

/// An object of a JSON file and its location.
#[derive(Clone, Copy)]
pub(super) struct Object<'a> {
    file: &'a Path,
    /// `None` for the document, otherwise the key of a list and the number in it.
    place: Option<(&'a str, usize)>,
    value: &'a Value,
}

/// Reads a JSON file. `NaN` and the like, as Python writes them, become strings: they matter only where a number is
/// needed.
pub(super) fn read(file: &Path) -> Result<Value> {
    parse(file, read_text(file, MOST_BYTES).map_err(|e| Error::unreadable(file, &e))?.as_bytes())
}

/// Parses the text of a JSON file as [`read`] does.
pub(super) fn parse(file: &Path, text: &[u8]) -> Result<Value> {
    let invalid = |error| Error::Data(format!("{} is not valid JSON: {error}", file.display()));
    serde_json::from_slice(&quote_no_numbers(text)).map_err(invalid)
}

/// Returns the keys of the first frame of a JSON file that lists frames, and of the file itself.
fn keys_of_frames(file: &Path) -> Option<(Vec<String>, Vec<String>)> {
    let is_json = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json"));
    let value = is_json.then(|| read(file).ok()).flatten()?;
    let keys = |value: &Value| Some(value.as_object()?.keys().cloned().collect::<Vec<String>>());
    Some((keys(value["frames"].get(0)?)?, keys(&value)?))
}

/// Returns whether a JSON file lists frames as a scene's poses do.
pub(super) fn lists_frames(file: &Path) -> bool {
    keys_of_frames(file).is_some_and(|(of_frame, _)| of_frame.iter().any(|key| key == "file_path"))
}

/// Says of a JSON file that lists frames under other keys what to rename.
pub(super) fn other_frames(file: &Path) -> Option<String> {
    let (of_frame, of_file) = keys_of_frames(file)?;
    let there = || of_frame.iter().chain(&of_file).map(String::as_str);
    let words: Vec<String> = ["file_path", "transform_matrix", foreign::FOCAL]
        .iter()
        .filter_map(|key| foreign::instead(key, there()))
        .collect();
    (!words.is_empty()).then(|| {
        format!(
            "{} lists frames under other keys than a transforms.json: {}; call the result transforms.json",
            file.display(),
            words.join("; ")
        )
    })
}

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
        let place = match self.place {
            None => String::new(),
            Some(("frames", i)) => format!("frame {i} (counted from 0): "),
            Some((key, i)) => format!("\"{key}\" {i} (counted from 0): "),
        };
        Error::Data(format!("{}: {place}{what}", self.file.display()))
    }

    /// Returns the elements of a list of views, at least one.
    pub(super) fn objects(&self, key: &'a str) -> Result<Vec<Object<'a>>> {
        let frames = self.required(key)?;
        let list = frames.as_array().ok_or_else(|| self.wrong(key, frames, "an array"))?;
        if list.is_empty() {
            return Err(self.error(&format!("\"{key}\" is empty, but at least one view is needed")));
        }
        let frame = |(i, value)| {
            let object = Object { file: self.file, place: Some((key, i)), value };
            let found = kind(value);
            value.is_object().then_some(object).ok_or_else(|| object.error(&format!("{found} instead of an object")))
        };
        list.iter().enumerate().map(frame).collect()
    }

    /// Returns whether a list is there whose first value is of a kind.
    pub(super) fn begins_with(&self, key: &str, kind: fn(&Value) -> bool) -> bool {
        self.value.get(key).and_then(|list| list.get(0)).is_some_and(kind)
    }

    /// Returns whether a list is there and empty.
    pub(super) fn is_empty(&self, key: &str) -> bool {
        self.value.get(key).and_then(Value::as_array).is_some_and(Vec::is_empty)
    }

    /// Returns the first key that says that cameras are orthographic: a kind of camera by its text, or one such as
    /// `ortho_scale` because it is set. Names of files say nothing.
    pub(super) fn orthographic(&self) -> Option<&'a str> {
        const KINDS: [&str; 6] =
            ["camera_model", "camera_type", "orthographic", "projection", "projection_type", "type"];
        let is_set = |key: &str| key.starts_with("ortho") || key.starts_with("is_ortho");
        let is_said = |key: &&str| match self.get(key) {
            Some(Value::String(text)) => {
                KINDS.contains(key) && text.to_lowercase().contains("ortho") && !text.contains(['/', '\\'])
            }
            Some(Value::Bool(is)) => *is && is_set(key),
            Some(Value::Number(number)) => number.as_f64() != Some(0.0) && is_set(key),
            _ => false,
        };
        self.keys().find(is_said)
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
                number_text(v)
            ))),
            angle => Ok(angle),
        }
    }

    /// Returns `transform_matrix`, camera to world, 4x4 or 3x4, in OpenGL's axes, and the scale that was taken out of it.
    /// `axes` are those of the file.
    pub(super) fn pose(&self, axes: Axes) -> Result<(Pose, Option<Scaled>)> {
        let key = "transform_matrix";
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
        let whole = match last.as_deref() {
            None => 1.0,
            Some([Some(a), Some(b), Some(c), Some(whole)])
                if [a, b, c].iter().all(|v| v.abs() < 1e-6 * whole.abs()) && whole.abs() > SMALLEST * SMALLEST =>
            {
                *whole
            }
            Some(_) => {
                let is_transposed = pose.iter().all(|row| row[3].abs() < 1e-6);
                let why = if is_transposed { ": the matrix is probably transposed" } else { "" };
                return Err(
                    self.error(&format!("the last row of \"{key}\" is {}, but it must be [0, 0, 0, 1]{why}", rows[3]))
                );
            }
        };
        let is_whole = (whole - 1.0).abs() >= 1e-6;
        if is_whole {
            pose.iter_mut().flatten().for_each(|number| *number /= whole);
        }
        let (pose, scale) = pose::unscaled(&pose);
        pose::check_rotation(&pose).map_err(|what| {
            self.error(&format!("the left 3x3 part of \"{key}\" must be a rotation, but it has {what}"))
        })?;
        let by = if is_whole { whole } else { scale };
        let pose = if axes == Axes::Opencv { pose::flipped(&pose) } else { pose };
        Ok((pose, (is_whole || scale != 1.0).then_some(Scaled { by, whole: is_whole })))
    }

    /// Returns the image file that `key` names; see [`Picture`].
    pub(super) fn picture(&self, key: &str) -> Result<Picture> {
        let value = self.required(key)?;
        let text = value.as_str().ok_or_else(|| self.wrong(key, value, "a text"))?;
        let written = slashes(text);
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
        self.get(key).ok_or_else(|| self.error(&format!("the key \"{key}\" is missing{}", self.instead(key))))
    }

    /// Names the key that is there in the place of another, and what to do with it.
    pub(super) fn instead(&self, key: &str) -> String {
        foreign::instead(key, self.keys()).map(|words| format!("; {words}")).unwrap_or_default()
    }

    fn wrong(&self, key: &str, found: &Value, needed: &str) -> Error {
        let mut shown = found.to_string();
        if let Some((end, _)) = shown.char_indices().nth(60) {
            shown.truncate(end);
            shown.push_str("...");
        }
        let is_number = found.as_str().is_some_and(|text| text.trim().parse().is_ok_and(f64::is_finite));
        let advice = if is_number { ": take away the quotation marks" } else { "" };
        self.error(&format!("\"{key}\" is {shown}, but it must be {needed}{advice}"))
    }
}

/// The scale that was taken out of a matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scaled {
    pub(super) by: f64,
    /// All numbers had it, the last row's, too; otherwise the three axes.
    pub(super) whole: bool,
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
    fn a_camera_is_orthographic_by_keys_of_cameras_alone() {
        for (value, key) in [
            (serde_json::json!({"file_path": "images/orthophoto_1.png", "ortho_scale": 0}), None),
            (serde_json::json!({"orthophoto": "map.png", "is_ortho": false, "type": "a/ortho"}), None),
            (serde_json::json!({"camera_model": "ORTHOGRAPHIC"}), Some("camera_model")),
            (serde_json::json!({"type": "ORTHO"}), Some("type")),
            (serde_json::json!({"projection_type": "orthographic"}), Some("projection_type")),
            (serde_json::json!({"ortho_scale": 2.5}), Some("ortho_scale")),
            (serde_json::json!({"orthographic_size": 4}), Some("orthographic_size")),
            (serde_json::json!({"is_orthographic": true}), Some("is_orthographic")),
        ] {
            assert_eq!(Object::document(Path::new("a"), &value).unwrap().orthographic(), key);
        }
    }

    #[test]
    fn paths_of_another_machine_end_in_ever_less() {
        assert!(is_absolute("/a/b.png") && is_absolute("C:/a/b.png") && !is_absolute("a/b.png") && !is_absolute("C"));
        assert_eq!(parts("/a//b/c.png").collect::<Vec<_>>(), ["a//b/c.png", "b/c.png", "c.png"]);
        assert_eq!(parts("C:/a/c.png").collect::<Vec<_>>(), ["a/c.png", "c.png"]);
    }
}

//! `cameras.txt`, `images.txt`, `points3D.txt`: one line per entry, two per image. `#` begins a comment.

use std::path::Path;
use std::str::FromStr;

use super::model::{Lens, Photograph, Point, lens, model_of_name, pose};
use crate::LARGEST;
use augnerf_base::input::read_text;
use augnerf_base::{Error, Result};

/// Largest size of a file in bytes: some ten million observations.
const MOST_BYTES: u64 = 2 << 30;

/// The words of a line.
struct Words<'a> {
    file: &'a Path,
    /// From 1.
    line: usize,
    rest: &'a str,
}

impl<'a> Words<'a> {
    fn error(&self, what: &str) -> Error {
        Error::Data(format!("{}, line {}: {what}", self.file.display(), self.line))
    }

    fn word(&mut self, what: &str) -> Result<&'a str> {
        let (word, rest) = match self.rest.split_once(char::is_whitespace) {
            Some((word, rest)) => (word, rest.trim_start()),
            None => (self.rest, ""),
        };
        self.rest = rest;
        if word.is_empty() { Err(self.error(&format!("the line ends where {what} is to be"))) } else { Ok(word) }
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T> {
        let word = self.word(what)?;
        word.parse().map_err(|_| self.error(&format!("{what} is {:?}, which is no such number", shown(word))))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number(what)?;
        }
        Ok(numbers)
    }
}

/// Returns a word in a readable form.
fn shown(word: &str) -> String {
    word.chars().take(40).filter(|letter| !letter.is_control()).collect()
}

/// Returns the file's text.
fn read(file: &Path) -> Result<String> {
    read_text(file, MOST_BYTES).map_err(|e| Error::unreadable(file, &e))
}

/// Iterates over its lines, without comments.
fn lines<'a>(file: &'a Path, text: &'a str) -> impl Iterator<Item = Words<'a>> {
    let numbered = text.lines().enumerate().map(|(line, rest)| Words { file, line: line + 1, rest: rest.trim() });
    numbered.filter(|words| !words.rest.starts_with('#'))
}

pub(super) fn lenses(file: &Path) -> Result<Vec<(u32, Lens)>> {
    let text = read(file)?;
    let camera = |mut words: Words| {
        let id = words.number("the camera's number")?;
        let (model, parameters) = model_of_name(&shown(words.word("the model")?)).map_err(|what| words.error(&what))?;
        let size = words.numbers("width or height")?;
        let mut values = Vec::new();
        for _ in 0..parameters {
            values.push(words.number("a parameter")?);
        }
        Ok((id, lens(model, size, &values).map_err(|what| words.error(&what))?))
    };
    lines(file, &text).filter(|words| !words.rest.is_empty()).map(camera).collect()
}

pub(super) fn photographs(file: &Path) -> Result<Vec<Photograph>> {
    let text = read(file)?;
    // The second line of an image, with the points seen in it, may be empty.
    let mut lines = lines(file, &text);
    let mut photographs = Vec::new();
    while let Some(mut words) = lines.by_ref().find(|words| !words.rest.is_empty()) {
        let id = words.number("the image's number")?;
        let (quaternion, shift) = (words.numbers("its rotation")?, words.numbers("its shift")?);
        let camera = words.number("its camera's number")?;
        let pose = pose(quaternion, shift).map_err(|what| words.error(&what))?;
        // A name may contain spaces.
        let name = words.rest.to_string();
        photographs.push(Photograph { id, camera, name, pose });
        lines.next().map_or(Ok(()), |seen| check_seen(&seen, id))?;
    }
    Ok(photographs)
}

/// Checks that the second line of an image has three numbers for each point seen in it. Another image's first line has
/// not. It would be skipped if second lines were missing.
fn check_seen(seen: &Words, id: u32) -> Result<()> {
    let are_numbers = seen.rest.split_whitespace().all(|word| word.parse::<f64>().is_ok());
    if are_numbers && seen.rest.split_whitespace().count().is_multiple_of(3) {
        return Ok(());
    }
    Err(seen.error(&format!(
        "the second line of image {id} is to be here, empty or with three numbers for each point that is seen in the image: each \
         image takes two lines"
    )))
}

pub(super) fn points(file: &Path) -> Result<Vec<Point>> {
    let text = read(file)?;
    let point = |mut words: Words| {
        let _: u64 = words.number("the point's number")?;
        let place: [f64; 3] = words.numbers("its place")?;
        if place.iter().any(|v| v.is_nan() || v.abs() > LARGEST) {
            return Err(
                words.error(&format!("it lies at {place:?}: every number must be finite, of at most {LARGEST:e}"))
            );
        }
        // Colour and reprojection error.
        let _: [f64; 4] = words.numbers("its colour or error")?;
        let mut seen_in = Vec::new();
        while !words.rest.is_empty() {
            seen_in.push(words.number("an image that it is seen in")?);
            let _: u32 = words.number("its place in that image")?;
        }
        Ok(Point { place, seen_in })
    };
    lines(file, &text).filter(|words| !words.rest.is_empty()).map(point).collect()
}

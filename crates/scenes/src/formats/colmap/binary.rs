//! `cameras.bin`, `images.bin`, `points3D.bin`: little-endian, a count followed by as many entries.

use std::path::Path;

use super::model::{Lens, MOST_NAME, Photograph, Point, lens, model_of_number, pose};
use crate::LARGEST;
use augnerf_base::input::read_bytes;
use augnerf_base::{Error, Result};

/// Largest size of a file in bytes: some hundred million observations.
const MOST_BYTES: u64 = 4 << 30;

/// The rest of a file.
struct Bytes<'a> {
    file: &'a Path,
    rest: &'a [u8],
    /// The name of the current entry, and its number from 0.
    entry: (&'static str, u64),
}

impl<'a> Bytes<'a> {
    fn error(&self, what: &str) -> Error {
        let (name, number) = self.entry;
        Error::Data(format!("{}: {name} {number} (counted from 0): {what}", self.file.display()))
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        if count > self.rest.len() {
            return Err(self.error("the file ends within it: it is cut, or no such file"));
        }
        let (taken, rest) = self.rest.split_at(count);
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        Ok(self.take(N)?.try_into().expect("as many were taken"))
    }

    fn u64(&mut self) -> Result<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.array().map(f64::from_le_bytes)?;
        }
        Ok(numbers)
    }

    /// Returns the bytes of a list of `count` entries of `size` bytes.
    fn list(&mut self, count: u64, size: usize) -> Result<&'a [u8]> {
        // A count that no file can hold is larger than the rest of any file.
        self.take(usize::try_from(count).ok().and_then(|count| count.checked_mul(size)).unwrap_or(usize::MAX))
    }

    /// Returns a text that ends in a zero byte.
    fn name(&mut self) -> Result<String> {
        let end = self.rest.iter().take(MOST_NAME).position(|&byte| byte == 0);
        let end = end.ok_or_else(|| self.error("its name does not end"))?;
        let name = String::from_utf8_lossy(self.take(end)?).into_owned();
        self.take(1)?;
        Ok(name)
    }
}

/// Reads all entries of a file.
fn entries<T>(file: &Path, name: &'static str, read: impl Fn(&mut Bytes) -> Result<T>) -> Result<Vec<T>> {
    let bytes = read_bytes(file, MOST_BYTES).map_err(|e| Error::unreadable(file, &e))?;
    let mut bytes = Bytes { file, rest: &bytes, entry: (name, 0) };
    let count = bytes.u64()?;
    let mut all = Vec::new();
    for number in 0..count {
        bytes.entry.1 = number;
        all.push(read(&mut bytes)?);
    }
    match bytes.rest.len() {
        0 => Ok(all),
        more => Err(bytes.error(&format!("{more} bytes follow the last of {count}: no such file, or another's count"))),
    }
}

pub(super) fn lenses(file: &Path) -> Result<Vec<(u32, Lens)>> {
    entries(file, "camera", |bytes| {
        let (id, number) = (bytes.u32()?, bytes.u32()? as i32);
        let (model, parameters) = model_of_number(number).map_err(|what| bytes.error(&what))?;
        let size = [bytes.u64()? as f64, bytes.u64()? as f64];
        let mut values = Vec::new();
        for _ in 0..parameters {
            let [value] = bytes.numbers()?;
            values.push(value);
        }
        Ok((id, lens(model, size, &values).map_err(|what| bytes.error(&what))?))
    })
}

pub(super) fn photographs(file: &Path) -> Result<Vec<Photograph>> {
    entries(file, "image", |bytes| {
        let id = bytes.u32()?;
        let (quaternion, shift) = (bytes.numbers()?, bytes.numbers()?);
        let pose = pose(quaternion, shift).map_err(|what| bytes.error(&what))?;
        let (camera, name) = (bytes.u32()?, bytes.name()?);
        // The points that are seen in it: x, y, the point's number.
        let seen = bytes.u64()?;
        bytes.list(seen, 24)?;
        Ok(Photograph { id, camera, name, pose })
    })
}

pub(super) fn points(file: &Path) -> Result<Vec<Point>> {
    entries(file, "point", |bytes| {
        bytes.u64()?;
        let place: [f64; 3] = bytes.numbers()?;
        if place.iter().any(|v| v.is_nan() || v.abs() > LARGEST) {
            return Err(
                bytes.error(&format!("it lies at {place:?}: every number must be finite, of at most {LARGEST:e}"))
            );
        }
        // Colour and reprojection error.
        bytes.take(3 + 8)?;
        let length = bytes.u64()?;
        let track = bytes.list(length, 8)?.chunks_exact(8);
        let image = |pair: &[u8]| u32::from_le_bytes([pair[0], pair[1], pair[2], pair[3]]);
        Ok(Point { place, seen_in: track.map(image).collect() })
    })
}
/// Returns how many photos a file of images announces.
pub(super) fn photograph_count(file: &Path) -> Result<usize> {
    /// Least bytes of an entry: numbers, pose, camera, an empty name, no observations.
    const LEAST: u64 = 73;
    let mut count = [0; 8];
    let read = augnerf_base::input::open_regular(file).and_then(|mut open| {
        std::io::Read::read_exact(&mut open, &mut count)?;
        Ok(open.metadata()?.len())
    });
    let (count, bytes) = (u64::from_le_bytes(count), read.map_err(|e| Error::unreadable(file, &e))?);
    Ok(if count <= bytes / LEAST { count as usize } else { 0 })
}

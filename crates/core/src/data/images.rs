//! Image files: finding out their sizes, decoding them in parallel, bringing them to the working
//! resolution.
//!
//! Pixels are taken as stored: an EXIF orientation is not applied, as COLMAP does not apply it either. Only where a capture's file
//! says that its poses are those of turned photographs is it ([`crate::data::formats::transforms`]).

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;

use super::resample;
use crate::base::input::{open_regular, read_bytes};
use crate::base::{Error, Event, Image, Listener, Result};
use crate::runtime::free_memory_mib;
use crate::settings::DataConfig;

/// Most bytes of a picture's file.
const MOST_BYTES: u64 = 1 << 30;
/// Most bytes of a decoded WebP picture: its decoder takes more than twice as many on the way, whatever the file holds.
const MOST_WEBP: u64 = 384 << 20;

/// Endings of files that count as images, lower case.
pub const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "webp"];

/// The working resolution, as the configuration asks for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// Smaller by an integer factor; what does not divide is rounded down.
    Factor(usize),
    /// Exactly so many columns; rows follow the aspect.
    Width(usize),
}

impl Size {
    /// `data.width` where it is set, `data.downscale` otherwise.
    pub fn of(config: &DataConfig) -> Size {
        match config.width {
            0 => Size::Factor(config.downscale.unwrap_or(1).max(1) as usize),
            width => Size::Width(width as usize),
        }
    }

    /// Width and height that images of `from` are brought to. Refuses to enlarge them.
    pub fn apply(self, from: (usize, usize), file: &Path) -> Result<(usize, usize)> {
        match self {
            Size::Factor(factor) => Ok(((from.0 / factor).max(1), (from.1 / factor).max(1))),
            Size::Width(width) if width <= from.0 => {
                let height = (from.1 as f64 * width as f64 / from.0 as f64).round() as usize;
                Ok((width, height.max(1)))
            }
            Size::Width(width) => Err(Error::Config(format!(
                "data.width = {width} is more than the {} columns of {}: images are only made smaller; \
                 choose at most {}",
                from.0,
                file.display(),
                from.0
            ))),
        }
    }
}

/// The sizes that images of `from` are brought to: by the factor, or all by what makes the widest of them as wide as asked for, so
/// that what is far from the camera is as large in each. `file` is one of them.
pub fn working_sizes(size: Size, from: &[(usize, usize)], file: &Path) -> Result<Vec<(usize, usize)>> {
    let widest = from.iter().map(|size| size.0).max().unwrap_or(1);
    let Size::Width(width) = size else { return from.iter().map(|&from| size.apply(from, file)).collect() };
    let scaled = |side: usize| ((side as f64 * width as f64 / widest as f64).round() as usize).max(1);
    size.apply((widest, 1), file)?;
    Ok(from.iter().map(|&(width, height)| (scaled(width), scaled(height))).collect())
}

/// Whether a file's ending is one of [`ENDINGS`].
pub fn is_image(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}

/// The image files of a folder, sorted by name.
pub fn list(dir: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir).map_err(|e| Error::unreadable(dir, &e))?;
    let mut paths = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::unreadable(dir, &e))?.path();
        // Files whose names start with a dot are a system's notes about images, not images.
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if !hidden && is_image(&path) {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// Width and height that a file's header states.
pub fn size(path: &Path) -> Result<(usize, usize)> {
    let (width, height) = open(path)?.into_dimensions().map_err(|e| undecodable(path, &e))?;
    sound(path, (width, height))
}

/// Whether a file is of a format that may lose values on the way.
pub(super) fn may_be_lossy(path: &Path) -> Result<bool> {
    Ok(matches!(open(path)?.format(), Some(ImageFormat::Jpeg | ImageFormat::WebP)))
}

/// By how much the images of a folder of this name are smaller than the originals: `images`, `images_{factor}`.
pub(super) fn factor_of(name: &str) -> Option<usize> {
    match name.strip_prefix("images")? {
        "" => Some(1),
        rest => rest.strip_prefix('_')?.parse().ok().filter(|factor| *factor > 1),
    }
}

/// Width, height and the turn that EXIF asks viewers for.
pub(super) fn header(path: &Path) -> Result<((usize, usize), Orientation)> {
    let mut decoder = open(path)?.into_decoder().map_err(|e| undecodable(path, &e))?;
    let size = sound(path, decoder.dimensions())?;
    // Damaged notes are no damage of the picture.
    Ok((size, decoder.orientation().unwrap_or(Orientation::NoTransforms)))
}

/// Says which photographs viewers show turned: pixels are taken as they are stored.
pub(super) fn note_turned(scene: &Path, paths: &[PathBuf], events: &dyn Listener) -> Result<()> {
    let mut turned: Vec<String> = Vec::new();
    for path in paths {
        if header(path)?.1 != Orientation::NoTransforms {
            turned.push(path.file_name().unwrap_or_default().to_string_lossy().into_owned());
        }
    }
    if !turned.is_empty() {
        events.on(Event::Note(&format!(
            "{}: {} photographs have an EXIF orientation, which is not applied (pixels are taken as they are stored, as COLMAP takes \
             them): {}",
            scene.display(),
            turned.len(),
            turned.join(", ")
        )));
    }
    Ok(())
}

fn open(path: &Path) -> Result<ImageReader<BufReader<File>>> {
    let reader = open_regular(path).map(|file| ImageReader::new(BufReader::new(file)));
    reader.and_then(ImageReader::with_guessed_format).map_err(|e| Error::unreadable(path, &e))
}

fn sound(path: &Path, (width, height): (u32, u32)) -> Result<(usize, usize)> {
    if width == 0 || height == 0 {
        return Err(Error::Data(format!("{} is an image of {width}x{height} pixels: it is empty", path.display())));
    }
    Ok((width as usize, height as usize))
}

/// The one size that all files have.
pub fn common_size(paths: &[PathBuf]) -> Result<(usize, usize)> {
    let Some(first) = paths.first() else {
        return Err(Error::Data("no image files to read".into()));
    };
    let expected = size(first)?;
    for path in paths {
        let found = size(path)?;
        if found != expected {
            return Err(Error::Data(format!(
                "{} is {}x{} pixels but {} is {}x{}: all images of a scene must have one size",
                first.display(),
                expected.0,
                expected.1,
                path.display(),
                found.0,
                found.1
            )));
        }
    }
    Ok(expected)
}

/// Decodes one PNG, JPEG or WebP file of 8 or 16 bits.
pub fn decode(path: &Path) -> Result<DynamicImage> {
    let bytes = read_bytes(path, MOST_BYTES).map_err(|e| Error::unreadable(path, &e))?;
    let format = image::guess_format(&bytes).map_err(|e| undecodable(path, &e))?;
    if format == ImageFormat::Jpeg && !jpeg_is_complete(&bytes) {
        return Err(undecodable(path, &"its end-of-image marker is missing"));
    }
    let mut reader = ImageReader::with_format(Cursor::new(&bytes), format);
    if format == ImageFormat::WebP {
        let mut limits = Limits::default();
        limits.max_alloc = Some(MOST_WEBP);
        reader.limits(limits);
    }
    reader.decode().map_err(|e| undecodable(path, &e))
}

/// Whether the last scan of a JPEG is closed by an end-of-image marker. The decoder fills what is
/// missing with grey, which would be trained on.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    let scan = bytes.windows(2).rposition(|pair| pair == [0xff, 0xda]);
    scan.is_some_and(|at| bytes[at..].windows(2).any(|pair| pair == [0xff, 0xd9]))
}

fn undecodable(path: &Path, error: &dyn std::fmt::Display) -> Error {
    // Some of the decoders' messages end in a full stop or a line break.
    let error = error.to_string();
    let error = error.trim_end_matches(['.', '\n', ' ']);
    Error::Data(format!(
        "cannot decode {} as an image: {error}; PNG, JPEG and WebP files are read, this one may be truncated or damaged",
        path.display()
    ))
}

/// A decoded file as RGB or RGBA of `to` (width x height), averaged over the area of each pixel.
pub fn averaged(decoded: &DynamicImage, to: (usize, usize)) -> Image {
    let from = (decoded.width() as usize, decoded.height() as usize);
    let colour = decoded.color();
    let deep = colour.bytes_per_pixel() > colour.channel_count();
    // What is stored as it is needed is not copied: one picture may take half a gigabyte.
    match (decoded, deep, colour.has_alpha()) {
        (DynamicImage::ImageRgb8(rgb), ..) => resample::average(rgb.as_raw(), from, 3, 255.0, to),
        (DynamicImage::ImageRgba8(rgba), ..) => resample::average(rgba.as_raw(), from, 4, 255.0, to),
        (_, false, false) => resample::average(decoded.to_rgb8().as_raw(), from, 3, 255.0, to),
        (_, false, true) => resample::average(decoded.to_rgba8().as_raw(), from, 4, 255.0, to),
        (_, true, false) => resample::average(decoded.to_rgb16().as_raw(), from, 3, 65535.0, to),
        (_, true, true) => resample::average(decoded.to_rgba16().as_raw(), from, 4, 65535.0, to),
    }
}

/// Reads one file at `to` (width x height), RGB or RGBA with straight alpha.
pub fn read(path: &Path, to: (usize, usize)) -> Result<Image> {
    Ok(averaged(&decode(path)?, to))
}

/// Refuses more pictures of a size than the machine has memory free for.
pub(super) fn check_memory(count: usize, size: (usize, usize)) -> Result<()> {
    check_memory_of(&vec![size; count])
}

/// The same of pictures that have sizes of their own.
pub(super) fn check_memory_of(sizes: &[(usize, usize)]) -> Result<()> {
    let Some(free) = free_memory_mib() else { return Ok(()) };
    let bytes = |&(width, height): &(usize, usize)| width as f64 * height as f64 * (3 * size_of::<f32>()) as f64;
    let needed = sizes.iter().map(bytes).sum::<f64>() / f64::from(1 << 20);
    if needed <= free {
        return Ok(());
    }
    let count = sizes.len();
    let (width, height) = sizes.iter().copied().max_by_key(|size| size.0.saturating_mul(size.1)).unwrap_or_default();
    Err(Error::Data(format!(
        "{count} pictures of {width}x{height} pixels take {:.1} GiB of memory, and {:.1} GiB are free: make them smaller \
          with data.downscale or data.width",
        needed / 1024.0,
        free / 1024.0
    )))
}

/// How many pictures may be decoded at once: so many that what they take on the way stays bounded.
fn at_once(paths: &[PathBuf]) -> Result<usize> {
    /// Samples of up to 16 bits with alpha.
    const PIXEL_BYTES: usize = 8;
    const BYTES: usize = 1 << 31;
    let mut largest = 1;
    for path in paths {
        let (width, height) = size(path)?;
        largest = largest.max(width.saturating_mul(height));
    }
    Ok((BYTES / PIXEL_BYTES / largest).max(1))
}

/// Runs `read` over all files in parallel. Of several failures the first file's is reported,
/// whichever came first in time.
pub(super) fn each<T: Send>(
    paths: &[PathBuf],
    label: &str,
    events: &dyn Listener,
    read: impl Fn(usize, &Path) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    events.on(Event::Started { what: label, parts: paths.len() as u64 });
    let work = |(i, path): (usize, &PathBuf)| {
        let result = read(i, path);
        events.on(Event::Advanced);
        result
    };
    let numbered: Vec<(usize, &PathBuf)> = paths.iter().enumerate().collect();
    let mut results: Vec<Result<T>> = Vec::with_capacity(paths.len());
    for some in numbered.chunks(at_once(paths)?) {
        results.par_extend(some.par_iter().copied().map(work));
    }
    events.on(Event::Finished);
    results.into_iter().collect()
}

/// Reads all files at `to` onto `background`. The flag says whether anything was see-through.
pub(super) fn read_all(
    paths: &[PathBuf],
    to: (usize, usize),
    background: [f32; 3],
    label: &str,
    events: &dyn Listener,
) -> Result<(Vec<Image>, bool)> {
    check_memory(paths.len(), to)?;
    let read = |_, path: &Path| Ok(resample::composite(read(path, to)?, background));
    let (images, clear): (Vec<Image>, Vec<bool>) = each(paths, label, events, read)?.into_iter().unzip();
    Ok((images, clear.contains(&true)))
}

/// The folder of the files, their size and the one that they are averaged down to, for people.
pub(super) fn folder_words(paths: &[PathBuf], from: (usize, usize), to: (usize, usize)) -> String {
    let folder = paths.first().and_then(|path| path.parent()).unwrap_or(Path::new(""));
    let averaged = if from == to { "as stored".into() } else { format!("averaged down to {} x {}", to.0, to.1) };
    format!("{}: {} x {} pixels, {averaged}", folder.display(), from.0, from.1)
}

/// The folder that all files lie in or below.
fn common_folder(paths: &[PathBuf]) -> PathBuf {
    let folders = paths.iter().map(|path| path.parent().unwrap_or(Path::new("")).to_path_buf());
    let shared = |common: PathBuf, folder: PathBuf| {
        let parts = common.components().zip(folder.components());
        parts.take_while(|(a, b)| a == b).map(|(part, _)| part).collect()
    };
    folders.reduce(shared).unwrap_or_default()
}

/// A name for each view: its file's stem; where stems repeat, its path below the folder that all have in common. Where that folder
/// lies is in no name, for hashes of scenes hang on them.
pub(super) fn names(paths: &[PathBuf]) -> Vec<String> {
    let stem = |path: &PathBuf| path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let mut names: Vec<String> = paths.iter().map(stem).collect();
    let distinct = |names: &[String]| names.iter().collect::<std::collections::HashSet<_>>().len() == names.len();
    if !distinct(&names) {
        let common = common_folder(paths);
        let below = |path: &PathBuf| path.strip_prefix(&common).unwrap_or(path).with_extension("");
        names = paths.iter().map(|path| below(path).to_string_lossy().replace(['/', '\\'], "_")).collect();
    }
    if !distinct(&names) {
        names.iter_mut().enumerate().for_each(|(i, name)| name.push_str(&format!("_{i}")));
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_and_grey_become_rgb_in_unit_range() {
        let deep = DynamicImage::ImageLuma16(image::ImageBuffer::from_pixel(2, 2, image::Luma([65535u16])));
        assert_eq!(averaged(&deep, (1, 1)), Image { width: 1, height: 1, channels: 3, pixels: vec![1.0; 3] });
        let clear = DynamicImage::ImageLumaA8(image::ImageBuffer::from_pixel(1, 1, image::LumaA([51u8, 0])));
        assert_eq!(averaged(&clear, (1, 1)).pixels, [0.2, 0.2, 0.2, 0.0]);
    }

    #[test]
    fn sizes_follow_factor_or_width_and_never_grow() {
        let file = Path::new("a.png");
        assert_eq!(Size::Factor(2).apply((801, 401), file).unwrap(), (400, 200));
        assert_eq!(Size::Factor(64).apply((8, 8), file).unwrap(), (1, 1));
        assert_eq!(Size::Width(100).apply((800, 600), file).unwrap(), (100, 75));
        let message = Size::Width(900).apply((800, 600), file).unwrap_err().to_string();
        assert!(message.contains("data.width = 900") && message.contains("800"), "{message}");
    }

    #[test]
    fn repeated_stems_get_longer_names() {
        let below = |folder: &str| ["a/0.png", "b/0.png", "b/c/1.png"].map(|file| Path::new(folder).join(file));
        for folder in ["", "/home/someone/capture", "../here"] {
            assert_eq!(names(&below(folder)), ["a_0", "b_0", "b_c_1"], "{folder}");
        }
        assert_eq!(names(&["a/0.png", "a/1.png"].map(PathBuf::from)), ["0", "1"]);
    }
}

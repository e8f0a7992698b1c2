//! Image files: their sizes, parallel decoding, and resampling to the working resolution.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::{Path, PathBuf};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;

use super::found::slashes;
use super::{foreign, resample};
use crate::settings::DataConfig;
use augnerf_base::input::{open_regular, read_bytes};
use augnerf_base::machine::free_memory_mib;
use augnerf_base::{Error, Event, Image, Listener, Result};

/// Largest size of an image file in bytes.
const MOST_BYTES: u64 = 1 << 30;
/// Largest size of a decoded WebP image in bytes. Its decoder needs more than twice as much temporarily. For other images the
/// decoders' own limit counts, 512 MiB.
const MOST_WEBP: u64 = 384 << 20;

const MIB: f64 = (1 << 20) as f64;

/// File extensions of images, in lower case.
pub const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "webp"];

/// The working resolution in the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// Smaller by an integer factor, rounded down.
    Factor(usize),
    /// Exactly this many columns. The rows follow the aspect ratio.
    Width(usize),
}

impl Size {
    /// Returns `data.width` if it is set, and `data.downscale` otherwise.
    pub fn of(config: &DataConfig) -> Size {
        match config.width {
            0 => Size::Factor(config.downscale.unwrap_or(1).max(1) as usize),
            width => Size::Width(width as usize),
        }
    }

    /// Returns width and height of images of `from` at the working resolution. Enlarging them is an error.
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

/// Returns the working sizes of images of `from`. A factor applies to all. A width scales all by one factor so that the
/// widest has this width, and distant objects have the same size in each. `file` is one of the files, for messages.
pub fn working_sizes(size: Size, from: &[(usize, usize)], file: &Path) -> Result<Vec<(usize, usize)>> {
    let widest = from.iter().map(|size| size.0).max().unwrap_or(1);
    let Size::Width(width) = size else { return from.iter().map(|&from| size.apply(from, file)).collect() };
    let scaled = |side: usize| ((side as f64 * width as f64 / widest as f64).round() as usize).max(1);
    size.apply((widest, 1), file)?;
    Ok(from.iter().map(|&(width, height)| (scaled(width), scaled(height))).collect())
}

/// Returns whether the file has one of the [`ENDINGS`].
pub fn is_image(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}

/// Returns the image files of a folder, sorted by name.
pub fn list(dir: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir).map_err(|e| Error::unreadable(dir, &e))?;
    let mut paths = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::unreadable(dir, &e))?.path();
        // Files whose names start with a dot are notes of the system, not images.
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if !hidden && is_image(&path) {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// Returns width and height from a file's header.
pub fn size(path: &Path) -> Result<(usize, usize)> {
    let (width, height) = limited(open(path)?).into_dimensions().map_err(|e| undecodable(path, &e))?;
    sound(path, (width, height))
}

/// Returns whether the file's format may be lossy.
pub(super) fn may_be_lossy(path: &Path) -> Result<bool> {
    Ok(matches!(open(path)?.format(), Some(ImageFormat::Jpeg | ImageFormat::WebP)))
}

/// Returns the folders `images` and `images_{factor}` of a scene, each with its factor, in the order of the factors.
pub(super) fn folders(dir: &Path) -> Result<Vec<(usize, PathBuf)>> {
    let entries = std::fs::read_dir(dir).map_err(|e| Error::unreadable(dir, &e))?;
    let factor = |name: &std::ffi::OsStr| factor_of(&name.to_string_lossy());
    let named = entries.flatten().filter(|entry| entry.path().is_dir());
    let mut found: Vec<(usize, PathBuf)> =
        named.filter_map(|entry| Some((factor(&entry.file_name())?, entry.path()))).collect();
    found.sort();
    Ok(found)
}

/// Returns the names of these folders, for people.
pub(super) fn folder_names(dir: &Path) -> Result<String> {
    let name = |folder: &Path| folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let names: Vec<String> = folders(dir)?.iter().map(|(_, folder)| name(folder)).collect();
    Ok(if names.is_empty() { "no images_* folder at all".into() } else { names.join(", ") })
}

/// Returns the factor in the name of an image folder: `images`, `images_{factor}`.
pub(super) fn factor_of(name: &str) -> Option<usize> {
    match name.strip_prefix("images")? {
        "" => Some(1),
        rest => rest.strip_prefix('_')?.parse().ok().filter(|factor| *factor > 1),
    }
}

/// What a photo's header says.
#[derive(Clone, Copy, Debug)]
pub(super) struct Header {
    /// Width and height, of the turned photo if it is turned.
    pub(super) size: (usize, usize),
    /// The EXIF orientation.
    pub(super) exif: Orientation,
    /// Whether pixels are turned by it.
    pub(super) turned: bool,
    /// Whether there is an alpha channel.
    pub(super) has_alpha: bool,
}

impl Header {
    /// Reads a file's header.
    pub(super) fn read(path: &Path) -> Result<Header> {
        let mut decoder = limited(open(path)?).into_decoder().map_err(|e| undecodable(path, &e))?;
        let (size, has_alpha) = (sound(path, decoder.dimensions())?, decoder.color_type().has_alpha());
        // Damaged EXIF data does not make an image damaged.
        let exif = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        Ok(Header { size, exif, turned: false, has_alpha })
    }

    /// Returns the header of the photo turned by its EXIF orientation, if only that fits its camera.
    pub(super) fn turned_to_fit(self, fits: impl Fn((usize, usize)) -> bool) -> Header {
        use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
        let swaps = matches!(self.exif, Rotate90 | Rotate90FlipH | Rotate270 | Rotate270FlipH);
        let size = (self.size.1, self.size.0);
        if swaps && !fits(self.size) && fits(size) { Header { size, turned: true, ..self } } else { self }
    }

    /// Returns the turn from the stored pixels to the photo.
    pub(super) fn turn(&self) -> Orientation {
        if self.turned { self.exif } else { Orientation::NoTransforms }
    }
}

/// A file or its bytes. All decoders are generic over this type: as one, it is compiled once.
trait Source: BufRead + Seek {}

impl<S: BufRead + Seek> Source for S {}

fn open(path: &Path) -> Result<ImageReader<Box<dyn Source>>> {
    let source = |file: File| -> Box<dyn Source> { Box::new(BufReader::new(file)) };
    let reader = open_regular(path).map(|file| ImageReader::new(source(file)));
    reader.and_then(ImageReader::with_guessed_format).map_err(|e| Error::unreadable(path, &e))
}

/// Limits the memory that a decoder may take.
fn limited<'a>(mut reader: ImageReader<Box<dyn Source + 'a>>) -> ImageReader<Box<dyn Source + 'a>> {
    if reader.format() == Some(ImageFormat::WebP) {
        let mut limits = Limits::default();
        limits.max_alloc = Some(MOST_WEBP);
        reader.limits(limits);
    }
    reader
}

fn sound(path: &Path, (width, height): (u32, u32)) -> Result<(usize, usize)> {
    if width == 0 || height == 0 {
        return Err(Error::Data(format!("{} is an image of {width}x{height} pixels: it is empty", path.display())));
    }
    Ok((width as usize, height as usize))
}

/// Reads the headers of all files, which must have one size once turned to fit.
pub(super) fn headers_of_one_size(paths: &[PathBuf], fits: impl Fn((usize, usize)) -> bool) -> Result<Vec<Header>> {
    let headers: Vec<Header> =
        paths.iter().map(|path| Ok(Header::read(path)?.turned_to_fit(&fits))).collect::<Result<_>>()?;
    let Some(first) = headers.first().map(|header| header.size) else {
        return Err(Error::Data("no image files to read".into()));
    };
    let other = headers.iter().zip(paths).find(|(header, _)| header.size != first);
    other.map_or(Ok(headers.clone()), |(Header { size, .. }, path)| {
        Err(Error::Data(format!(
            "{} is {}x{} pixels but {} is {}x{}: all images of a scene must have one size",
            paths[0].display(),
            first.0,
            first.1,
            path.display(),
            size.0,
            size.1
        )))
    })
}

/// Decodes one PNG, JPEG or WebP file of 8 or 16 bits.
pub fn decode(path: &Path) -> Result<DynamicImage> {
    let bytes = read_bytes(path, MOST_BYTES).map_err(|e| Error::unreadable(path, &e))?;
    let format = image::guess_format(&bytes).map_err(|e| undecodable(path, &e))?;
    if format == ImageFormat::Jpeg && !jpeg_is_complete(&bytes) {
        return Err(undecodable(path, &"its end-of-image marker is missing"));
    }
    let source: Box<dyn Source + '_> = Box::new(Cursor::new(&bytes));
    limited(ImageReader::with_format(source, format)).decode().map_err(|e| undecodable(path, &e))
}

/// Returns whether an end-of-image marker closes the last scan of a JPEG. The decoder fills what is missing with grey,
/// which would be trained on.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    let scan = bytes.windows(2).rposition(|pair| pair == [0xff, 0xda]);
    scan.is_some_and(|at| bytes[at..].windows(2).any(|pair| pair == [0xff, 0xd9]))
}

fn undecodable(path: &Path, error: &dyn std::fmt::Display) -> Error {
    let mut begin = [0; 16];
    let read = open_regular(path).and_then(|mut file| std::io::Read::read(&mut file, &mut begin)).unwrap_or(0);
    if let Some(kind) = foreign::kind_of(&begin[..read]) {
        return Error::Data(format!(
            "{} is {kind}, whatever its name: only PNG, JPEG and WebP are read; convert it, and do not just rename it",
            path.display()
        ));
    }
    // Some decoders' messages end in a full stop or a line break.
    let error = error.to_string();
    let error = error.trim_end_matches(['.', '\n', ' ']);
    Error::Data(format!(
        "cannot decode {} as an image: {error}; PNG, JPEG and WebP files are read, this one may be truncated or damaged",
        path.display()
    ))
}

/// Returns a decoded file as RGB or RGBA of `to` (width x height), averaged over the area of each pixel.
pub fn averaged(decoded: &DynamicImage, to: (usize, usize)) -> Image {
    let from = (decoded.width() as usize, decoded.height() as usize);
    let colour = decoded.color();
    let deep = colour.bytes_per_pixel() > colour.channel_count();
    // An image in the right format is not copied: it may take half a gigabyte.
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

/// Returns an error for more images, each of width and height, than the free memory can hold.
pub fn check_memory_of(sizes: &[(usize, usize)]) -> Result<()> {
    let Some(free) = free_memory_mib() else { return Ok(()) };
    let bytes = |&(width, height): &(usize, usize)| width as f64 * height as f64 * (3 * size_of::<f32>()) as f64;
    let needed = sizes.iter().map(bytes).sum::<f64>() / MIB;
    if needed <= free {
        return Ok(());
    }
    let count = sizes.len();
    let (width, height) = sizes.iter().copied().max_by_key(|size| size.0.saturating_mul(size.1)).unwrap_or_default();
    Err(Error::Data(format!(
        "{count} images of {width}x{height} pixels take {:.1} GiB of memory, and {:.1} GiB are free; reduce them \
          with data.downscale or data.width",
        needed / 1024.0,
        free / 1024.0
    )))
}

/// Returns how many of these files, each with the bytes that reading it takes, may be read at once.
///
/// # Errors
/// Not even one.
fn at_once(files: &[(&Path, f64)]) -> Result<usize> {
    /// So that temporary memory stays bounded.
    const MOST_MIB: f64 = 2048.0;
    let Some((path, largest)) = files.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else { return Ok(1) };
    let (free, needed) = (free_memory_mib(), largest / MIB);
    if let Some(free) = free.filter(|free| needed > *free) {
        return Err(Error::Data(format!(
            "{} takes up to {needed:.0} MiB of memory to read, and {free:.0} MiB are free; make the photos smaller first, or \
             give the program more memory",
            path.display()
        )));
    }
    // The allocator needs room, too, and what is read stays.
    let room = free.map_or(MOST_MIB, |free| (free / 2.0).min(MOST_MIB));
    Ok(((room / needed) as usize).max(1))
}

/// Runs `read` over all files, each with the bytes that reading it takes, in parallel. Of several failures it reports that of
/// the first file, whichever came first in time.
pub(super) fn each<T: Send>(
    files: &[(&Path, f64)],
    label: &str,
    events: &dyn Listener,
    read: impl Fn(usize) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    events.on(Event::Started { what: label, parts: files.len() as u64 });
    let work = |i: usize| {
        let result = read(i);
        events.on(Event::Advanced);
        result
    };
    let mut results: Vec<Result<T>> = Vec::with_capacity(files.len());
    while results.len() < files.len() {
        let (first, rest) = (results.len(), &files[results.len()..]);
        let last = first + at_once(rest)?.min(rest.len());
        results.par_extend((first..last).into_par_iter().map(work));
    }
    events.on(Event::Finished);
    results.into_iter().collect()
}

/// Describes the folder of the files, their size, and their working size.
pub(super) fn folder_words(paths: &[PathBuf], from: (usize, usize), to: (usize, usize)) -> String {
    let folder = paths.first().and_then(|path| path.parent()).unwrap_or(Path::new(""));
    let averaged = if from == to { "as stored".into() } else { format!("averaged down to {} x {}", to.0, to.1) };
    format!("{}: {} x {} pixels, {averaged}", folder.display(), from.0, from.1)
}

/// Returns the folder that contains all files.
fn common_folder(paths: &[PathBuf]) -> PathBuf {
    let folders = paths.iter().map(|path| path.parent().unwrap_or(Path::new("")).to_path_buf());
    let shared = |common: PathBuf, folder: PathBuf| {
        let parts = common.components().zip(folder.components());
        parts.take_while(|(a, b)| a == b).map(|(part, _)| part).collect()
    };
    folders.reduce(shared).unwrap_or_default()
}

/// Returns a name for each view: its file's stem. If stems repeat, it is the path below the common folder. The location
/// of that folder is in no name, because hashes of scenes depend on names.
pub(super) fn names(paths: &[PathBuf]) -> Vec<String> {
    let plain = |name: &str| name.replace(|letter: char| letter.is_control(), "_");
    let paths: Vec<PathBuf> = paths.iter().map(|path| slashes(&path.to_string_lossy()).into()).collect();
    let stem = |path: &PathBuf| path.file_stem().map(|s| plain(&s.to_string_lossy())).unwrap_or_default();
    let mut names: Vec<String> = paths.iter().map(stem).collect();
    let distinct = |names: &[String]| names.iter().collect::<std::collections::HashSet<_>>().len() == names.len();
    if !distinct(&names) {
        let common = common_folder(&paths);
        let below = |path: &PathBuf| path.strip_prefix(&common).unwrap_or(path).with_extension("");
        names = paths.iter().map(|path| plain(&below(path).to_string_lossy()).replace('/', "_")).collect();
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

//! Image files: their sizes, parallel decoding, and resampling to the working resolution.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;
use unicode_normalization::UnicodeNormalization;

use super::{foreign, resample};
use crate::base::input::{open_regular, read_bytes};
use crate::base::{Error, Event, Image, Listener, Result, first_names};
use crate::runtime::free_memory_mib;
use crate::settings::DataConfig;

/// Largest size of an image file in bytes.
const MOST_BYTES: u64 = 1 << 30;
/// Largest size of a decoded WebP image in bytes. Its decoder needs more than twice as much temporarily.
const MOST_WEBP: u64 = 384 << 20;

const MIB: f64 = (1 << 20) as f64;

/// Most bytes of a decoded pixel: four channels of 16 bits.
const MOST_PIXEL_BYTES: u64 = 8;
/// Largest size of a decoded PNG image in bytes.
const MOST_PNG: u64 = 512 << 20;
/// Most bytes for a PNG's colour profile and texts, which are unpacked with it. Profiles take a few kB.
const MOST_NOTES: u64 = 16 << 20;

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

/// Parts of the names of images that are no photos: masks, and the maps of depth and normals of Blender scenes.
const NO_PHOTOS: [&str; 4] = ["mask", "depth", "normal", "alpha"];
/// Largest number of unused photos that are named.
const UNUSED_NAMED: usize = 5;

/// Least likeness (0 to 1) of a name that is suggested.
const NEAR: f64 = 0.6;

/// Folders below a scene's that are searched.
const DEEPEST: usize = 3;
/// Most files and folders that are searched.
const MOST_PATHS: usize = 100_000;

/// Returns the files and folders below a folder that can be seen, as paths within it, the less deep first.
pub(super) fn paths_below(folder: &Path) -> Vec<PathBuf> {
    let inside = |within: &Path| {
        let entries = std::fs::read_dir(folder.join(within)).into_iter().flatten().flatten();
        let seen = entries.map(|entry| entry.file_name()).filter(|name| !name.to_string_lossy().starts_with('.'));
        let mut paths: Vec<PathBuf> = seen.map(|name| within.join(name)).collect();
        paths.sort();
        paths
    };
    let mut found = inside(Path::new(""));
    let mut at = 0;
    while at < found.len() && found.len() < MOST_PATHS {
        if found[at].components().count() <= DEEPEST && folder.join(&found[at]).is_dir() {
            let more = inside(&found[at]);
            found.extend(more);
        }
        at += 1;
    }
    found
}

/// Returns the images below a folder as paths within it, in order.
pub(super) fn below(folder: &Path) -> Vec<PathBuf> {
    let is_file = |within: &PathBuf| is_image(within) && folder.join(within).is_file();
    let mut found: Vec<PathBuf> = paths_below(folder).into_iter().filter(is_file).collect();
    found.sort();
    found
}

/// Returns a file without detours and links, by which equal files are known.
pub(super) fn real(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_path_buf())
}

/// Notes photos that are not used because the same name with another ending is, and returns them.
pub(super) fn note_twins<'a>(
    scene: &Path,
    used: impl Iterator<Item = &'a PathBuf>,
    events: &dyn Listener,
) -> BTreeSet<PathBuf> {
    let used: BTreeSet<&PathBuf> = used.collect();
    let stems: BTreeSet<PathBuf> = used.iter().map(|path| path.with_extension("")).collect();
    let folders: BTreeSet<&Path> = used.iter().filter_map(|path| path.parent()).collect();
    let there = folders.into_iter().flat_map(|folder| list(folder).unwrap_or_default());
    let twins: BTreeSet<PathBuf> =
        there.filter(|path| !used.contains(path) && stems.contains(&path.with_extension(""))).collect();
    if let Some(first) = twins.first().and_then(|first| first.file_name()) {
        events.on(Event::Note(&format!(
            "{}: {} photos are there again with another ending and are not used, such as {}: if no ending is named, PNG is read before \
             JPEG and WebP",
            scene.display(),
            twins.len(),
            first.to_string_lossy()
        )));
    }
    twins
}

/// Notes photos in the folders of the used ones, and below their folder in the scene, that are not used themselves. `why`
/// ends "3 photos".
pub(super) fn note_unused<'a>(scene: &Path, used: impl Iterator<Item = &'a PathBuf>, why: &str, events: &dyn Listener) {
    let used: Vec<&PathBuf> = used.collect();
    let twins = note_twins(scene, used.iter().copied(), events);
    // The folder in the scene, such as `images`; the scene itself has others' folders.
    let top =
        |path: &&PathBuf| Some(path.parent()?.strip_prefix(scene).ok()?.components().next()?.as_os_str().to_owned());
    let tops: BTreeSet<_> = used.iter().filter_map(top).map(|name| scene.join(name)).collect();
    let mut folders: BTreeMap<PathBuf, Vec<PathBuf>> = BTreeMap::new();
    let parents: BTreeSet<&Path> = used.iter().filter_map(|path| path.parent()).collect();
    for folder in parents.into_iter().filter(|folder| !tops.iter().any(|top| folder.starts_with(top))) {
        folders.insert(folder.to_path_buf(), list(folder).unwrap_or_default());
    }
    for top in tops {
        for within in below(&top) {
            let path = top.join(within);
            folders.entry(path.parent().unwrap_or(&top).to_path_buf()).or_default().push(path);
        }
    }
    let used: BTreeSet<PathBuf> = used.into_iter().map(|path| real(path)).collect();
    for (folder, there) in &folders {
        let within = folder.strip_prefix(scene).unwrap_or(folder);
        let is_other = |path: &&PathBuf| {
            let name = within.join(path.file_name().unwrap_or_default());
            is_photo(&name.to_string_lossy().to_lowercase()) && !twins.contains(*path) && !used.contains(&real(path))
        };
        let others: Vec<String> = there
            .iter()
            .filter(is_other)
            .map(|path| path.file_name().unwrap_or_default().to_string_lossy().into_owned())
            .collect();
        if others.is_empty() {
            continue;
        }
        let place = if within.as_os_str().is_empty() { String::new() } else { format!(" in {}", within.display()) };
        events.on(Event::Note(&format!(
            "{}: {} of the {} photos{place} {why} and are not used: {}",
            scene.display(),
            others.len(),
            there.len(),
            first_names(&others, UNUSED_NAMED)
        )));
    }
}

/// Returns whether a path, in lower case, names no mask and no map of depth.
pub(super) fn is_photo(path: &str) -> bool {
    !NO_PHOTOS.iter().any(|part| path.contains(part))
}

/// The images below a folder, among which photos are found that are not where they are named.
pub(super) struct Below {
    /// Paths within the folder, with their names as they are compared, without an image's ending.
    files: Vec<(PathBuf, String)>,
}

impl Below {
    pub(super) fn of(paths: Vec<PathBuf>) -> Below {
        let key = |path: PathBuf| (without_ending(name_key(&path)), path);
        Below { files: paths.into_iter().map(key).map(|(key, path)| (path, key)).collect() }
    }

    /// Returns the only file whose name fits. Of a name with several endings it is the first of [`ENDINGS`].
    fn only(&self, fits: impl Fn(&str) -> bool) -> Option<&Path> {
        let mut fitting: Vec<&(PathBuf, String)> = self.files.iter().filter(|(_, key)| fits(key)).collect();
        fitting.sort_by_key(|(path, _)| rank(path));
        let (path, key) = fitting.first()?;
        let is_twin = |(other, name): &&&(PathBuf, String)| name == key && rank(other) > rank(path);
        (fitting.iter().skip(1).filter(is_twin).count() + 1 == fitting.len()).then_some(path)
    }

    /// Returns the file that has a name, apart from its letter case, its Unicode form and an image's ending.
    pub(super) fn under_same_name(&self, name: &str) -> Option<&Path> {
        let wanted = without_ending(name_key(Path::new(name)));
        self.only(|key| key == wanted)
    }

    /// Returns the only file that a name means: its path ends in the name or in the longest end of it, or it lies in the
    /// folder itself under the last part. A split's folder stays part of the name. Masks and maps of depth are no photos.
    pub(super) fn by_end(&self, name: &str) -> Option<&Path> {
        let wanted = without_ending(name_key(Path::new(name.trim_start_matches('/'))));
        let splits = splits_in(&wanted);
        let names_split = |end: &str| splits.iter().all(|split| end.contains(split));
        let only = |fits: &dyn Fn(&str) -> bool| self.only(|key| is_photo(key) && fits(key));
        let ends = |end: &str| {
            only(&|key| key.strip_suffix(end).is_some_and(|front| front.is_empty() || front.ends_with('/')))
        };
        // The longest end first; its last part alone means a file in the folder itself.
        let parts = wanted.match_indices('/').map(|(at, _)| &wanted[at + 1..]);
        let shorter = parts.filter(|end| end.contains('/') && names_split(end));
        let last = wanted.rsplit('/').next().filter(|last| names_split(last));
        self.only(|key| key == wanted)
            .or_else(|| std::iter::once(&*wanted).chain(shorter).find_map(ends))
            .or_else(|| only(&|key| Some(key) == last))
    }

    /// Returns the only folder that has the most of these files by the last part of their names, at least half, with the file
    /// of each name. Folders of originals come before those of reduced photos. Of these it is the one with the largest factor
    /// that divides `downscale`, or else the one with the largest photos.
    pub(super) fn renamed_folder(&self, names: &[&str], downscale: usize) -> Option<(&Path, Vec<Option<&Path>>)> {
        let keys: Vec<String> = names.iter().map(|name| without_ending(name_key(Path::new(name)))).collect();
        let mut folders: BTreeMap<&Path, BTreeMap<&str, &Path>> = BTreeMap::new();
        for (path, key) in self.files.iter().filter(|(_, key)| is_photo(key)) {
            let files = folders.entry(path.parent().unwrap_or(Path::new(""))).or_default();
            let file = files.entry(last_part(key)).or_insert(path);
            if rank(path) < rank(file) {
                *file = path;
            }
        }
        let fits = |folder: &Path, key: &str| {
            let place = format!("{}/", name_key(folder));
            splits_in(key).iter().all(|split| place.contains(split))
        };
        let found = |(folder, files): (&'_ Path, &BTreeMap<&str, &'_ Path>)| -> usize {
            keys.iter().filter(|key| fits(folder, key) && files.contains_key(last_part(key))).count()
        };
        let most = folders.iter().map(|(folder, files)| found((folder, files))).max()?;
        let mut best: Vec<&Path> = folders
            .iter()
            .filter(|(folder, files)| found((folder, files)) == most)
            .map(|(folder, _)| *folder)
            .collect();
        // Photos reduced by the wanted factor, and nothing else, may be read as they are.
        let order = |folder: &&Path| match factor_in(folder) {
            1 => (0, 0),
            factor if downscale.is_multiple_of(factor) => (1, usize::MAX - factor),
            factor => (2, factor),
        };
        best.sort_by_key(order);
        if 2 * most < names.len() || most == 0 || (best.len() > 1 && order(&best[0]) == order(&best[1])) {
            return None;
        }
        let files = &folders[best[0]];
        let file = |key: &String| files.get(last_part(key)).copied().filter(|_| fits(best[0], key));
        Some((best[0], keys.iter().map(file).collect()))
    }

    /// Returns the file whose name is nearest to a name, if one is near.
    pub(super) fn nearest(&self, name: &str) -> Option<&Path> {
        let wanted = without_ending(name_key(Path::new(name)));
        let likeness = |key: &str| strsim::normalized_damerau_levenshtein(last_part(key), last_part(&wanted));
        let (path, key) = self.files.iter().max_by(|a, b| likeness(&a.1).total_cmp(&likeness(&b.1)))?;
        (likeness(key) >= NEAR).then_some(path)
    }
}

/// Returns the folders of splits that a name has.
fn splits_in(name: &str) -> Vec<&'static str> {
    ["train/", "test/", "val/"].into_iter().filter(|split| name.contains(split)).collect()
}

fn last_part(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// Returns the place of a file's ending in [`ENDINGS`], which decides between photos of one name.
fn rank(path: &Path) -> usize {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    ENDINGS.iter().position(|known| ending.as_deref() == Some(known)).unwrap_or(ENDINGS.len())
}

/// Returns the factor by which the photos of a folder are reduced, by its name or that of a folder above it.
pub(super) fn factor_in(folder: &Path) -> usize {
    let factors = folder.components().filter_map(|part| factor_of(&part.as_os_str().to_string_lossy()));
    factors.max().unwrap_or(1)
}

/// Says that reduced photos are read because their originals are not there.
pub(super) fn reduced_words(folder: &Path, factor: usize, size: Size) -> String {
    let lost = match size {
        Size::Factor(wanted) if !wanted.is_multiple_of(factor) => {
            "; the originals are not there, and these are read as they are"
        }
        _ => "",
    };
    format!(
        "only {} is there, whose photos are {factor} times smaller than the originals, as data.downscale={factor} reads them{lost}",
        folder.display()
    )
}

/// Keeps one photo of each name where several endings are there: the first of [`ENDINGS`].
pub(super) fn without_twins(paths: Vec<PathBuf>) -> Vec<PathBuf> {
    let mut best: BTreeMap<PathBuf, usize> = BTreeMap::new();
    for path in &paths {
        let best = best.entry(path.with_extension("")).or_insert(usize::MAX);
        *best = rank(path).min(*best);
    }
    paths.into_iter().filter(|path| best[&path.with_extension("")] == rank(path)).collect()
}

/// Returns a name from a file with slashes, without `./` in front.
pub(super) fn slashes(name: &str) -> String {
    name.replace('\\', "/").trim_start_matches("./").to_string()
}

/// Returns a path as names are compared: neither letter case nor the Unicode form (macOS takes letters and accents apart)
/// make a difference, nor which slash.
pub(super) fn name_key(path: &Path) -> String {
    path.to_string_lossy().replace('\\', "/").nfc().collect::<String>().to_lowercase()
}

fn without_ending(text: String) -> String {
    match Path::new(&text) {
        path if is_image(path) => path.with_extension("").to_string_lossy().into_owned(),
        _ => text,
    }
}

/// Returns width and height from a file's header.
pub fn size(path: &Path) -> Result<(usize, usize)> {
    let (width, height) = limited(open(path)?, 0).into_dimensions().map_err(|e| undecodable(path, &e))?;
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
        let mut decoder = limited(open(path)?, 0).into_decoder().map_err(|e| undecodable(path, &e))?;
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

fn open(path: &Path) -> Result<ImageReader<BufReader<File>>> {
    let reader = open_regular(path).map(|file| ImageReader::new(BufReader::new(file)));
    reader.and_then(ImageReader::with_guessed_format).map_err(|e| Error::unreadable(path, &e))
}

/// Limits the memory that a decoder may take: that of pixels, and a little more for what stands beside them in a file.
fn limited<R: std::io::BufRead + std::io::Seek>(mut reader: ImageReader<R>, pixel_bytes: u64) -> ImageReader<R> {
    let most = match reader.format() {
        Some(ImageFormat::WebP) => Some(MOST_WEBP),
        Some(ImageFormat::Png) => Some(pixel_bytes.saturating_add(MOST_NOTES)),
        _ => None,
    };
    if let Some(most) = most {
        let mut limits = Limits::default();
        limits.max_alloc = Some(most);
        reader.limits(limits);
    }
    reader
}

/// Returns the number of pixels in a PNG's header; 0 for other files.
fn png_pixels(bytes: &[u8]) -> u64 {
    let number =
        |at: usize| bytes.get(at..at + 4).map_or(0, |four| u64::from(u32::from_be_bytes(four.try_into().unwrap())));
    if bytes.starts_with(b"\x89PNG") { number(16) * number(20) } else { 0 }
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
    let reader = ImageReader::with_format(Cursor::new(&bytes), format);
    limited(reader, png_pixels(&bytes).saturating_mul(MOST_PIXEL_BYTES).min(MOST_PNG))
        .decode()
        .map_err(|e| undecodable(path, &e))
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

//! Masks: which pixels of a photo count. A capture's file names them (nerfstudio's `mask_path`), or they lie in a folder
//! that `data.masks` names.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use crate::found;
use crate::frame::Frame;
use crate::json::Object;
use crate::settings::DataConfig;
use crate::{images, resample};
use augnerf_base::{Error, Event, Image, Listener, Result};

/// Part of the names of folders in which masks lie, in lower case.
const IN_FOLDERS: &str = "mask";
/// The value of `data.masks` for masks that lie beside their photos.
const BESIDE: &str = "beside";
/// The value of `data.masks` for none at all.
const NONE: &str = "none";
/// Begin of the names of instant-ngp's masks, in the photos' folder. White is left out there.
const DYNAMIC: &str = "dynamic_mask_";

/// Its key in files.
pub(crate) const KEY: &str = "mask_path";
/// Fraction of a pixel's area that must count for the pixel to count: all of it, except for rounding.
const WHOLE: f32 = 1.0 - 1e-4;

/// Returns the mask that a frame names, or the document for all frames.
pub(crate) fn named_in(frame: Object, document: Object) -> Result<Option<MaskFile>> {
    let Some(owner) = [frame, document].into_iter().find(|object| object.get(KEY).is_some()) else { return Ok(None) };
    let picture = owner.picture(KEY)?;
    let missing = || {
        let what = format!(
            "\"{KEY}\" is \"{}\", but there is no such image: what it masks would be trained on",
            picture.written
        );
        owner.error(&what)
    };
    let path = picture.path.clone().ok_or_else(missing)?;
    Ok(Some(MaskFile { path, inverted: false }))
}

/// A mask's file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MaskFile {
    path: PathBuf,
    /// Whether white is left out, not black.
    inverted: bool,
}

/// Gives photos the masks of `data.masks`, before those that their file names. Masks that lie there and are not asked for are
/// noted.
///
/// # Errors
/// `data.masks` names a folder that has none of them.
pub(crate) fn find<'a>(
    frames: impl Iterator<Item = &'a mut Frame>,
    config: &DataConfig,
    events: &dyn Listener,
) -> Result<()> {
    let mut frames: Vec<&mut Frame> = frames.collect();
    let (name, dir, all) = (config.masks.as_str(), &config.dir, frames.len());
    match name {
        NONE => frames.iter_mut().for_each(|frame| frame.mask = None),
        "" if frames.iter().any(|frame| frame.mask.is_some()) => {}
        "" => Finder::new(Path::new(dir), &frames).note_unused(events),
        _ => {
            let files = Finder::new(Path::new(dir), &frames).find(name);
            let found = files.iter().flatten().count();
            if found == 0 {
                return Err(Error::Data(format!(
                    "data.masks = \"{name}\": {dir} has no mask of its {all} photos there; a mask is called like its photo, with \
                     the ending .png"
                )));
            }
            events.on(Event::Note(&format!("{dir}: {found} of {all} photos have masks, by data.masks = \"{name}\"")));
            frames.iter_mut().zip(files).for_each(|(frame, mask)| frame.mask = mask.or(frame.mask.take()));
        }
    }
    Ok(())
}

/// Finds masks of photos by their names.
struct Finder<'a> {
    dir: &'a Path,
    photos: Vec<&'a Path>,
    /// How many photos have a stem.
    stems: HashMap<String, usize>,
}

/// Images of a folder by their names without ending, as names are compared.
type Images = HashMap<String, PathBuf>;

impl<'a> Finder<'a> {
    fn new(dir: &'a Path, frames: &'a [&mut Frame]) -> Finder<'a> {
        let photos: Vec<&Path> = frames.iter().map(|frame| &*frame.path).collect();
        let mut stems = HashMap::new();
        photos.iter().filter_map(|photo| stem(photo)).for_each(|stem| *stems.entry(stem).or_default() += 1);
        Finder { dir, photos, stems }
    }

    /// Notes masks that are not used, and folders of masks in which no name fits.
    fn note_unused(&self, events: &dyn Listener) {
        let (dir, all) = (self.dir.display(), self.photos.len());
        let folders = self.folders();
        let places =
            folders.keys().map(|name| (format!("{name}/"), &**name)).chain([("their own folder".into(), BESIDE)]);
        for (place, value) in places {
            let found = self.find(value).iter().flatten().count();
            if found > 0 {
                events.on(Event::Note(&format!(
                    "{dir}: {found} of {all} photos have masks in {place}, which are not used; data.masks={value} uses them, \
                     data.masks=none says that they are not meant"
                )));
            } else if let Some(images) = folders.get(value).filter(|images| **images > 0) {
                events.on(Event::Note(&format!(
                    "{dir}: {place} has {images} images that are called like no photo; a mask has its photo's name, with the ending .png"
                )));
            }
        }
    }

    /// Returns the folders of masks, in the scene or beside photos, by their names, and how many images they have.
    fn folders(&self) -> BTreeMap<String, usize> {
        let parents = self.photos.iter().filter_map(|photo| photo.parent());
        let mut folders = BTreeMap::new();
        for place in parents.chain([self.dir]).collect::<BTreeSet<_>>() {
            for entry in std::fs::read_dir(place).into_iter().flatten().flatten().filter(|entry| entry.path().is_dir())
            {
                let name = entry.file_name().to_string_lossy().into_owned();
                let holds_photos = || self.photos.iter().any(|photo| photo.starts_with(entry.path()));
                if name.to_lowercase().contains(IN_FOLDERS) && !holds_photos() {
                    *folders.entry(name).or_default() += found::below(&entry.path()).len();
                }
            }
        }
        folders
    }

    /// Finds each photo's mask by a value of `data.masks`: a folder of the scene or beside the photos, or [`BESIDE`].
    fn find(&self, value: &str) -> Vec<Option<MaskFile>> {
        let mut known: HashMap<PathBuf, Images> = HashMap::new();
        let mut find = |photo: &&Path| {
            let parent = photo.parent()?;
            let own = match value {
                BESIDE => parent.to_path_buf(),
                folder => parent.join(folder),
            };
            let mut mask = |folder: PathBuf, prefixes: &[PathBuf]| {
                let images = known.entry(folder).or_insert_with_key(|folder| images_of(folder));
                prefixes.iter().find_map(|prefix| named(images, photo, prefix, value == BESIDE))
            };
            let beside = mask(own, &[PathBuf::new()]);
            if value == BESIDE { beside } else { beside.or_else(|| mask(self.dir.join(value), &self.prefixes(photo))) }
        };
        self.photos.iter().map(&mut find).collect()
    }

    /// Returns the sub-folders in which a photo's mask may lie: the photo's own, and none if no other photo has its name.
    fn prefixes(&self, photo: &Path) -> Vec<PathBuf> {
        let within = photo.strip_prefix(self.dir).ok().and_then(Path::parent).unwrap_or(Path::new(""));
        // Photos lie in images/ or the like, and masks in the same sub-folders of theirs.
        let below = within.components().skip(1).collect::<PathBuf>();
        let is_single = stem(photo).is_some_and(|stem| self.stems.get(&stem) == Some(&1));
        let bare = is_single.then(PathBuf::new);
        let all = [Some(within.to_path_buf()), Some(below), bare].into_iter().flatten();
        all.filter(|prefix| is_single || prefix.as_os_str() != "").collect()
    }
}

fn stem(photo: &Path) -> Option<String> {
    photo.file_stem().map(|stem| found::name_key(Path::new(stem)))
}

fn images_of(folder: &Path) -> Images {
    let key = |within: &PathBuf| found::name_key(&within.with_extension(""));
    found::below(folder).into_iter().map(|within| (key(&within), folder.join(&within))).collect()
}

/// Finds `NAME.png`, `NAME.jpg.png` as COLMAP has it, `NAME_mask.png`, `mask_NAME.png`, `NAME.mask.png`, and instant-ngp's
/// `dynamic_mask_NAME.png`, in which white is left out. Beside a photo its own name is the photo.
fn named(images: &Images, photo: &Path, prefix: &Path, beside: bool) -> Option<MaskFile> {
    let (stem, name) = (photo.file_stem()?.to_string_lossy(), photo.file_name()?.to_string_lossy());
    let plain = Some(stem.to_string()).filter(|_| !beside);
    let marked = [
        name.to_string(),
        format!("{stem}_mask"),
        format!("mask_{stem}"),
        format!("{stem}.mask"),
        format!("{stem}_alpha"),
    ];
    let dynamic = [format!("{DYNAMIC}{stem}"), format!("{DYNAMIC}{name}")];
    let get = |base: &String| images.get(&found::name_key(&prefix.join(base)));
    let path = plain.into_iter().chain(marked).find_map(|base| get(&base)).filter(|path| **path != *photo);
    let inverted = path.is_none();
    let path = path.or_else(|| dynamic.iter().find_map(get))?.clone();
    Some(MaskFile { path, inverted })
}

impl MaskFile {
    /// Reads which pixels of the photo's view of `width` x `height` count, row by row: those without any black of the mask.
    pub(crate) fn read(&self, photo: &Frame, (width, height): (usize, usize)) -> Result<Vec<bool>> {
        let file = self.path.display();
        let mask = self.counting()?;
        let (columns, rows) = photo.size();
        let shape = (mask.width as f64 * rows as f64 / columns as f64 - mask.height as f64).abs();
        if mask.width < columns || mask.height < rows || shape > 1.0 {
            return Err(Error::Data(format!(
                "{file} is {}x{} pixels, but its photo {} is {columns}x{rows}; a mask must have the photo's size, or be larger and of \
                 the same shape",
                mask.width,
                mask.height,
                photo.path.display()
            )));
        }
        let mask = photo.rectified(resample::shrink(&mask, columns, rows));
        let mask = resample::shrink(&mask, width, height);
        let kept: Vec<bool> = mask.pixels.iter().map(|&share| share >= WHOLE).collect();
        if !kept.contains(&true) {
            return Err(Error::Data(format!(
                "{file} leaves no pixel of {} at {width}x{height} (all of it is masked): remove the frame, or correct the mask",
                photo.path.display()
            )));
        }
        Ok(kept)
    }

    /// Returns 1 where a mask counts, and 0 where it is black or transparent. In a lossy format such as JPEG, black has
    /// dark artefacts around it; there everything brighter than half counts.
    fn counting(&self) -> Result<Image> {
        let darkest = if images::may_be_lossy(&self.path)? { u16::MAX / 2 } else { 0 };
        let mask = images::decode(&self.path)?.into_luma_alpha16();
        let (width, height) = (mask.width() as usize, mask.height() as usize);
        let counts = |[grey, alpha]: [u16; 2]| (grey > darkest && alpha > 0) != self.inverted;
        let pixels = mask.pixels().map(|pixel| f32::from(u8::from(counts(pixel.0)))).collect();
        Ok(Image { width, height, channels: 1, pixels })
    }
}

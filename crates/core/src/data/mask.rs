//! Masks: which pixels of a photo count. A capture's file names them (nerfstudio's `mask_path`), or they lie in a folder
//! that `data.masks` names.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::json::Object;
use crate::data::{images, resample};
use crate::settings::DataConfig;

/// Folders in which masks usually lie.
const FOLDERS: [&str; 4] = ["masks", "mask", "images_mask", "images_masks"];
/// The value of `data.masks` for none at all.
pub(in crate::data) const NONE: &str = "none";
/// Begin of the names of instant-ngp's masks, in the photos' folder. White is left out there.
const DYNAMIC: &str = "dynamic_mask_";

/// Its key in files.
pub(in crate::data) const KEY: &str = "mask_path";
/// Fraction of a pixel's area that must count for the pixel to count: all of it, except for rounding.
const WHOLE: f32 = 1.0 - 1e-4;

/// Returns the mask that a frame names, or the document for all frames.
pub(in crate::data) fn file_of(frame: Object, document: Object) -> Result<Option<PathBuf>> {
    let Some(owner) = [frame, document].into_iter().find(|object| object.get(KEY).is_some()) else { return Ok(None) };
    let picture = owner.picture(KEY)?;
    let missing = || {
        let what = format!(
            "\"{KEY}\" is \"{}\", but there is no such image: what it masks would be trained on",
            picture.written
        );
        owner.error(&what)
    };
    picture.path.clone().map(Some).ok_or_else(missing)
}

/// A masked photo.
pub(in crate::data) struct Masked<'a> {
    /// Its file.
    pub(in crate::data) path: &'a Path,
    /// Its width and height.
    pub(in crate::data) size: (usize, usize),
}

/// A mask's file.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::data) struct MaskFile {
    path: PathBuf,
    /// Whether white is left out, not black.
    inverted: bool,
}

impl MaskFile {
    /// A mask that leaves black out.
    pub(in crate::data) fn of_black(path: PathBuf) -> MaskFile {
        MaskFile { path, inverted: false }
    }

    /// Finds a photo's mask in a folder of the scene: `NAME.png`, `NAME_mask.png` or `mask_NAME.png` of `NAME.jpg`, or
    /// `NAME.jpg.png` as COLMAP has it, in the photo's own sub-folder, or in the folder itself if no other photo `has_name`.
    fn in_folder(dir: &Path, folder: &str, photo: &Path, has_name: impl Fn(&str) -> usize) -> Option<MaskFile> {
        let (stem, name) = (photo.file_stem()?.to_string_lossy(), photo.file_name()?.to_string_lossy());
        let within = photo.strip_prefix(dir).ok().and_then(Path::parent).unwrap_or(Path::new(""));
        // Photos lie in images/ or the like, and masks in the same sub-folders of theirs.
        let below = within.components().skip(1).collect::<PathBuf>();
        let bare = (has_name(&stem) == 1).then(PathBuf::new);
        let places = [Some(within.to_path_buf()), Some(below), bare];
        let endings = || images::ENDINGS.iter().flat_map(|ending| [ending.to_string(), ending.to_ascii_uppercase()]);
        let bases = [name.to_string(), stem.to_string(), format!("{stem}_mask"), format!("mask_{stem}")];
        let file = |place: PathBuf| {
            let names = bases.iter().flat_map(|base| endings().map(move |ending| format!("{base}.{ending}")));
            names.map(|name| dir.join(folder).join(&place).join(name)).find(|path| path.is_file())
        };
        places
            .into_iter()
            .flatten()
            .filter(|place| has_name(&stem) == 1 || place.as_os_str() != "")
            .find_map(file)
            .map(MaskFile::of_black)
    }

    /// Finds instant-ngp's mask beside a photo.
    fn beside(photo: &Path) -> Option<MaskFile> {
        let name = format!("{DYNAMIC}{}.png", photo.file_stem()?.to_string_lossy());
        let path = photo.with_file_name(name);
        path.is_file().then_some(MaskFile { path, inverted: true })
    }

    /// Reads which pixels of the photo's view of `width` x `height` count, row by row. `rectified` removes the photo's
    /// distortion.
    pub(in crate::data) fn read(
        &self,
        photograph: &Masked,
        rectified: impl Fn(Image) -> Image,
        size: (usize, usize),
    ) -> Result<Vec<bool>> {
        read(self, photograph, rectified, size)
    }
}

/// The masks of photos that no file names, by `data.masks`.
pub(in crate::data) struct Masks {
    /// The mask of each photo.
    pub(in crate::data) files: Vec<Option<MaskFile>>,
}

impl Masks {
    /// Finds the photos' masks. Masks that lie there and are not asked for are noted.
    ///
    /// # Errors
    /// `data.masks` names a folder that has none of them.
    pub(in crate::data) fn of<'a>(
        config: &DataConfig,
        photos: impl Iterator<Item = &'a Path>,
        events: &dyn Listener,
    ) -> Result<Masks> {
        let (photos, dir): (Vec<&Path>, _) = (photos.collect(), Path::new(&config.dir));
        let stem = |photo: &Path| photo.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let mut stems: HashMap<String, usize> = HashMap::new();
        photos.iter().filter_map(|photo| stem(photo)).for_each(|stem| *stems.entry(stem).or_default() += 1);
        let has_name = |stem: &str| stems.get(stem).copied().unwrap_or(0);
        let in_folder = |name: &str| -> Vec<Option<MaskFile>> {
            photos.iter().map(|photo| MaskFile::in_folder(dir, name, photo, has_name)).collect()
        };
        let beside = || photos.iter().map(|photo| MaskFile::beside(photo)).collect::<Vec<_>>();
        let count = |files: &[Option<MaskFile>]| files.iter().flatten().count();
        match config.masks.as_str() {
            "" => {
                let folders = FOLDERS.iter().map(|name| (format!("{name}/"), *name, count(&in_folder(name))));
                let all = folders.chain([(format!("{DYNAMIC}*.png"), "beside", count(&beside()))]);
                for (place, value, found) in all.filter(|(_, _, found)| *found > 0) {
                    events.on(Event::Note(&format!(
                        "{}: {found} of {} photos have masks in {place}, which are not used; data.masks={value} uses them, \
                         data.masks=none says that they are not meant",
                        dir.display(),
                        photos.len()
                    )));
                }
                Ok(Masks { files: vec![None; photos.len()] })
            }
            NONE => Ok(Masks { files: vec![None; photos.len()] }),
            name => {
                let files = if name == "beside" { beside() } else { in_folder(name) };
                let found = count(&files);
                if found == 0 {
                    return Err(Error::Data(format!(
                        "data.masks = \"{name}\": {} has no mask of its {} photos there; a mask is called like its photo, with the \
                         ending .png",
                        dir.display(),
                        photos.len()
                    )));
                }
                events.on(Event::Note(&format!(
                    "{}: {found} of {} photos have masks, by data.masks = \"{name}\"",
                    dir.display(),
                    photos.len()
                )));
                Ok(Masks { files })
            }
        }
    }
}

/// Reads which pixels of the photo's view of `width` x `height` count, row by row: those without any black of the mask.
/// `rectified` removes the photo's distortion.
fn read(
    mask_file: &MaskFile,
    photograph: &Masked,
    rectified: impl Fn(Image) -> Image,
    (width, height): (usize, usize),
) -> Result<Vec<bool>> {
    let file = &*mask_file.path;
    let mask = counting(mask_file)?;
    let (columns, rows) = photograph.size;
    let shape = (mask.width as f64 * rows as f64 / columns as f64 - mask.height as f64).abs();
    if mask.width < columns || mask.height < rows || shape > 1.0 {
        return Err(Error::Data(format!(
            "{} is {}x{} pixels, but its photo {} is {columns}x{rows}; a mask must have the photo's size, or be larger and of \
             the same shape",
            file.display(),
            mask.width,
            mask.height,
            photograph.path.display()
        )));
    }
    let mask = rectified(resample::shrink(&mask, columns, rows));
    let kept: Vec<bool> = resample::shrink(&mask, width, height).pixels.iter().map(|&share| share >= WHOLE).collect();
    if !kept.contains(&true) {
        return Err(Error::Data(format!(
            "{} leaves no pixel of {} at {width}x{height} (all of it is masked): remove the frame, or correct the mask",
            file.display(),
            photograph.path.display()
        )));
    }
    Ok(kept)
}

/// Returns 1 where a mask counts, and 0 where it is black or transparent. In a lossy format such as JPEG, black has
/// dark artefacts around it; there everything brighter than half counts.
fn counting(MaskFile { path: file, inverted }: &MaskFile) -> Result<Image> {
    let darkest = if images::may_be_lossy(file)? { u16::MAX / 2 } else { 0 };
    let mask = images::decode(file)?.into_luma_alpha16();
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let counts = |[grey, alpha]: [u16; 2]| match inverted {
        false => grey > darkest && alpha > 0,
        true => grey <= darkest || alpha == 0,
    };
    let pixels = mask.pixels().map(|pixel| f32::from(u8::from(counts(pixel.0)))).collect();
    Ok(Image { width, height, channels: 1, pixels })
}

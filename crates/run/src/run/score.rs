//! Measures images of any program as our own are: 8-bit values against the same 8-bit ground truth.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::base::input::read_bytes;
use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::{Scene, View, images, resample};
use crate::metrics::{Floor, Lpips, MSE, MeanMetrics, PSNR_FLOAT, ViewMetrics, measure_unmasked};
use crate::settings::Resolved;

use super::protocol::{PROTOCOL, Protocol, sides};

/// Size limit of an image file in bytes.
const MOST_BYTES: u64 = 1 << 30;

/// An image file with the name for matching.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// The file's name without its extension and without `_rgb` or `_truth`, which this program adds.
    pub name: String,
    /// The file.
    pub path: PathBuf,
}

/// How images are matched with the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matching {
    /// By equal names.
    Name,
    /// By order of names; numbers in names count by value.
    Order,
}

/// The ground truth of images.
pub enum Truth<'a> {
    /// Image files.
    Pictures(Vec<Picture>),
    /// Held-out views of one of our scenes.
    Scene(&'a Resolved, &'a Scene),
}

/// One image with its metrics.
#[derive(Clone, Debug)]
pub struct ScoredView {
    /// Its metrics, under the name of the ground truth.
    pub metrics: ViewMetrics,
    /// The image file.
    pub prediction: PathBuf,
    /// The file of the ground truth, or `None` for a scene's view.
    pub truth: Option<PathBuf>,
    /// SHA-256 of the image file.
    pub prediction_sha256: String,
    /// SHA-256 of the ground truth's file, or of a scene's view's 8-bit values.
    pub truth_sha256: String,
}

/// Metrics of a set of images.
#[derive(Clone, Debug)]
pub struct Score {
    /// Each image, in the order of the ground truth.
    pub views: Vec<ScoredView>,
    /// Means over the views.
    pub mean: MeanMetrics,
    /// The known fields of the protocol.
    pub protocol: Vec<(String, String)>,
    /// SHA-256 over the names of the views and the hashes of the images.
    pub predictions_sha256: String,
    /// The same for the ground truth.
    pub truth_sha256: String,
}

/// Lists the images of a folder in order. If this program rendered into the folder, it also has depth and ground
/// truth. Then only files that end with `suffix`, such as `_rgb`, are listed.
///
/// # Errors
/// The folder cannot be read or has no images; two images have the same name.
pub fn pictures(folder: &Path, suffix: &str) -> Result<Vec<Picture>> {
    let picture = |path: PathBuf| {
        let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        Picture { name, path }
    };
    let mut all: Vec<Picture> = images::list(folder)?.into_iter().map(picture).collect();
    if all.is_empty() {
        return Err(Error::Data(format!(
            "{} holds no PNG, JPEG or WebP files; name the folder of the images",
            folder.display()
        )));
    }
    let own: Vec<Picture> = all
        .iter()
        .filter_map(|picture| {
            let name = picture.name.strip_suffix(suffix).filter(|name| !name.is_empty())?.to_string();
            Some(Picture { name, ..picture.clone() })
        })
        .collect();
    // `NAME_rgb`, `NAME_truth`, `NAME_depth`: a folder of this program.
    if !own.is_empty() {
        all = own;
    }
    all.sort_by(|a, b| natural(&a.name, &b.name).then_with(|| a.path.cmp(&b.path)));
    match all.windows(2).find(|pair| pair[0].name == pair[1].name) {
        Some(pair) => Err(Error::Data(format!(
            "{} and {} have the same name; keep one file a view",
            pair[0].path.display(),
            pair[1].path.display()
        ))),
        None => Ok(all),
    }
}

/// Lists the images of two folders that are compared with each other. This program's suffixes tell its files apart,
/// unless every complete name has its own partner.
///
/// # Errors
/// Those of [`pictures`].
pub fn both_pictures(predictions: &Path, truth: &Path) -> Result<(Vec<Picture>, Vec<Picture>)> {
    let alike =
        |a: &[Picture], b: &[Picture]| a.iter().map(|picture| &picture.name).eq(b.iter().map(|other| &other.name));
    let own = (pictures(predictions, "_rgb")?, pictures(truth, "_truth")?);
    if alike(&own.0, &own.1) {
        return Ok(own);
    }
    match (pictures(predictions, ""), pictures(truth, "")) {
        (Ok(predictions), Ok(truth)) if alike(&predictions, &truth) => Ok((predictions, truth)),
        _ => Ok(own),
    }
}

/// Compares names by the value of numbers in them: `r_2` before `r_10`.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a.as_bytes(), b.as_bytes());
    while let (Some(x), Some(y)) = (a.first(), b.first()) {
        if x.is_ascii_digit() && y.is_ascii_digit() {
            let digits = |text: &[u8]| text.iter().take_while(|byte| byte.is_ascii_digit()).count();
            let (m, n) = (digits(a), digits(b));
            let bare = |text: &[u8]| text.iter().position(|byte| *byte != b'0').unwrap_or(text.len());
            let (p, q) = (&a[bare(&a[..m])..m], &b[bare(&b[..n])..n]);
            let order = p.len().cmp(&q.len()).then_with(|| p.cmp(q)).then_with(|| m.cmp(&n));
            if order != Ordering::Equal {
                return order;
            }
            (a, b) = (&a[m..], &b[n..]);
        } else if x != y {
            return x.cmp(y);
        } else {
            (a, b) = (&a[1..], &b[1..]);
        }
    }
    a.len().cmp(&b.len())
}

/// The ground truth of one image.
enum Target<'a> {
    File(&'a Picture),
    View(&'a View),
}

impl Target<'_> {
    fn name(&self) -> &str {
        match self {
            Target::File(picture) => &picture.name,
            Target::View(view) => &view.name,
        }
    }

    /// Returns which pixels count, if a scene's view has a mask.
    fn mask(&self) -> Option<&[bool]> {
        match self {
            Target::File(_) => None,
            Target::View(view) => view.mask.as_deref(),
        }
    }
}

impl Truth<'_> {
    fn targets(&self) -> Vec<Target<'_>> {
        match self {
            Truth::Pictures(pictures) => pictures.iter().map(Target::File).collect(),
            Truth::Scene(_, scene) => scene.test.iter().map(Target::View).collect(),
        }
    }
}

/// Measures images against the ground truth. `background` is the colour behind transparent ones.
///
/// # Errors
/// Numbers, names or sizes of images do not match; transparent images have no background; files cannot be read.
pub fn score(
    predictions: &[Picture],
    truth: &Truth,
    matching: Matching,
    background: Option<[f32; 3]>,
    lpips: &[Lpips],
    events: &dyn Listener,
) -> Result<Score> {
    let targets = truth.targets();
    let pairs = matched(predictions, targets, matching)?;
    events.on(Event::Started { what: "scoring", parts: pairs.len() as u64 });
    let floor = match truth {
        Truth::Scene(_, scene) => Floor::of_views(&scene.train),
        Truth::Pictures(_) => None,
    };
    let mut views = Vec::new();
    for (picture, target) in &pairs {
        views.push(view(picture, target, background, floor.as_ref(), lpips)?);
        events.on(Event::Advanced);
    }
    events.on(Event::Finished);
    let measured: Vec<ViewMetrics> = views.iter().map(|view| view.metrics.clone()).collect();
    let mut mean = MeanMetrics::from_views(&measured);
    // The images were rounded before they came here.
    mean.set(&PSNR_FLOAT, None);
    let hash = |of: fn(&ScoredView) -> &str| {
        let mut hash = Sha256::new();
        views.iter().for_each(|view| hash.update(format!("{}  {}\n", of(view), view.metrics.name)));
        hex(hash)
    };
    let predictions_sha256 = hash(|view| &view.prediction_sha256);
    let truth_sha256 = hash(|view| &view.truth_sha256);
    let protocol = protocol(truth, background, &pairs, lpips)?;
    Ok(Score { predictions_sha256, truth_sha256, mean, protocol, views })
}

/// Pairs each target with its image.
fn matched<'a>(
    predictions: &'a [Picture],
    targets: Vec<Target<'a>>,
    matching: Matching,
) -> Result<Vec<(&'a Picture, Target<'a>)>> {
    let names = |names: Vec<&str>| match names.len() {
        0..=3 => names.join(", "),
        more => format!("{} and {} more", names[..3].join(", "), more - 3),
    };
    let (own, other) = (predictions.len(), targets.len());
    if matching == Matching::Order {
        if own != other {
            return Err(Error::Data(format!(
                "{own} images for {other} views; give one image a view, in the same order"
            )));
        }
        return Ok(predictions.iter().zip(targets).collect());
    }
    let without: Vec<&str> =
        targets.iter().map(Target::name).filter(|name| !predictions.iter().any(|own| own.name == *name)).collect();
    let unknown = predictions.iter().map(|own| own.name.as_str());
    let unknown: Vec<&str> = unknown.filter(|name| !targets.iter().any(|target| target.name() == *name)).collect();
    let advice = "name images like the views, or match them by order (--match order)";
    if !without.is_empty() {
        let unknown =
            if unknown.is_empty() { String::new() } else { format!(" (images of no view: {})", names(unknown)) };
        return Err(Error::Data(format!(
            "{} of {other} views have no image of the same name: {}{unknown}; {advice}",
            without.len(),
            names(without)
        )));
    }
    if !unknown.is_empty() {
        return Err(Error::Data(format!(
            "{own} images for {other} views; these match no view: {}; {advice}",
            names(unknown)
        )));
    }
    let find = |target: &Target| predictions.iter().find(|own| own.name == target.name()).expect("every view has one");
    Ok(targets.into_iter().map(|target| (find(&target), target)).collect())
}

fn view(
    picture: &Picture,
    target: &Target,
    background: Option<[f32; 3]>,
    floor: Option<&Floor>,
    lpips: &[Lpips],
) -> Result<ScoredView> {
    let (image, prediction_sha256) = read(&picture.path, background)?;
    let (truth, path, truth_sha256) = match target {
        Target::File(file) => {
            let (truth, hash) = read(&file.path, background)?;
            (truth, Some(file.path.clone()), hash)
        }
        Target::View(view) => ((*view.image).clone(), None, hash_of_values(&view.image)),
    };
    if (image.width, image.height) != (truth.width, truth.height) {
        return Err(Error::Data(format!(
            "{} is {}x{} pixels, but view {} is {}x{}; score images of the views' size (data.downscale, data.width)",
            picture.path.display(),
            image.width,
            image.height,
            target.name(),
            truth.width,
            truth.height
        )));
    }
    let mut metrics = measure_unmasked(target.name(), &image, &truth, target.mask(), lpips)?;
    // The values before rounding are unknown.
    metrics.values.set(&PSNR_FLOAT, None);
    metrics.values.set(&MSE, None);
    floor.map_or(Ok(()), |floor| floor.measure(&mut metrics, &truth, target.mask()))?;
    Ok(ScoredView { metrics, prediction: picture.path.clone(), truth: path, prediction_sha256, truth_sha256 })
}

/// Reads an image's 8-bit values on the background, and the hash of its file.
fn read(path: &Path, background: Option<[f32; 3]>) -> Result<(Image, String)> {
    let bytes = read_bytes(path, MOST_BYTES).map_err(|e| Error::unreadable(path, &e))?;
    let size = images::size(path)?;
    let (image, clear) = resample::composite(images::read(path, size)?, background.unwrap_or([0.0; 3]));
    if clear && background.is_none() {
        return Err(Error::Data(format!(
            "{} has transparent pixels; name the colour behind them, --background white or black",
            path.display()
        )));
    }
    Ok((image, hex(Sha256::new().chain_update(bytes))))
}

fn hash_of_values(image: &Image) -> String {
    let values: Vec<u8> = image.pixels.iter().map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    let size = format!("{}x{}x{}\n", image.width, image.height, image.channels);
    hex(Sha256::new().chain_update(size).chain_update(values))
}

fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns the known provenance of the numbers.
fn protocol(
    truth: &Truth,
    background: Option<[f32; 3]>,
    pairs: &[(&Picture, Target)],
    lpips: &[Lpips],
) -> Result<Vec<(String, String)>> {
    let mut known: Vec<(String, String)> = match truth {
        Truth::Scene(config, scene) => {
            Protocol::of_views(config, scene).into_iter().map(|(name, text)| (name.to_string(), text)).collect()
        }
        Truth::Pictures(_) => {
            let sizes = pairs.iter().map(|(picture, _)| images::size(&picture.path)).collect::<Result<Vec<_>>>()?;
            let background = background.map_or("", |colour| if colour == [1.0; 3] { "white" } else { "black" });
            let known = [
                ("protocol", PROTOCOL.to_string()),
                ("width", sides(sizes.iter().map(|(width, _)| *width))),
                ("height", sides(sizes.iter().map(|(_, height)| *height))),
                ("background", background.to_string()),
                ("views_evaluated", pairs.len().to_string()),
            ];
            known.map(|(name, text)| (name.to_string(), text)).to_vec()
        }
    };
    let weights: Vec<String> =
        lpips.iter().map(|lpips| format!("{} {}", lpips.backbone().name(), lpips.weights_hash())).collect();
    known.push(("lpips_weights".into(), weights.join(", ")));
    Ok(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_by_their_size() {
        let mut names = ["r_10", "r_2", "r_1", "a", "r_02", "r_2b", "r_"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["a", "r_", "r_1", "r_2", "r_2b", "r_02", "r_10"]);
    }

    #[test]
    fn matching_is_by_name_or_by_order() {
        let picture = |name: &str| Picture { name: name.into(), path: format!("{name}.png").into() };
        let own = ["0", "1"].map(picture);
        let other = ["1", "0"].map(picture);
        let targets = |pictures: &'static [Picture]| pictures.iter().map(Target::File).collect::<Vec<_>>();
        let other: &'static [Picture] = Box::leak(Box::new(other));
        let names = |pairs: Vec<(&Picture, Target)>| {
            pairs.into_iter().map(|(own, target)| format!("{}{}", own.name, target.name())).collect::<Vec<_>>()
        };
        assert_eq!(names(matched(&own, targets(other), Matching::Name).unwrap()), ["11", "00"]);
        assert_eq!(names(matched(&own, targets(other), Matching::Order).unwrap()), ["01", "10"]);
        let refused = |own: &[Picture], matching| matched(own, targets(other), matching).err().unwrap().to_string();
        assert!(refused(&own[..1], Matching::Order).contains("1 images for 2 views"));
        assert!(refused(&own[..1], Matching::Name).contains("1 of 2 views have no image of the same name: 1; "));
        let more = ["0", "1", "2"].map(picture);
        assert!(refused(&more, Matching::Name).contains("these match no view: 2"));
    }
}

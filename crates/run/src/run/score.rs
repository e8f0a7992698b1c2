//! Pictures that any program rendered, measured as ours are: 8-bit values against the same 8-bit truth.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::base::input::read_bytes;
use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::{Scene, View, images, resample};
use crate::metrics::{Lpips, MeanMetrics, ViewMetrics, measure_unmasked};
use crate::settings::Resolved;

use super::protocol::{PROTOCOL, Protocol, sides};

/// Most bytes of a picture's file.
const MOST_BYTES: u64 = 1 << 30;

/// A picture file under the name that it is matched by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// The file's name without its ending and without `_rgb` or `_truth`, which this program puts there.
    pub name: String,
    /// The file.
    pub path: PathBuf,
}

/// How pictures find what they are held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matching {
    /// Equal names.
    Name,
    /// The first with the first: by name, numbers in it by their size.
    Order,
}

/// What pictures are held against.
pub enum Truth<'a> {
    /// Pictures.
    Pictures(Vec<Picture>),
    /// Held-out views of a scene of ours.
    Scene(&'a Resolved, &'a Scene),
}

/// One picture with its numbers.
#[derive(Clone, Debug)]
pub struct ScoredView {
    /// Its metrics, under the truth's name.
    pub metrics: ViewMetrics,
    /// The picture's file.
    pub prediction: PathBuf,
    /// The file of the truth; none of a scene's view.
    pub truth: Option<PathBuf>,
    /// SHA-256 of the picture's file.
    pub prediction_sha256: String,
    /// SHA-256 of the truth's file; of a scene's view of its 8-bit values.
    pub truth_sha256: String,
}

/// What a set of pictures came to.
#[derive(Clone, Debug)]
pub struct Score {
    /// Each picture, in the order of the truth.
    pub views: Vec<ScoredView>,
    /// Means over them.
    pub mean: MeanMetrics,
    /// The fields of the protocol that are known.
    pub protocol: Vec<(String, String)>,
    /// SHA-256 over the names of the views and the hashes of the pictures.
    pub predictions_sha256: String,
    /// The same of the truth.
    pub truth_sha256: String,
}

/// The pictures of a folder, in their order. Of one that this program rendered into, which has depth and truth beside them, those
/// alone that end with `suffix`, such as `_rgb`.
///
/// # Errors
/// A folder that cannot be read or has no pictures; two pictures of one name.
pub fn pictures(folder: &Path, suffix: &str) -> Result<Vec<Picture>> {
    let picture = |path: PathBuf| {
        let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        Picture { name, path }
    };
    let mut all: Vec<Picture> = images::list(folder)?.into_iter().map(picture).collect();
    if all.is_empty() {
        return Err(Error::Data(format!(
            "{} holds no PNG, JPEG or WebP files: name the folder of the pictures",
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
            "{} and {} have one name: leave one file a view",
            pair[0].path.display(),
            pair[1].path.display()
        ))),
        None => Ok(all),
    }
}

/// The pictures of two folders that are held against each other. What this program puts behind names tells its files apart, unless
/// whole names alone have a partner each.
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

/// Names in the order that a person gives them: `r_2` before `r_10`.
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

/// What one picture is held against.
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

    /// Which pixels count, where a scene's view says so.
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

/// Measures pictures against the truth. `background` is what see-through ones are put on.
///
/// # Errors
/// Other numbers of pictures, other names, other sizes; see-through pictures without a background; files that cannot be read.
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
    let mut views = Vec::new();
    for (picture, target) in &pairs {
        views.push(view(picture, target, background, lpips)?);
        events.on(Event::Advanced);
    }
    events.on(Event::Finished);
    let measured: Vec<ViewMetrics> = views.iter().map(|view| view.metrics.clone()).collect();
    let mut mean = MeanMetrics::from_views(&measured);
    // Of pictures that were rounded before they came here.
    mean.set("psnr_float", None);
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

/// Each target with its picture.
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
                "there are {own} pictures for {other} views: give one picture a view, in the same order"
            )));
        }
        return Ok(predictions.iter().zip(targets).collect());
    }
    let without: Vec<&str> =
        targets.iter().map(Target::name).filter(|name| !predictions.iter().any(|own| own.name == *name)).collect();
    let unknown = predictions.iter().map(|own| own.name.as_str());
    let unknown: Vec<&str> = unknown.filter(|name| !targets.iter().any(|target| target.name() == *name)).collect();
    let advice = "name pictures as the views are named, or match them in their order (--match order)";
    if !without.is_empty() {
        let unknown = if unknown.is_empty() { String::new() } else { format!(" (of no view: {})", names(unknown)) };
        return Err(Error::Data(format!(
            "{} of {other} views have no picture of their name: {}{unknown}; {advice}",
            without.len(),
            names(without)
        )));
    }
    if !unknown.is_empty() {
        return Err(Error::Data(format!(
            "there are {own} pictures for {other} views; of no view are {}; {advice}",
            names(unknown)
        )));
    }
    let find = |target: &Target| predictions.iter().find(|own| own.name == target.name()).expect("every view has one");
    Ok(targets.into_iter().map(|target| (find(&target), target)).collect())
}

fn view(picture: &Picture, target: &Target, background: Option<[f32; 3]>, lpips: &[Lpips]) -> Result<ScoredView> {
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
            "{} is {}x{} pixels, but view {} is {}x{}: score pictures of the views' own size (data.downscale, data.width)",
            picture.path.display(),
            image.width,
            image.height,
            target.name(),
            truth.width,
            truth.height
        )));
    }
    let mut metrics = measure_unmasked(target.name(), &image, &truth, target.mask(), lpips)?;
    // What the values were before they were rounded is not known.
    metrics.values.set("psnr_float", None);
    metrics.values.set("mse", None);
    Ok(ScoredView { metrics, prediction: picture.path.clone(), truth: path, prediction_sha256, truth_sha256 })
}

/// A picture's 8-bit values on the background, and the hash of its file.
fn read(path: &Path, background: Option<[f32; 3]>) -> Result<(Image, String)> {
    let bytes = read_bytes(path, MOST_BYTES).map_err(|e| Error::unreadable(path, &e))?;
    let size = images::size(path)?;
    let (image, clear) = resample::composite(images::read(path, size)?, background.unwrap_or([0.0; 3]));
    if clear && background.is_none() {
        return Err(Error::Data(format!(
            "{} has see-through pixels: say what they are put on, --background white or black",
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

/// What is known of where the numbers come from.
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
        assert!(refused(&own[..1], Matching::Order).contains("1 pictures for 2 views"));
        assert!(refused(&own[..1], Matching::Name).contains("1 of 2 views have no picture of their name: 1; "));
        let more = ["0", "1", "2"].map(picture);
        assert!(refused(&more, Matching::Name).contains("of no view are 2"));
    }
}

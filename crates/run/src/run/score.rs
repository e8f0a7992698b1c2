//! Measures images of any program as our own are: 8-bit values against the same 8-bit ground truth.

use std::path::{Path, PathBuf};

use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::{Scene, View, images, resample};
use crate::metrics::{Floor, Lpips, MSE, MeanMetrics, PSNR_FLOAT, ViewMetrics, measure_unmasked};
use crate::settings::Resolved;

use super::protocol::Protocol;

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

/// Metrics of a set of images.
#[derive(Clone, Debug)]
pub struct Score {
    /// Each image under the name of its ground truth, in the order of the ground truth.
    pub views: Vec<ViewMetrics>,
    /// The image of each view.
    pub images: Vec<PathBuf>,
    /// Means over the views.
    pub mean: MeanMetrics,
    /// The known fields of the protocol.
    pub protocol: Vec<(&'static str, String)>,
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
    all.sort_by(|a, b| natural(&a.name).cmp(&natural(&b.name)).then_with(|| a.path.cmp(&b.path)));
    match all.windows(2).find(|pair| pair[0].name == pair[1].name) {
        Some(pair) => Err(Error::Data(format!(
            "{} and {} have the same name; keep one file a view",
            pair[0].path.display(),
            pair[1].path.display()
        ))),
        None => Ok(all),
    }
}

/// Returns a name in parts that compare by the value of numbers in it: `r_2` before `r_10`. A number is compared by its length
/// without leading zeros, then by its digits. Last comes the name itself, for leading zeros.
fn natural(name: &str) -> (Vec<(usize, &str)>, &str) {
    let is_digit = |letter: &char| letter.is_ascii_digit();
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let other = |letter: char| is_digit(&letter) != is_digit(&first);
        let (part, after) = rest.split_at(rest.find(other).unwrap_or(rest.len()));
        let number = part.trim_start_matches('0');
        parts.push(if is_digit(&first) { (1 + number.len(), number) } else { (0, part) });
        rest = after;
    }
    (parts, name)
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
    let (targets, floor, mut protocol): (Vec<Target>, _, _) = match truth {
        Truth::Pictures(pictures) => (pictures.iter().map(Target::File).collect(), None, Vec::new()),
        Truth::Scene(config, scene) => (
            scene.test.iter().map(Target::View).collect(),
            Floor::of_views(&scene.train),
            Protocol::of_views(config, scene),
        ),
    };
    let pairs = matched(predictions, targets, matching)?;
    events.on(Event::Started { what: "scoring", parts: pairs.len() as u64 });
    let mut views = Vec::new();
    for (picture, target) in &pairs {
        views.push(view(picture, target, background, floor.as_ref(), lpips)?);
        events.on(Event::Advanced);
    }
    events.on(Event::Finished);
    let mut mean = MeanMetrics::from_views(&views);
    // The images were rounded before they came here.
    mean.set(&PSNR_FLOAT, None);
    let weights: Vec<String> =
        lpips.iter().map(|lpips| format!("{} {}", lpips.backbone().name(), lpips.weights_hash())).collect();
    protocol.push(("lpips_weights", weights.join(", ")));
    let images = pairs.iter().map(|(picture, _)| picture.path.clone()).collect();
    Ok(Score { views, images, mean, protocol })
}

/// Pairs each target with its image.
fn matched<'a>(
    predictions: &'a [Picture],
    targets: Vec<Target<'a>>,
    matching: Matching,
) -> Result<Vec<(&'a Picture, Target<'a>)>> {
    let (own, other) = (predictions.len(), targets.len());
    let with_image = |target: Target<'a>| match predictions.iter().find(|own| own.name == target.name()) {
        Some(own) => Ok((own, target)),
        None => Err(Error::Data(format!(
            "view {} has no image of its name; name images like the views, or match them by order (--match order)",
            target.name()
        ))),
    };
    let pairs = match matching {
        Matching::Order => predictions.iter().zip(targets).collect(),
        Matching::Name => targets.into_iter().map(with_image).collect::<Result<Vec<_>>>()?,
    };
    match own == other {
        true => Ok(pairs),
        false => Err(Error::Data(format!("{own} images for {other} views; give one image a view"))),
    }
}

fn view(
    picture: &Picture,
    target: &Target,
    background: Option<[f32; 3]>,
    floor: Option<&Floor>,
    lpips: &[Lpips],
) -> Result<ViewMetrics> {
    let image = read(&picture.path, background)?;
    let (truth, mask) = match target {
        Target::File(file) => (read(&file.path, background)?, None),
        Target::View(view) => ((*view.image).clone(), view.mask.as_deref()),
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
    let mut metrics = measure_unmasked(target.name(), &image, &truth, mask, lpips)?;
    // The values before rounding are unknown.
    metrics.values.set(&PSNR_FLOAT, None);
    metrics.values.set(&MSE, None);
    floor.map_or(Ok(()), |floor| floor.measure(&mut metrics, &truth, mask))?;
    Ok(metrics)
}

/// Reads an image's 8-bit values on the background.
fn read(path: &Path, background: Option<[f32; 3]>) -> Result<Image> {
    let (image, clear) = resample::composite(images::read(path, images::size(path)?)?, background.unwrap_or([0.0; 3]));
    if clear && background.is_none() {
        return Err(Error::Data(format!(
            "{} has transparent pixels; name the colour behind them, --background white or black",
            path.display()
        )));
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_by_their_size() {
        let mut names = ["r_10", "r_2", "r_1", "a", "r_02", "r_2b", "r_"];
        names.sort_by_key(|name| natural(name));
        assert_eq!(names, ["a", "r_", "r_1", "r_02", "r_2", "r_2b", "r_10"]);
    }

    #[test]
    fn matching_is_by_name_or_by_order() {
        let picture = |name: &str| Picture { name: name.into(), path: format!("{name}.png").into() };
        let (own, other) = (["0", "1"].map(picture), ["1", "0"].map(picture));
        let targets = || other.iter().map(Target::File).collect::<Vec<_>>();
        let names = |matching| {
            let pairs = matched(&own, targets(), matching).unwrap();
            pairs.into_iter().map(|(own, target)| format!("{}{}", own.name, target.name())).collect::<Vec<_>>()
        };
        assert_eq!(names(Matching::Name), ["11", "00"]);
        assert_eq!(names(Matching::Order), ["01", "10"]);
        let refused = |own: &[Picture], matching| matched(own, targets(), matching).err().unwrap().to_string();
        assert!(refused(&[picture("0")], Matching::Name).contains("view 1 has no image"));
        for matching in [Matching::Name, Matching::Order] {
            let three = ["0", "1", "2"].map(picture);
            assert!(refused(&three, matching).contains("3 images for 2 views"));
        }
    }
}

//! LLFF scenes: `poses_bounds.npy` next to `images_{factor}` or `images`, with nerf-pytorch's conventions for axes,
//! scale and video path.

mod folder;
mod orbit;
mod paths;
mod poses;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

pub use orbit::settle_orbit;
pub use poses::Poses;

use crate::formats::transforms::distortion::{Distortion, Intrinsics};
use crate::formats::{Capture, colmap};
use crate::found;
use crate::frame::{self, Frame, Reading};
use crate::images::{self, Header, Size};
use crate::mask;
use crate::pose::Pose;
use crate::settings::{DataConfig, DataKind, scene_name};
use crate::{Camera, Ndc, Photos, Rig, Scene, SceneSpace, background, path};
use augnerf_base::input::{TEXT_BYTES, read_text};
use augnerf_base::{Error, Event, Listener, Result};
use folder::{Source, is_of_shape};

/// The file that makes a folder an LLFF scene.
pub const POSES_FILE: &str = "poses_bounds.npy";

/// LLFF's list of the photos that have poses.
const VIEWS_FILE: &str = "view_imgs.txt";

/// Largest difference, beyond a pixel, between images and the size for which the poses were made, as a fraction.
const SIZE_TOLERANCE: f64 = 0.01;

/// Reads an LLFF scene. Every `config.holdout`-th view is held out, starting with the first.
pub fn load(config: &DataConfig, photos: Photos, events: &dyn Listener) -> Result<Scene> {
    if config.spherify && config.ndc {
        return Err(Error::Config(
            "data.spherify and data.ndc exclude each other: NDC is for cameras that face forward; set data.ndc=false"
                .into(),
        ));
    }
    let dir = Path::new(&config.dir);
    let file = dir.join(POSES_FILE);
    let mut poses = Poses::read(&file)?;
    let listed = registered(dir, poses.poses.len(), events)?;
    let source =
        folder::find(dir, Size::of(config), (poses.poses.len(), [poses.width, poses.height]), listed.as_ref())?;
    check_count(&source, poses.poses.len(), &file)?;
    source.reduced.iter().for_each(|words| events.on(Event::Note(&format!("{}: {words}", dir.display()))));
    let folder = source.paths[0].parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    if images::factor_of(&folder).is_none() {
        events.on(Event::Note(&format!(
            "{}: there is no folder images, and {folder}, the only folder with an image for each pose, is read",
            dir.display()
        )));
    }
    check_size(&source, &mut poses, config, &file, events)?;
    let name_file = |e: Error| Error::Data(format!("{}: {e}", file.display()));
    let path = normalize(&mut poses, config).map_err(name_file)?;
    let camera = camera_at(source.target, &poses, config);
    let cameras: Vec<Camera> = poses.poses.iter().map(|&pose| Camera { pose, ..camera }).collect();
    let names = images::names(&source.paths);
    if config.ndc {
        check_facing(&cameras, &names, &file)?;
    }
    found::note_twins(dir, source.paths.iter(), events);
    let lens = Intrinsics { focal: camera.focal, centre: camera.centre };
    let frame = |(path, header): (&PathBuf, &Header)| {
        Frame::new(path.clone(), *header, lens, Distortion::default()).expect("nothing to undo")
    };
    let mut frames: Vec<Frame> = source.paths.iter().zip(&source.headers).map(frame).collect();
    mask::find(frames.iter_mut(), config, events)?;
    let background = background(config);
    let how = Reading { scene: dir, background: (background, false), photos, what: "photos", events };
    let (views, clear) = frame::views(&frames, &names, &cameras, how)?;
    let ndc = Ndc { width: source.target.0 as f64, height: source.target.1 as f64, focal: camera.focal[0] };
    let capture = Capture {
        views,
        near: if config.ndc { 0.0 } else { 0.9 * poses.nearest() },
        far: if config.ndc { 1.0 } else { poses.farthest() },
        ndc: config.ndc.then_some(ndc),
        background: clear.then_some(background),
        path: path.into_iter().map(|pose| Camera { pose, ..camera }).collect(),
        space: space(&poses, &cameras, &source, config),
    };
    Ok(capture.hold_out(scene_name(config), DataKind::Llff.name(), config))
}

/// Returns units, box and notes. For forward-facing cameras only NDC tell where objects are.
fn space(poses: &Poses, cameras: &[Camera], source: &Source, config: &DataConfig) -> SceneSpace {
    let mut space = SceneSpace { world: poses.world, ..SceneSpace::default() };
    if config.spherify {
        space.domain = Rig::of(cameras).subject.map(|subject| subject.domain());
    }
    space.note("images", images::folder_words(&source.paths, source.stored, source.target));
    if !source.passed.is_empty() {
        space.note("passed over", source.passed.join("; "));
    }
    let [near, far] = [poses.nearest(), poses.farthest()].map(|bound| bound / poses.world.scale);
    space.note("bounds from", format!("{POSES_FILE}, whose depths run from {near:.4} to {far:.4} in the file's units"));
    space
}

/// Scales, recentres and optionally spherifies the poses, and returns the video path.
fn normalize(poses: &mut Poses, config: &DataConfig) -> Result<Vec<Pose>> {
    poses.scale_bounds(config.bound_factor);
    if config.recentre {
        poses.recentre()?;
    }
    if config.spherify {
        poses.spherify()?;
        // nerf-pytorch's circle would turn the camera about its axis if the capture is of one side.
        return if path::goes_around(&poses.poses) { poses.circle() } else { Ok(path::around(&poses.poses)) };
    }
    // A spiral is for forward-facing cameras.
    let goes_around = !config.ndc && orbit::around(&poses.poses).is_some();
    if goes_around { Ok(path::around(&poses.poses)) } else { poses.spiral() }
}

/// Returns the camera at the working resolution, without its pose. Its focal length is the file's over the factor, as in
/// nerf-pytorch. Its principal point keeps its place in the picture.
fn camera_at((width, height): (usize, usize), poses: &Poses, config: &DataConfig) -> Camera {
    let focal = poses.focal.map(|focal| match Size::of(config) {
        Size::Factor(factor) => focal / factor as f64,
        Size::Width(_) => focal * width as f64 / poses.width,
    });
    let [x, y] = poses.centre;
    // Twice the fraction of a side, which is exactly 1 for the middle.
    let centre = [2.0 * x / poses.width * (width as f64 / 2.0), 2.0 * y / poses.height * (height as f64 / 2.0)];
    Camera { width, height, focal, centre, pose: [[0.0; 4]; 3] }
}

fn check_count(source: &Source, poses: usize, file: &Path) -> Result<()> {
    let folder = source.paths[0].parent().unwrap_or(Path::new("images"));
    if source.paths.len() != poses {
        return Err(Error::Data(format!(
            "{} holds {} images, but {} has {poses} poses: every image needs its pose, in the order of the file names",
            folder.display(),
            source.paths.len(),
            file.display()
        )));
    }
    Ok(())
}

/// Returns the names of the photos that have poses, if there are more photos: of `view_imgs.txt`, which LLFF writes, or of
/// the COLMAP model in `sparse/0`. `None` if neither is there or has as many names as there are poses.
fn registered(dir: &Path, poses: usize, events: &dyn Listener) -> Result<Option<BTreeSet<String>>> {
    let all = images::list(&dir.join("images")).map_or(0, |paths| found::without_twins(paths).len());
    if all <= poses {
        return Ok(None);
    }
    let file = dir.join(VIEWS_FILE);
    let text = file.is_file().then(|| read_text(&file, TEXT_BYTES).map_err(|e| Error::unreadable(&file, &e)));
    let listed = text.transpose()?.map(|text| {
        text.lines().map(str::trim).filter(|line| !line.is_empty()).map(found::slashes).collect::<BTreeSet<String>>()
    });
    let names = match listed.filter(|names| names.len() == poses) {
        Some(names) => Some((VIEWS_FILE, names)),
        None => colmap::names(dir).filter(|names| names.len() == poses).map(|names| ("the COLMAP model", names)),
    };
    let Some((from, names)) = names else { return Ok(None) };
    events.on(Event::Note(&format!("{}: {poses} of {all} photos have poses, by {from}", dir.display())));
    Ok(Some(names))
}

/// Checks that the images are those of the poses at the factor, or smaller ones of the same shape, whose focal length is
/// scaled; otherwise the focal length would not fit.
fn check_size(
    source: &Source,
    poses: &mut Poses,
    config: &DataConfig,
    file: &Path,
    events: &dyn Listener,
) -> Result<()> {
    let scale = match Size::of(config) {
        Size::Factor(factor) => 1.0 / factor as f64,
        Size::Width(width) => width as f64 / poses.width,
    };
    let expected = [poses.width * scale, poses.height * scale];
    let found = [source.target.0 as f64, source.target.1 as f64];
    let close = |(found, expected): (f64, f64)| (found - expected).abs() <= 1.0 + SIZE_TOLERANCE * expected;
    if found.into_iter().zip(expected).all(close) {
        return Ok(());
    }
    let same_shape = |shape: [f64; 2]| is_of_shape(source.stored, shape);
    if same_shape([poses.width, poses.height]) {
        events.on(Event::Note(&format!(
            "{}: made for {}x{} images, and {} is {}x{}: the focal length is scaled with it",
            file.display(),
            poses.width,
            poses.height,
            source.paths[0].display(),
            source.stored.0,
            source.stored.1
        )));
        // What the file would say of these images.
        poses.scale_images(found[0] / expected[0]);
        return Ok(());
    }
    if same_shape([poses.height, poses.width]) {
        return Err(Error::Data(format!(
            "{}: height and width stand in each other's place: it says {}x{} (width x height), and {} is {}x{}; exchange the first \
             two numbers of each pose's last column",
            file.display(),
            poses.width,
            poses.height,
            source.paths[0].display(),
            source.stored.0,
            source.stored.1
        )));
    }
    Err(Error::Data(format!(
        "{} is {}x{} pixels and would be trained on at {}x{}, but {} was made for {}x{} images, which makes {:.0}x{:.0} \
         here: the images were scaled, cropped or turned after their poses were found, or the folder's name is wrong",
        source.paths[0].display(),
        source.stored.0,
        source.stored.1,
        source.target.0,
        source.target.1,
        file.display(),
        poses.width,
        poses.height,
        expected[0],
        expected[1]
    )))
}

/// Checks that NDC are defined: for rays towards -z that start in front of the near plane's far side.
fn check_facing(cameras: &[Camera], names: &[String], file: &Path) -> Result<()> {
    for (camera, name) in cameras.iter().zip(names) {
        if !camera.faces_forward() {
            return Err(Error::Data(format!(
                "{}: view {name} looks away from the scene's -z axis, so its rays have no normalized device \
                 coordinates; set data.ndc=false, and data.spherify=true for a capture from all around",
                file.display()
            )));
        }
    }
    Ok(())
}

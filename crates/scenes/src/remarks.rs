//! What is said of cameras that are probably wrong, though they can be computed with.

use super::pose::{self, Pose, Vec3};
use super::{Camera, Rig, Scene, View};
use crate::settings::DataKind;
use augnerf_base::image::colour_spread;

/// Fewest training views of which nothing is said.
const FEW_VIEWS: usize = 3;
/// Distance under which cameras stand in one place, as a fraction of the scene's largest depth.
const ONE_PLACE: f64 = 1e-6;
/// Degrees between a viewing direction and their mean from which on cameras stand around something.
const ALL_AROUND: f64 = 60.0;
/// Largest median distance of viewing axes from their common point, as a fraction of the median camera's.
const MEETING: f64 = 0.25;
/// Formats for which `data.axes` counts.
const READ_WITH_AXES: [DataKind; 2] = [DataKind::Transforms, DataKind::Blender];
/// Difference of the focal lengths across and down, as a fraction, from which on it is said.
const UNEQUAL_FOCAL: f64 = 0.25;
/// Distance of a principal point from the middle, as a fraction of the side, from which on it is said.
const OFF_CENTRE: f64 = 0.25;
/// Degrees that a lens of a photo usually sees across.
const FIELD_OF_VIEW: std::ops::RangeInclusive<f64> = 5.0..=120.0;

/// Photos whose colours (0 to 1) differ less may be of one colour.
pub const MANY_COLOURS: f32 = 0.02;

/// Returns the remarks on a scene's cameras.
pub(super) fn of(scene: &Scene) -> Vec<String> {
    let views: Vec<&View> = scene.train.iter().chain(&scene.test).collect();
    let lens = [unequal_focal(&views), off_centre(&views), field_of_view(&views)];
    let place = one_place(scene, &views);
    // Of cameras in one place the rest follows.
    let same = if place.is_some() { None } else { same_pose(&views).or_else(|| look_away(scene, &views)) };
    [few(scene), place, same, one_colour(scene)].into_iter().chain(lens).flatten().collect()
}

fn few(scene: &Scene) -> Option<String> {
    let count = scene.train.len();
    let views = if count == 1 { "view trains" } else { "views train" };
    (count < FEW_VIEWS).then(|| format!("only {count} {views}: a field needs at least {FEW_VIEWS} to find depth"))
}

/// Views that show nothing. Any picture of their colour is perfect.
fn one_colour(scene: &Scene) -> Option<String> {
    let is_flat = |views: &[View]| scene.is_read() && !views.is_empty() && are_one_colour(views);
    let (what, views) =
        [("held-out", &scene.test), ("training", &scene.train)].into_iter().find(|(_, views)| is_flat(views))?;
    Some(format!(
        "all {} {what} views are of one and the same colour: they show nothing, and metrics mean nothing; if their photos have an \
         alpha channel that is 0 everywhere, remove it",
        views.len()
    ))
}

/// Returns whether all pixels of all views that count are of one colour.
fn are_one_colour(views: &[View]) -> bool {
    colour_spread(views.iter().map(|view| (&*view.image, view.mask.as_deref()))) <= MANY_COLOURS
}

/// Most cameras without parallax, as of a tripod.
fn one_place(scene: &Scene, views: &[&View]) -> Option<String> {
    let centre = |view: &View| pose::column(&view.camera.pose, 3);
    let near = |a: Vec3, b: Vec3| pose::length(pose::sub(a, b)) <= ONE_PLACE * scene.far.abs().max(1.0);
    let together = |view: &&View| views.iter().filter(|other| near(centre(view), centre(other))).count();
    let (count, most) = (views.len(), views.iter().map(together).max()?);
    let advice = "without parallax no depth can be found; matrices from world to camera look like this, too, and have to be inverted";
    match most {
        1 => None,
        _ if most == count => Some(format!("all {count} cameras stand in one place: {advice}")),
        _ if 2 * most > count => Some(format!("{most} of {count} cameras stand in one place: {advice}")),
        _ => None,
    }
}

fn same_pose(views: &[&View]) -> Option<String> {
    let (first, second) = views.iter().enumerate().find_map(|(i, view)| {
        // A view may be trained on and evaluated.
        let is_itself = |other: &View| other.name == view.name && other.image == view.image;
        let same = |other: &&&View| other.camera.pose == view.camera.pose && !is_itself(other);
        Some((view, views[i + 1..].iter().find(same)?))
    })?;
    Some(format!("views {} and {} have the same pose: one of the poses may be another's", first.name, second.name))
}

/// Cameras all around that look away from their common point. Of cameras that face one way the axes may well meet behind.
fn look_away(scene: &Scene, views: &[&View]) -> Option<String> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let rig = Rig::of(&cameras);
    if rig.spread.is_some_and(|degrees| degrees <= ALL_AROUND) {
        return None;
    }
    let flipped: Vec<Camera> =
        cameras.iter().map(|camera| Camera { pose: pose::flipped(&camera.pose), ..*camera }).collect();
    let advice = match READ_WITH_AXES.iter().any(|kind| kind.name() == scene.kind) {
        true => {
            "unless the capture looks outwards, its matrices have OpenCV's axes (x right, y down, z ahead), which data.axes=opencv reads"
        }
        false => "unless the capture looks outwards, its poses have other axes than the format's",
    };
    if rig.subject.is_none() && Rig::of(&flipped).subject.is_some() {
        return Some(format!("the cameras look away from their common point: {advice}"));
    }
    let (away, all) = (behind(&cameras)?, cameras.len());
    (away > 0).then(|| format!("{away} of {all} cameras look away from the point at which the others look: their matrices may have other axes"))
}

/// Returns how many cameras have the point where all axes meet behind them; `None` if they meet nowhere.
fn behind(cameras: &[Camera]) -> Option<usize> {
    let poses: Vec<Pose> = cameras.iter().map(|camera| camera.pose).collect();
    let focus = pose::focus_point(&poses)?;
    let to_focus = |pose: &Pose| pose::sub(focus, pose::column(pose, 3));
    let depth = |pose: &Pose| -pose::dot(to_focus(pose), pose::column(pose, 2));
    let off_axis = |pose: &Pose| (pose::dot(to_focus(pose), to_focus(pose)) - depth(pose).powi(2)).max(0.0).sqrt();
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let meets = median(poses.iter().map(off_axis).collect())
        <= MEETING * median(poses.iter().map(|pose| pose::length(to_focus(pose))).collect());
    let away = poses.iter().filter(|pose| depth(pose) < 0.0).count();
    (meets && 2 * away <= poses.len()).then_some(away)
}

/// Pixels that are not square.
fn unequal_focal(views: &[&View]) -> Option<String> {
    let unequal = |view: &&&View| {
        let [x, y] = view.camera.focal;
        (x - y).abs() > UNEQUAL_FOCAL * x.min(y)
    };
    let view = views.iter().find(unequal)?;
    let [x, y] = view.camera.focal;
    Some(format!(
        "view {} has focal lengths of {x:.1} pixels across and {y:.1} down: pixels are rarely so far from square",
        view.name
    ))
}

fn off_centre(views: &[&View]) -> Option<String> {
    let sides = |view: &View| [view.camera.width as f64, view.camera.height as f64];
    let is_off = |view: &&&View| {
        let places = view.camera.centre.iter().zip(sides(view));
        places.into_iter().any(|(centre, side)| (centre / side - 0.5).abs() > OFF_CENTRE)
    };
    let view = views.iter().find(is_off)?;
    let ([x, y], [width, height]) = (view.camera.centre, sides(view));
    Some(format!(
        "view {} has its principal point at {x:.1}, {y:.1} of {width} x {height} pixels: lenses are rarely so far off the middle, \
         intrinsics of another size are",
        view.name
    ))
}

fn field_of_view(views: &[&View]) -> Option<String> {
    let degrees = |view: &View| 2.0 * (0.5 * view.camera.width as f64 / view.camera.focal[0]).atan().to_degrees();
    let view = views.iter().find(|view| !FIELD_OF_VIEW.contains(&degrees(view)))?;
    Some(format!(
        "view {} sees {:.1} degrees across: its focal length of {:.1} pixels is probably in other units, or of another size",
        view.name,
        degrees(view),
        view.camera.focal[0]
    ))
}

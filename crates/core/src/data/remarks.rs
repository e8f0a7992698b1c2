//! What is said of cameras that are probably wrong, though they can be computed with.

use super::pose::{self, Vec3};
use super::{Camera, Rig, Scene};
use crate::settings::DataKind;

/// Fewest training views of which nothing is said.
const FEW_VIEWS: usize = 3;
/// Distance under which cameras stand in one place, as a fraction of the scene's largest depth.
const ONE_PLACE: f64 = 1e-6;
/// Degrees between a viewing direction and their mean from which on cameras stand around something.
const ALL_AROUND: f64 = 60.0;
/// Formats for which `data.axes` counts.
const READ_WITH_AXES: [DataKind; 2] = [DataKind::Transforms, DataKind::Blender];
/// Difference of the focal lengths across and down, as a fraction, from which on it is said.
const UNEQUAL_FOCAL: f64 = 0.25;

/// Returns the remarks on a scene's cameras.
pub(super) fn of(scene: &Scene) -> Vec<String> {
    let cameras: Vec<Camera> = scene.train.iter().chain(&scene.test).map(|view| view.camera).collect();
    let away = looks_away(&cameras).filter(|_| READ_WITH_AXES.iter().any(|kind| kind.name() == scene.kind));
    [few(scene), one_place(scene), away, unequal_focal(scene)].into_iter().flatten().collect()
}

fn few(scene: &Scene) -> Option<String> {
    let count = scene.train.len();
    let views = if count == 1 { "view trains" } else { "views train" };
    (count < FEW_VIEWS).then(|| format!("only {count} {views}: a field needs at least {FEW_VIEWS} to find depth"))
}

/// Cameras without parallax, as of a tripod.
fn one_place(scene: &Scene) -> Option<String> {
    let views = || scene.train.iter().chain(&scene.test);
    let centre = |camera: &Camera| pose::column(&camera.pose, 3);
    let near = |a: Vec3, b: Vec3| {
        let distance = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
        distance <= ONE_PLACE * scene.far.abs().max(1.0)
    };
    let first = centre(&views().next()?.camera);
    let count = views().count();
    if count > 1 && views().all(|view| near(centre(&view.camera), first)) {
        return Some(format!("all {count} cameras stand in one place: without parallax no depth can be found"));
    }
    None
}

/// Cameras all around whose common point lies behind them. Of cameras that face one way the axes may well meet behind.
fn looks_away(cameras: &[Camera]) -> Option<String> {
    let flipped: Vec<Camera> =
        cameras.iter().map(|camera| Camera { pose: pose::flipped(&camera.pose), ..*camera }).collect();
    let rig = Rig::of(cameras);
    let around = rig.spread.is_none_or(|degrees| degrees > ALL_AROUND);
    let away = around && rig.subject.is_none() && Rig::of(&flipped).subject.is_some();
    away.then(|| {
        "the cameras look away from their common point: unless the capture looks outwards, its matrices have OpenCV's axes (x \
         right, y down, z ahead), which data.axes=opencv reads"
            .into()
    })
}

/// Pixels that are not square.
fn unequal_focal(scene: &Scene) -> Option<String> {
    let unequal = |camera: &Camera| {
        let [x, y] = camera.focal;
        (x - y).abs() > UNEQUAL_FOCAL * x.min(y)
    };
    let view = scene.train.iter().chain(&scene.test).find(|view| unequal(&view.camera))?;
    let [x, y] = view.camera.focal;
    Some(format!(
        "view {} has focal lengths of {x:.1} pixels across and {y:.1} down: pixels are rarely so far from square",
        view.name
    ))
}

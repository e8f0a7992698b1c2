//! Camera paths: what a scene's cameras look at is in every frame, for every kind of scene.

use std::path::Path;

use augnerf::data::formats::builtin;
use augnerf::data::pose::{self, Pose, Vec3};
use augnerf::data::{self, Camera, Scene, path};
use augnerf::settings::{DataConfig, DataKind};
use tempfile::TempDir;

use crate::captures::Folder;
use crate::common::files::json as read_json;
use crate::common::needs::scene as scene_folder;

/// Pixels a side of the exported pictures.
const WIDTH: usize = 16;

fn load(dir: &Path, change: impl FnOnce(&mut DataConfig)) -> Scene {
    let mut config = DataConfig { dir: dir.display().to_string(), downscale: Some(1), ..DataConfig::default() };
    change(&mut config);
    config.kind = data::detect(&config).unwrap();
    data::load(&config, 0, &()).unwrap()
}

/// Where a camera sees a point: from the middle (0) to an edge (1) of its picture, whichever axis is worse.
fn off_centre(camera: &Camera, point: Vec3) -> f64 {
    let [x, y, back] = pose::transform(&pose::inverse_rigid(&camera.pose), point);
    assert!(back < 0.0, "{point:?} is behind the camera");
    let at = [camera.centre[0] - camera.focal[0] * x / back, camera.centre[1] + camera.focal[1] * y / back];
    let half = [0.5 * camera.width as f64, 0.5 * camera.height as f64];
    (at[0] / half[0] - 1.0).abs().max((at[1] / half[1] - 1.0).abs())
}

/// Demands that the point which the training cameras look at is in every frame, at most so far from its middle.
#[track_caller]
fn assert_shown(scene: &Scene, most: f64) {
    let poses: Vec<Pose> = scene.train.iter().map(|view| view.camera.pose).collect();
    let centre = path::centre(&poses).expect("they look at something");
    assert!(scene.path.len() >= 40, "{} frames", scene.path.len());
    let worst = scene.path.iter().map(|camera| off_centre(camera, centre)).fold(0.0, f64::max);
    assert!(worst <= most, "{}: {worst}", scene.kind);
}

#[test]
fn embedded_scenes_are_in_every_frame() {
    for (kind, most) in [(DataKind::BuiltinBlender, 1e-6), (DataKind::BuiltinForward, 0.2)] {
        let config = DataConfig { kind, width: WIDTH as u32, downscale: Some(1), ..DataConfig::default() };
        assert_shown(&data::load(&config, 0, &()).unwrap(), most);
    }
}

/// Cameras that look at one point are followed.
#[test]
fn captures_are_in_the_middle_of_every_frame() {
    assert_shown(&Folder::new(12).load(|_| {}), 1e-6);
    // From one side alone.
    let mut side = Folder::new(12);
    side.frames().truncate(5);
    assert_shown(&side.load(|_| {}), 1e-6);
}

/// NeRF-Synthetic's sphere has nerf-pytorch's path; splits of another place and size one of their own.
#[test]
fn scenes_of_splits_are_in_every_frame() {
    let dir = TempDir::new().unwrap();
    builtin::export(dir.path(), WIDTH, None).unwrap();
    let scene = load(dir.path(), |_| ());
    assert_shown(&scene, 0.2);
    let poses: Vec<Pose> = scene.path.iter().map(|camera| camera.pose).collect();
    assert_eq!(poses, augnerf::data::formats::blender::orbit());
    for split in ["train", "val", "test"] {
        let file = dir.path().join(format!("transforms_{split}.json"));
        let mut document = read_json(&file);
        for frame in document["frames"].as_array_mut().unwrap() {
            for (row, shift) in [5.0, 6.0, -7.0].into_iter().enumerate() {
                let cell = &mut frame["transform_matrix"][row][3];
                *cell = (3.0 * cell.as_f64().unwrap() + shift).into();
            }
        }
        std::fs::write(&file, document.to_string()).unwrap();
    }
    assert_shown(&load(dir.path(), |_| ()), 0.2);
}

#[test]
#[ignore = "needs AUGNERF_DATA"]
fn published_scenes_are_in_every_frame() {
    assert_shown(&load(&scene_folder("nerf_llff_data/fern"), |config| config.downscale = Some(8)), 0.5);
    assert_shown(
        &load(&scene_folder("nerf_synthetic/chair"), |config| (config.width, config.test_skip) = (8, 100)),
        0.1,
    );
}

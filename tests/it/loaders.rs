//! The loaders against nerf-pytorch's own numbers (tests/fixtures/loaders.safetensors and
//! numeric_core.safetensors, written by nerf-pytorch 63a5a63 in float32).
//!
//! The scenes are not in the repository: `AUGNERF_DATA` names the folder that holds
//! `nerf_llff_data/fern` and `nerf_synthetic/chair`.

use crate::common::needs::scene;
use crate::common::reference::Reference;
use augnerf::data::formats::blender;
use augnerf::data::formats::llff::Poses;
use augnerf::data::pose::{self, Pose, Vec3};
use augnerf::data::{self, Camera, Ndc, images};
use augnerf::settings::{DataConfig, DataKind};

/// The references are float32, a handful of roundings away from our float64: poses and bounds are
/// compared relative to max(1, |reference|). 2^-24 * 30 = 1.8e-6; 5e-7 is the largest seen.
const POSES: f64 = 2e-6;
/// Focal lengths of some hundred pixels, relative.
const FOCAL: f64 = 1e-6;
/// Means of four 8-bit values in float32.
const PIXEL: f64 = 1e-6;

fn config(dir: &std::path::Path, kind: DataKind, downscale: u32) -> DataConfig {
    DataConfig { dir: dir.display().to_string(), kind, downscale: Some(downscale), ..DataConfig::default() }
}

/// Asserts closeness relative to max(1, |expected|) and reports the largest deviation.
fn assert_close(what: &str, found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{what}: number of values");
    let error = |(f, e): (&f64, &f64)| (f - e).abs() / e.abs().max(1.0);
    let worst = found.iter().zip(expected).map(error).fold(0.0, |a: f64, b| if b.is_nan() { b } else { a.max(b) });
    println!("{what}: largest deviation {worst:.2e}, allowed {tolerance:.0e}");
    assert!(worst <= tolerance, "{what}: deviates by {worst:e}, allowed {tolerance:e}");
}

/// 3x5 matrices `[pose | height, width, focal]` as nerf-pytorch keeps them.
fn with_hwf(poses: &[Pose], hwf: [f64; 3]) -> Vec<f64> {
    poses.iter().flat_map(|p| (0..3).flat_map(move |i| [p[i][0], p[i][1], p[i][2], p[i][3], hwf[i]])).collect()
}

fn square(poses: impl Iterator<Item = Pose>) -> Vec<f64> {
    poses.flat_map(|p| p.into_iter().chain([[0.0, 0.0, 0.0, 1.0]]).flatten().collect::<Vec<_>>()).collect()
}

/// nerf-pytorch's held-out view: the one nearest to the average pose.
fn nearest_to_average(poses: &[Pose]) -> f64 {
    let average = pose::column(&pose::average(poses).unwrap(), 3);
    let distance = |p: &Pose| pose::length(pose::sub(pose::column(p, 3), average));
    let best = (0..poses.len()).min_by(|&a, &b| distance(&poses[a]).total_cmp(&distance(&poses[b])));
    best.unwrap() as f64
}

#[test]
#[ignore = "needs AUGNERF_DATA"]
fn poses_of_fern_are_nerf_pytorchs() {
    let reference = Reference::load("loaders");
    for part in ["forward", "spherify"] {
        let mut poses = Poses::read(&scene("nerf_llff_data/fern").join("poses_bounds.npy")).unwrap();
        poses.scale_bounds(0.75);
        poses.recentre().unwrap();
        let path = if part == "spherify" {
            poses.spherify().unwrap();
            poses.circle()
        } else {
            poses.spiral()
        };
        let hwf = [poses.height / 8.0, poses.width / 8.0, poses.focal[0] / 8.0];
        let bounds: Vec<f64> = poses.bounds.iter().flatten().copied().collect();
        let check = |what: &str, found: &[f64]| {
            let name = format!("llff.{part}.{what}");
            assert_close(&name, found, &reference.values(&name), POSES);
        };
        check("poses", &with_hwf(&poses.poses, hwf));
        check("bounds", &bounds);
        check("render_poses", &with_hwf(&path.unwrap(), hwf));
        check("i_test", &[nearest_to_average(&poses.poses)]);
    }
}

#[test]
#[ignore = "needs AUGNERF_DATA"]
fn fern_loads_as_a_scene() {
    let dir = scene("nerf_llff_data/fern");
    let mut config = config(&dir, DataKind::Auto, 8);
    config.kind = data::detect(&config).unwrap();
    assert_eq!(config.kind, DataKind::Llff);
    let scene = data::load(&config, 0, &()).unwrap();
    let names: Vec<&str> = scene.test.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["image000", "image008", "image016"]);
    assert_eq!((scene.train.len(), scene.near, scene.far, scene.path.len()), (17, 0.0, 1.0, 120));
    let camera = scene.test[0].camera;
    assert_eq!((camera.width, camera.height, camera.centre), (504, 378, [252.0, 189.0]));
    let expected = Reference::load("loaders").values("llff.forward.poses");
    assert_close("scene pose 0", &with_hwf(&[camera.pose], [378.0, 504.0, camera.focal[0]]), &expected[..15], POSES);
    assert_eq!(scene.ndc, Some(Ndc { width: 504.0, height: 378.0, focal: camera.focal[0] }));
    assert_eq!(scene.background, None);
    let pixels = &scene.test[0].image.pixels;
    assert!(pixels.len() == 504 * 378 * 3 && pixels.iter().all(|v| (0.0..=1.0).contains(v)));
    assert!(scene.describe().iter().any(|(label, value)| label == "coordinates" && value == "NDC"));

    let bounds = Reference::load("loaders").values("llff.forward.bounds");
    let world = data::load(&DataConfig { ndc: false, ..config.clone() }, 0, &()).unwrap();
    let extreme = |pick: fn(f64, f64) -> f64| bounds.iter().copied().reduce(pick).unwrap();
    assert_close("bounds without NDC", &[world.near, world.far], &[0.9 * extreme(f64::min), extreme(f64::max)], POSES);

    let wide = data::load(&DataConfig { width: 252, test_skip: 2, ..config }, 0, &()).unwrap();
    assert_eq!((wide.test.len(), wide.train[0].camera.height), (2, 189));
    assert_close("focal at width 252", &[wide.train[0].camera.focal[0]], &[expected[14] / 2.0], FOCAL);
}

#[test]
#[ignore = "needs AUGNERF_DATA"]
fn chair_at_half_resolution_is_nerf_pytorchs() {
    let dir = scene("nerf_synthetic/chair");
    let reference = Reference::load("loaders");
    let mut config = config(&dir, DataKind::Auto, 2);
    config.kind = data::detect(&config).unwrap();
    assert_eq!(config.kind, DataKind::Blender);
    config.test_skip = 40;
    let scene = data::load(&config, 0, &()).unwrap();
    let camera = scene.train[0].camera;
    let hwf = [camera.height as f64, camera.width as f64, camera.focal[0]];
    assert_close("hwf", &hwf, &reference.values("blender.half.hwf"), FOCAL);
    assert_eq!(camera.focal[0], camera.focal[1]);
    let first = square(std::iter::once(camera.pose));
    assert_close("train_pose0", &first, &reference.values("blender.half.train_pose0"), POSES);
    let test = square(scene.test.iter().map(|v| v.camera.pose));
    assert_close("test_poses", &test, &reference.values("blender.half.test_poses"), POSES);
    let path = square(scene.path.iter().map(|c| c.pose));
    assert_close("render_poses", &path, &reference.values("blender.render_poses"), POSES);
    assert_eq!((scene.train.len(), scene.near, scene.far, scene.background), (100, 2.0, 6.0, Some([1.0; 3])));

    let rgba = images::read(&dir.join("train/r_0.png"), (400, 400)).unwrap();
    let crop: Vec<f64> = (120..184)
        .flat_map(|y| rgba.pixels[(y * 400 + 140) * 4..(y * 400 + 204) * 4].iter().map(|&v| f64::from(v)))
        .collect();
    let expected = reference.values("blender.half.train0_rgba_crop_120_140_64");
    assert_close("rgba crop", &crop, &expected, PIXEL);
    let white: Vec<f64> = expected.chunks_exact(4).flat_map(|p| [0, 1, 2].map(|c| p[c] * p[3] + 1.0 - p[3])).collect();
    let shown: Vec<f64> = (120..184)
        .flat_map(|y| scene.train[0].image.pixels[(y * 400 + 140) * 3..(y * 400 + 204) * 3].iter())
        .map(|&v| f64::from(v))
        .collect();
    assert_close("rgb on white", &shown, &white, PIXEL);
}

#[test]
fn the_orbit_is_nerf_pytorchs() {
    let path = square(blender::orbit().into_iter());
    assert_close("orbit", &path, &Reference::load("loaders").values("blender.render_poses"), POSES);
}

/// Origins and directions are those of `NAME.o` and `NAME.d`.
fn assert_rays(name: &str, rays: impl Iterator<Item = (Vec3, Vec3)>) {
    let reference = Reference::load("numeric_core");
    let (origins, directions): (Vec<Vec3>, Vec<Vec3>) = rays.unzip();
    for (part, found) in [("o", origins), ("d", directions)] {
        let name = format!("{name}.{part}");
        assert_close(&name, &found.concat(), &reference.values(&name), POSES);
    }
}

#[test]
fn pixel_rays_are_nerf_pytorchs() {
    let reference = Reference::load("numeric_core");
    let (c2w, hwf) = (reference.values("rays.c2w"), reference.values("rays.hwf"));
    let camera = Camera {
        width: hwf[1] as usize,
        height: hwf[0] as usize,
        focal: [hwf[2]; 2],
        centre: [0.5 * hwf[1], 0.5 * hwf[0]],
        pose: std::array::from_fn(|i| std::array::from_fn(|j| c2w[4 * i + j])),
    };
    let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x as f64, y as f64)));
    assert_rays("rays", pixels.map(|(x, y)| camera.ray(x, y)));
}

#[test]
fn normalised_device_coordinates_are_nerf_pytorchs() {
    let reference = Reference::load("numeric_core");
    let hwf = reference.values("rays.hwf");
    let ndc = Ndc { width: hwf[1], height: hwf[0], focal: hwf[2] };
    let (o, d) = (reference.values("ndc.in_o"), reference.values("ndc.in_d"));
    let vector = |v: &[f64]| [v[0], v[1], v[2]];
    assert_rays("ndc", o.chunks_exact(3).zip(d.chunks_exact(3)).map(|(o, d)| ndc.map(vector(o), vector(d))));
}

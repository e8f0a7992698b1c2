use super::material::Material;
use super::shapes::{Shape, Solid};
use super::*;
use crate::settings::EvalSplit;
use crate::vector::{add, along, cross, dot, length, scale, sub, unit};

/// Agreement of a closed-form crossing with sphere tracing, which stops this near the surface.
const MARCH_TOLERANCE: f64 = 1e-6;
/// Grazing rays come nearer to a surface than this without a clear answer.
const GRAZE: f64 = 1e-4;

/// Low-discrepancy numbers in 0..1: rays all over, without randomness.
fn spread(i: usize, dimension: u32) -> f64 {
    (0.5 + (i as f64 + 1.0) * 0.856_674_883_854_5f64.powi(dimension as i32 + 1)).fract()
}

fn on_unit_sphere(u: f64, v: f64) -> [f64; 3] {
    let z = 2.0 * u - 1.0;
    let (s, c) = (v * std::f64::consts::TAU).sin_cos();
    let r = (1.0 - z * z).sqrt();
    [r * c, r * s, z]
}

fn every_shape() -> Vec<Shape> {
    vec![
        Shape::Sphere { radius: 0.7 },
        Shape::Cuboid { half: [0.5, 0.3, 0.8] },
        Shape::Frustum { bottom: 0.4, top: 0.4, half_height: 0.6 },
        Shape::Frustum { bottom: 0.3, top: 0.7, half_height: 0.4 },
        Shape::Frustum { bottom: 0.6, top: 0.0, half_height: 0.5 },
        Shape::Frustum { bottom: 0.016, top: 0.012, half_height: 0.8 },
        Shape::Torus { major: 0.6, minor: 0.25 },
        Shape::Torus { major: 0.7, minor: 0.016 },
    ]
}

/// A ray from outside towards a point near the shape, and a length of direction other than 1.
fn ray_at(shape: &Shape, i: usize) -> ([f64; 3], [f64; 3]) {
    let origin = scale(on_unit_sphere(spread(i, 0), spread(i, 1)), 3.0);
    let target = scale(on_unit_sphere(spread(i, 2), spread(i, 3)), shape.bound() * spread(i, 4));
    (origin, scale(sub(target, origin), 0.3 + spread(i, 5)))
}

/// First crossing by walking the signed distance, and the nearest that the ray came to it before.
fn march(shape: &Shape, origin: [f64; 3], direction: [f64; 3]) -> (Option<f64>, f64) {
    let speed = length(direction);
    let (mut t, mut nearest) = (0.0, f64::INFINITY);
    while t * speed < 8.0 {
        let gap = shape.distance(along(origin, direction, t));
        if gap < 1e-9 {
            return (Some(t), 0.0);
        }
        nearest = gap.min(nearest);
        t += gap / speed;
    }
    (None, nearest)
}

#[test]
fn crossings_agree_with_sphere_tracing() {
    for shape in every_shape() {
        let mut hits = 0;
        for i in 0..4000 {
            let (origin, direction) = ray_at(&shape, i);
            let found = shape.first_crossing(origin, direction, 0.0);
            match march(&shape, origin, direction) {
                (Some(t), _) => {
                    let at = |t: f64| shape.distance(along(origin, direction, t));
                    // Where sphere tracing stops at a surface that the ray only grazes, the exact
                    // answer may be a later crossing, or none.
                    let deepest = (1..200).map(|k| at(t + 1e-3 * f64::from(k))).fold(0.0, f64::min);
                    let Some(found) = found else {
                        assert!(deepest > -GRAZE, "{shape:?} ray {i}: missed at {t}");
                        continue;
                    };
                    assert!(at(found).abs() < 1e-11, "{shape:?} ray {i}: {} off the surface", at(found));
                    let normal = shape.normal(along(origin, direction, found));
                    let slant = -dot(normal, direction) / length(direction);
                    if slant > 0.05 {
                        assert!((found - t).abs() < MARCH_TOLERANCE, "{shape:?} ray {i}: {found} is not {t}");
                        hits += 1;
                    }
                }
                (None, nearest) => assert!(found.is_none() || nearest < GRAZE, "{shape:?} ray {i}: phantom {found:?}"),
            }
        }
        assert!(hits > 20, "{shape:?}: only {hits} clear hits");
    }
}

#[test]
fn crossings_from_inside_leave_the_solid() {
    for shape in every_shape() {
        let inside = if let Shape::Torus { major, .. } = shape { [major, 0.0, 0.0] } else { [0.0; 3] };
        assert!(shape.distance(inside) < 0.0);
        for i in 0..200 {
            let direction = on_unit_sphere(spread(i, 0), spread(i, 1));
            let t = shape.first_crossing(inside, direction, 0.0).expect("a way out");
            let p = along(inside, direction, t);
            assert!(shape.distance(p).abs() < 1e-12);
            assert!(dot(shape.normal(p), direction) >= 0.0);
        }
    }
}

#[test]
fn normals_are_the_gradient_of_the_distance() {
    const STEP: f64 = 1e-6;
    for shape in every_shape() {
        let mut checked = 0;
        for i in 0..1000 {
            let (origin, direction) = ray_at(&shape, i);
            let Some(t) = shape.first_crossing(origin, direction, 0.0) else { continue };
            let p = along(origin, direction, t);
            let axis = |k: usize| std::array::from_fn(|j| if j == k { STEP } else { 0.0 });
            let slope = |k: usize| shape.distance(add(p, axis(k))) - shape.distance(sub(p, axis(k)));
            let gradient: [f64; 3] = std::array::from_fn(|k| slope(k) / (2.0 * STEP));
            // At an edge the distance has no gradient: central differences give a shorter one.
            if (length(gradient) - 1.0).abs() < 1e-6 {
                let off = length(sub(gradient, shape.normal(p)));
                assert!(off < 1e-3, "{shape:?}: {gradient:?} is not {:?}", shape.normal(p));
                checked += 1;
            }
        }
        assert!(checked > 10, "{shape:?}: only {checked} points");
    }
}

#[test]
fn placed_solids_keep_distances_and_crossings() {
    let shape = Shape::Frustum { bottom: 0.3, top: 0.1, half_height: 0.4 };
    let solid = Solid::at(shape, [0.2, -0.4, 0.3], Material::matte([0.5; 3])).facing([0.3, -0.5, 0.8]);
    for i in 0..500 {
        let origin = scale(on_unit_sphere(spread(i, 0), spread(i, 1)), 3.0);
        let direction = sub(solid.centre, origin);
        let t = solid.first_crossing(origin, direction, 0.0).expect("rays at the centre hit");
        let p = along(origin, direction, t);
        assert!(solid.distance(p).abs() < 1e-12);
        assert!(length(sub(solid.global(solid.local(p)), p)) < 1e-12);
        assert!(dot(solid.normal(p), direction) <= 0.0);
    }
}

fn config(kind: DataKind, width: u32) -> DataConfig {
    DataConfig { kind, width, ..DataConfig::default() }
}

/// A camera straight above the bare board: the depth is its height less the board's.
#[test]
fn depth_is_exact_on_a_known_pixel() {
    let stage = blender_stage(None);
    let (x, y) = (0.25, -0.1);
    let pose = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, 4.0]];
    let camera = Camera { width: 9, height: 9, focal: [400.0; 2], centre: [4.0; 2], pose };
    let picture = stage.render(&camera, crate::settings::PixelOrigin::Corner);
    assert_eq!(picture.depth[4 * 9 + 4], 4.72);
    // Away from the axis it is still the depth along the axis, not along the ray.
    assert_eq!(picture.depth[2 * 9 + 7], 4.72);
}

fn load(config: &DataConfig) -> Result<Scene> {
    crate::load(config, 0, &())
}

#[test]
fn a_blender_scene_has_what_training_needs() {
    let scene = load(&config(DataKind::BuiltinBlender, 32)).unwrap();
    assert_eq!((scene.train.len(), scene.test.len(), scene.path.len()), (40, 8, 40));
    assert_eq!((scene.near, scene.far, scene.ndc, scene.background), (2.0, 6.0, None, Some([1.0; 3])));
    for view in scene.train.iter().chain(&scene.test) {
        assert_eq!((view.image.width, view.image.height, view.image.channels), (32, 32, 3));
        assert_eq!(view.image.pixels.len(), 32 * 32 * 3);
        assert!(view.image.pixels.iter().all(|v| (0.0..=1.0).contains(v)));
        let depth = view.depth.as_ref().unwrap();
        assert!(depth.iter().all(|&d| d == f32::INFINITY || (2.0..6.0).contains(&d)));
        let share = depth.iter().filter(|d| d.is_finite()).count() as f64 / depth.len() as f64;
        assert!((0.15..0.8).contains(&share), "{}: {share} covered", view.name);
    }
}

#[test]
fn everything_lies_within_the_scenes_box() {
    let stage = blender_stage(None);
    let mesh = Mesh::of(&stage);
    assert!(mesh.vertices.iter().flatten().all(|v| v.abs() <= 1.2));
}

#[test]
fn a_forward_scene_fills_every_pixel_beyond_the_near_plane() {
    let scene = load(&config(DataKind::BuiltinForward, 40)).unwrap();
    assert_eq!((scene.near, scene.far, scene.background), (0.0, 1.0, None));
    assert_eq!((scene.train.len(), scene.test.len(), scene.path.len()), (17, 3, 60));
    assert_eq!(scene.ndc.map(|ndc| (ndc.width, ndc.height, ndc.focal)), Some((40.0, 30.0, 42.0)));
    for view in scene.train.iter().chain(&scene.test) {
        for (i, &depth) in view.depth.as_ref().unwrap().iter().enumerate() {
            let (o, d) = view.camera.ray((i % 40) as f64, (i / 40) as f64);
            assert!(depth.is_finite() && d[2] < 0.0);
            assert!(o[2] + f64::from(depth) * d[2] < -1.0, "{}: depth {depth}", view.name);
        }
    }
    let stage = forward_stage(None);
    for camera in scene.path.iter().chain(scene.train.iter().map(|view| &view.camera)) {
        let picture = stage.render(camera, crate::settings::PixelOrigin::Corner);
        assert!(picture.image.pixels.iter().skip(3).step_by(4).all(|&alpha| alpha == 1.0));
    }
}

#[test]
fn settings_are_honoured() {
    let base = config(DataKind::BuiltinBlender, 24);
    let black = load(&DataConfig { background: crate::settings::Background::Black, ..base.clone() }).unwrap();
    assert_eq!(black.background, Some([0.0; 3]));
    assert_eq!(black.test[0].image.pixels[..3], [0.0; 3]);
    let few = DataConfig { test_skip: 3, near: Some(2.5), far: Some(5.5), ..base.clone() };
    let few = crate::load(&few, 0, &()).unwrap();
    assert_eq!((few.test.len(), few.near, few.far), (3, 2.5, 5.5));
    assert_eq!(few.test[1].name, "r_3");
    let val = load(&DataConfig { eval_split: EvalSplit::Val, ..base.clone() }).unwrap();
    assert_eq!(val.test.len(), 4);
    let centre = crate::settings::PixelOrigin::Centre;
    let centred = load(&DataConfig { pixel_origin: Some(centre), ..base.clone() }).unwrap();
    assert_ne!(centred.train[0].image, val.train[0].image);
    let small = load(&DataConfig { width: 0, downscale: Some(4), ..base.clone() }).unwrap();
    assert_eq!(small.train[0].camera.width, 25);
    let bounded = load(&DataConfig { ndc: false, ..config(DataKind::BuiltinForward, 16) }).unwrap();
    assert!(bounded.ndc.is_none() && bounded.near > 0.5 && bounded.far < 6.0);
}

#[test]
fn settings_that_make_no_scene_are_refused_in_words() {
    let cases = [
        (DataConfig { width: 10_000, ..config(DataKind::BuiltinBlender, 0) }, "data.width"),
        (DataConfig { downscale: Some(64), ..config(DataKind::BuiltinForward, 0) }, "data.downscale"),
        (DataConfig { near: Some(7.0), ..config(DataKind::BuiltinBlender, 16) }, "data.near"),
    ];
    for (config, words) in cases {
        let error = crate::load(&config, 0, &()).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let camera = views::around(Role::Test, 40)[2].1;
    let render = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| blender_stage(None).render(&camera, crate::settings::PixelOrigin::Corner))
    };
    assert_eq!(render(1), render(2));
}

#[test]
fn mesh_vertices_lie_on_the_surfaces() {
    let stage = blender_stage(None);
    let mesh = Mesh::of(&stage);
    assert_eq!(mesh.parts.len(), stage.solids().len());
    for (solid, part) in stage.solids().iter().zip(&mesh.parts) {
        for index in mesh.triangles[part.clone()].iter().flatten() {
            let vertex = mesh.vertices[*index as usize].map(f64::from);
            // Exact but for the rounding of coordinates below 2 to 32-bit floats.
            assert!(solid.distance(vertex).abs() < 2e-7, "{:?}: {vertex:?}", solid.shape);
        }
    }
}

#[test]
fn mesh_parts_are_closed_and_face_outwards() {
    let stage = blender_stage(None);
    let mesh = Mesh::of(&stage);
    for (solid, part) in stage.solids().iter().zip(&mesh.parts) {
        let mut edges = std::collections::HashMap::new();
        for triangle in &mesh.triangles[part.clone()] {
            for k in 0..3 {
                *edges.entry((triangle[k], triangle[(k + 1) % 3])).or_insert(0) += 1;
            }
            let corner = triangle.map(|i| mesh.vertices[i as usize].map(f64::from));
            let facing = cross(sub(corner[1], corner[0]), sub(corner[2], corner[0]));
            let middle = scale(add(add(corner[0], corner[1]), corner[2]), 1.0 / 3.0);
            assert!(length(facing) > 0.0, "{:?}: an empty triangle", solid.shape);
            // Off the middle along the triangle's normal one gets away from the solid.
            let step = 1e-3 * length(facing).sqrt();
            let away = solid.distance(add(middle, scale(unit(facing), step)));
            assert!(away > solid.distance(middle), "{:?} faces inwards", solid.shape);
        }
        let matched = edges.iter().all(|(&(a, b), &count)| count == 1 && edges.get(&(b, a)) == Some(&1));
        assert!(matched, "{:?} is not closed", solid.shape);
    }
}

fn read_json(path: &std::path::Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// The camera that a reader of the exported files makes.
fn camera_from_json(json: &serde_json::Value, frame: usize, width: usize) -> Camera {
    let angle = json["camera_angle_x"].as_f64().unwrap();
    let matrix = &json["frames"][frame]["transform_matrix"];
    let pose = std::array::from_fn(|i| std::array::from_fn(|j| matrix[i][j].as_f64().unwrap()));
    let focal = 0.5 * width as f64 / (0.5 * angle).tan();
    Camera { width, height: width, focal: [focal; 2], centre: [0.5 * width as f64; 2], pose }
}

#[test]
fn exported_pictures_and_poses_reproduce_the_render() {
    const WIDTH: usize = 28;
    let dir = tempfile::tempdir().unwrap();
    let exported = export(dir.path(), WIDTH, None).unwrap();
    assert_eq!((exported.pictures, exported.depths), (52, 8));
    let stage = blender_stage(None);
    for split in ["train", "val", "test"] {
        let json = read_json(&dir.path().join(format!("transforms_{split}.json")));
        for frame in 0..3 {
            let file = json["frames"][frame]["file_path"].as_str().unwrap();
            let stored = image::open(dir.path().join(format!("{file}.png"))).unwrap().into_rgba8();
            let camera = camera_from_json(&json, frame, WIDTH);
            let fresh = stage.render(&camera, crate::settings::PixelOrigin::Corner);
            let bytes: Vec<u8> = fresh.image.pixels.iter().map(|v| (255.0 * v).round() as u8).collect();
            assert_eq!(stored.as_raw(), &bytes, "{file}");
            if split == "test" {
                check_depth_files(&dir.path().join("depth"), frame, &fresh.depth);
            }
        }
    }
    check_ply(&std::fs::read(dir.path().join("mesh.ply")).unwrap(), &exported);
}

fn check_depth_files(dir: &std::path::Path, frame: usize, depth: &[f32]) {
    let npy = std::fs::read(dir.join(format!("r_{frame}.npy"))).unwrap();
    let data = &npy[npy.len() - 4 * depth.len()..];
    assert_eq!((npy.len() - data.len()) % 64, 0);
    let values: Vec<f32> = data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(values, depth);
}

fn check_ply(ply: &[u8], exported: &Exported) {
    let end = b"end_header\n";
    let body = ply.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    assert_eq!(ply.len() - body, 15 * exported.vertices + 13 * exported.triangles);
}

#[test]
fn export_leaves_folders_alone_that_hold_something() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("notes.txt"), "mine").unwrap();
    let error = export(dir.path(), 16, None).unwrap_err();
    assert_eq!(error.exit_code(), 4);
    assert!(error.to_string().contains("already holds files"), "{error}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    assert_eq!(export(&dir.path().join("new"), 2, None).unwrap_err().exit_code(), 2);
}

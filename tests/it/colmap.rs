//! COLMAP scenes and captures that go around something: models by a writer of this file's own, of the embedded scene.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use augnerf::base::rng::{Random, Stream};
use augnerf::data::formats::builtin::export;
use augnerf::data::pose::{self, Pose, Vec3};
use augnerf::data::{Camera, Photos, PointRays, Scene, View};
use augnerf::mesh::read_mesh;
use augnerf::run::load_scene;
use augnerf::settings::{Config, DataConfig, PixelOrigin};
use tempfile::TempDir;

use crate::captures::{all, load, read};
use crate::common::assert_says;
use crate::common::files::write_poses;
use crate::common::program::{Place, set};

/// What COLMAP knows of a photograph: number, world to camera, camera, file.
struct Photograph {
    id: u32,
    quaternion: [f64; 4],
    shift: Vec3,
    camera: u32,
    name: String,
}

/// Number, model's number and name, columns, rows, parameters.
type Lens = (u32, i32, &'static str, [u64; 2], Vec<f64>);

/// A model to write.
struct Model {
    cameras: Vec<Lens>,
    photographs: Vec<Photograph>,
    /// Places, and photographs that see them.
    points: Vec<(Vec3, Vec<u32>)>,
}

/// A rotation's quaternion (w, x, y, z); its rows are the camera's axes.
fn quaternion(rows: [Vec3; 3]) -> [f64; 4] {
    let [[a, b, c], [d, e, f], [g, h, i]] = rows;
    // The largest of the four, so that nothing is lost; each column of the table is w, x, y, z times four times it.
    let squares = [1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i];
    let largest = (0..4).max_by(|&p, &q| squares[p].total_cmp(&squares[q])).unwrap();
    let products = [
        [squares[0], h - f, c - g, d - b],
        [h - f, squares[1], b + d, c + g],
        [c - g, b + d, squares[2], f + h],
        [d - b, c + g, f + h, squares[3]],
    ];
    products[largest].map(|v| 0.5 * v / squares[largest].sqrt())
}

impl Photograph {
    fn new(id: u32, pose: &Pose, camera: u32, name: &str) -> Photograph {
        let axes = [pose::column(pose, 0), pose::column(pose, 1).map(|v| -v), pose::column(pose, 2).map(|v| -v)];
        let shift = axes.map(|axis| -pose::dot(axis, pose::column(pose, 3)));
        Photograph { id, quaternion: quaternion(axes), shift, camera, name: name.into() }
    }
}

impl Model {
    /// Writes the three files.
    fn write(&self, dir: &Path, as_text: bool) {
        fs::create_dir_all(dir).unwrap();
        let contents = if as_text { self.texts().map(String::into_bytes) } else { self.bytes() };
        let ending = if as_text { "txt" } else { "bin" };
        for (name, content) in ["cameras", "images", "points3D"].into_iter().zip(contents) {
            fs::write(dir.join(format!("{name}.{ending}")), content).unwrap();
        }
    }

    fn texts(&self) -> [String; 3] {
        let mut texts = ["# cameras\n", "# images, two lines each\n", "# points\n"].map(String::from);
        for (id, _, name, [width, height], values) in &self.cameras {
            let values: Vec<String> = values.iter().map(f64::to_string).collect();
            writeln!(texts[0], "{id} {name} {width} {height} {}", values.join(" ")).unwrap();
        }
        for Photograph { id, quaternion: [w, x, y, z], shift: [tx, ty, tz], camera, name } in &self.photographs {
            // Points seen: one line has some, the next has none.
            let seen = if id % 2 == 0 { "1.5 2.5 1 3.5 4 -1" } else { "" };
            writeln!(texts[1], "{id} {w} {x} {y} {z} {tx} {ty} {tz} {camera} {name}\n{seen}").unwrap();
        }
        for (id, ([x, y, z], seen)) in self.points.iter().enumerate() {
            let seen: Vec<String> = seen.iter().map(|image| format!("{image} 0")).collect();
            writeln!(texts[2], "{id} {x} {y} {z} 10 20 30 0.5 {}", seen.join(" ")).unwrap();
        }
        texts
    }

    fn bytes(&self) -> [Vec<u8>; 3] {
        let count = |count: usize| (count as u64).to_le_bytes().to_vec();
        let numbers = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let mut files = [self.cameras.len(), self.photographs.len(), self.points.len()].map(count);
        for (id, number, _, size, values) in &self.cameras {
            files[0].extend([id.to_le_bytes(), number.to_le_bytes()].concat());
            files[0].extend(size.iter().flat_map(|side| side.to_le_bytes()));
            files[0].extend(numbers(values));
        }
        for Photograph { id, quaternion, shift, camera, name } in &self.photographs {
            files[1].extend([&id.to_le_bytes()[..], &numbers(quaternion), &numbers(shift)].concat());
            files[1].extend([&camera.to_le_bytes()[..], name.as_bytes(), b"\0"].concat());
            files[1].extend([count(1), numbers(&[1.5, 2.5]), (-1i64).to_le_bytes().to_vec()].concat());
        }
        for (id, (place, seen)) in self.points.iter().enumerate() {
            files[2].extend([count(id), numbers(place), vec![10, 20, 30], numbers(&[0.5]), count(seen.len())].concat());
            files[2].extend(seen.iter().flat_map(|image| [image.to_le_bytes(), 0u32.to_le_bytes()].concat()));
        }
        files
    }
}

const WIDTH: usize = 32;

/// The embedded scene's export, its training cameras, and a COLMAP folder with their pictures but without a model.
struct Export {
    dir: TempDir,
    scene: Scene,
}

impl Export {
    fn new() -> Export {
        let dir = TempDir::new().unwrap();
        let export = dir.path().join("export");
        export::export(&export, WIDTH, None).unwrap();
        let scene = read(&export, |data| data.downscale = Some(1)).0.unwrap();
        fs::create_dir_all(dir.path().join("capture/images")).unwrap();
        for view in &scene.train {
            let file = format!("{}.png", view.name);
            fs::copy(export.join("train").join(&file), dir.path().join("capture/images").join(&file)).unwrap();
        }
        Export { dir, scene }
    }

    fn capture(&self) -> std::path::PathBuf {
        self.dir.path().join("capture")
    }

    /// The cameras of the export, with points on its surface.
    fn model(&self) -> Model {
        let camera = self.scene.train[0].camera;
        let parameters = vec![camera.focal[0], camera.focal[1], camera.centre[0], camera.centre[1]];
        let views = self.scene.train.iter().zip(7..);
        let photographs: Vec<Photograph> =
            views.map(|(view, id)| Photograph::new(id, &view.camera.pose, 3, &format!("{}.png", view.name))).collect();
        let all: Vec<u32> = photographs.iter().map(|photograph| photograph.id).collect();
        let mesh = read_mesh(&self.dir.path().join("export/mesh.ply")).unwrap();
        let points = mesh.vertices.iter().step_by(97).map(|vertex| (vertex.map(f64::from), all.clone()));
        let size = [WIDTH as u64; 2];
        Model { cameras: vec![(3, 1, "PINHOLE", size, parameters)], photographs, points: points.collect() }
    }

    fn load(&self, change: impl FnOnce(&mut DataConfig)) -> augnerf::base::Result<Scene> {
        let change = |data: &mut DataConfig| {
            data.downscale = Some(1);
            change(data);
        };
        read(&self.capture(), change).0
    }
}

fn worst(a: &Camera, b: &Camera) -> f64 {
    let numbers = |camera: &Camera| -> Vec<f64> {
        let Camera { focal, centre, pose, .. } = camera;
        focal.iter().chain(centre).chain(pose.iter().flatten()).copied().collect()
    };
    numbers(a).iter().zip(numbers(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn a_model_of_the_embedded_scene_reads_to_its_cameras() {
    let export = Export::new();
    for (folder, as_text) in [("sparse/0", false), ("sparse", true), ("colmap/sparse/0", true)] {
        export.model().write(&export.capture().join(folder), as_text);
        let scene = export.load(|config| config.recentre = false).unwrap();
        assert_eq!((scene.kind, all(&scene).count()), ("colmap", export.scene.train.len()), "{folder}");
        for view in all(&scene) {
            let own = export.scene.train.iter().find(|own| own.name == view.name).unwrap();
            assert!(worst(&view.camera, &own.camera) < 1e-9, "{folder} {}", view.name);
            assert_eq!(view.image.pixels, own.image.pixels, "{}", view.name);
        }
        // Recentred, the scene says how its units follow from the file's.
        let placed = export.load(|_| ()).unwrap();
        for view in all(&placed) {
            let own = export.scene.train.iter().find(|own| own.name == view.name).unwrap();
            let pose = placed.space.world.camera(&own.camera.pose);
            assert!(worst(&view.camera, &Camera { pose, ..own.camera }) < 1e-9, "{folder} {}", view.name);
        }
        fs::remove_dir_all(export.capture().join(folder)).unwrap();
    }
}

/// A ray to a point is that of the pixel that the point is in, and t is its depth.
#[test]
fn rays_to_points_pass_them() {
    let export = Export::new();
    export.model().write(&export.capture().join("sparse/0"), true);
    let mut scene = export.load(|_| {}).unwrap();
    for origin in [PixelOrigin::Corner, PixelOrigin::Centre] {
        let rays = PointRays::of(&scene, origin);
        assert!(rays.count() > scene.train.len());
        let (drawn, t) = rays.draw(200, &mut Random::new(1, Stream::Points, 0));
        for ((camera, x, y), t) in drawn.into_iter().zip(t) {
            let (from, along) = camera.ray(f64::from(x) + origin.shift(), f64::from(y) + origin.shift());
            let place: Vec3 = std::array::from_fn(|axis| from[axis] + f64::from(t) * along[axis]);
            let apart = |point: &[f32; 3]| pose::length(pose::sub(place, point.map(f64::from)));
            let nearest = scene.space.points.iter().map(apart).fold(f64::INFINITY, f64::min);
            // Half a pixel along each side.
            assert!(nearest <= 0.71 * f64::from(t) / camera.focal[0] + 1e-6, "{nearest} at {t}");
        }
    }
    // Views without sightings have no rays, and masked pixels neither.
    let View { name, camera, .. } = scene.train[0].clone();
    scene.space.sightings.retain(|(of, _)| *of == name);
    let of_one = PointRays::of(&scene, PixelOrigin::Centre);
    let (drawn, _) = of_one.draw(50, &mut Random::new(2, Stream::Points, 0));
    assert!(drawn.iter().all(|ray| ray.0 == camera));
    scene.train[0].mask = Some(vec![false; camera.width * camera.height].into());
    assert_eq!(PointRays::of(&scene, PixelOrigin::Centre).count(), 0);
}

#[test]
fn points_give_near_far_and_the_box() {
    let export = Export::new();
    let model = export.model();
    model.write(&export.capture().join("sparse/0"), false);
    let scene = export.load(|config| config.recentre = false).unwrap();
    let depths = all(&scene).flat_map(|view| {
        let Camera { pose, .. } = view.camera;
        let depth = move |place: Vec3| -pose::dot(pose::sub(place, pose::column(&pose, 3)), pose::column(&pose, 2));
        model.points.iter().map(move |(place, _)| depth(*place))
    });
    let depths: Vec<f64> = depths.collect();
    let ends: [fn(f64, f64) -> f64; 2] = [f64::min, f64::max];
    let [least, most] = ends.map(|pick| depths.iter().copied().reduce(pick).unwrap());
    let (near, far) = scene.bounds();
    assert!(near > 0.6 * least && near <= least && far > most && far < 1.5 * most, "{near} {far} {least} {most}");
    let [low, high] = scene.space.domain.unwrap();
    let is_fit = |axis: usize| low[axis] > -2.0 && high[axis] < 2.0 && high[axis] - low[axis] > 0.5;
    assert!((0..3).all(is_fit), "{low:?} {high:?}");
    // A scene unit of the recentred one is another: bounds and box follow.
    let placed = export.load(|_| ()).unwrap();
    let scale = placed.space.world.scale;
    assert!((placed.near / scale - scene.near).abs() < 1e-9 && (placed.far / scale - scene.far).abs() < 1e-9);
    let corner = placed.space.world.point(low);
    assert!(pose::length(pose::sub(corner, placed.space.domain.unwrap()[0])) < 1e-9);
    // Without points the cameras tell both, around the same place.
    fs::remove_file(export.capture().join("sparse/0/points3D.bin")).unwrap();
    let alone = export.load(|config| config.recentre = false).unwrap();
    let [low, high] = alone.space.domain.unwrap();
    assert!((0..3).all(|axis| low[axis] < 0.0 && 0.0 < high[axis]) && alone.near < least && alone.far > most);
    // What is set is taken.
    let set = export.load(|config| (config.near, config.far) = (Some(0.3), Some(9.0))).unwrap();
    assert_eq!(set.bounds(), (0.3, 9.0));
}

#[test]
fn distortion_is_undone() {
    let export = Export::new();
    let mut model = export.model();
    let (_, number, name, _, parameters) = &mut model.cameras[0];
    (*number, *name) = (4, "OPENCV");
    parameters.extend([0.12, -0.02, 0.001, -0.002]);
    model.write(&export.capture().join("sparse/0"), true);
    let scene = export.load(|_| ()).unwrap();
    assert!(scene.train[0].camera.focal[0] > export.scene.train[0].camera.focal[0] * 1.01);
    assert!(format!("{:?}", scene.space.notes).contains("undone in"), "{:?}", scene.space.notes);
}

#[test]
fn broken_models_are_refused_in_a_sentence() {
    let export = Export::new();
    let sparse = export.capture().join("sparse/0");
    let refused = |change: fn(&mut Model), words: &[&str]| {
        for as_text in [false, true] {
            let mut model = export.model();
            change(&mut model);
            fs::remove_dir_all(&sparse).ok();
            model.write(&sparse, as_text);
            assert_says(&export.load(|_| ()).unwrap_err().to_string(), words);
        }
    };
    let fisheye = |model: &mut Model| model.cameras[0] = (3, 5, "OPENCV_FISHEYE", [32; 2], vec![40.0; 8]);
    refused(fisheye, &["cameras", "OPENCV_FISHEYE", "undistort"]);
    refused(|model| model.cameras.push(model.cameras[0].clone()), &["cameras", "camera 3 is there twice"]);
    refused(|model| model.cameras[0].4[0] = f64::NAN, &["cameras", "finite"]);
    refused(|model| model.photographs[2].camera = 8, &["images", "camera 8"]);
    refused(|model| model.photographs[2].quaternion = [0.0; 4], &["images", "quaternion"]);
    refused(|model| model.photographs[2].name = "../r_1.png".into(), &["images", "../r_1.png"]);
    refused(|model| model.photographs[2].id = 7, &["images", "twice"]);
    refused(|model| model.points[0].0[1] = f64::INFINITY, &["points3D", "finite"]);
    refused(|model| model.photographs.clear(), &["images", "no image has a pose"]);
    refused(|model| model.cameras[0].3 = [32, 48], &["r_0.png", "32x48", "cropped or turned"]);
    let others = |model: &mut Model| model.photographs.iter_mut().for_each(|photograph| photograph.name.insert(0, 'x'));
    refused(others, &["images", "x", "none of the"]);
    // Without second lines every other image would be lost.
    fs::remove_dir_all(&sparse).unwrap();
    export.model().write(&sparse, true);
    let images = fs::read_to_string(sparse.join("images.txt")).unwrap();
    let first: Vec<&str> = images.lines().filter(|line| line.ends_with(".png")).collect();
    fs::write(sparse.join("images.txt"), first.join("\n")).unwrap();
    assert_says(&export.load(|_| ()).unwrap_err().to_string(), &["images.txt, line 2", "second line of image 7"]);
    fs::remove_dir_all(&sparse).unwrap();
    // Cut files.
    export.model().write(&sparse, false);
    let images = fs::read(sparse.join("images.bin")).unwrap();
    fs::write(sparse.join("images.bin"), &images[..images.len() - 3]).unwrap();
    assert_says(&export.load(|_| ()).unwrap_err().to_string(), &["images.bin", "ends within"]);
    // A count that no memory holds.
    fs::write(sparse.join("images.bin"), [&u64::MAX.to_le_bytes()[..], &images[8..]].concat()).unwrap();
    assert_says(&export.load(|_| ()).unwrap_err().to_string(), &["images.bin", "ends within"]);
}

/// From a folder to a mesh in the capture's units, as a user goes.
#[test]
fn a_colmap_folder_is_checked_drawn_trained_and_meshed() {
    let export = Export::new();
    export.model().write(&export.capture().join("sparse/0"), false);
    let capture = export.capture().display().to_string();
    let place = Place::new();
    let words = ["colmap", "PINHOLE", "bounds from", "depths of", "looking at", "box", "scene units", "distortion"];
    place.says(&format!("data check {capture} --picture scene.svg -q"), 0, &words);
    assert!(place.text("scene.svg").contains("<svg"));
    place.says(&format!("data check {capture} --picture scene.gif"), 2, &["--picture", ".svg"]);
    let small = "field.width=16 field.depth=2 field.skips=[] train.rays=32 train.steps=2 eval.pictures=0";
    place.run(&format!("train --data {capture} --preset smoke --out run -q{}", set(small)), 0);
    let scene = place.json("run/scene.json");
    assert!(scene["world_to_scene"]["scale"].as_f64().unwrap() > 0.0 && scene["box"].is_array(), "{scene}");
    let config: toml::Table = place.text("run/config.toml").parse().unwrap();
    assert_eq!(config["data"]["pixel_origin"].as_str(), Some("centre"));

    let vertices = |units: &str| {
        draw_mesh(&place, &format!("mesh run --resolution 8 --units {units} --cap --out {units} -q"));
        (read_mesh(&place.at(units).join("mesh.ply")).unwrap().vertices, place.json(&format!("{units}/mesh.json")))
    };
    let ((scene_units, _), (capture_units, report)) = (vertices("scene"), vertices("capture"));
    assert_eq!(report["units"], "capture");
    let matrix: Pose = serde_json::from_value(report["world_to_scene"]["matrix"].clone()).unwrap();
    assert_eq!(scene_units.len(), capture_units.len());
    for (scene, capture) in scene_units.iter().zip(&capture_units) {
        let back = pose::transform(&matrix, capture.map(f64::from));
        assert!(pose::length(pose::sub(back, scene.map(f64::from))) < 1e-5);
    }
}

/// Draws a mesh at a threshold that has a level set, which the refusal of one that has none names, and returns what is said.
pub fn draw_mesh(place: &Place, mesh: &str) -> String {
    let message = place.run(&format!("{mesh} --threshold 1e9"), 2);
    let (_, rest) = message.split_once("such as ").unwrap_or_else(|| panic!("{message}"));
    place.run(&format!("{mesh} --threshold {}", rest.split(',').next().unwrap()), 0)
}

/// `poses_bounds.npy` of twelve cameras on an arc of so many degrees around (0, 0, -3), for photographs of so many columns and rows.
pub fn arc_of(dir: &Path, degrees: f64, [columns, rows]: [f64; 2]) {
    let row = |view: usize| {
        let angle = (degrees * (view as f64 / 11.0 - 0.5)).to_radians();
        let (sin, cos) = angle.sin_cos();
        let (x, z) = (3.0 * sin, 3.0 * cos - 3.0);
        // Columns down, right, back, origin, (height, width, focal).
        [0.0, cos, sin, x, rows, -1.0, 0.0, 0.0, 0.0, columns, 0.0, -sin, cos, z, 14.0, 1.0, 60.0]
    };
    write_poses(dir, &std::array::from_fn::<_, 12, _>(row));
    fs::create_dir_all(dir.join("images")).unwrap();
    for view in 0..12 {
        image::RgbImage::from_pixel(16, 12, image::Rgb([view as u8 * 9; 3]))
            .save(dir.join(format!("images/{view:02}.png")))
            .unwrap();
    }
}

#[test]
fn a_capture_in_llff_format_that_goes_around_is_read_without_ndc() {
    let dir = TempDir::new().unwrap();
    let load = |change: fn(&mut Config)| {
        let (loaded, notes) = load(dir.path(), Photos::Read, |config| {
            config.data.downscale = Some(1);
            change(config);
        });
        (loaded, notes.concat())
    };
    arc_of(dir.path(), 120.0, [16.0, 12.0]);
    let (loaded, said) = load(|_| ());
    let (config, scene) = loaded.unwrap();
    assert_eq!((config.data.ndc, config.data.spherify, scene.ndc), (false, true, None));
    assert_says(&said, &["goes around", "60 degrees", "data.ndc=false"]);
    assert!(scene.describe().iter().any(|(label, words)| label == "orbit" && said.contains(words)));
    assert!(scene.space.domain.is_some() && scene.far / scene.near > 20.0);
    // Its configuration repeats it without a word.
    let mut again = config.clone().into_draft();
    again.data.dir = dir.path().display().to_string();
    assert!(load_scene(again, &()).unwrap().1.ndc.is_none());
    let (kept, said) = load(|config| config.data.recognise_orbits = false);
    assert!(kept.map(|(_, scene)| scene.ndc.is_some()).unwrap_or(true) && said.is_empty());
    // Samples even in disparity are for bounds in scene units.
    let (near, _) = load(|config| config.sampling.spacing = augnerf::settings::Spacing::Disparity);
    near.unwrap();
    // One that faces forward stays in NDC.
    arc_of(dir.path(), 20.0, [16.0, 12.0]);
    let (loaded, said) = load(|_| ());
    assert!(loaded.unwrap().1.ndc.is_some() && said.is_empty(), "{said}");
    let (refused, _) = load(|config| config.sampling.spacing = augnerf::settings::Spacing::Disparity);
    assert_says(&refused.unwrap_err().to_string(), &["sampling.spacing", "data.ndc"]);
}

//! The method against the authors' numbers, closed forms and finite differences.

use std::sync::Arc;

use candle_core::{Device, Tensor};

use crate::base::Image;
use crate::data::{Camera, Scene, View};
use crate::settings::{Config, DataKind, Method, Resolved};

use super::geometry::Viewpoint;
use super::mpi::{Mpi, Mpis, SourceView};

mod learning;
mod pictures;
mod reference;

/// A camera at (x, y, 0) that looks along -z; `focal` pixels, the middle of the picture in the middle between pixels.
fn camera([x, y]: [f64; 2], width: usize, height: usize, focal: f64) -> Camera {
    let centre = [0.5 * width as f64, 0.5 * height as f64];
    let pose = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, 0.0]];
    Camera { width, height, focal: [focal; 2], centre, pose }
}

/// The same with pixels counted from the middle of the first, as most scenes have them.
fn eye(place: [f64; 2], width: usize, height: usize, focal: f64) -> Viewpoint {
    Viewpoint { camera: camera(place, width, height, focal), shift: 0.5 }
}

/// A smooth texture, between 0 and 1, in units of its plane.
fn texture(x: f64, y: f64, channel: usize) -> f64 {
    0.5 + 0.25 * (3.1 * x + channel as f64).sin() + 0.25 * (2.3 * y - 0.7 * channel as f64 + x).cos()
}

/// What a camera sees of the textured plane z = -depth.
fn picture(eye: &Viewpoint, depth: f64) -> Image {
    let Camera { width, height, .. } = eye.camera;
    let pixel = |i: usize| {
        let (origin, direction) = eye.ray([(i % width) as f64, (i / width) as f64]);
        let at = |axis: usize| origin[axis] + depth * direction[axis];
        (0..3).map(|c| texture(at(0), at(1), c) as f32).collect::<Vec<f32>>()
    };
    Image { width, height, channels: 3, pixels: (0..width * height).flat_map(pixel).collect() }
}

/// Five cameras in front of the textured plane at depth 2; the last one is held out.
fn scene(side: usize) -> Scene {
    let view = |index: usize| {
        let place = [[0.0, 0.0], [0.2, 0.05], [-0.15, 0.1], [0.05, -0.2], [0.1, 0.1]][index];
        let eye = eye(place, side, side, 1.2 * side as f64);
        let image = Arc::new(picture(&eye, 2.0));
        View::new(format!("view{index}"), eye.camera, image)
    };
    Scene {
        name: "wall".into(),
        kind: "transforms",
        train: (0..4).map(view).collect(),
        test: vec![view(4)],
        near: 1.0,
        far: 4.0,
        ndc: None,
        background: None,
        path: vec![],
        corrupted: None,
        lacks_split: false,
        space: Default::default(),
    }
}

/// Settings for such a scene.
fn config(scene: &Scene, change: impl FnOnce(&mut Config)) -> Resolved {
    let mut config = Config { method: Method::Llff, ..Config::default() };
    config.data.ndc = false;
    config.llff.planes = 8;
    config.llff.inputs = 3;
    config.llff.window = 16;
    config.llff.crop = 8;
    config.llff.near = Some(1.0);
    config.llff.far = Some(4.0);
    change(&mut config);
    config.resolve(DataKind::Transforms, scene.extent()).unwrap()
}

/// Planes that no network made.
fn made(all: Vec<Mpi>, depths: Vec<f64>) -> Arc<Mpis> {
    let image = Arc::new(Image { width: 0, height: 0, channels: 3, pixels: vec![] });
    let views: Vec<SourceView> = all.iter().map(|mpi| SourceView { eye: mpi.eye, image: image.clone() }).collect();
    let mpis = Mpis::new(&views, &depths, Box::new(|_, _, _| unreachable!("all are there")));
    all.into_iter().enumerate().for_each(|(view, mpi)| mpis.keep(view, mpi));
    Arc::new(mpis)
}

fn f64s(values: Vec<f64>, shape: &[usize]) -> Tensor {
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

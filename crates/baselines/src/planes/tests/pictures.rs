//! Closed forms: a textured wall from its own camera and between cameras, backgrounds, sides.

use candle_core::{DType, Device, Tensor};

use crate::base::Image;
use crate::data::{RayBuffer, RayParts};
use crate::grids::reference::values;
use crate::methods::{RenderedRays, Renderer};
use crate::planes::PlanesRenderer;
use crate::planes::geometry::{Viewpoint, depths};
use crate::planes::mpi::Mpi;
use crate::planes::sweep::{Window, padded};
use crate::settings::PixelOrigin;

use super::{eye, f64s, made, picture};

/// Planes that are empty but for one, which has a picture.
fn wall(image: &Image, planes: usize, opaque: usize) -> Tensor {
    let size = image.width * image.height;
    let mut values = vec![0.0; planes * size * 4];
    for (i, pixel) in image.pixels.chunks(3).enumerate() {
        let at = 4 * (opaque * size + i);
        (0..3).for_each(|c| values[at + c] = f64::from(pixel[c]));
        values[at + 3] = 1.0;
    }
    f64s(values, &[planes, image.height, image.width, 4])
}

/// Depths of four planes: 4, 2, 4/3, 1.
fn four() -> Vec<f64> {
    depths(1.0, 4.0, 4)
}

/// Three views in a row whose planes are a wall at depth 2.
fn renderer(background: Option<[f32; 3]>) -> PlanesRenderer {
    let eyes: Vec<Viewpoint> = [0.0, 0.2, 1.0].map(|x| eye([x, 0.0], 16, 8, 20.0)).to_vec();
    // Whole numbers of 8 bits, a little above, so that cutting off keeps them.
    let bits = |mut image: Image| {
        image.pixels.iter_mut().for_each(|value| *value = ((*value * 255.0).round() + 0.25).min(255.0) / 255.0);
        image
    };
    let mpi = |eye: &Viewpoint| Mpi::new(*eye, &wall(&bits(picture(eye, 2.0)), 4, 1)).unwrap();
    let mpis = made(eyes.iter().map(mpi).collect(), four());
    PlanesRenderer { mpis, eyes, blend: 1, background }
}

fn render(renderer: &PlanesRenderer, eye: &Viewpoint) -> RenderedRays {
    let (width, height) = (eye.camera.width as u32, eye.camera.height as u32);
    let pixels: Vec<_> = (0..height).flat_map(|y| (0..width).map(move |x| (&eye.camera, x, y))).collect();
    let rays = RayBuffer::new(&pixels, None, PixelOrigin::Centre, RayParts::default());
    renderer.render(&rays.to_tensors(DType::F32, &Device::Cpu).unwrap()).unwrap()
}

#[test]
fn at_its_own_camera_a_view_is_its_picture() {
    let renderer = renderer(None);
    for eye in &renderer.eyes {
        let rendered = render(&renderer, eye);
        let expected = picture(eye, 2.0).pixels;
        for (found, expected) in values(&rendered.rgb).iter().zip(expected) {
            assert!((found - f64::from(expected)).abs() < 0.5 / 255.0 + 1e-4);
        }
        assert!(values(&rendered.acc).iter().all(|acc| (acc - 1.0).abs() < 1e-4));
        assert!(values(&rendered.depth).iter().all(|depth| (depth - 2.0).abs() < 1e-3));
    }
}

/// Where no planes are, the scene's background is seen, and nothing has a depth.
#[test]
fn beside_all_planes_the_background_is_seen() {
    let renderer = renderer(Some([0.1, 0.6, 0.3]));
    let mut away = eye([0.0, 0.0], 16, 8, 20.0);
    // Turned around.
    (away.camera.pose[0][0], away.camera.pose[2][2]) = (-1.0, -1.0);
    let rendered = render(&renderer, &away);
    assert!(values(&rendered.rgb).chunks(3).all(|p| (p[0] - 0.1).abs() < 1e-6 && (p[1] - 0.6).abs() < 1e-6));
    assert!(values(&rendered.acc).iter().chain(&values(&rendered.depth)).all(|value| *value == 0.0));
}

#[test]
fn sides_are_filled_up_to_multiples_of_eight() {
    assert_eq!([1, 8, 9, 378, 504].map(padded), [8, 8, 16, 384, 504]);
    let window = Window::whole(5, 9);
    assert_eq!((window.width, window.height), (8, 16));
    assert!(window.holds([0.0, 15.0]) && !window.holds([7.5, 0.0]) && !window.holds([f64::NAN, 0.0]));
    // What is beyond the view is cut off again.
    let own = eye([0.0, 0.0], 5, 9, 20.0);
    let rgba = f64s((0..8 * 16 * 8 * 4).map(|i| ((i / 4 % 8) as f64 + 0.5) / 255.0).collect(), &[8, 16, 8, 4]);
    let mpi = Mpi::new(own, &rgba).unwrap();
    assert_eq!(mpi.planes.len(), 8 * 9 * 5 * 4);
    assert!(mpi.planes.iter().enumerate().all(|(i, value)| usize::from(*value) == i / 4 % 5));
}

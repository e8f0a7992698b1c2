//! What the page shows of a rendered view.

use std::borrow::Cow;

use crate::base::{Image, Result};
use crate::data::{Camera, Ndc, Scene};
use crate::draw::{SOLID, depth_colour};
use crate::run::RenderedView;
use crate::settings::PixelOrigin;

/// A picture of a rendered view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// Colour over the scene's background.
    Colour,
    /// Depth: near is bright.
    Depth,
    /// Accumulated weight: 1 is white.
    Accumulation,
    /// Normals of the surface at the rendered depth: x, y and z as red, green and blue.
    Normals,
}

impl Layer {
    /// All layers, in the page's order.
    pub const ALL: [Layer; 4] = [Layer::Colour, Layer::Depth, Layer::Accumulation, Layer::Normals];

    /// Returns its name in addresses.
    pub fn name(self) -> &'static str {
        match self {
            Layer::Colour => "colour",
            Layer::Depth => "depth",
            Layer::Accumulation => "accumulation",
            Layer::Normals => "normals",
        }
    }
}

/// Draws one layer of a view that `camera` saw, whose rays go through the pixels at `origin`. `depths` is the range of the
/// colours of depth.
///
/// # Errors
/// If the view has another size than the camera.
pub fn draw_layer<'a>(
    layer: Layer,
    view: &'a RenderedView,
    camera: &Camera,
    (scene, origin): (&Scene, PixelOrigin),
    depths: (f32, f32),
) -> Result<Cow<'a, Image>> {
    let (width, height) = (view.image.width, view.image.height);
    let drawn = match layer {
        Layer::Colour => return Ok(Cow::Borrowed(&view.image)),
        Layer::Depth => depth_colour(&view.depth, width, height, depths.0, depths.1, Some(&view.acc))?,
        Layer::Accumulation => {
            let pixels = view.acc.iter().flat_map(|&acc| [acc.clamp(0.0, 1.0); 3]).collect();
            Image { width, height, channels: 3, pixels }
        }
        Layer::Normals => normals(view, camera, scene.ndc.as_ref(), origin),
    };
    Ok(Cow::Owned(drawn))
}

/// Draws the normals of the surface through the rendered depths, towards the camera, by differences between neighbours. Grey
/// where less than half of the light is stopped.
fn normals(view: &RenderedView, camera: &Camera, ndc: Option<&Ndc>, pixel: PixelOrigin) -> Image {
    let (width, height) = (view.image.width, view.image.height);
    let point = |x: usize, y: usize| -> Option<[f64; 3]> {
        let at = y * width + x;
        let depth = f64::from(view.depth[at]);
        let (origin, direction) = camera.ray(x as f64 + pixel.shift(), y as f64 + pixel.shift());
        let t = if ndc.is_some() { Ndc::world_t(origin, direction, depth) } else { depth };
        (view.acc[at] >= SOLID && t.is_finite()).then(|| std::array::from_fn(|axis| origin[axis] + t * direction[axis]))
    };
    // The difference across a pixel to both neighbours, or to the one that exists.
    let across = |before: Option<[f64; 3]>, here: [f64; 3], after: Option<[f64; 3]>| -> Option<[f64; 3]> {
        let (from, to) = (before.unwrap_or(here), after.unwrap_or(here));
        (before.is_some() || after.is_some()).then(|| std::array::from_fn(|axis| to[axis] - from[axis]))
    };
    let normal = |x: usize, y: usize| -> Option<[f32; 3]> {
        let here = point(x, y)?;
        let left = x.checked_sub(1).and_then(|x| point(x, y));
        let right = (x + 1 < width).then(|| point(x + 1, y)).flatten();
        let above = y.checked_sub(1).and_then(|y| point(x, y));
        let below = (y + 1 < height).then(|| point(x, y + 1)).flatten();
        let (a, b) = (across(left, here, right)?, across(below, here, above)?);
        let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let length = cross.iter().map(|value| value * value).sum::<f64>().sqrt();
        (length > 0.0).then(|| cross.map(|value| (0.5 + 0.5 * value / length) as f32))
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let pixels = pixels.flat_map(|(x, y)| normal(x, y).unwrap_or([0.5; 3])).collect();
    Image { width, height, channels: 3, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall across the view, and one that falls away to the right by 45 degrees.
    #[test]
    fn normals_of_walls() {
        let (width, height) = (8, 6);
        let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let camera = Camera { width, height, focal: [10.0, 10.0], centre: [4.0, 3.0], pose };
        let image = Image { width, height, channels: 3, pixels: vec![0.0; 3 * width * height] };
        let view = |depth: &dyn Fn(f64) -> f64| {
            let depths = (0..width * height).map(|i| depth((i % width) as f64 + 0.5 - 4.0) as f32).collect();
            RenderedView { image: image.clone(), depth: depths, acc: vec![1.0; width * height] }
        };
        let flat = normals(&view(&|_| 3.0), &camera, None, PixelOrigin::Centre);
        // The plane z = -3 - x: at pixel x the ray (x / 10, ., -1) t is in it where t = 3 + t x / 10.
        let slanted = normals(&view(&|x| 3.0 / (1.0 - x / 10.0)), &camera, None, PixelOrigin::Centre);
        let close = |image: &Image, expected: [f64; 3]| {
            let expected = expected.map(|value| 0.5 + 0.5 * value);
            for pixel in image.pixels.chunks(3) {
                assert!(pixel.iter().zip(expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-4), "{pixel:?}");
            }
        };
        close(&flat, [0.0, 0.0, 1.0]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        close(&slanted, [half, 0.0, half]);
        let thin = RenderedView { acc: vec![0.1; width * height], ..view(&|_| 3.0) };
        assert!(normals(&thin, &camera, None, PixelOrigin::Centre).pixels.iter().all(|&value| value == 0.5));
    }
}

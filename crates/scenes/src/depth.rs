//! The depth maps of NeRF-Synthetic's test views: `r_7_depth_0000.png` next to `r_7.png`.
//!
//! The data do not document them. They are RGBA of 8 bits, with all four channels equal, and 0 where nothing is hit.
//! The meaning of the values was found on the chair. Points of 11 test views were put into space with t = far - slope *
//! value / 255. They must be on the surface that the other views' maps show, never in front of it, and on each view's
//! silhouette. `slope` and `far` were varied, with t along the ray or along the viewing axis. Agreement has one peak,
//! at t along the *ray* (of unit length) with slope 8.00 and far 8.014 +- 0.006. There 0.5 % of the points are in front
//! of what another view sees, and 0.03 % outside of its silhouette. Along the axis these are 13 % and 4 %. (The test,
//! with other views and tolerances, finds 0.1 % and 0.06 %.) That is
//!
//! ```text
//! value = 255 - floor(255 t / 8),   so   t = 8 (255.5 - value) / 255 +- 0.016
//! ```
//!
//! a distance over 8 scene units, cut to 8 bits and inverted. `tests/it/geometry.rs` holds the agreement between views.
//! Other scenes of the set are assumed to be alike. A map that is not (other channels, distances outside of the scene's
//! bounds) is not read as depth.

use std::path::{Path, PathBuf};

use image::DynamicImage;

use super::{Camera, images};
use augnerf_base::Result;

/// Distance of the 255 steps of a map, in scene units.
const SPAN: f64 = 8.0;
/// Pixels whose parts differ by more than this show two surfaces.
const SPREAD: f64 = 4.0 * SPAN / 255.0;

/// Returns the depth map of an image file, if it has one: `NAME_depth_0000.png` next to `NAME.png`, with any one
/// number.
pub fn file_of(image: &Path) -> Option<PathBuf> {
    let stem = image.file_stem()?.to_string_lossy();
    let start = format!("{stem}_depth_");
    let is_map = |name: &str| {
        let number = name.strip_prefix(&start).and_then(|rest| rest.strip_suffix(".png"));
        number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let first = image.with_file_name(format!("{start}0000.png"));
    if first.is_file() {
        return Some(first);
    }
    let entries = std::fs::read_dir(image.parent()?).ok()?;
    let found = entries.filter_map(|entry| Some(entry.ok()?.path()));
    found.filter(|path| path.file_name().is_some_and(|name| is_map(&name.to_string_lossy()))).min()
}

/// Reads depth along the viewing axis at the camera's resolution, row-major, in scene units. It is infinite where
/// nothing is hit, and NaN where it is not known. A pixel is the mean over its part of the map, if all of that shows
/// one surface, within 4 of the map's steps. Returns `None` for other maps: with channels that differ, distances
/// outside of `bounds`, or a size that the camera's does not divide.
pub fn read(path: &Path, camera: &Camera, bounds: [f64; 2]) -> Result<Option<Vec<f32>>> {
    let DynamicImage::ImageRgba8(map) = images::decode(path)? else { return Ok(None) };
    let (width, height) = (map.width() as usize, map.height() as usize);
    let distance = |value: u8| SPAN * (255.5 - f64::from(value)) / 255.0;
    let alike = map.pixels().all(|pixel| {
        let [value, others @ ..] = pixel.0;
        others == [value; 3] && (value == 0 || (bounds[0]..bounds[1]).contains(&distance(value)))
    });
    if !alike || width % camera.width != 0 || height % camera.height != 0 {
        return Ok(None);
    }
    // The camera at the map's own resolution, and the ray through the middle of each pixel.
    let scale = [width as f64 / camera.width as f64, height as f64 / camera.height as f64];
    let whole = Camera {
        focal: std::array::from_fn(|i| camera.focal[i] * scale[i]),
        centre: std::array::from_fn(|i| camera.centre[i] * scale[i]),
        ..*camera
    };
    let depth: Vec<f64> = map
        .enumerate_pixels()
        .map(|(x, y, pixel)| {
            if pixel.0[0] == 0 {
                return f64::INFINITY;
            }
            let (_, direction) = whole.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            // Directions have unit depth.
            distance(pixel.0[0]) / super::vector::length(direction)
        })
        .collect();
    Ok(Some(reduce(&depth, (width, height), (camera.width, camera.height))))
}

/// Reduces depth to fewer pixels, whose sizes divide. A pixel is the mean over a block that shows only one surface. It
/// is infinite for a block that shows none, and NaN for other blocks, also for surfaces more than 4 steps apart.
fn reduce(depth: &[f64], from: (usize, usize), to: (usize, usize)) -> Vec<f32> {
    let (columns, rows) = (from.0 / to.0, from.1 / to.1);
    let block = |x: usize, y: usize| {
        (0..rows).flat_map(move |dy| (0..columns).map(move |dx| depth[(y * rows + dy) * from.0 + x * columns + dx]))
    };
    let one = |x: usize, y: usize| {
        let (nearest, farthest) =
            block(x, y).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), depth| (a.min(depth), b.max(depth)));
        match farthest - nearest {
            _ if nearest == f64::INFINITY => f32::INFINITY,
            spread if spread <= SPREAD => (block(x, y).sum::<f64>() / (columns * rows) as f64) as f32,
            _ => f32::NAN,
        }
    };
    (0..to.1).flat_map(|y| (0..to.0).map(move |x| one(x, y))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Camera = Camera {
        width: 2,
        height: 1,
        focal: [20.0; 2],
        centre: [1.0, 0.5],
        pose: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    };

    fn map(values: [u8; 8]) -> DynamicImage {
        let pixels = values.iter().flat_map(|&value| [value; 4]).collect();
        DynamicImage::ImageRgba8(image::RgbaImage::from_raw(4, 2, pixels).unwrap())
    }

    fn read_map(map: &DynamicImage) -> Option<Vec<f32>> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r_0_depth_0003.png");
        map.save(&path).unwrap();
        assert_eq!(file_of(&dir.path().join("r_0.png")), Some(path.clone()));
        assert_eq!(file_of(&dir.path().join("r_1.png")), None);
        read(&path, &CAMERA, [2.0, 6.0]).unwrap()
    }

    #[test]
    fn values_are_distances_along_the_ray() {
        let found = read_map(&map([128, 128, 0, 0, 128, 128, 0, 0])).unwrap();
        // A block of four pixels, a focal length of 40 pixels: offsets of -1.5 and -0.5, and +-0.5 pixels.
        let along = |x: f64, y: f64| 8.0 * 127.5 / 255.0 / (1.0 + (x / 40.0).powi(2) + (y / 40.0).powi(2)).sqrt();
        assert!((f64::from(found[0]) - 0.5 * (along(1.5, 0.5) + along(0.5, 0.5))).abs() < 1e-6, "{found:?}");
        assert_eq!(found[1], f32::INFINITY);
    }

    #[test]
    fn mixed_pixels_are_not_known() {
        let found = read_map(&map([128, 0, 128, 120, 128, 128, 128, 128])).unwrap();
        assert!(found.iter().all(|depth| depth.is_nan()), "{found:?}");
    }

    #[test]
    fn maps_of_another_kind_are_not_read() {
        assert_eq!(read_map(&map([250; 8])), None, "nearer than any surface");
        assert_eq!(read_map(&DynamicImage::ImageRgb8(map([128; 8]).to_rgb8())), None);
        let mut tinted = map([128; 8]).to_rgba8();
        tinted.get_pixel_mut(0, 0).0[1] = 7;
        assert_eq!(read_map(&DynamicImage::ImageRgba8(tinted)), None);
    }
}

//! Images: 8-bit PNGs, depth as colours and as 16-bit PNGs, and images side by side.

use std::path::Path;
use std::sync::OnceLock;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::codecs::png::PngEncoder;
use ::image::{ExtendedColorType, ImageEncoder};

use crate::base::files::write_atomic;
use crate::base::{Error, Image, Result};

/// Number of colours of the depth map.
const COLOURS: usize = 256;
/// Colour of the gaps of [`beside`], and background of transparent pixels there and in GIFs.
const PAPER: f32 = 1.0;
/// Colour of a depth map where nothing was hit: a grey unlike any colour of the map.
const NOTHING: [f32; 3] = [0.5, 0.5, 0.5];
/// Fraction of depths that [`depth_range`] ignores at each end.
const OUTLIERS: f64 = 0.02;
/// Least accumulation of a pixel whose depth counts in [`depth_range`].
pub const SOLID: f32 = 0.5;

/// Returns the nearest 8-bit value of each number, clamped to 0..=1 first. Metrics round the same way, so they measure
/// what is visible.
pub fn quantise(pixels: &[f32]) -> Vec<u8> {
    pixels.iter().map(|&value| (value.clamp(0.0, 1.0) * 255.0).round() as u8).collect()
}

/// Returns, for each pixel, the root mean square difference over channels of the 8-bit values, as a fraction of white.
pub fn pixel_errors(rendered: &Image, truth: &Image) -> Vec<f32> {
    let (a, b) = (quantise(&rendered.pixels), quantise(&truth.pixels));
    let error = |(a, b): (&[u8], &[u8])| {
        let sum: u32 = a.iter().zip(b).map(|(&a, &b)| u32::from(a.abs_diff(b)).pow(2)).sum();
        (sum as f32 / a.len() as f32).sqrt() / 255.0
    };
    a.chunks_exact(3).zip(b.chunks_exact(3)).map(error).collect()
}

/// Draws diagonal stripes over the masked pixels of an RGB image, alternately grey and the darkened image. `mask` says
/// which pixels count, row by row.
pub fn stripe(picture: &mut Image, mask: &[bool]) {
    /// Pixels across two stripes.
    const PERIOD: usize = 8;
    let width = picture.width;
    for (at, texel) in picture.pixels.chunks_exact_mut(3).enumerate().filter(|(at, _)| !mask[*at]) {
        let bright = (at % width + at / width) % PERIOD < PERIOD / 2;
        texel.iter_mut().for_each(|value| *value = if bright { 0.6 } else { 0.4 * *value });
    }
}

/// Writes an RGB or RGBA image as PNG, 8 bits a channel, atomically.
pub fn write_png8(path: &Path, picture: &Image) -> Result<()> {
    let png = encode_png8(picture).map_err(|reason| unwritable(path, &reason))?;
    write_atomic(path, &png)
}

/// Encodes an image as an 8-bit PNG.
pub fn encode_png8(picture: &Image) -> std::result::Result<Vec<u8>, String> {
    check(picture)?;
    let colours = if picture.channels == 4 { ExtendedColorType::Rgba8 } else { ExtendedColorType::Rgb8 };
    encode_png(&quantise(&picture.pixels), picture.width, picture.height, colours)
}

/// Encodes an image as JPEG of a quality from 1 to 100; transparent pixels are on white.
pub fn encode_jpeg(picture: &Image, quality: u8) -> Result<Vec<u8>> {
    let failed = |reason: String| Error::Output(format!("cannot encode an image: {reason}"));
    check(picture).map_err(failed)?;
    let size = |length: usize| u32::try_from(length).map_err(|_| failed(format!("{length} pixels are too many")));
    let (width, height) = (size(picture.width)?, size(picture.height)?);
    let mut jpeg = Vec::new();
    let encoded = JpegEncoder::new_with_quality(&mut jpeg, quality).write_image(
        &quantise(&on_paper(picture)),
        width,
        height,
        ExtendedColorType::Rgb8,
    );
    encoded.map_err(|e| failed(e.to_string()))?;
    Ok(jpeg)
}

/// Writes depth as a 16-bit greyscale PNG: `depth = value / 65535 * max`. The value 0 means that there is no depth
/// (not finite, or not positive). Depths beyond `max` are stored as `max`. Readers need `max`, so it belongs in the
/// JSON next to the image.
pub fn write_depth16(path: &Path, depth: &[f32], width: usize, height: usize, max: f32) -> Result<()> {
    if !(max.is_finite() && max > 0.0) {
        return Err(unwritable(path, &format!("the greatest depth is {max}; it must be positive")));
    }
    check_size(depth.len(), width, height, 1).map_err(|reason| unwritable(path, &reason))?;
    // The image crate takes 16-bit values in the CPU's byte order.
    let bytes: Vec<u8> = depth.iter().flat_map(|&value| depth_to_u16(value, max).to_ne_bytes()).collect();
    let png = encode_png(&bytes, width, height, ExtendedColorType::L16).map_err(|reason| unwritable(path, &reason))?;
    write_atomic(path, &png)
}

fn depth_to_u16(depth: f32, max: f32) -> u16 {
    if !(depth.is_finite() && depth > 0.0) {
        return 0;
    }
    (depth as f64 / max as f64 * 65535.0).round().clamp(1.0, 65535.0) as u16
}

/// Returns the range that shows `depth` well: its 2nd and 98th percentile over the pixels with finite depth and, if
/// given, an accumulation of at least one half. `None` if no pixel is left.
pub fn depth_range(depth: &[f32], acc: Option<&[f32]>) -> Option<(f32, f32)> {
    depth_range_of(&[(depth, acc)])
}

/// Returns the same over all pixels of several views, each with depth and accumulation.
pub fn depth_range_of(views: &[(&[f32], Option<&[f32]>)]) -> Option<(f32, f32)> {
    let mut kept: Vec<f32> = Vec::new();
    for (depth, acc) in views {
        let solid = |index: usize| acc.is_none_or(|acc| acc.get(index).is_some_and(|&acc| acc >= SOLID));
        let numbered = depth.iter().enumerate();
        kept.extend(numbered.filter(|(index, depth)| depth.is_finite() && solid(*index)).map(|(_, &depth)| depth));
    }
    kept.sort_unstable_by(f32::total_cmp);
    let last = kept.len().checked_sub(1)?;
    let at = |share: f64| kept[(share * last as f64).round() as usize];
    Some((at(OUTLIERS), at(1.0 - OUTLIERS)))
}

/// Draws depth as colours: `near` and closer bright yellow, `far` and farther dark violet, linearly in between. Pixels
/// without finite depth are grey, and `acc` (accumulation, 0..=1) fades towards that grey. Take `near` and `far` from
/// the scene or from [`depth_range`]; use one pair for all frames of a video.
pub fn depth_colour(
    depth: &[f32],
    width: usize,
    height: usize,
    near: f32,
    far: f32,
    acc: Option<&[f32]>,
) -> Result<Image> {
    let sized = check_size(depth.len(), width, height, 1);
    sized
        .and_then(|()| acc.map_or(Ok(()), |acc| check_size(acc.len(), width, height, 1)))
        .map_err(|reason| Error::Output(format!("cannot draw a depth map: {reason}")))?;
    let span = (far - near).max(f32::MIN_POSITIVE);
    let mut pixels = Vec::with_capacity(depth.len() * 3);
    for (index, &depth) in depth.iter().enumerate() {
        let seen = if depth.is_finite() { acc.map_or(1.0, |acc| acc[index].clamp(0.0, 1.0)) } else { 0.0 };
        let colour = scale_colour(1.0 - (depth - near) / span);
        pixels.extend((0..3).map(|c| NOTHING[c] + seen * (colour[c] - NOTHING[c])));
    }
    Ok(Image { width, height, channels: 3, pixels })
}

/// Returns the depth map's colour of a number: dark violet for 0 and less, bright yellow for 1 and more.
pub fn scale_colour(share: f32) -> [f32; 3] {
    colour_map()[(share.clamp(0.0, 1.0) * (COLOURS - 1) as f32).round() as usize]
}

/// Puts images side by side from left to right, aligned at the top, with `gap` white pixels between them. Transparent
/// pixels are on white.
pub fn beside(pictures: &[&Image], gap: usize) -> Result<Image> {
    for picture in pictures {
        check(picture).map_err(|reason| Error::Output(format!("cannot put images side by side: {reason}")))?;
    }
    let gaps = gap * pictures.len().saturating_sub(1);
    let width = pictures.iter().map(|picture| picture.width).sum::<usize>() + gaps;
    let height = pictures.iter().map(|picture| picture.height).max().unwrap_or(0);
    let mut pixels = vec![PAPER; width * height * 3];
    let mut left = 0;
    for picture in pictures {
        let opaque = on_paper(picture);
        for y in 0..picture.height {
            let (to, from) = ((y * width + left) * 3, y * picture.width * 3);
            pixels[to..to + picture.width * 3].copy_from_slice(&opaque[from..from + picture.width * 3]);
        }
        left += picture.width + gap;
    }
    Ok(Image { width, height, channels: 3, pixels })
}

/// Returns the RGB values of an image, with transparent pixels on white.
pub(super) fn on_paper(picture: &Image) -> Vec<f32> {
    if picture.channels == 3 {
        return picture.pixels.clone();
    }
    let blend = |pixel: &[f32], c: usize| PAPER + pixel[3] * (pixel[c] - PAPER);
    picture.pixels.chunks_exact(4).flat_map(|pixel| [0, 1, 2].map(|c| blend(pixel, c))).collect()
}

fn encode_png(
    bytes: &[u8],
    width: usize,
    height: usize,
    colours: ExtendedColorType,
) -> std::result::Result<Vec<u8>, String> {
    let size = |length: usize| u32::try_from(length).map_err(|_| format!("{length} pixels are too many for a PNG"));
    let (width, height) = (size(width)?, size(height)?);
    let mut png = Vec::new();
    PngEncoder::new(&mut png).write_image(bytes, width, height, colours).map_err(|error| error.to_string())?;
    Ok(png)
}

pub(super) fn check(picture: &Image) -> std::result::Result<(), String> {
    if picture.channels != 3 && picture.channels != 4 {
        return Err(format!("an image has {} channels; it must have 3 or 4", picture.channels));
    }
    check_size(picture.pixels.len(), picture.width, picture.height, picture.channels)
}

fn check_size(found: usize, width: usize, height: usize, channels: usize) -> std::result::Result<(), String> {
    let expected = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(channels));
    if found == 0 || expected != Some(found) {
        return Err(format!("{width}x{height} pixels with {channels} values each do not have {found} values"));
    }
    Ok(())
}

pub(super) fn unwritable(path: &Path, reason: &str) -> Error {
    Error::Output(format!("cannot write {}: {reason}", path.display()))
}

/// Returns the depth map's colours, sRGB, dark to bright. They were made for this program in the OKLab space (Ottosson
/// 2020, "A perceptual color space for image processing"). Lightness rises by equal steps, so that equal differences
/// of depth look equal and survive a greyscale print. The hue goes from violet over red to yellow. Chroma is as large
/// as the screen's colours allow, up to a bound.
fn colour_map() -> &'static [[f32; 3]; COLOURS] {
    static MAP: OnceLock<[[f32; 3]; COLOURS]> = OnceLock::new();
    MAP.get_or_init(|| std::array::from_fn(|index| map_colour(index as f64 / (COLOURS - 1) as f64)))
}

fn map_colour(t: f64) -> [f32; 3] {
    let lightness = 0.22 + 0.72 * t;
    let hue = (285.0 + 185.0 * t).to_radians();
    let (mut inside, mut outside) = (0.0, 0.19);
    // The largest chroma below the bound that a screen can show, by bisection.
    for _ in 0..30 {
        let middle = 0.5 * (inside + outside);
        let rgb = linear_from_oklab(lightness, middle * hue.cos(), middle * hue.sin());
        let shown = rgb.iter().all(|value| (0.0..=1.0).contains(value));
        if shown { inside = middle } else { outside = middle }
    }
    linear_from_oklab(lightness, inside * hue.cos(), inside * hue.sin()).map(|value| srgb_from_linear(value) as f32)
}

/// Converts an OKLab colour to linear RGB, with Ottosson's matrices.
fn linear_from_oklab(lightness: f64, a: f64, b: f64) -> [f64; 3] {
    let long = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let medium = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let short = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    [
        4.076_741_662_1 * long - 3.307_711_591_3 * medium + 0.230_969_929_2 * short,
        -1.268_438_004_6 * long + 2.609_757_401_1 * medium - 0.341_319_396_5 * short,
        -0.004_196_086_3 * long - 0.703_418_614_7 * medium + 1.707_614_701_0 * short,
    ]
}

fn srgb_from_linear(value: f64) -> f64 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(width: usize, height: usize, colour: [f32; 3]) -> Image {
        Image { width, height, channels: 3, pixels: colour.repeat(width * height) }
    }

    #[test]
    fn eight_bits_are_the_nearest_and_clamped() {
        assert_eq!(
            quantise(&[-1.0, 0.0, 0.499 / 255.0, 0.501 / 255.0, 0.5, 1.0, 9.0, f32::NAN]),
            [0, 0, 0, 1, 128, 255, 255, 0]
        );
    }

    #[test]
    fn the_colour_map_rises_in_luminance_all_the_way() {
        let luminance = |rgb: &[f32; 3]| 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
        let map = colour_map();
        assert!(map.windows(2).all(|pair| luminance(&pair[0]) < luminance(&pair[1]) + 2e-3));
        assert!(luminance(&map[COLOURS - 1]) > luminance(&map[0]) + 0.6);
        assert!(map.as_flattened().iter().all(|value| (0.0..=1.0).contains(value)));
    }

    #[test]
    fn the_range_ignores_outliers_gaps_and_empty_pixels() {
        let mut depth: Vec<f32> = (0..1000).map(|i| 2.0 + i as f32 / 1000.0).collect();
        depth.extend([f32::INFINITY, f32::NAN, -900.0, 900.0]);
        let (near, far) = depth_range(&depth, None).unwrap();
        assert!((2.0..2.05).contains(&near) && (2.95..3.0).contains(&far), "{near} {far}");
        assert_eq!(depth_range(&depth, Some(&vec![0.0; depth.len()])), None);
        assert_eq!(depth_range(&[], None), None);
        assert_eq!(depth_range(&[4.0], None), Some((4.0, 4.0)));
    }

    #[test]
    fn depth_colours_go_from_bright_to_dark_and_grey_where_nothing_is() {
        let picture =
            depth_colour(&[2.0, 6.0, 99.0, f32::INFINITY, 2.0], 5, 1, 2.0, 6.0, Some(&[1.0, 1.0, 1.0, 1.0, 0.0]));
        let (near, far) = (colour_map()[255], colour_map()[0]);
        let expected = [near, far, far, NOTHING, NOTHING];
        assert_eq!(quantise(&picture.unwrap().pixels), quantise(expected.as_flattened()));
        assert!(depth_colour(&[1.0], 1, 1, 3.0, 3.0, None).unwrap().pixels.iter().all(|value| value.is_finite()));
        assert!(depth_colour(&[1.0], 2, 1, 0.0, 1.0, None).is_err());
        assert!(depth_colour(&[1.0], 1, 1, 0.0, 1.0, Some(&[])).is_err());
    }

    #[test]
    fn sixteen_bits_keep_absence_apart() {
        let values: Vec<u16> =
            [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e-9, 2.0, 4.0, 5.0].map(|d| depth_to_u16(d, 4.0)).into();
        assert_eq!(values, [0, 0, 0, 0, 1, 32768, 65535, 65535]);
    }

    #[test]
    fn pictures_beside_one_another_keep_their_place() {
        let (red, blue) = (plain(2, 2, [1.0, 0.0, 0.0]), plain(1, 1, [0.0, 0.0, 1.0]));
        let joined = beside(&[&red, &blue], 1).unwrap();
        assert_eq!((joined.width, joined.height), (4, 2));
        let at = |x: usize, y: usize| &joined.pixels[(y * 4 + x) * 3..][..3];
        assert_eq!(
            (at(1, 1), at(2, 0), at(3, 0), at(3, 1)),
            (&[1.0, 0.0, 0.0][..], &[1.0; 3][..], &[0.0, 0.0, 1.0][..], &[1.0; 3][..])
        );
        let clear = Image { width: 1, height: 1, channels: 4, pixels: vec![0.0; 4] };
        assert_eq!(beside(&[&clear], 3).unwrap().pixels, [1.0; 3]);
    }

    #[test]
    fn bad_frames_are_errors() {
        assert!(encode_png8(&Image { width: 2, ..plain(1, 1, [0.0; 3]) }).is_err());
    }
}

use candle_core::{DType, Device};

use super::*;
use crate::grids::reference::{error, ramp, values};

/// Locations of some rays: between pixels, on them, in the pixel beyond an edge, outside, nowhere.
fn places(planes: usize) -> Locations {
    let some =
        [[0.3, 1.6], [2.0, 1.0], [-0.4, 2.7], [3.7, -0.2], [5.0, 1.0], [f64::NAN, 0.0], [3.0, 2.0], [-1.0, -1.0]];
    let of_rays = (0..8 * planes).map(|i| some[(i * 3 + i / 8) % 8]).collect();
    Locations { planes, of_rays }
}

/// A tent around every pixel, as the interpolation is defined.
fn slow(planes: &Tensor, places: &Locations) -> Tensor {
    let (count, height, width, channels) = planes.dims4().unwrap();
    let all = values(planes);
    let tent = |a: f64, b: usize| (1.0 - (a - b as f64).abs()).max(0.0);
    let mut out = Vec::new();
    for (i, [x, y]) in places.of_rays.iter().enumerate() {
        for c in 0..channels {
            let at = |row: usize, column: usize| all[((i % count * height + row) * width + column) * channels + c];
            let sum = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
            let sum: f64 = sum.map(|(row, column)| tent(*x, column) * tent(*y, row) * at(row, column)).sum();
            out.push(if x.is_nan() { 0.0 } else { sum });
        }
    }
    Tensor::from_vec(out, (places.rays(), count, channels), &Device::Cpu).unwrap()
}

#[test]
fn values_are_tents_around_pixels_and_fade_beyond_the_edge() {
    let (planes, places) = (ramp(&[3, 3, 4, 2], 0.4), places(3));
    let expected = slow(&planes, &places);
    assert!(error(&plane_sample(&planes, &places).unwrap(), &expected) < 1e-14);
    let fast = plane_sample(&planes.to_dtype(DType::F32).unwrap(), &places).unwrap();
    assert!(error(&fast, &expected) < 1e-6);
}

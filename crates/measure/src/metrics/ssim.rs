//! Structural similarity (Wang et al. 2004) with the settings of its reference implementation.

use rayon::prelude::*;

use super::check_same_shape;
use augnerf_base::{Image, Result};

/// Columns and rows of the window.
pub(super) const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
/// `(K * range)^2` for K 0.01 and 0.03 and a range of 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Windowed means of a, b, a^2, b^2 and ab.
type Moments = [f64; 5];

/// Mean SSIM of two images in 0..=1 of one shape: an 11x11 Gaussian window of sigma 1.5,
/// K 0.01 and 0.03, population covariance, the mean over the positions where the window lies
/// within the image and over channels. `None` where a side is below 11 pixels.
///
/// Sums run in `f64`, because the variances are differences of nearly equal moments.
pub fn ssim(a: &Image, b: &Image) -> Result<Option<f64>> {
    check_same_shape(a, b)?;
    if a.width < WINDOW || a.height < WINDOW {
        return Ok(None);
    }
    let taps = gaussian();
    let sum: f64 = (0..a.channels).map(|channel| channel_ssim(a, b, channel, &taps)).sum();
    Ok(Some(sum / a.channels as f64))
}

/// The mean over those positions, row by row, that `counted` holds; none where it holds none.
pub(super) fn ssim_where(a: &Image, b: &Image, counted: &[bool]) -> Result<Option<f64>> {
    check_same_shape(a, b)?;
    let count = counted.iter().filter(|counts| **counts).count();
    if count == 0 {
        return Ok(None);
    }
    let taps = gaussian();
    let sum: f64 = (0..a.channels).map(|channel| window_sum(a, b, channel, &taps, |place| counted[place])).sum();
    Ok(Some(sum / (a.channels * count) as f64))
}

fn gaussian() -> [f64; WINDOW] {
    let centre = (WINDOW / 2) as f64;
    let taps: [f64; WINDOW] = std::array::from_fn(|i| (-0.5 * ((i as f64 - centre) / SIGMA).powi(2)).exp());
    let sum: f64 = taps.iter().sum();
    taps.map(|tap| tap / sum)
}

fn channel_ssim(a: &Image, b: &Image, channel: usize, taps: &[f64; WINDOW]) -> f64 {
    let windows = (a.width + 1 - WINDOW) * (a.height + 1 - WINDOW);
    window_sum(a, b, channel, taps, |_| true) / windows as f64
}

/// The sum over the windows at places, row by row, that `counts` holds of.
fn window_sum(
    a: &Image,
    b: &Image,
    channel: usize,
    taps: &[f64; WINDOW],
    counts: impl Fn(usize) -> bool + Sync,
) -> f64 {
    let (out_width, out_height) = (a.width + 1 - WINDOW, a.height + 1 - WINDOW);
    let across = filter_across(a, b, channel, taps); // [height, out_width]
    let row_sum = |y: usize| -> f64 {
        let at = |x: usize| similarity(filter_down(&across[y * out_width + x..], out_width, taps));
        (0..out_width).filter(|x| counts(y * out_width + x)).map(at).sum()
    };
    // Collected before summing, so that the result does not depend on the number of threads.
    let rows: Vec<f64> = (0..out_height).into_par_iter().map(row_sum).collect();
    rows.iter().sum()
}

fn filter_across(a: &Image, b: &Image, channel: usize, taps: &[f64; WINDOW]) -> Vec<Moments> {
    let out_width = a.width + 1 - WINDOW;
    let mut out = vec![[0.0; 5]; a.height * out_width];
    out.par_chunks_mut(out_width).enumerate().for_each(|(y, row)| {
        for (x, moments) in row.iter_mut().enumerate() {
            for (k, tap) in taps.iter().enumerate() {
                let i = (y * a.width + x + k) * a.channels + channel;
                let (p, q) = (f64::from(a.pixels[i]), f64::from(b.pixels[i]));
                add_scaled(moments, *tap, &[p, q, p * p, q * q, p * q]);
            }
        }
    });
    out
}

fn filter_down(column: &[Moments], stride: usize, taps: &[f64; WINDOW]) -> Moments {
    let mut moments = [0.0; 5];
    for (k, tap) in taps.iter().enumerate() {
        add_scaled(&mut moments, *tap, &column[k * stride]);
    }
    moments
}

fn add_scaled(sum: &mut Moments, scale: f64, values: &Moments) {
    for (s, v) in sum.iter_mut().zip(values) {
        *s += scale * v;
    }
}

fn similarity([a, b, aa, bb, ab]: Moments) -> f64 {
    let (var_a, var_b, cov) = (aa - a * a, bb - b * b, ab - a * b);
    (2.0 * a * b + C1) * (2.0 * cov + C2) / ((a * a + b * b + C1) * (var_a + var_b + C2))
}

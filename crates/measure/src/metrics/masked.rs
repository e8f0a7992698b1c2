//! Metrics of the pixels that a mask leaves; without a mask, of all.

use super::{check_same_shape, ssim as windowed};
use augnerf_base::{Image, Result};

/// Mean squared error over the pixels that count and their channels; none where none counts.
pub(super) fn mse(a: &Image, b: &Image, mask: Option<&[bool]>) -> Result<Option<f64>> {
    let Some(mask) = mask else { return super::mse(a, b).map(Some) };
    check_same_shape(a, b)?;
    let texels = a.pixels.chunks_exact(a.channels).zip(b.pixels.chunks_exact(b.channels));
    let (mut sum, mut count) = (0.0, 0);
    for (texels, _) in texels.zip(mask).filter(|(_, counts)| **counts) {
        sum += super::squared_error(texels);
        count += a.channels;
    }
    Ok((count > 0).then(|| sum / count as f64))
}

/// Mean SSIM over the windows all of whose pixels count; none where there is no such window.
pub(super) fn ssim(a: &Image, b: &Image, mask: Option<&[bool]>) -> Result<Option<f64>> {
    match mask {
        None => windowed::ssim(a, b),
        Some(mask) => windowed::ssim_where(a, b, &windows(mask, a.width, a.height)),
    }
}

/// For each window's place, row by row, whether all of its pixels count.
fn windows(mask: &[bool], width: usize, height: usize) -> Vec<bool> {
    const SIDE: usize = windowed::WINDOW;
    if width < SIDE || height < SIDE {
        return Vec::new();
    }
    // Masked pixels of the rectangle from the first corner to each place.
    let mut sums = vec![0u32; (width + 1) * (height + 1)];
    for y in 0..height {
        for x in 0..width {
            let here = u32::from(!mask[y * width + x]);
            let at = |x: usize, y: usize| y * (width + 1) + x;
            sums[at(x + 1, y + 1)] = here + sums[at(x, y + 1)] + sums[at(x + 1, y)] - sums[at(x, y)];
        }
    }
    let at = |x: usize, y: usize| sums[y * (width + 1) + x];
    let whole = |x: usize, y: usize| at(x + SIDE, y + SIDE) + at(x, y) == at(x + SIDE, y) + at(x, y + SIDE);
    (0..=height - SIDE).flat_map(|y| (0..=width - SIDE).map(move |x| (x, y))).map(|(x, y)| whole(x, y)).collect()
}

/// The rendered picture with the photograph where it is masked.
pub fn unmasked_or(rendered: Image, truth: &Image, mask: Option<&[bool]>) -> Image {
    let Some(mask) = mask else { return rendered };
    let mut filled = rendered;
    let channels = filled.channels;
    let texels = filled.pixels.chunks_exact_mut(channels).zip(truth.pixels.chunks_exact(channels));
    for ((texel, truth), _) in texels.zip(mask).filter(|(_, counts)| !**counts) {
        texel.copy_from_slice(truth);
    }
    filled
}

/// Share of the pixels that count.
pub fn share(mask: Option<&[bool]>) -> f64 {
    mask.map_or(1.0, |mask| mask.iter().filter(|counts| **counts).count() as f64 / mask.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::{MSE, Metric, PSNR, PSNR_FLOAT, SSIM, measure, measure_unmasked};

    fn noise(seed: usize) -> Image {
        let value = |i: usize| ((i * 7919 + seed * 104_729) % 1009) as f32 / 1009.0;
        Image { width: 24, height: 20, channels: 3, pixels: (0..24 * 20 * 3).map(value).collect() }
    }

    /// The first `columns` of an image.
    fn left(image: &Image, columns: usize) -> Image {
        let rows = image.pixels.chunks_exact(image.width * 3);
        Image { width: columns, pixels: rows.flat_map(|row| row[..3 * columns].to_vec()).collect(), ..*image }
    }

    /// A mask that leaves a rectangle measures what lies in it, as if the image were cut, whatever lies beside it.
    #[test]
    fn a_mask_measures_as_a_cut_does() {
        let (a, b) = (noise(1), noise(2));
        let mask: Vec<bool> = (0..24 * 20).map(|pixel| pixel % 24 < 14).collect();
        let masked = measure_unmasked("view", &a, &b, Some(&mask), &[]).unwrap();
        let cut = measure("view", &left(&a, 14), &left(&b, 14), &[]).unwrap();
        for metric in [&PSNR as &Metric, &PSNR_FLOAT, &MSE, &SSIM] {
            let (masked, cut) = (masked.get(metric).unwrap(), cut.get(metric).unwrap());
            assert!((masked - cut).abs() < 1e-9 * cut.abs(), "{}: {masked} {cut}", metric.key);
        }
        let mut other = a.clone();
        other
            .pixels
            .chunks_exact_mut(3)
            .zip(&mask)
            .filter(|(_, counts)| !**counts)
            .for_each(|(texel, _)| texel.fill(0.5));
        assert_eq!(measure_unmasked("view", &other, &b, Some(&mask), &[]).unwrap(), masked);
        assert_eq!(unmasked_or(a.clone(), &b, Some(&mask)), unmasked_or(other, &b, Some(&mask)));
    }

    #[test]
    fn a_mask_that_leaves_all_changes_nothing_and_one_that_leaves_nothing_measures_nothing() {
        let (a, b) = (noise(1), noise(2));
        let all = measure_unmasked("view", &a, &b, Some(&[true; 480]), &[]).unwrap();
        let plain = measure("view", &a, &b, &[]).unwrap();
        for metric in [&PSNR, &SSIM] {
            assert!((all.get(metric).unwrap() - plain.get(metric).unwrap()).abs() < 1e-12);
        }
        let nothing = measure_unmasked("view", &a, &b, Some(&[false; 480]), &[]).unwrap();
        assert_eq!((nothing.get(&PSNR), nothing.get(&MSE), nothing.get(&SSIM)), (None, None, None));
        assert!(measure_unmasked("view", &a, &b, Some(&[true; 7]), &[]).is_err());
        assert_eq!(share(Some(&[true, false, false, true])), 0.5);
    }
}

//! Resizing of images, and their background.

use augnerf_base::Image;

/// The coverage of each source sample by one output sample, along one axis.
struct Span {
    first: usize,
    weights: Vec<f64>,
}

/// Returns the spans of a box filter from `from` samples to `to`. The weights of a span sum to 1.
fn spans(from: usize, to: usize) -> Vec<Span> {
    let scale = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            // Integer products: exact edges if `to` divides `from`.
            let (start, end) = ((i * from) as f64 / to as f64, ((i + 1) * from) as f64 / to as f64);
            let first = start.floor() as usize;
            let last = (end.ceil() as usize).clamp(first + 1, from);
            let cover = |j: usize| (end.min((j + 1) as f64) - start.max(j as f64)).max(0.0) / scale;
            Span { first, weights: (first..last).map(cover).collect() }
        })
        .collect()
}

/// Averages `samples` (row-major, `channels` interleaved, full scale `white`) over the area of each of `to` (width x
/// height) pixels. Partly covered samples count by their covered fraction.
pub(super) fn average<T: Copy + Into<f32>>(
    samples: &[T],
    from: (usize, usize),
    channels: usize,
    white: f32,
    to: (usize, usize),
) -> Image {
    let value = |v: T| -> f32 { v.into() / white };
    if from == to {
        let pixels = samples.iter().map(|&v| value(v)).collect();
        return Image { width: to.0, height: to.1, channels, pixels };
    }
    let (columns, rows) = (spans(from.0, to.0), spans(from.1, to.1));
    let mut pixels = Vec::with_capacity(to.0 * to.1 * channels);
    let mut sums = vec![0.0f64; to.0 * channels];
    for row in &rows {
        sums.fill(0.0);
        for (dy, &wy) in row.weights.iter().enumerate() {
            let line = &samples[(row.first + dy) * from.0 * channels..][..from.0 * channels];
            for (column, sum) in columns.iter().zip(sums.chunks_exact_mut(channels)) {
                for (texel, &wx) in line[column.first * channels..].chunks_exact(channels).zip(&column.weights) {
                    for (sum, &v) in sum.iter_mut().zip(texel) {
                        *sum += wx * wy * f64::from(v.into());
                    }
                }
            }
        }
        pixels.extend(sums.iter().map(|&s| (s / f64::from(white)) as f32));
    }
    Image { width: to.0, height: to.1, channels, pixels }
}

/// Reduces by area averaging to `width` x `height`, both at least 1 and at most the image's own. RGBA is averaged as
/// stored (straight alpha), as in the original NeRF.
pub fn shrink(image: &Image, width: usize, height: usize) -> Image {
    average(&image.pixels, (image.width, image.height), image.channels, 1.0, (width, height))
}

/// Composites an RGBA image over a background, `rgb * a + background * (1 - a)`. RGB is returned unchanged. The flag
/// says whether anything was transparent.
pub fn composite(image: Image, background: [f32; 3]) -> (Image, bool) {
    if image.channels != 4 {
        return (image, false);
    }
    let mut clear = false;
    let mut pixels = Vec::with_capacity(image.width * image.height * 3);
    for texel in image.pixels.chunks_exact(4) {
        let alpha = texel[3];
        clear |= alpha < 1.0;
        pixels.extend((0..3).map(|c| texel[c] * alpha + background[c] * (1.0 - alpha)));
    }
    (Image { channels: 3, pixels, ..image }, clear)
}

/// Writes the bilinear value of every channel at continuous coordinates (the centre of pixel (0, 0) is (0.5, 0.5)).
/// Coordinates outside take the nearest edge.
pub fn bilinear(image: &Image, x: f64, y: f64, out: &mut [f32]) {
    let cell = |at: f64, size: usize| {
        let at = (at - 0.5).clamp(0.0, (size - 1) as f64);
        let low = at as usize;
        (low, (low + 1).min(size - 1), (at - low as f64) as f32)
    };
    let ((x0, x1, fx), (y0, y1, fy)) = (cell(x, image.width), cell(y, image.height));
    let channels = out.len();
    let texel = |x: usize, y: usize| &image.pixels[(y * image.width + x) * channels..][..channels];
    let (tops, bottoms) = (texel(x0, y0).iter().zip(texel(x1, y0)), texel(x0, y1).iter().zip(texel(x1, y1)));
    for (((a, b), (c, d)), out) in tops.zip(bottoms).zip(out.iter_mut()) {
        let (top, bottom) = (a * (1.0 - fx) + b * fx, c * (1.0 - fx) + d * fx);
        *out = top * (1.0 - fy) + bottom * fy;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Image {
        let pixels = (0..width * height).map(|i| (i % width) as f32 + 10.0 * (i / width) as f32).collect();
        Image { width, height, channels: 1, pixels }
    }

    #[test]
    fn integer_factors_average_blocks() {
        assert_eq!(shrink(&ramp(4, 2), 2, 1).pixels, [5.5, 7.5]);
        assert_eq!(shrink(&ramp(4, 2), 4, 2), ramp(4, 2));
    }

    #[test]
    fn fractional_coverage_counts_by_its_share() {
        // 3 -> 2: each output covers 1.5 samples.
        let found = shrink(&ramp(3, 1), 2, 1).pixels;
        let expected = [(0.0 + 0.5 * 1.0) / 1.5, (0.5 * 1.0 + 2.0) / 1.5];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
    }

    #[test]
    fn the_mean_is_kept_at_any_size() {
        let image = ramp(17, 13);
        let mean = |image: &Image| image.pixels.iter().map(|&v| f64::from(v)).sum::<f64>() / image.pixels.len() as f64;
        for (width, height) in [(1, 1), (5, 13), (16, 7), (2, 3)] {
            assert!((mean(&shrink(&image, width, height)) - mean(&image)).abs() < 1e-5, "{width}x{height}");
        }
    }

    #[test]
    fn straight_alpha_goes_over_the_background() {
        let image = Image { width: 2, height: 1, channels: 4, pixels: vec![0.5, 0.0, 1.0, 0.25, 0.1, 0.2, 0.3, 1.0] };
        let (image, clear) = composite(image, [1.0; 3]);
        assert_eq!(image.pixels, [0.875, 0.75, 1.0, 0.1, 0.2, 0.3]);
        assert!(clear);
    }

    #[test]
    fn bilinear_is_exact_on_a_ramp() {
        let mut out = [0.0; 2];
        bilinear(&ramp(4, 4), 1.75, 2.25, &mut out[..1]);
        bilinear(&ramp(4, 4), -9.0, 9.0, &mut out[1..]);
        assert_eq!(out, [1.25 + 17.5, 30.0]);
    }
}

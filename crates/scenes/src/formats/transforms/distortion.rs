//! OpenCV's lens distortion, and its removal from images.

use rayon::prelude::*;

use crate::resample;
use augnerf_base::Image;

/// Newton steps of the inverse. It converges in a handful if the model is invertible.
const STEPS: usize = 50;
/// Tolerance of the inverse, in focal lengths.
const TOLERANCE: f64 = 1e-9;
/// The largest zoom that is tried to keep undefined pixels out of the image.
const LARGEST_ZOOM: f64 = 4.0;

/// Radial (k1 to k6) and tangential (p1, p2) coefficients, on coordinates of focal length 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// Radial coefficients of r^2, r^4 and r^6.
    pub radial: [f64; 3],
    /// Tangential coefficients p1 and p2.
    pub tangential: [f64; 2],
    /// Radial coefficients k4 to k6 of the divisor: 1, then those of r^2, r^4 and r^6.
    pub rational: [f64; 3],
}

/// Focal lengths and principal point in pixels, x and y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal lengths.
    pub focal: [f64; 2],
    /// Principal point; pixel (0, 0) covers 0..1.
    pub centre: [f64; 2],
}

impl Distortion {
    /// Returns whether there is no distortion.
    pub fn is_none(&self) -> bool {
        *self == Distortion::default()
    }

    /// Returns the image point of the pinhole camera's point (`x`, `y`).
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [p1, p2] = self.tangential;
        let r2 = x * x + y * y;
        let (radial, _) = self.radial(r2);
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
        ]
    }

    /// Returns the radial factor at a squared radius, and its derivative.
    fn radial(&self, r2: f64) -> (f64, f64) {
        let of = |[a, b, c]: [f64; 3]| (1.0 + r2 * (a + r2 * (b + r2 * c)), a + r2 * (2.0 * b + r2 * 3.0 * c));
        let ((above, above_slope), (below, below_slope)) = (of(self.radial), of(self.rational));
        (above / below, (above_slope * below - above * below_slope) / (below * below))
    }

    /// Returns the pinhole camera's point whose image is `seen`. `None` if there is none, or more than one between it
    /// and the axis (the model folds over).
    pub fn undistort(&self, seen: [f64; 2]) -> Option<[f64; 2]> {
        let mut point = seen;
        for _ in 0..STEPS {
            let found = self.distort(point);
            let miss = [found[0] - seen[0], found[1] - seen[1]];
            let [[a, b], [c, d]] = self.jacobian(point);
            let determinant = a * d - b * c;
            if !(determinant > 0.0 && determinant.is_finite()) {
                return None;
            }
            point[0] -= (d * miss[0] - b * miss[1]) / determinant;
            point[1] -= (a * miss[1] - c * miss[0]) / determinant;
        }
        let found = self.distort(point);
        let error = (found[0] - seen[0]).hypot(found[1] - seen[1]);
        (error < TOLERANCE && self.is_one_to_one(point)).then_some(point)
    }

    /// Returns whether the model does not fold over between the axis and `point`.
    fn is_one_to_one(&self, point: [f64; 2]) -> bool {
        const PROBES: usize = 32;
        (0..=PROBES).all(|i| {
            let share = i as f64 / PROBES as f64;
            let [[a, b], [c, d]] = self.jacobian(point.map(|v| v * share));
            a * d - b * c > 0.0
        })
    }

    fn jacobian(&self, [x, y]: [f64; 2]) -> [[f64; 2]; 2] {
        let [p1, p2] = self.tangential;
        let (radial, slope) = self.radial(x * x + y * y);
        let slope = 2.0 * slope;
        let mixed = slope * x * y + 2.0 * (p1 * x + p2 * y);
        [
            [radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, mixed],
            [mixed, radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y],
        ]
    }
}

/// Returns the pinhole camera to which a distorted image of `size` is resampled. It has the same principal point, and
/// the least increase of focal lengths that keeps every pixel inside the photo. `None` if the model is not invertible
/// over the image.
pub fn pinhole(lens: Intrinsics, distortion: &Distortion, size: (usize, usize)) -> Option<Intrinsics> {
    let border = border(size);
    let normal = |p: &[f64; 2]| [(p[0] - lens.centre[0]) / lens.focal[0], (p[1] - lens.centre[1]) / lens.focal[1]];
    for point in &border {
        distortion.undistort(normal(point))?;
    }
    let zoomed = |zoom: f64| Intrinsics { focal: lens.focal.map(|f| f * zoom), ..lens };
    let fits = |zoom: f64| {
        border.iter().all(|&point| {
            let source = source_of(zoomed(zoom), lens, distortion, point);
            let inside = |v: f64, size: usize| v >= -1e-6 && v <= size as f64 + 1e-6;
            inside(source[0], size.0) && inside(source[1], size.1)
        })
    };
    if fits(1.0) {
        return Some(lens);
    }
    let (mut low, mut high) = (1.0, LARGEST_ZOOM);
    if !fits(high) {
        return None;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if fits(middle) { high = middle } else { low = middle }
    }
    Some(zoomed(high))
}

/// Resamples a photo onto the `pinhole` camera, bilinearly.
pub fn rectify(image: &Image, lens: Intrinsics, distortion: &Distortion, pinhole: Intrinsics) -> Image {
    let mut pixels = vec![0.0; image.pixels.len()];
    pixels.par_chunks_mut(image.width * image.channels).enumerate().for_each(|(y, row)| {
        for (x, texel) in row.chunks_exact_mut(image.channels).enumerate() {
            let [u, v] = source_of(pinhole, lens, distortion, [x as f64 + 0.5, y as f64 + 0.5]);
            resample::bilinear(image, u, v, texel);
        }
    });
    Image { pixels, ..*image }
}

/// Returns the position in the photo of the pinhole camera's `pixel`.
fn source_of(pinhole: Intrinsics, lens: Intrinsics, distortion: &Distortion, pixel: [f64; 2]) -> [f64; 2] {
    let point = std::array::from_fn(|i| (pixel[i] - pinhole.centre[i]) / pinhole.focal[i]);
    let seen = distortion.distort(point);
    std::array::from_fn(|i| seen[i] * lens.focal[i] + lens.centre[i])
}

/// Returns points along the four edges of an image.
fn border((width, height): (usize, usize)) -> Vec<[f64; 2]> {
    const POINTS: usize = 32;
    let (w, h) = (width as f64, height as f64);
    let shares = (0..=POINTS).map(|i| i as f64 / POINTS as f64);
    shares.flat_map(|s| [[s * w, 0.0], [s * w, h], [0.0, s * h], [w, s * h]]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Intrinsics = Intrinsics { focal: [80.0, 82.0], centre: [50.5, 39.0] };

    #[test]
    fn distortion_round_trips_over_the_image() {
        for k1 in [-0.2, 0.0, 0.15] {
            let rational = if k1 > 0.0 { [0.02, -0.01, 0.003] } else { [0.0; 3] };
            let distortion = Distortion { radial: [k1, 0.03, -0.004], tangential: [0.002, -0.003], rational };
            for i in 0..21 {
                for j in 0..21 {
                    let point = [f64::from(i - 10) * 0.06, f64::from(j - 10) * 0.05];
                    let back = distortion.undistort(distortion.distort(point)).unwrap();
                    assert!((back[0] - point[0]).abs() < 1e-9 && (back[1] - point[1]).abs() < 1e-9, "{point:?}");
                }
            }
        }
    }

    #[test]
    fn a_model_that_folds_over_is_refused() {
        let distortion = Distortion { radial: [-2.0, 0.0, 0.0], ..Distortion::default() };
        assert_eq!(pinhole(LENS, &distortion, (100, 80)), None);
    }

    #[test]
    fn the_pinhole_camera_sees_only_what_was_photographed() {
        for k1 in [-0.1, 0.1] {
            let distortion = Distortion { radial: [k1, 0.0, 0.0], tangential: [0.001, 0.0], ..Distortion::default() };
            let camera = pinhole(LENS, &distortion, (100, 80)).unwrap();
            for point in border((100, 80)) {
                let [x, y] = source_of(camera, LENS, &distortion, point);
                assert!((-1e-5..=100.00001).contains(&x) && (-1e-5..=80.00001).contains(&y), "{k1}: {x} {y}");
            }
        }
    }

    /// A photograph whose value is the pinhole coordinate itself must come out as a linear ramp.
    #[test]
    fn rectified_images_obey_the_pinhole_camera() {
        let distortion =
            Distortion { radial: [0.08, -0.01, 0.0], tangential: [0.002, -0.001], ..Distortion::default() };
        let (width, height) = (100, 80);
        let value = |i: usize| {
            let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let seen = [(x - LENS.centre[0]) / LENS.focal[0], (y - LENS.centre[1]) / LENS.focal[1]];
            distortion.undistort(seen).unwrap()[0] as f32
        };
        let image = Image { width, height, channels: 1, pixels: (0..width * height).map(value).collect() };
        let camera = pinhole(LENS, &distortion, (width, height)).unwrap();
        assert!(camera.focal[0] > LENS.focal[0]);
        let flat = rectify(&image, LENS, &distortion, camera);
        for y in 2..height - 2 {
            for x in 2..width - 2 {
                let expected = (x as f64 + 0.5 - camera.centre[0]) / camera.focal[0];
                let found = f64::from(flat.pixels[y * width + x]);
                // A hundredth of a pixel: bilinear on a curve with second derivatives near 0.5 per focal length squared.
                assert!((found - expected).abs() < 0.01 / LENS.focal[0], "({x}, {y}): {found} {expected}");
            }
        }
    }
}

//! Section `data.corruption`: what is done to training views, never to held-out ones.

use serde::{Deserialize, Serialize};

use augnerf_base::settings::name_of;
use augnerf_base::settings::{numbers, section};

/// A kind of corruption.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CorruptionKind {
    /// Views stay as they are.
    #[default]
    None,
    /// Normal noise on every channel (ImageNet-C).
    GaussianNoise,
    /// Poisson noise on every channel, as of few photons (ImageNet-C).
    ShotNoise,
    /// Pixels set to black or white (the released code).
    Pepper,
    /// Cameras rotated and moved (the released code has it but never uses it).
    Poses,
}

impl CorruptionKind {
    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        name_of::<CorruptionKind>(self as usize)
    }
}

/// Standard deviations of severities 1 to 5, for values in 0..=1 (Hendrycks and Dietterich 2019).
const GAUSSIAN_STD: [f64; 5] = [0.08, 0.12, 0.18, 0.26, 0.38];
/// Photons for a value of 1 at severities 1 to 5 (the same source).
const SHOT_PHOTONS: [f64; 5] = [60.0, 25.0, 12.0, 5.0, 3.0];

const CORRUPTION: &[&str] = &["corruption"];

section! {
    /// Corruption of the training views, drawn from the run's seed.
    #[derive(Copy)]
    pub struct CorruptionConfig {
        /// Kind of corruption: `none`, `gaussian-noise`, `shot-noise`, `pepper` or `poses`.
        pub kind: CorruptionKind = CorruptionKind::None, numbers().columns(CORRUPTION).same_time();
        /// Noise: severity 1 to 5 as in ImageNet-C, which gives the standard deviation or the photons. The paper does
        /// not say which it used.
        pub severity: usize = 3, numbers().whole(1, 5, "1 to 5, as in ImageNet-C").columns(CORRUPTION).same_time();
        /// Pepper: number of random pixels over the number of pixels of the image. Pixels are drawn with replacement,
        /// so that 0.3 changes 26 % of them.
        pub share: f64 = 0.3,
            numbers().real(|share| (0.0..=10.0).contains(&share), "0 to 10 draws a pixel").columns(CORRUPTION).same_time();
        /// Poses: largest rotation about each of the three world axes, in degrees; the angles are uniform.
        pub degrees: f64 = 5.0,
            numbers().real(|angle| (0.0..=180.0).contains(&angle), "0 to 180").columns(CORRUPTION).same_time();
        /// Poses: largest shift of each coordinate of the origin, in scene units after recentring and scaling; the
        /// shifts are uniform.
        pub offset: f64 = 0.1,
            numbers().real(|offset| offset >= 0.0, "0 or more scene units").columns(CORRUPTION).same_time();
    }
    sections {}
}

impl CorruptionConfig {
    /// Returns whether the training views are corrupted.
    pub fn is_on(&self) -> bool {
        self.kind != CorruptionKind::None
    }

    /// Returns the standard deviation of Gaussian noise.
    pub fn gaussian_std(&self) -> f64 {
        GAUSSIAN_STD[self.severity - 1]
    }

    /// Returns the number of photons for a value of 1 in shot noise.
    pub fn shot_photons(&self) -> f64 {
        SHOT_PHOTONS[self.severity - 1]
    }
}

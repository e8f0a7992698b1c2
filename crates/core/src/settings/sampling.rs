//! Section `sampling`: samples along a ray.

use serde::{Deserialize, Serialize};

use super::registry::{choice, numbers, section};

/// The quantity in which the coarse samples of a ray are evenly spaced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Spacing {
    /// In t.
    #[default]
    Depth,
    /// In 1 / t, as nerf-pytorch's `lindisp`: samples are denser near the camera.
    Disparity,
}

impl Spacing {
    /// Returns t at a fraction of the way from near to far. Near is positive if the spacing is in disparity.
    pub fn at(self, (near, far): (f64, f64), share: f64) -> f64 {
        match self {
            Spacing::Depth => near * (1.0 - share) + far * share,
            Spacing::Disparity => 1.0 / ((1.0 - share) / near + share / far),
        }
    }
}

choice!(Spacing);

section! {
    /// Samples along a ray.
    pub struct SamplingConfig {
        /// Stratified samples of the coarse pass (MipNeRF and hash grids: intervals).
        pub coarse: usize = 64, numbers().whole(3, 4096, "3 to 4096 samples").column("samples_coarse");
        /// Additional inverse-CDF samples of the fine pass, which has `coarse + fine`. MipNeRF and hash grids: the
        /// number of its intervals (0 = coarse pass only, not with hash grids).
        pub fine: usize = 64, numbers().whole(0, 4096, "0 (coarse only) to 4096 samples").column("samples_fine");
        /// MipNeRF and hash grids: added to the blurred weights from which the fine pass draws its intervals.
        pub resample_padding: f64 = 0.01,
            numbers().real(|padding| padding > 0.0, "positive: where all weights are 0, intervals are drawn from it alone")
                .column("resample_padding").later().same_time();
        /// The quantity in which the coarse samples are evenly spaced: `depth`, or `disparity` (1 / depth) for bounds
        /// that are far apart without NDC.
        pub spacing: Spacing = Spacing::Depth, numbers().column("spacing").later().same_time();
        /// Jitter samples in training.
        pub jitter: bool = true, numbers().column("jitter");
        /// Standard deviation of the noise on raw density in training. Empty = 1 for forward-facing scenes, 0
        /// otherwise.
        pub density_noise: Option<f64> = None, numbers().real(|noise| noise >= 0.0, "0 or positive").column("density_noise");
    }
    sections {}
}

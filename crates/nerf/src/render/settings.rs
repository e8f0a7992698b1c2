//! Section `sampling`: samples along a ray.

use serde::{Deserialize, Serialize};

use crate::base::settings::{numbers, section};

mod occupancy;

pub use occupancy::OccupancyConfig;

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
    pub fn at(self, (near, far): (f64, f64), fraction: f64) -> f64 {
        match self {
            Spacing::Depth => near * (1.0 - fraction) + far * fraction,
            Spacing::Disparity => 1.0 / ((1.0 - fraction) / near + fraction / far),
        }
    }
}

/// How the samples of the pass that is rendered are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placing {
    /// By the weights of a coarse pass (NeRF).
    #[default]
    Resampled,
    /// Even intervals, of which those are queried that are neither empty nor hidden (Instant-NGP).
    Occupancy,
}

const ANNEAL: &[&str] = &["anneal"];

section! {
    /// Samples along a ray.
    pub struct SamplingConfig {
        /// How the samples of the pass that is rendered are chosen: `resampled`, by the weights of a coarse pass, or
        /// `occupancy`, which queries a hash grid only where a grid of occupied cells and the light that is left say that it counts
        /// (section `sampling.occupancy`; Instant-NGP).
        pub kind: Placing = Placing::Resampled, numbers().columns(&["occupancy"]);
        /// Stratified samples of the coarse pass (MipNeRF and hash grids: intervals).
        pub coarse: usize = 64, numbers().whole(3, 4096, "3 to 4096 samples").column("samples_coarse");
        /// Additional inverse-CDF samples of the fine pass, which has `coarse + fine`. MipNeRF and hash grids: the
        /// number of its intervals (0 = coarse pass only, not with hash grids).
        pub fine: usize = 64, numbers().whole(0, 4096, "0 (coarse only) to 4096 samples").column("samples_fine");
        /// MipNeRF and hash grids: added to the blurred weights from which the fine pass draws its intervals.
        pub resample_padding: f64 = 0.01,
            numbers().real(|padding| padding > 0.0, "positive: where all weights are 0, intervals are drawn from it alone")
                .column("resample_padding").same_time();
        /// The quantity in which the coarse samples are evenly spaced: `depth`, or `disparity` (1 / depth) for bounds
        /// that are far apart without NDC.
        pub spacing: Spacing = Spacing::Depth, numbers().column("spacing").same_time();
        /// Number of first steps in which the samples of training spread from a part of the ray to all of it (RegNeRF; 0 =
        /// all from the start).
        pub anneal_steps: u64 = 0, numbers().columns(ANNEAL).same_time();
        /// The part's share of the ray in the first step.
        pub anneal_start: f64 = 0.5,
            numbers().share_above_0().columns(ANNEAL).same_time();
        /// Where the part is: the place from near (0) to far (1) that it grows from.
        pub anneal_middle: f64 = 0.5,
            numbers().real(|place| (0.0..=1.0).contains(&place), "0 (near) to 1 (far)").columns(ANNEAL).same_time();
        /// Jitter samples in training.
        pub jitter: bool = true, numbers().column("jitter");
        /// Standard deviation of the noise on raw density in training. Empty = 1 for forward-facing scenes, 0
        /// otherwise.
        pub density_noise: Option<f64> = None, numbers().zero_or_positive().column("density_noise");
    }
    sections {
        /// The occupied cells of `kind = "occupancy"`. Other kinds ignore it.
        pub occupancy: OccupancyConfig;
    }
}

impl SamplingConfig {
    /// Returns the number of samples, or intervals, that are evenly spread along a ray.
    pub fn even(&self) -> usize {
        match self.kind {
            Placing::Resampled => self.coarse,
            Placing::Occupancy => self.occupancy.intervals,
        }
    }

    /// Returns the numbers of rays of first steps that are below `rays`, one for each update of the cells. Where all cells still
    /// count as occupied, a ray has so many samples that fewer rays must do.
    pub fn first_rays(&self, rays: usize) -> impl Iterator<Item = usize> {
        let first = (self.kind == Placing::Occupancy).then_some(self.occupancy.first_rays);
        std::iter::successors(first, |before| Some(2 * before)).take_while(move |first| *first < rays)
    }

    /// Returns the rays of the step after `step` finished ones, of `rays` in later ones.
    pub fn rays_at(&self, rays: usize, step: u64) -> usize {
        self.first_rays(rays).nth((step / self.occupancy.refresh) as usize).unwrap_or(rays)
    }

    /// Returns the ends of the rays' part that the step after `step` finished ones samples, of the `bounds` near and far.
    ///
    /// ```
    /// # use augnerf_nerf::settings::SamplingConfig;
    /// let from_half = SamplingConfig { anneal_steps: 256, ..SamplingConfig::default() };
    /// assert_eq!([0, 128, 256].map(|step| from_half.annealed((2.0, 6.0), step)), [(3.0, 5.0), (2.5, 5.5), (2.0, 6.0)]);
    /// ```
    pub fn annealed(&self, (near, far): (f64, f64), step: u64) -> (f64, f64) {
        if step >= self.anneal_steps {
            return (near, far);
        }
        let fraction = self.anneal_start + (1.0 - self.anneal_start) * (step as f64 / self.anneal_steps as f64);
        let middle = near + self.anneal_middle * (far - near);
        (middle + fraction * (near - middle), middle + fraction * (far - middle))
    }
}

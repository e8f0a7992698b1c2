//! Section `nv`: Neural Volumes (Lombardi et al. 2019), for one still scene.

use serde::{Deserialize, Serialize};

use super::DataKind;
use crate::base::Result;
use crate::base::settings::require;
use crate::base::settings::{numbers, section};

/// The input of the decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum VolumeCode {
    /// The same learned numbers in every step.
    #[default]
    Fixed,
    /// A learned normal distribution that each step samples. Its divergence keeps it near the standard one. Views are
    /// rendered with its mean.
    Variational,
}

/// The protocol's column for all settings of the section.
const COLUMN: &[&str] = &["nv"];

/// Channels of the decoder's narrowest layer before division.
const NARROWEST: usize = 128;

section! {
    /// Neural Volumes: a decoder of 3D convolutions from a code to a volume of colour and opacity, which is looked up
    /// through a learned warp. Defaults are those of the original code.
    pub struct VolumeConfig {
        /// Input of the decoder: `fixed` (256 learned numbers) or `variational` (a learned normal distribution of
        /// them).
        pub code: VolumeCode = VolumeCode::Fixed, numbers().columns(COLUMN);
        /// Voxels along a side of the volume: a power of two.
        pub resolution: usize = 128, numbers().whole(4, 256, "4 to 256 voxels, a power of two").columns(COLUMN);
        /// Divisor of the decoder's channels: a power of two.
        pub divide: usize = 1, numbers().whole(1, 64, "1 to 64, a power of two").columns(COLUMN);
        /// Map positions through a warp, a mixture of 16 affine maps.
        pub warp: bool = true, numbers().columns(COLUMN);
        /// Points along a side of the warp's grid.
        pub warp_resolution: usize = 32, numbers().whole(2, 128, "2 to 128 points").columns(COLUMN);
        /// Two corners in scene units. The volume is the smallest cube around their middle that holds them. Empty = the
        /// box in which the scene's surface is expected. Set it if the cameras look at no common point.
        pub bounds: Option<[[f64; 3]; 2]> = None, numbers().corners().columns(COLUMN);
        /// Length of a step along a ray, in units in which the volume's side is 2. Empty = 2 / resolution.
        pub step: Option<f64> = None,
            numbers().real(|step| step > 1e-4 && step <= 1.0, "above 0.0001, at most 1").columns(COLUMN);
        /// Standard deviation of the logarithm of each step's length in training; views are rendered without it.
        pub step_jitter: f64 = 0.01,
            numbers().real(|jitter| (0.0..=1.0).contains(&jitter), "0 (none) to 1").columns(COLUMN).same_time();
        /// Weight of the prior that a ray's accumulation is 0 or 1: log(0.1 + A) + log(1.1 - A) + 2.20727.
        pub alpha_prior: f64 = 0.01, numbers().off_or_positive().columns(COLUMN).same_time();
        /// Weight of the total variation of the logarithm of the voxels' opacity.
        pub tv: f64 = 0.01, numbers().off_or_positive().columns(COLUMN).same_time();
        /// `variational`: weight of the divergence from the standard normal distribution.
        pub kl: f64 = 0.001, numbers().positive().columns(COLUMN).same_time();
    }
    sections {}
}

impl VolumeConfig {
    /// Fills the settings that depend on the scene. The box stays open if the cameras look at no common point.
    pub(super) fn resolve(&mut self, kind: DataKind, domain: Option<[[f64; 3]; 2]>) {
        self.step.get_or_insert(2.0 / self.resolution as f64);
        let objects = kind.object_half().map(|half| [[-half; 3], [half; 3]]);
        self.bounds = self.bounds.or(domain).or(objects);
    }

    /// Returns the cube of the volume: its middle, and half its side, in scene units. `None` while the box is open.
    pub fn cube(&self) -> Option<([f64; 3], f64)> {
        let [low, high] = self.bounds?;
        let side = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
        Some((std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis])), 0.5 * side))
    }

    /// Returns the length of a step along a ray, in units in which the volume's side is 2.
    pub fn step_length(&self) -> f64 {
        self.step.unwrap_or(2.0 / self.resolution as f64)
    }

    /// Checks the sizes.
    pub(super) fn validate(&self) -> Result<()> {
        let VolumeConfig { resolution, divide, .. } = *self;
        require(resolution.is_power_of_two(), "nv.resolution", resolution, "a power of two from 4 to 256")?;
        require(divide.is_power_of_two(), "nv.divide", divide, "a power of two from 1 to 64")
    }

    /// Returns all settings in one line, for tables.
    pub fn text(&self) -> String {
        let VolumeConfig { resolution, divide, warp, warp_resolution, step_jitter, alpha_prior, tv, kl, .. } = self;
        let warp = if *warp { format!("warp {warp_resolution}^3") } else { "no warp".into() };
        let place = self.bounds.map_or_else(String::new, |bounds| format!(", box {bounds:?}"));
        let code = match self.code {
            VolumeCode::Fixed => "fixed code".into(),
            VolumeCode::Variational => format!("variational code (weight {kl})"),
        };
        let channels = 8 * NARROWEST / divide;
        format!(
            "{resolution}^3 from {channels} channels, {warp}, {code}, steps of {} (jitter {step_jitter}), priors {alpha_prior} \
             (accumulation) and {tv} (tv){place}",
            self.step_length()
        )
    }
}

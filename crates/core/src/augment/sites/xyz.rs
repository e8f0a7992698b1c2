//! A shift of a sample's point, or of a Gaussian's mean, `[rays, samples, 3]`.

use crate::augment::epsilon::Epsilon;
use crate::augment::geometry::{PassGeometry, PixelScale};
use crate::augment::set::{DeltaSet, Norm};
use crate::augment::site::{ANY_EPSILON, DefaultSizes, Level, Passes, Radius, SetChoices, SiteNumbers, SiteSpec};
use crate::base::Result;

pub const SITE: SiteSpec = SiteSpec {
    name: "xyz",
    level: Level::Input,
    moves_samples: true,
    what: "shift of a sample's point",
    unit: "pixels",
    passes: Passes::Both,
    key: 1,
    sizes: DefaultSizes {
        steps: 3,
        norm: Norm::L2,
        paper_epsilon: 1.0,
        paper_step_size: 1e-2,
        calibrated_epsilon: |_| 1.0,
    },
    largest_epsilon: ANY_EPSILON,
    over_units: false,
    scalar: false,
    set,
};

/// Returns the set: per sample a ball or box of epsilon pixels, where a pixel is at most (far - near) |d| / (2 (N -
/// 1)).
fn set(numbers: &SiteNumbers, choices: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet> {
    let (near, far) = pass.bounds;
    let cap = (pass.direction_norm * ((far - near) / (2.0 * (pass.cap_samples as f64 - 1.0))))?;
    let pixel = pass.scalar(pixel(&pass.pixel, choices.xyz_radius))?;
    let radius = match choices.xyz_radius {
        Radius::Pixel => cap.broadcast_minimum(&pixel)?,
        // The released code's cap does not depend on the length of the direction.
        Radius::Released => cap.broadcast_div(pass.direction_norm)?.broadcast_minimum(&pixel)?,
    };
    let radius = match numbers.epsilon {
        Epsilon::Units(epsilon) => (radius * epsilon)?,
        Epsilon::Reach => (radius.zeros_like()? + numbers.radius(|epsilon| epsilon))?,
    };
    let radius = radius.unsqueeze(2)?; // [rays, 1, 1]
    Ok(DeltaSet::new(numbers.norm, radius, &[pass.rays()?, pass.samples, 3]))
}

/// Returns the length of one epsilon before the cap, in scene units: 2/W in NDC, 1/f otherwise. In the released code it
/// is 2 / max(H, W).
fn pixel(scale: &PixelScale, choice: Radius) -> f64 {
    match choice {
        Radius::Released => 2.0 / scale.width.max(scale.height),
        Radius::Pixel if scale.ndc => 2.0 / scale.width,
        Radius::Pixel => 1.0 / scale.focal,
    }
}

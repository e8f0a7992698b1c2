//! The input level: deltas of the coordinates at which the field is queried.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::perturb::epsilon::Epsilon;
use crate::perturb::geometry::{PassGeometry, PixelScale};
use crate::perturb::set::{DeltaSet, Norm};
use crate::perturb::site::{ANY_EPSILON, DefaultSizes, Level, PaperSite, Pgd, Site, SiteNumbers, SiteSpec};

/// A shift along the ray, in the shape of `t_vals`: points `[rays, samples]`, or edges `[rays, samples + 1]`.
pub struct T {
    /// Its numbers in an experiment.
    pub numbers: SiteNumbers,
}

/// Half of the gap keeps the order of samples.
const LARGEST_SHIFT: f64 = 0.5;

impl T {
    pub(super) const SPEC: SiteSpec = SiteSpec {
        name: "t",
        level: Level::Input,
        moves_samples: true,
        sizes: DefaultSizes {
            steps: 3,
            norm: Norm::Linf,
            paper_epsilon: LARGEST_SHIFT,
            paper_step_size: 1e-2,
            calibrated_epsilon: |_| 0.25,
        },
        largest_epsilon: (LARGEST_SHIFT, "0 to 0.5 of the gap to the nearer sample, so that samples stay sorted"),
        over_units: false,
        scalar: true,
    };
}

impl Site for T {
    fn at(&self) -> PaperSite {
        PaperSite::T
    }

    fn pgd(&self) -> Pgd {
        self.numbers.pgd
    }

    /// Returns the set: at most epsilon of the gap to the nearer neighbour, within near..far. The ends have one neighbour.
    ///
    /// In the paper's geometry epsilon is of the gap that the paper's pass would have here: this gap divided by the ratio of the
    /// paper's samples to ours. The radius stays at most half of this pass's gap. In a fine pass the ratio depends on the share
    /// of coarse samples around, which is estimated from the mean of the two gaps: random sampling changes it less than the
    /// nearer gap.
    ///
    /// The radius is two roundings below its nominal value. With epsilon 1/2 two neighbours may meet, and a gap that was
    /// rounded up would let them pass each other.
    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let (t_vals, (near, far)) = (pass.t_vals, pass.run.bounds);
        let (rays, samples) = t_vals.dims2()?;
        let gaps = (t_vals.narrow(1, 1, samples - 1)? - t_vals.narrow(1, 0, samples - 1)?)?;
        let before = Tensor::cat(&[&gaps.narrow(1, 0, 1)?, &gaps], 1)?;
        let after = Tensor::cat(&[&gaps, &gaps.narrow(1, samples - 2, 1)?], 1)?;
        let two_roundings = match t_vals.dtype() {
            DType::F64 => 1.0 - 2.0 * f64::EPSILON,
            _ => 1.0 - 2.0 * f64::from(f32::EPSILON),
        };
        let (nearer_gap, samples_ratio) = (before.minimum(&after)?, pass.sample_density()?);
        let radius = match self.numbers.epsilon {
            // The paper's gaps may be wider than these. More than half of these would lose the order.
            Epsilon::Units(epsilon) => match samples_ratio.uniform() {
                Some(ratio) => (nearer_gap * ((epsilon / ratio).min(LARGEST_SHIFT) * two_roundings))?,
                None => {
                    let coarse_gap = (far - near) / (pass.run.coarse_samples as f64 - 1.0);
                    let ratio = samples_ratio.around(&((before + after)? * 0.5)?, coarse_gap)?;
                    let fraction = (ratio.recip()? * epsilon)?
                        .minimum(&pass.scalar(LARGEST_SHIFT)?.broadcast_as((rays, samples))?)?;
                    ((nearer_gap * fraction)? * two_roundings)?
                }
            },
            Epsilon::Reach => (nearer_gap * (LARGEST_SHIFT * two_roundings))?
                .broadcast_minimum(&pass.scalar(self.numbers.radius(|e| e))?)?,
        };
        let zero = t_vals.zeros_like()?;
        // Rounding can put a sample outside near..far. Its own bound must not push it.
        let lower = t_vals.affine(-1.0, near)?.minimum(&zero)?;
        let upper = t_vals.affine(-1.0, far)?.maximum(&zero)?;
        Ok(DeltaSet::new(Norm::Linf, radius, &[rays, samples]).within(lower, upper))
    }
}

/// A shift of a sample's point, or of a Gaussian's mean, `[rays, samples, 3]`.
pub struct Xyz {
    /// Its numbers in an experiment.
    pub numbers: SiteNumbers,
    /// The length of one epsilon.
    pub radius: Radius,
}

/// The length of one epsilon of `xyz`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Radius {
    /// One pixel: 2/W under NDC, 1/f otherwise, at most half a mean sample distance along the ray in scene units. The
    /// cap is on the length of one epsilon, not on epsilon times it.
    #[default]
    Pixel,
    /// min(2/max(H, W), half a mean sample distance), as in the released code.
    Released,
}

impl Xyz {
    pub(super) const SPEC: SiteSpec = SiteSpec {
        name: "xyz",
        level: Level::Input,
        moves_samples: true,
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
    };
}

impl Site for Xyz {
    fn at(&self) -> PaperSite {
        PaperSite::Xyz
    }

    fn pgd(&self) -> Pgd {
        self.numbers.pgd
    }

    /// Returns the set: per sample a ball or box of epsilon pixels, where a pixel is at most (far - near) |d| / (2 (N -
    /// 1)).
    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let (near, far) = pass.run.bounds;
        let cap = (pass.direction_norm * ((far - near) / (2.0 * (pass.run.cap_samples() as f64 - 1.0))))?;
        let pixel = pass.scalar(pixel(&pass.run.pixel, self.radius))?;
        let radius = match self.radius {
            Radius::Pixel => cap.broadcast_minimum(&pixel)?,
            // The released code's cap does not depend on the length of the direction.
            Radius::Released => cap.broadcast_div(pass.direction_norm)?.broadcast_minimum(&pixel)?,
        };
        let radius = match self.numbers.epsilon {
            Epsilon::Units(epsilon) => (radius * epsilon)?,
            Epsilon::Reach => (radius.zeros_like()? + self.numbers.radius(|epsilon| epsilon))?,
        };
        let radius = radius.unsqueeze(2)?; // [rays, 1, 1]
        Ok(DeltaSet::new(self.numbers.norm, radius, &[pass.rays()?, pass.samples, 3]))
    }
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

/// A tilt of a ray's viewing direction by two angles in its tangent plane, `[rays, 2]`.
pub struct View {
    /// Its numbers in an experiment.
    pub numbers: SiteNumbers,
}

impl View {
    pub(super) const SPEC: SiteSpec = SiteSpec {
        name: "view",
        level: Level::Input,
        moves_samples: false,
        sizes: DefaultSizes {
            steps: 3,
            norm: Norm::Linf,
            paper_epsilon: 1.0,
            paper_step_size: 1e-2,
            calibrated_epsilon: |_| 1.0,
        },
        largest_epsilon: ANY_EPSILON,
        over_units: false,
        scalar: false,
    };
}

impl Site for View {
    fn at(&self) -> PaperSite {
        PaperSite::View
    }

    fn pgd(&self) -> Pgd {
        self.numbers.pgd
    }

    /// Returns the set: each angle within epsilon / (2 f), radians.
    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let radius = self.numbers.radius(|epsilon| epsilon / (2.0 * pass.run.pixel.focal));
        Ok(DeltaSet::new(self.numbers.norm, pass.scalar(radius)?.reshape((1, 1))?, &[pass.rays()?, 2]))
    }
}

/// Tilts unit view directions `[rays, 3]` by small angles `[rays, 2]` along their two tangents `[rays, 3]`.
///
/// # Errors
/// Those of candle, if shapes do not fit.
pub fn tilt(viewdirs: &Tensor, tangents: &[Tensor; 2], angles: &Tensor) -> Result<Tensor> {
    let along = |axis: usize| angles.narrow(1, axis, 1)?.broadcast_mul(&tangents[axis]);
    let tilted = ((viewdirs + along(0)?)? + along(1)?)?;
    let norm = tilted.sqr()?.sum_keepdim(1)?.sqrt()?;
    Ok(tilted.broadcast_div(&norm)?)
}

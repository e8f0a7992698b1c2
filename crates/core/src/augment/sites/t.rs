//! A shift along the ray, `[rays, samples]`.

use candle_core::{DType, Tensor};

use crate::augment::epsilon::Epsilon;
use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Norm};
use crate::augment::site::{DefaultSizes, Level, Passes, SetChoices, SiteNumbers, SiteSpec};
use crate::base::Result;

/// Half of the gap keeps the order of samples.
const LARGEST: f64 = 0.5;

pub const SITE: SiteSpec = SiteSpec {
    name: "t",
    level: Level::Input,
    moves_samples: true,
    what: "shift along the ray",
    unit: "gap to the nearer sample",
    passes: Passes::Both,
    key: 0,
    sizes: DefaultSizes {
        steps: 3,
        norm: Norm::Linf,
        paper_epsilon: LARGEST,
        paper_step_size: 1e-2,
        calibrated_epsilon: |_| 0.25,
    },
    largest_epsilon: (LARGEST, "0 to 0.5 of the gap to the nearer sample, so that samples stay sorted"),
    over_units: false,
    scalar: true,
    set,
};

/// Returns the set: at most epsilon of the gap to the nearer neighbour, within near..far. The ends have one neighbour.
/// In the paper's geometry it is the gap that its pass would have there, and at most half of this pass's gap. The mean
/// of the two gaps tells the fraction of coarse samples around. Random sampling moves it less than the nearer gap.
///
/// The radius is two roundings below its nominal value. With epsilon 1/2 two neighbours may meet, and a gap that was
/// rounded up would let them pass each other.
fn set(numbers: &SiteNumbers, _: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet> {
    let (t_vals, (near, far)) = (pass.t_vals, pass.bounds);
    let (rays, samples) = t_vals.dims2()?;
    let gaps = (t_vals.narrow(1, 1, samples - 1)? - t_vals.narrow(1, 0, samples - 1)?)?;
    let before = Tensor::cat(&[&gaps.narrow(1, 0, 1)?, &gaps], 1)?;
    let after = Tensor::cat(&[&gaps, &gaps.narrow(1, samples - 2, 1)?], 1)?;
    let short = match t_vals.dtype() {
        DType::F64 => 1.0 - 2.0 * f64::EPSILON,
        _ => 1.0 - 2.0 * f64::from(f32::EPSILON),
    };
    let nearer = before.minimum(&after)?;
    let radius = match numbers.epsilon {
        // The paper's gaps may be wider than these. More than half of these would lose the order.
        Epsilon::Units(epsilon) => match pass.density.uniform() {
            Some(density) => (nearer * ((epsilon / density).min(LARGEST) * short))?,
            None => {
                let coarse_gap = (far - near) / (pass.coarse_samples as f64 - 1.0);
                let density = pass.density.around(&((before + after)? * 0.5)?, coarse_gap)?;
                let share =
                    (density.recip()? * epsilon)?.minimum(&pass.scalar(LARGEST)?.broadcast_as((rays, samples))?)?;
                ((nearer * share)? * short)?
            }
        },
        Epsilon::Reach => (nearer * (LARGEST * short))?.broadcast_minimum(&pass.scalar(numbers.radius(|e| e))?)?,
    };
    let zero = t_vals.zeros_like()?;
    // Rounding can put a sample outside near..far. Its own bound must not push it.
    let lower = t_vals.affine(-1.0, near)?.minimum(&zero)?;
    let upper = t_vals.affine(-1.0, far)?.maximum(&zero)?;
    let mut set = DeltaSet::new(Norm::Linf, radius, &[rays, samples]);
    set.bounds = Some((lower, upper));
    Ok(set)
}

//! The output level: deltas of the colours and densities that are rendered.

use candle_core::Tensor;

use crate::base::Result;
use crate::perturb::geometry::PassGeometry;
use crate::perturb::set::{DeltaSet, Norm};
use crate::perturb::sets::{Deltas, Sets, SiteSet};
use crate::perturb::site::{ANY_EPSILON, DefaultSizes, Level, PaperSite, Pgd, Site, SiteNumbers, SiteSpec};

/// Added to the colour of a sample, `[rays, samples, 3]`.
pub struct Rgb {
    /// Its numbers in an experiment.
    pub numbers: SiteNumbers,
}

impl Rgb {
    pub(super) const SPEC: SiteSpec = SiteSpec {
        name: "rgb",
        level: Level::Output,
        moves_samples: false,
        sizes: DefaultSizes {
            steps: 1,
            norm: Norm::Linf,
            paper_epsilon: 1e-5,
            paper_step_size: 1e-5,
            calibrated_epsilon: |_| 4.0 / 255.0,
        },
        largest_epsilon: ANY_EPSILON,
        over_units: false,
        scalar: false,
    };
}

impl Site for Rgb {
    fn at(&self) -> PaperSite {
        PaperSite::Rgb
    }

    fn pgd(&self) -> Pgd {
        self.numbers.pgd
    }

    /// Returns the set before the pass's colours cut it.
    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let radius = pass.scalar(self.numbers.radius(|epsilon| epsilon))?.reshape((1, 1, 1))?;
        Ok(DeltaSet::new(self.numbers.norm, radius, &[pass.rays()?, pass.samples, 3]))
    }
}

/// Added to the density of a sample, `[rays, samples]`.
pub struct Density {
    /// Its numbers in an experiment.
    pub numbers: SiteNumbers,
    /// Whether the density of a ray's last sample is perturbed (the paper's literal sum).
    pub perturb_last: bool,
}

impl Density {
    pub(super) const SPEC: SiteSpec = SiteSpec {
        name: "density",
        level: Level::Output,
        moves_samples: false,
        sizes: DefaultSizes {
            steps: 1,
            norm: Norm::Linf,
            paper_epsilon: 1e-5,
            paper_step_size: 1e-5,
            // It changes the opacity of a coarse interval by about 4/255.
            calibrated_epsilon: |interval| 4.0 / 255.0 / interval,
        },
        largest_epsilon: ANY_EPSILON,
        over_units: false,
        scalar: true,
    };
}

impl Site for Density {
    fn at(&self) -> PaperSite {
        PaperSite::Density
    }

    fn pgd(&self) -> Pgd {
        self.numbers.pgd
    }

    /// Returns the set before the pass's densities cut it. A ray's last sample reaches to infinity: any density there makes
    /// an empty ray opaque.
    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet> {
        let radius = pass.scalar(self.numbers.radius(|epsilon| epsilon))?.reshape((1, 1))?;
        let mut set = DeltaSet::new(self.numbers.norm, radius, &[pass.rays()?, pass.samples]);
        // Edges also end the last interval: no sample is opaque by definition.
        if !self.perturb_last && !pass.has_edges()? {
            let mut mask = vec![1f32; pass.samples];
            mask[pass.samples - 1] = 0.0;
            let mask = Tensor::from_vec(mask, (1, pass.samples), pass.t_vals.device())?;
            set.mask = Some(mask.to_dtype(pass.t_vals.dtype())?);
        }
        Ok(set)
    }
}

/// The upper end of a range without one.
const UNLIMITED: f64 = f32::MAX as f64;

/// Returns the range of the values to which a site of the output level is added. Density has no upper limit: `f32::MAX`.
/// `padding` is that of the field's colours.
///
/// # Panics
/// The site is of another level.
pub fn output_range(site: PaperSite, padding: f64) -> (f64, f64) {
    match site {
        PaperSite::Rgb => (-padding, 1.0 + padding),
        PaperSite::Density => (0.0, UNLIMITED),
        PaperSite::T | PaperSite::Xyz | PaperSite::View | PaperSite::Feature => {
            unreachable!("{} is not of the output level", site.name())
        }
    }
}

/// The deltas of a pass as it used them, and the sets onto which they were projected. Those of the output level are cut by
/// what the forward pass allows.
#[derive(Clone, Default)]
pub struct UsedDeltas {
    /// Projected at the output level, the others as given.
    pub deltas: Deltas,
    /// Their sets.
    pub sets: Sets,
}

impl UsedDeltas {
    /// Adds the deltas at a site of the output level to `value`. They are projected onto their sets, so that the sum stays
    /// in `range`, if there is one: gradients pass to delta and value as if nothing had been projected.
    ///
    /// # Errors
    /// Those of candle and of a site's own spread.
    pub fn add_to(&mut self, value: Tensor, at: PaperSite, range: Option<(f64, f64)>) -> Result<Tensor> {
        let UsedDeltas { deltas, sets } = self;
        // A projected sum can leave the range by rounding, and a spread delta is not projected onto it.
        let within_range = |sum: Tensor| match range {
            Some((low, high)) if high < UNLIMITED => sum.clamp(low, high),
            Some(_) => sum.relu(),
            None => Ok(sum),
        };
        let mut sum = match deltas.spread(sets, at)? {
            Some(spread) => straight_through(within_range((value.detach() + spread.detach())?)?, &value, &spread)?,
            None => value,
        };
        for SiteSet { site, set } in sets.iter_mut().filter(|entry| entry.site.at() == at && !entry.set.spreads()) {
            let Some(delta) = deltas.get(site.name()).cloned() else { continue };
            let values = sum.detach();
            *set = match range {
                Some((low, high)) if high < UNLIMITED => {
                    set.within(values.affine(-1.0, low)?, values.affine(-1.0, high)?)
                }
                Some((_, high)) => set.within(values.neg()?, (values.zeros_like()? + high)?),
                None => set.clone(),
            };
            let projected = set.project(&delta.detach())?;
            sum = straight_through(within_range((&values + &projected)?)?, &sum, &delta)?;
            deltas.insert(site.name(), projected);
        }
        Ok(sum)
    }
}

/// Returns `exact` with the gradient of `value + delta`. The two differences are exactly 0.
fn straight_through(exact: Tensor, value: &Tensor, delta: &Tensor) -> Result<Tensor> {
    let gradient = ((value - value.detach())? + (delta - delta.detach())?)?;
    Ok((exact + gradient)?)
}

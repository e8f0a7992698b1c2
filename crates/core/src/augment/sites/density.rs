//! The delta of a sample's density, `[rays, samples]`.

use candle_core::Tensor;

use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Norm};
use crate::augment::site::{ANY_EPSILON, DefaultSizes, Level, Passes, SetChoices, SiteNumbers, SiteSpec};
use crate::base::Result;

pub const SITE: SiteSpec = SiteSpec {
    name: "density",
    level: Level::Output,
    moves_samples: false,
    what: "added to the density of a sample",
    unit: "1 / length",
    passes: Passes::Both,
    key: 5,
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
    set,
};

/// Returns the set before the pass's densities cut it. A ray's last sample reaches to infinity: any density there makes
/// an empty ray opaque.
fn set(numbers: &SiteNumbers, choices: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet> {
    let radius = pass.scalar(numbers.radius(|epsilon| epsilon))?.reshape((1, 1))?;
    let mut set = DeltaSet::new(numbers.norm, radius, &[pass.rays()?, pass.samples]);
    // Edges also end the last interval: no sample is opaque by definition.
    if !choices.perturb_last && !pass.has_edges()? {
        set.mask = Some(all_but_last(pass)?);
    }
    Ok(set)
}

/// Returns `[1, samples]`: 1, and 0 for the last sample.
fn all_but_last(pass: &PassGeometry) -> Result<Tensor> {
    let mut mask = vec![1f32; pass.samples];
    mask[pass.samples - 1] = 0.0;
    Ok(Tensor::from_vec(mask, (1, pass.samples), pass.t_vals.device())?.to_dtype(pass.t_vals.dtype())?)
}

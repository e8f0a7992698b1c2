//! The delta of a sample's colour, `[rays, samples, 3]`.

use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Norm};
use crate::augment::site::{ANY_EPSILON, DefaultSizes, Level, Passes, SetChoices, SiteNumbers, SiteSpec};
use crate::base::Result;

pub const SITE: SiteSpec = SiteSpec {
    name: "rgb",
    level: Level::Output,
    moves_samples: false,
    what: "added to the colour of a sample",
    unit: "colour, 0 to 1",
    passes: Passes::Both,
    key: 4,
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
    set,
};

/// Returns the set before the pass's colours cut it.
fn set(numbers: &SiteNumbers, _: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet> {
    let radius = pass.scalar(numbers.radius(|epsilon| epsilon))?.reshape((1, 1, 1))?;
    Ok(DeltaSet::new(numbers.norm, radius, &[pass.rays()?, pass.samples, 3]))
}

//! The delta of a trunk layer's output, `[rays, samples, width]`.

use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Norm};
use crate::augment::site::{ANY_EPSILON, DefaultSizes, Level, Passes, SetChoices, SiteNumbers, SiteSpec};
use crate::base::Result;

pub const SITE: SiteSpec = SiteSpec {
    name: "feature",
    level: Level::Feature,
    moves_samples: false,
    what: "added to the output of a trunk layer",
    unit: "feature units",
    passes: Passes::Both,
    key: 3,
    sizes: DefaultSizes {
        steps: 1,
        norm: Norm::Linf,
        paper_epsilon: 1e-3,
        paper_step_size: 1e-3,
        calibrated_epsilon: |_| 1e-2,
    },
    largest_epsilon: ANY_EPSILON,
    over_units: true,
    scalar: false,
    set,
};

fn set(numbers: &SiteNumbers, _: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet> {
    let radius = pass.scalar(numbers.radius(|epsilon| epsilon))?.reshape((1, 1, 1))?;
    Ok(DeltaSet::new(numbers.norm, radius, &[pass.rays()?, pass.samples, pass.width]))
}

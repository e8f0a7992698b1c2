//! A tilt of a ray's viewing direction by two angles in its tangent plane, `[rays, 2]`.

use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Norm};
use crate::augment::site::{ANY_EPSILON, DefaultSizes, Level, Passes, SetChoices, SiteNumbers, SiteSpec};
use crate::base::Result;

pub const SITE: SiteSpec = SiteSpec {
    name: "view",
    level: Level::Input,
    moves_samples: false,
    what: "tilt of the viewing direction",
    unit: "half a pixel's angle, 1/(2f)",
    passes: Passes::Both,
    key: 2,
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
    set,
};

/// Returns the set: each angle within epsilon / (2 f), radians.
fn set(numbers: &SiteNumbers, _: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet> {
    let radius = pass.scalar(numbers.radius(|epsilon| epsilon / (2.0 * pass.pixel.focal)))?.reshape((1, 1))?;
    Ok(DeltaSet::new(numbers.norm, radius, &[pass.rays()?, 2]))
}

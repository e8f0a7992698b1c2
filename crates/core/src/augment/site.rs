//! What a site says of itself: the form that every file in `sites` fills in.

use serde::{Deserialize, Serialize};

use crate::augment::epsilon::Epsilon;
use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Norm};
use crate::base::Result;

/// The paper's three levels, in the order in which a pass meets them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// Coordinates that the field is queried at.
    Input,
    /// Intermediate features of the field.
    Feature,
    /// Colour and density before rendering.
    Output,
}

impl Level {
    /// All levels, in order.
    pub const ALL: [Level; 3] = [Level::Input, Level::Feature, Level::Output];
}

/// The passes that a site takes part in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Passes {
    /// Coarse and fine.
    Both,
    /// Coarse only.
    Coarse,
    /// Fine only.
    Fine,
    /// None.
    Off,
}

impl Passes {
    /// The coarse pass, or the fine one, is among them.
    pub fn include(self, coarse: bool) -> bool {
        match self {
            Passes::Both => true,
            Passes::Coarse => coarse,
            Passes::Fine => !coarse,
            Passes::Off => false,
        }
    }
}

/// The unit of step sizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StepUnit {
    /// The delta's own unit.
    #[default]
    Absolute,
    /// Radii of the delta's set.
    Relative,
}

/// What one epsilon of `xyz` is worth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Radius {
    /// A pixel: 2/W under NDC, 1/f otherwise, at most half a mean sample distance along the ray in scene units.
    /// The cap is on one epsilon's worth, not on epsilon times it.
    #[default]
    Pixel,
    /// min(2/max(H, W), half a mean sample distance), as the released code.
    Released,
}

/// A site's numbers in one experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiteNumbers {
    /// The passes it takes part in.
    pub passes: Passes,
    /// Ascent steps; 0 leaves the random start.
    pub steps: usize,
    /// Length of one step, in the experiment's [`StepUnit`].
    pub step_size: f64,
    /// Size of the set.
    pub epsilon: Epsilon,
    /// The set's norm.
    pub norm: Norm,
}

impl SiteNumbers {
    /// Takes part in any pass.
    pub fn on(&self) -> bool {
        self.passes != Passes::Off
    }

    /// Its set is larger than a point.
    pub fn perturbs(&self) -> bool {
        self.radius(|epsilon| epsilon) != 0.0
    }

    /// Radius of the set, where `units` says what an epsilon is worth in the delta's own unit.
    pub fn radius(&self, units: impl FnOnce(f64) -> f64) -> f64 {
        match self.epsilon {
            Epsilon::Units(epsilon) => units(epsilon),
            Epsilon::Reach => self.steps as f64 * self.step_size,
        }
    }
}

/// Choices of an experiment that single sites read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetChoices {
    /// What one epsilon of `xyz` is worth.
    pub xyz_radius: Radius,
    /// The density of a ray's last sample is perturbed, too (the paper's literal sum).
    pub perturb_last: bool,
}

/// The sizes that fill what an experiment leaves open.
#[derive(Clone, Copy, Debug)]
pub struct DefaultSizes {
    /// Ascent steps.
    pub steps: usize,
    /// The set's norm.
    pub norm: Norm,
    /// The paper's epsilon, or the largest that keeps to it.
    pub paper_epsilon: f64,
    /// The paper's step size, in the delta's own unit.
    pub paper_step_size: f64,
    /// Ours: large enough to matter. Of an interval (far - near) / coarse samples, in the units of `t_vals`.
    pub calibrated_epsilon: fn(f64) -> f64,
}

/// A site: a place in the pass where a delta enters.
#[derive(Debug)]
pub struct SiteSpec {
    /// Its name in settings, logs and tables.
    pub name: &'static str,
    /// The level that it belongs to.
    pub level: Level,
    /// What its delta is, for the documentation of settings.
    pub what: &'static str,
    /// The unit of its epsilon.
    pub unit: &'static str,
    /// Where it takes part if nobody says: [`Passes::Off`] for every site that is younger than the first six, so that
    /// no existing experiment changes.
    pub passes: Passes,
    /// Which random numbers are its own, for all time: no two sites have the same.
    pub key: u64,
    /// Its sizes where nobody says.
    pub sizes: DefaultSizes,
    /// Largest epsilon, with the range in words.
    pub largest_epsilon: (f64, &'static str),
    /// A box over the units of a layer, which the paper's geometry scales with the field's width
    /// ([`crate::augment::PaperPass::box_scale`]).
    pub over_units: bool,
    /// The delta is one number a sample: ball and box are the same set, which has one name, [`Norm::Linf`].
    pub scalar: bool,
    /// Its set in a pass; it is larger than a point.
    pub set: fn(numbers: &SiteNumbers, choices: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet>,
}

/// Range of an epsilon that only has to be a length.
pub const ANY_EPSILON: (f64, &str) = (f64::MAX, "0 or positive");

//! The specification of a site, which every file in `sites` fills in.

use serde::{Deserialize, Serialize};

use crate::augment::epsilon::Epsilon;
use crate::augment::geometry::PassGeometry;
use crate::augment::set::{DeltaSet, Norm};
use crate::base::Result;

/// The paper's three levels, in the order of a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// Coordinates at which the field is queried.
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

/// The passes with a site's delta.
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
    /// Returns whether the coarse pass, or the fine one, is included.
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
    /// Radii of the constraint set.
    Relative,
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

/// A site's numbers in one experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiteNumbers {
    /// The passes with its delta.
    pub passes: Passes,
    /// PGD steps. 0 keeps the random start.
    pub steps: usize,
    /// Length of one PGD step, in the experiment's [`StepUnit`].
    pub step_size: f64,
    /// Size of the constraint set.
    pub epsilon: Epsilon,
    /// Norm of the constraint set.
    pub norm: Norm,
}

impl SiteNumbers {
    /// Returns whether any pass has its delta.
    pub fn on(&self) -> bool {
        self.passes != Passes::Off
    }

    /// Returns whether its set is larger than a point.
    pub fn perturbs(&self) -> bool {
        self.radius(|epsilon| epsilon) != 0.0
    }

    /// Returns the radius of the set. `units` converts an epsilon to the delta's own unit.
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
    /// The length of one epsilon of `xyz`.
    pub xyz_radius: Radius,
    /// Whether the density of a ray's last sample is perturbed (the paper's literal sum).
    pub perturb_last: bool,
}

/// The sizes that fill what an experiment leaves open.
#[derive(Clone, Copy, Debug)]
pub struct DefaultSizes {
    /// PGD steps.
    pub steps: usize,
    /// Norm of the constraint set.
    pub norm: Norm,
    /// The paper's epsilon, or the largest that agrees with it.
    pub paper_epsilon: f64,
    /// The paper's step size, in the delta's own unit.
    pub paper_step_size: f64,
    /// Our epsilon, large enough to matter. Its argument is an interval, (far - near) / coarse samples, in the units of
    /// `t_vals`.
    pub calibrated_epsilon: fn(f64) -> f64,
}

/// The specification of a site: the point of a pass at which a delta is added.
#[derive(Debug)]
pub struct SiteSpec {
    /// Its name in settings, logs and tables.
    pub name: &'static str,
    /// Its level.
    pub level: Level,
    /// Whether its delta moves the samples at which the field is queried. A search computes what depends on them alone
    /// once, as soon as no such site moves any more.
    pub moves_samples: bool,
    /// Its delta in words, for the documentation of settings.
    pub what: &'static str,
    /// The unit of its epsilon.
    pub unit: &'static str,
    /// The passes with it by default. It is [`Passes::Off`] for every site that is newer than the first six, so that no
    /// existing experiment changes.
    pub passes: Passes,
    /// The key of its random numbers, which never changes. No two sites have the same.
    pub key: u64,
    /// Its default sizes.
    pub sizes: DefaultSizes,
    /// Largest epsilon, and the allowed range in words.
    pub largest_epsilon: (f64, &'static str),
    /// Whether its set is a box over the units of a layer. The paper's geometry scales such a box with the network's
    /// width ([`crate::augment::PaperPass::box_scale`]).
    pub over_units: bool,
    /// Whether the delta is one number per sample. Ball and box are then the same set, which has one name,
    /// [`Norm::Linf`].
    pub scalar: bool,
    /// Returns its set in a pass. The set is larger than a point.
    pub set: fn(numbers: &SiteNumbers, choices: &SetChoices, pass: &PassGeometry) -> Result<DeltaSet>,
}

/// Range of an epsilon that only has to be a length.
pub const ANY_EPSILON: (f64, &str) = (f64::MAX, "0 or positive");

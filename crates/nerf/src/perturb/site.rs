//! A site: a quantity of the perturbed pass (a coordinate, a feature or an output) to which a delta is added. The paper's six are
//! in `input`, `feature` and `output`, a file for each level.

use std::ops::{Index, IndexMut};

use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::perturb::epsilon::Epsilon;
use crate::perturb::geometry::PassGeometry;
use crate::perturb::set::{DeltaSet, Norm};
use crate::perturb::{feature, input, output};

/// A quantity of the perturbed pass to which a delta is added, with the set of its deltas.
///
/// A site of your own is a type that implements this. Its delta can have any shape: one number a ray, or six numbers of a
/// camera. [`DeltaSet::spread_by`] says what such a delta adds. The search moves it with all other sites.
pub trait Site: Send + Sync {
    /// Returns the site of the paper to whose quantity its delta is added. At `t` and `xyz` it moves samples.
    fn at(&self) -> PaperSite;

    /// Returns its name, which no other site has. One of your own must give it. Its diagnostics are logged as `gain.NAME`,
    /// `shift.NAME`, and so on.
    fn name(&self) -> &str {
        self.at().name()
    }

    /// Returns the steps of its search: three of half a radius each, if it does not say otherwise.
    fn pgd(&self) -> Pgd {
        Pgd { steps: 3, step_size: 0.5, unit: StepUnit::Relative }
    }

    /// Returns the set of its deltas in a pass. A pass has the rays of one part of a step (`train.chunk`).
    ///
    /// # Errors
    /// Those of candle.
    fn set(&self, pass: &PassGeometry) -> Result<DeltaSet>;
}

/// The steps of a site's search, projected gradient descent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pgd {
    /// Number of steps. 0 keeps the random start.
    pub steps: usize,
    /// Length of a step.
    pub step_size: f64,
    /// Unit of the length.
    pub unit: StepUnit,
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

/// The built-in sites: the paper's six. Their order numbers their random numbers: a new one comes last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PaperSite {
    /// Shift along the ray.
    T,
    /// Shift of a sample's point.
    Xyz,
    /// Tilt of the viewing direction.
    View,
    /// Added to a trunk layer's output.
    Feature,
    /// Added to the colour.
    Rgb,
    /// Added to the density.
    Density,
}

impl PaperSite {
    /// All sites, in the order of columns and of all other lists.
    pub const ALL: [PaperSite; 6] =
        [PaperSite::T, PaperSite::Xyz, PaperSite::View, PaperSite::Feature, PaperSite::Rgb, PaperSite::Density];

    /// Returns its constants: name, level, default sizes.
    pub fn spec(self) -> &'static SiteSpec {
        match self {
            PaperSite::T => &input::T::SPEC,
            PaperSite::Xyz => &input::Xyz::SPEC,
            PaperSite::View => &input::View::SPEC,
            PaperSite::Feature => &feature::Feature::SPEC,
            PaperSite::Rgb => &output::Rgb::SPEC,
            PaperSite::Density => &output::Density::SPEC,
        }
    }

    /// Returns the name in settings, logs and tables.
    pub fn name(self) -> &'static str {
        self.spec().name
    }

    /// Returns the site of a name.
    pub fn of_name(name: &str) -> Option<PaperSite> {
        PaperSite::ALL.into_iter().find(|site| site.name() == name)
    }

    /// Returns the part of a step's random numbers that is this site's own in the step's pass number `pass`.
    pub fn part(self, pass: u64) -> u64 {
        part(self as u64, pass)
    }
}

impl AsRef<str> for PaperSite {
    fn as_ref(&self) -> &str {
        self.name()
    }
}

/// Number of keys below which parts of a step are numbered directly. Other keys use the bits above.
const KEYS: u64 = 8;
/// Parts of a step are far fewer than 2 to this.
const PART_BITS: u32 = 48;
/// Keys of all other sites begin here.
const FIRST_KEY: u64 = 1 << 18;

/// Returns the part of a step's random numbers that a site of this name has in the step's pass number `pass`. It follows
/// from the name alone.
pub(super) fn part_of(name: &str, pass: u64) -> u64 {
    let key = PaperSite::of_name(name).map_or_else(|| FIRST_KEY + fnv1a(name) % FIRST_KEY, |site| site as u64);
    part(key, pass)
}

/// Injective in both if `pass` is below 2^45.
fn part(key: u64, pass: u64) -> u64 {
    ((key / KEYS) << PART_BITS) + KEYS * pass + key % KEYS
}

fn fnv1a(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// What is known of a site of the paper, whatever the experiment.
#[derive(Debug)]
pub struct SiteSpec {
    /// Its name in settings, logs and tables.
    pub name: &'static str,
    /// Its level.
    pub level: Level,
    /// Whether its delta moves the samples at which the field is queried. A search computes what depends on them alone
    /// once, as soon as no such site moves any more.
    pub moves_samples: bool,
    /// Its default sizes.
    pub sizes: DefaultSizes,
    /// Largest epsilon, and the allowed range in words.
    pub largest_epsilon: (f64, &'static str),
    /// Whether its set is a box over the units of a layer. The paper's geometry scales such a box with the network's
    /// width ([`crate::perturb::PaperPass::box_scale`]).
    pub over_units: bool,
    /// Whether the delta is one number per sample. Ball and box are then the same set, which has one name,
    /// [`Norm::Linf`].
    pub scalar: bool,
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

/// Range of an epsilon that only has to be a length.
pub(super) const ANY_EPSILON: (f64, &str) = (f64::MAX, "0 or positive");

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

/// A paper site's numbers in one experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiteNumbers {
    /// The passes with its delta.
    pub passes: Passes,
    /// The steps of its search.
    pub pgd: Pgd,
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
            Epsilon::Reach => self.pgd.steps as f64 * self.pgd.step_size,
        }
    }
}

/// One value for each of the paper's sites.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PerSite<T>([T; PaperSite::ALL.len()]);

impl<T> PerSite<T> {
    /// Creates the values with `value` of each site.
    pub fn from_fn(value: impl FnMut(PaperSite) -> T) -> PerSite<T> {
        PerSite(PaperSite::ALL.map(value))
    }

    /// Iterates over the sites with their values, in order.
    pub fn iter(&self) -> impl Iterator<Item = (PaperSite, &T)> {
        PaperSite::ALL.into_iter().zip(&self.0)
    }

    /// Iterates over the sites with their values, mutably.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = (PaperSite, &mut T)> {
        PaperSite::ALL.into_iter().zip(&mut self.0)
    }
}

impl<T> Index<PaperSite> for PerSite<T> {
    type Output = T;

    fn index(&self, site: PaperSite) -> &T {
        &self.0[site as usize]
    }
}

impl<T> IndexMut<PaperSite> for PerSite<T> {
    fn index_mut(&mut self, site: PaperSite) -> &mut T {
        &mut self.0[site as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    /// Trainings of every earlier program drew the numbers of site k in pass p from part 8 p + k of their step.
    #[test]
    fn sites_keep_their_random_numbers_and_share_none() {
        use PaperSite::{Density, Feature, Rgb, T, View, Xyz};
        for (k, site) in [(0, T), (1, Xyz), (2, View), (3, Feature), (4, Rgb), (5, Density)] {
            assert_eq!((site.part(0), site.part(77)), (k, 8 * 77 + k));
            assert_eq!((PaperSite::of_name(site.name()), part_of(site.name(), 77)), (Some(site), site.part(77)));
        }
        let parts: Vec<u64> = (0..40).flat_map(|key| (0..1000).map(move |pass| part(key, pass))).collect();
        assert_eq!(parts.iter().collect::<HashSet<_>>().len(), parts.len());
        assert!(part_of("ray_shift", 3) >> PART_BITS >= FIRST_KEY / KEYS);
    }
}

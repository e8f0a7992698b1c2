//! Section `regularizer`: terms of the loss next to the photometric one, on density in space or on rays.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::{LossTerm, TermNeeds};
use crate::base::Result;
use crate::base::settings::IdleKind::Dropped;
use crate::base::settings::{IdleSettings, all_of, name_of, one_or_many, refuse, require};
use crate::base::settings::{numbers, section};
use crate::data::{RayGroup, UnseenPoses};
use crate::schedule::{SCHEDULES, WeightSchedule};
use crate::space::{Lattice, Quadrature};

/// An explicit regularizer: an integral over a box (the paper's, appendix "Implementation of explicit
/// regularization"), a mean over rays, or a sum over tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Regularizer {
    /// abs(density): sparsity.
    L1,
    /// Length of the density gradient: total variation.
    Tv,
    /// abs(Laplacian of density).
    Laplacian,
    /// Spread of the weights along each ray (mip-NeRF 360, equation 15).
    Distortion,
    /// Density next to the camera (FreeNeRF).
    Occlusion,
    /// Entropy of the opacities along each ray (InfoNeRF).
    Entropy,
    /// log(1 + 2 density^2) of samples (SNeRG).
    Cauchy,
    /// Accumulations near 0 or 1 (Neural Volumes).
    OpacityPrior,
    /// 1 - exp(-density / 20) in the box (PlenOctrees).
    OpacitySparsity,
    /// Squares of a hash grid's entries (Zip-NeRF).
    HashDecay,
    /// Differences of depth between neighbouring pixels of unseen patches (RegNeRF).
    DepthSmoothness,
    /// Divergence between the opacities of a ray and of its twin (InfoNeRF).
    InformationGain,
    /// Weights where density falls along the ray, as on the far side of a surface (Ref-NeRF).
    Orientation,
    /// Depth at the points that COLMAP triangulated (DS-NeRF).
    SparseDepth,
}

/// All regularizers in their fixed order.
pub static REGULARIZERS: LazyLock<Vec<Regularizer>> = LazyLock::new(all_of);

impl Regularizer {
    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        name_of::<Regularizer>(self as usize)
    }

    /// Returns what the term is computed from.
    pub fn needs(self) -> TermNeeds {
        LossTerm::of(self, &RegularizerConfig::default()).needs()
    }

    /// Returns the groups in which rays come whose samples the term reads. `None` for other terms.
    pub fn group(self) -> Option<RayGroup> {
        match self.needs() {
            TermNeeds::Samples(group) => Some(group),
            TermNeeds::Slopes => Some(RayGroup::One),
            TermNeeds::Density(_) | TermNeeds::Tables => None,
        }
    }

    /// Returns whether the term counts in the evaluated pass alone, whatever [`RegularizerConfig::fields`] says.
    pub fn is_of_evaluated_pass(self) -> bool {
        LossTerm::of(self, &RegularizerConfig::default()).is_of_evaluated_pass()
    }
}

/// The rays on which terms of single rays are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TermRays {
    /// Those of the step's photographs.
    #[default]
    Training,
    /// Those of cameras without photographs.
    Unseen,
}

/// The points of the box at which a step queries density.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LatticePoints {
    /// `points_per_step` random cells of the grid, new in each step: an unbiased estimate.
    #[default]
    Sampled,
    /// The midpoint of every cell in every step: the paper's quadrature.
    Full,
}

/// Which networks are regularized.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RegularizedFields {
    /// Coarse and fine; their terms are added.
    #[default]
    Both,
    /// Only the network that is evaluated.
    Fine,
}

/// Largest number of points of a step. They are drawn at once, and this many take a few hundred megabytes.
const MOST_POINTS_PER_STEP: usize = 1 << 22;
/// Largest grid whose every cell a step queries. There is no checkpoint within a step, and so many points take minutes.
const MOST_CELLS_A_SIDE: usize = 256;

const POINTS: &[&str] = &["regularizer_points"];

section! {
    /// Explicit regularizers. The loss gains weight * term for each.
    pub struct RegularizerConfig {
        /// `l1`, `tv`, `laplacian`, `distortion`, `occlusion`, `entropy`, `cauchy`, `opacity-prior`,
        /// `opacity-sparsity`, `hash-decay`, `depth-smoothness`, `information-gain`, `orientation`, `sparse-depth`, or a list of several; empty = none.
        #[serde(deserialize_with = "one_or_many")]
        pub kind: Vec<Regularizer> = Vec::new(), numbers().columns(&["regularizers"]);
        /// Weight of each term in `kind`: a number, or a list in the same order. Empty = the default of each term (l1
        /// 1.4e-4, tv 3.8e-6, laplacian 7.4e-9, distortion 0.01, occlusion 0.01, entropy 1e-3, cauchy 1e-4,
        /// opacity-prior 0.01, opacity-sparsity 1e-3, hash-decay 0.1, depth-smoothness 0.1, information-gain 2e-5, orientation 0.01, sparse-depth 0.1), which
        /// is for one scene; `augnerf train --balance` measures others. A weight of 0 disables the term, unless its schedule begins elsewhere.
        #[serde(deserialize_with = "one_or_many")]
        pub weight: Vec<f64> = Vec::new(),
            numbers().off_or_positive().columns(&["regularizers"]).same_time();
        /// How each weight moves: `constant`, `from 400 in 512 steps` (from there to the weight) or `halved every 5000
        /// steps` (from the weight on), or a list in the order of `kind`. Empty = constant.
        #[serde(deserialize_with = "one_or_many")]
        pub schedule: Vec<WeightSchedule> = Vec::new(),
            numbers().text(WeightSchedule::is_possible, SCHEDULES).columns(&["regularizers"]).same_time();
        /// Lower and upper corner of the box, in the units of the points (NDC if the scene uses it).
        pub domain: [[f64; 3]; 2] = [[-1.0; 3], [1.0; 3]], numbers().corners().columns(&["regularizer_domain"]);
        /// Cells along each side of the box (N): at most 256 with `points = "full"`.
        pub lattice: usize = 64,
            numbers().whole(4, 1024, "4 to 1024 cells a side: fewer say nothing about smoothness, more would never finish")
                .columns(POINTS);
        /// Which cells a step queries: `sampled` (random cells) or `full` (all cells).
        pub points: LatticePoints = LatticePoints::Sampled, numbers().columns(POINTS);
        /// Number of cells that a step of `points = "sampled"` draws.
        pub points_per_step: usize = 4096, numbers().columns(POINTS);
        /// Query a sampled cell at a uniformly random point, which estimates the integral without bias. `false` = at
        /// its midpoint, which estimates the sum over the full sampling grid without bias.
        pub jitter: bool = true, numbers().columns(POINTS);
        /// Which networks are regularized: `both` or `fine`.
        pub fields: RegularizedFields = RegularizedFields::Both, numbers().column("regularizer_fields");
        /// Share of near..far in which `occlusion` counts density. Default: 20 of 128 even samples, as FreeNeRF.
        pub occlusion_share: f64 = 0.15625,
            numbers().real(|share| share > 0.0 && share <= 1.0, "over 0, at most 1").columns(&["regularizers"]).same_time();
        /// The rays of `distortion`, `occlusion`, `entropy`, `cauchy`, `opacity-prior` and `orientation`: `training` (the step's own), or
        /// `unseen` (`unseen_rays` of cameras without photographs).
        pub rays: TermRays = TermRays::Training, numbers().columns(&["regularizers"]);
        /// Number of unseen rays in a step, for each of single rays, pairs (`information-gain`), patches of 64
        /// (`depth-smoothness`) and rays to points (`sparse-depth`) that a term needs. Empty = `train.rays`, in whole pairs and patches.
        pub unseen_rays: Option<usize> = None,
            numbers().whole(1, 1 << 20, "1 to 2^20, in whole pairs and patches of 64").columns(&["unseen"]);
        /// Cameras of unseen rays, from the training cameras alone: `box` (in the box around them, looking at what they
        /// look at), `sphere` (around that, as far and at least as high as they are) or `between` (between two of them).
        /// Empty = box for forward-facing scenes, sphere for Blender's, between for captures.
        pub unseen_poses: Option<UnseenPoses> = None, numbers().columns(&["unseen"]).same_time();
    }
    sections {}
}

impl RegularizerConfig {
    /// Returns the points in space of one training step, a function of `seed` and `step`.
    pub fn quadrature(&self, seed: u64, step: u64) -> Quadrature {
        let lattice = Lattice { domain: self.domain, side: self.lattice };
        match self.points {
            LatticePoints::Full => Quadrature::full(lattice),
            LatticePoints::Sampled => Quadrature::draw(lattice, self.points_per_step, self.jitter, seed, step),
        }
    }

    /// Returns the terms with their weights.
    pub fn terms(&self) -> impl Iterator<Item = (Regularizer, f64)> + '_ {
        self.kind.iter().copied().zip(self.weight.iter().copied())
    }

    /// Returns the same with their weights in the step after `step` finished ones.
    pub fn terms_at(&self, step: u64) -> Vec<(Regularizer, f64)> {
        let terms = self.terms().zip(self.schedules());
        terms.map(|((term, weight), schedule)| (term, schedule.at(weight, step))).collect()
    }

    /// Returns what comes after the method's name: ` + tv 8e-5`, and nothing without terms.
    pub fn added(&self) -> String {
        let weight = |weight: f64| if weight < 1e-3 { format!("{weight:e}") } else { weight.to_string() };
        self.terms().map(|(term, of)| format!(" + {} {}", term.name(), weight(of))).collect()
    }

    /// Returns the schedule of each term.
    pub fn schedules(&self) -> impl Iterator<Item = WeightSchedule> + '_ {
        self.schedule.iter().copied().chain(std::iter::repeat(WeightSchedule::Constant)).take(self.kind.len())
    }

    /// Returns whether any term reads rays of cameras without photographs.
    pub fn reads_unseen_cameras(&self) -> bool {
        self.unseen_groups().iter().any(|group| *group != RayGroup::Point)
    }

    /// Returns the groups in which terms read rays without photographs' colours, each once.
    pub fn unseen_groups(&self) -> Vec<RayGroup> {
        let terms: Vec<LossTerm> = self.kind.iter().map(|kind| LossTerm::of(*kind, self)).collect();
        LossTerm::unseen_groups(terms.iter())
    }

    /// Returns whether any term is an integral over the box.
    pub fn has_space_terms(&self) -> bool {
        self.kind.iter().any(|kind| matches!(kind.needs(), TermNeeds::Density(_)))
    }

    /// Returns the box's volume, in cubic units of the points.
    pub fn volume(&self) -> f64 {
        let [low, high] = self.domain;
        low.iter().zip(high).map(|(low, high)| high - low).product()
    }

    /// Fills empty weights, and removes terms of weight 0. Lists of unequal length stay, for [`RegularizerConfig::validate`].
    pub(crate) fn settle(&mut self) {
        if self.weight.is_empty() {
            self.weight = self.kind.iter().map(|kind| LossTerm::default_weight(*kind)).collect();
        }
        if self.weight.len() != self.kind.len() || ![0, self.kind.len()].contains(&self.schedule.len()) {
            return;
        }
        let counts = |(_, weight): &(Regularizer, f64), schedule: &WeightSchedule| {
            *weight != 0.0 || matches!(schedule, WeightSchedule::Linear { from, .. } if *from != 0.0)
        };
        let kept = self.terms().zip(self.schedules()).filter(|(term, schedule)| counts(term, schedule));
        ((self.kind, self.weight), self.schedule) = kept.unzip();
        if self.schedule.iter().all(|schedule| *schedule == WeightSchedule::Constant) {
            self.schedule.clear();
        }
    }

    /// Checks the settings against one another.
    pub(crate) fn validate(&self) -> Result<()> {
        let kinds = &self.kind;
        for (i, kind) in kinds.iter().enumerate() {
            let twice = format!("regularizer.kind names {} twice; name each term once", kind.name());
            refuse(kinds[..i].contains(kind), twice)?;
        }
        let lists = [
            ("weight", self.weight.len(), "number", "the defaults"),
            ("schedule", self.schedule.len(), "schedule", "constant weights"),
        ];
        for (name, count, thing, otherwise) in lists {
            let (found, terms) = (counted(count, thing), counted(kinds.len(), "term"));
            let unequal = format!(
                "regularizer.{name} has {found} and regularizer.kind names {terms}; give one {name} for each term, or none for \
                 {otherwise}"
            );
            refuse(count != 0 && count != kinds.len(), unequal)?;
        }
        if let (Some(rays), Some(group)) = (self.unseen_rays, self.unseen_groups().last()) {
            let (together, of) = (group.rays(), if *group == RayGroup::Patch { "patch" } else { "pair" });
            let allowed = format!("a multiple of {together}, the rays of a {of}");
            require(rays.is_multiple_of(together), "regularizer.unseen_rays", rays, &allowed)?;
        }
        if self.points == LatticePoints::Full {
            return Ok(());
        }
        let (points, lattice) = (self.points_per_step, self.lattice);
        let cells = lattice.pow(3);
        let most = cells.min(MOST_POINTS_PER_STEP);
        let all = format!(" (regularizer.points = \"full\" takes all {cells} cells)");
        let all = if lattice <= MOST_CELLS_A_SIDE { all } else { String::new() };
        let allowed = format!("1 to {most} on a lattice of {lattice} a side{all}");
        require((1..=most).contains(&points), "regularizer.points_per_step", points, &allowed)
    }

    /// Checks that a step of a new run ends. Runs that are there stay readable.
    ///
    /// # Errors
    /// [`Error::Setting`](crate::base::Error::Setting): a term in space takes too many cells.
    pub fn check_lattice(&self) -> Result<()> {
        let is_full = self.has_space_terms() && self.points == LatticePoints::Full;
        let is_too_long = is_full && self.lattice > MOST_CELLS_A_SIDE;
        let allowed = format!(
            "at most {MOST_CELLS_A_SIDE} with regularizer.points = \"full\"; lower it, or set regularizer.points = \"sampled\""
        );
        require(!is_too_long, "regularizer.lattice", self.lattice, &allowed)
    }

    /// Adds the settings without effect.
    pub(crate) fn idle(&self, idle: &mut IdleSettings) {
        let terms = REGULARIZERS.iter().map(|term| term.name()).collect::<Vec<_>>().join(", ");
        let in_space = ["domain", "lattice", "points", "points_per_step", "jitter"];
        let on_rays = ["weight", "schedule", "fields", "occlusion_share", "rays", "unseen_rays", "unseen_poses"];
        let why = format!("regularizer.kind names no term; choose from {terms}");
        let all = [&in_space[..], &on_rays].concat();
        idle.add(Dropped, "regularizer.", &all, self.kind.is_empty(), why);
        let why = "no term of regularizer.kind is an integral over the box";
        idle.add(Dropped, "regularizer.", &in_space, !self.has_space_terms(), why);
        let is_full = self.points == LatticePoints::Full;
        let why = "regularizer.points is \"full\"";
        idle.add(Dropped, "regularizer.", &["points_per_step", "jitter"], is_full, why);
        let occludes = self.kind.contains(&Regularizer::Occlusion);
        let why = "regularizer.kind does not name occlusion";
        idle.add(Dropped, "regularizer.", &["occlusion_share"], !occludes, why);
        let on_single_rays = self.kind.iter().any(|term| term.group() == Some(RayGroup::One));
        let why = "no term of regularizer.kind is computed on single rays; distortion and occlusion are, among others";
        idle.add(Dropped, "regularizer.", &["rays"], !on_single_rays, why);
        let why = "no term of regularizer.kind reads unseen rays; depth-smoothness and information-gain do, and others with \
                   regularizer.rays = \"unseen\"";
        idle.add(Dropped, "regularizer.", &["unseen_rays"], self.unseen_groups().is_empty(), why);
        idle.add(Dropped, "regularizer.", &["unseen_poses"], !self.reads_unseen_cameras(), why);
    }
}

/// Returns a number of things in words: `1 term`, `2 terms`.
fn counted(number: usize, thing: &str) -> String {
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::REGULARIZERS;
    use crate::data::RayGroup;
    use crate::settings::registry::REGISTRY;

    #[test]
    fn the_text_of_rays_names_every_term_on_single_rays() {
        let doc = &REGISTRY.get("regularizer.rays").unwrap().doc;
        for term in REGULARIZERS.iter() {
            let named = doc.contains(&format!("`{}`", term.name()));
            assert_eq!(named, term.group() == Some(RayGroup::One), "{}", term.name());
        }
    }

    #[test]
    fn the_text_of_weights_names_every_default() {
        let doc = &REGISTRY.get("regularizer.weight").unwrap().doc;
        let named = doc.split_once('(').unwrap().1.split_once(')').unwrap().0;
        let named: Vec<(&str, f64)> = named
            .split(", ")
            .map(|pair| pair.split_once(' ').unwrap())
            .map(|(name, w)| (name, w.parse().unwrap()))
            .collect();
        let expected = REGULARIZERS.iter().map(|term| (term.name(), super::LossTerm::default_weight(*term)));
        assert_eq!(named, expected.collect::<Vec<_>>());
    }
}

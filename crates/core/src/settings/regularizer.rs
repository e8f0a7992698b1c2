//! Section `regularizer`: terms of the loss next to the photometric one, on density in space or on rays.

use serde::{Deserialize, Deserializer, Serialize};

use crate::data::RayGroup;
use crate::field::Order;

use super::registry::{choice, numbers, section};
use super::schedule::WeightSchedule;

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
pub const REGULARIZERS: [Regularizer; 14] = [
    Regularizer::L1,
    Regularizer::Tv,
    Regularizer::Laplacian,
    Regularizer::Distortion,
    Regularizer::Occlusion,
    Regularizer::Entropy,
    Regularizer::Cauchy,
    Regularizer::OpacityPrior,
    Regularizer::OpacitySparsity,
    Regularizer::HashDecay,
    Regularizer::DepthSmoothness,
    Regularizer::InformationGain,
    Regularizer::Orientation,
    Regularizer::SparseDepth,
];

/// What a term is computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TermNeeds {
    /// The samples of rays, which come in such groups. Pairs and patches are unseen.
    Samples(RayGroup),
    /// The samples of single rays with density's gradient there.
    Slopes,
    /// Density at points of the box of section `regularizer`, up to this derivative.
    Density(Order),
    /// The tables of hash grids.
    Tables,
}

/// What settings know of a term.
struct Known {
    name: &'static str,
    needs: TermNeeds,
    default_weight: f64,
    is_of_evaluated_pass: bool,
}

const fn known(name: &'static str, needs: TermNeeds, default_weight: f64) -> Known {
    Known { name, needs, default_weight, is_of_evaluated_pass: false }
}

/// The same of a term that counts in the evaluated pass alone.
const fn known_alone(name: &'static str, needs: TermNeeds, default_weight: f64) -> Known {
    Known { is_of_evaluated_pass: true, ..known(name, needs, default_weight) }
}

impl Regularizer {
    /// Name, what it is computed from, and default weight of each term. With that weight a term of the paper has a tenth of
    /// the photometric loss's gradient norm on fern, preset `paper-llff`, after 100 steps. Another scene can need hundreds
    /// of times as much; `augnerf train --balance` measures it. The others have their authors' weights: mip-NeRF 360's,
    /// FreeNeRF's, InfoNeRF's on Blender's scenes with 4 views, SNeRG's, Neural Volumes', PlenOctrees', Zip-NeRF's on the
    /// scenes of mip-NeRF 360, RegNeRF's after its first 512 steps, InfoNeRF's on DTU, FlipNeRF's on
    /// Blender's scenes, and DS-NeRF's.
    fn known(self) -> Known {
        const RAYS: TermNeeds = TermNeeds::Samples(RayGroup::One);
        match self {
            Regularizer::L1 => known("l1", TermNeeds::Density(Order::Density), 1.4e-4),
            Regularizer::Tv => known("tv", TermNeeds::Density(Order::Gradient), 3.8e-6),
            Regularizer::Laplacian => known("laplacian", TermNeeds::Density(Order::Laplacian), 7.4e-9),
            Regularizer::Distortion => known("distortion", RAYS, 0.01),
            Regularizer::Occlusion => known_alone("occlusion", RAYS, 0.01),
            Regularizer::Entropy => known_alone("entropy", RAYS, 1e-3),
            Regularizer::Cauchy => known("cauchy", RAYS, 1e-4),
            Regularizer::OpacityPrior => known("opacity-prior", RAYS, 0.01),
            Regularizer::OpacitySparsity => known("opacity-sparsity", TermNeeds::Density(Order::Density), 1e-3),
            Regularizer::HashDecay => known("hash-decay", TermNeeds::Tables, 0.1),
            Regularizer::DepthSmoothness => known_alone("depth-smoothness", TermNeeds::Samples(RayGroup::Patch), 0.1),
            Regularizer::InformationGain => known_alone("information-gain", TermNeeds::Samples(RayGroup::Pair), 2e-5),
            Regularizer::Orientation => known_alone("orientation", TermNeeds::Slopes, 0.01),
            Regularizer::SparseDepth => known_alone("sparse-depth", TermNeeds::Samples(RayGroup::Point), 0.1),
        }
    }

    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        self.known().name
    }

    /// Returns what the term is computed from.
    pub fn needs(self) -> TermNeeds {
        self.known().needs
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
        self.known().is_of_evaluated_pass
    }

    /// Returns whether the term is an integral over the box of section `regularizer`, of density or its derivatives at
    /// points.
    pub fn in_space(self) -> bool {
        matches!(self.needs(), TermNeeds::Density(_))
    }

    /// Returns whether the term reads density or its derivatives at points, of the box or of rays.
    pub fn reads_points(self) -> bool {
        self.in_space() || self.needs() == TermNeeds::Slopes
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

/// Where cameras without photographs are. All placements are made from the training cameras alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UnseenPoses {
    /// In the box around the training cameras, looking at what they look at (RegNeRF on forward-facing scenes).
    Box,
    /// Around what the training cameras look at, as far away and at least as high as they are (RegNeRF on objects).
    Sphere,
    /// Between two training cameras.
    Between,
}

impl UnseenPoses {
    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            UnseenPoses::Box => "box",
            UnseenPoses::Sphere => "sphere",
            UnseenPoses::Between => "between",
        }
    }
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

choice!(Regularizer, LatticePoints, RegularizedFields, TermRays, UnseenPoses);

const POINTS: &[&str] = &["regularizer_points"];

section! {
    /// Explicit regularizers. The loss gains weight * term for each.
    pub struct RegularizerConfig {
        /// `l1`, `tv`, `laplacian`, `distortion`, `occlusion`, `entropy`, `cauchy`, `opacity-prior`,
        /// `opacity-sparsity`, `hash-decay`, `depth-smoothness`, `information-gain`, `orientation`, `sparse-depth`, or a list of several; empty = none.
        #[serde(deserialize_with = "kinds")]
        pub kind: Vec<Regularizer> = Vec::new(), numbers().columns(&["regularizers"]);
        /// Weight of each term in `kind`: a number, or a list in the same order. Empty = the default of each term (l1
        /// 1.4e-4, tv 3.8e-6, laplacian 7.4e-9, distortion 0.01, occlusion 0.01, entropy 1e-3, cauchy 1e-4,
        /// opacity-prior 0.01, opacity-sparsity 1e-3, hash-decay 0.1, depth-smoothness 0.1, information-gain 2e-5, orientation 0.01, sparse-depth 0.1), which
        /// is for one scene; `augnerf train --balance` measures others. A weight of 0 disables the term, unless its schedule begins elsewhere.
        #[serde(deserialize_with = "weights")]
        pub weight: Vec<f64> = Vec::new(),
            numbers().real(|weight| weight >= 0.0, "0 (off) or positive").columns(&["regularizers"]).same_time();
        /// How each weight moves: `constant`, `from 400 in 512 steps` (from there to the weight) or `halved every 5000
        /// steps` (from the weight on), or a list in the order of `kind`. Empty = constant.
        #[serde(deserialize_with = "schedules")]
        pub schedule: Vec<WeightSchedule> = Vec::new(),
            numbers().allowing("constant, from WEIGHT (at least 0) in N steps, or halved every N steps (N at least 1)")
                .columns(&["regularizers"]).same_time();
        /// Lower and upper corner of the box, in the units of the points (NDC if the scene uses it).
        pub domain: [[f64; 3]; 2] = [[-1.0; 3], [1.0; 3]], numbers().corners().columns(&["regularizer_domain"]);
        /// Cells along each side of the box (N).
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
    /// Returns the terms with their weights.
    pub fn terms(&self) -> impl Iterator<Item = (Regularizer, f64)> + '_ {
        self.kind.iter().copied().zip(self.weight.iter().copied())
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
        let groups = [RayGroup::Point, RayGroup::One, RayGroup::Pair, RayGroup::Patch];
        let reads = |group: &RayGroup| {
            let of_group = |term: &Regularizer| term.group() == Some(*group);
            (*group != RayGroup::One || self.rays == TermRays::Unseen) && self.kind.iter().any(of_group)
        };
        groups.into_iter().filter(reads).collect()
    }

    /// Returns whether any term is an integral over the box.
    pub fn has_space_terms(&self) -> bool {
        self.kind.iter().any(|kind| kind.in_space())
    }

    /// Returns whether any term reads density or its derivatives at points.
    pub fn reads_points(&self) -> bool {
        self.kind.iter().any(|kind| kind.reads_points())
    }

    /// Returns the box's volume, in cubic units of the points.
    pub fn volume(&self) -> f64 {
        let [low, high] = self.domain;
        low.iter().zip(high).map(|(low, high)| high - low).product()
    }

    /// Fills empty weights and removes settings without effect. Those are terms of weight 0, the box if no term is an
    /// integral over it, and the sampling of a grid that is not sampled. Afterwards the configuration equals that of a
    /// run without them.
    pub(super) fn resolve(&mut self) {
        if self.weight.is_empty() {
            self.weight = self.kind.iter().map(|kind| kind.known().default_weight).collect();
        }
        let counts = |(_, weight): &(Regularizer, f64), schedule: &WeightSchedule| {
            *weight != 0.0 || matches!(schedule, WeightSchedule::Linear { from, .. } if *from != 0.0)
        };
        let kept = self.terms().zip(self.schedules()).filter(|(term, schedule)| counts(term, schedule));
        ((self.kind, self.weight), self.schedule) = kept.unzip();
        if self.schedule.iter().all(|schedule| *schedule == WeightSchedule::Constant) {
            self.schedule.clear();
        }
        if self.kind.is_empty() {
            *self = RegularizerConfig::default();
        }
        if !self.has_space_terms() {
            let RegularizerConfig { domain, lattice, points, .. } = RegularizerConfig::default();
            (self.domain, self.lattice, self.points) = (domain, lattice, points);
        }
        if !self.kind.iter().any(|term| term.group() == Some(RayGroup::One)) {
            self.rays = TermRays::Training;
        }
        if self.unseen_groups().is_empty() {
            self.unseen_rays = None;
        }
        if !self.reads_unseen_cameras() {
            self.unseen_poses = None;
        }
        if !self.kind.contains(&Regularizer::Occlusion) {
            self.occlusion_share = RegularizerConfig::default().occlusion_share;
        }
        if self.points == LatticePoints::Full || !self.has_space_terms() {
            let RegularizerConfig { points_per_step, jitter, .. } = RegularizerConfig::default();
            (self.points_per_step, self.jitter) = (points_per_step, jitter);
        }
    }
}

#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "expected l1, tv, laplacian, distortion, occlusion, entropy, cauchy, opacity-prior, opacity-sparsity, \
                hash-decay, depth-smoothness, information-gain, orientation or sparse-depth, or a list such as [\"l1\", \"tv\"]"
)]
enum Kinds {
    One(Regularizer),
    Many(Vec<Regularizer>),
}

fn kinds<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Regularizer>, D::Error> {
    Ok(match Kinds::deserialize(deserializer)? {
        Kinds::One(kind) => vec![kind],
        Kinds::Many(kinds) => kinds,
    })
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected a number, or a list of numbers, one for each of regularizer.kind")]
enum Weights {
    One(f64),
    Many(Vec<f64>),
}

fn weights<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    Ok(match Weights::deserialize(deserializer)? {
        Weights::One(weight) => vec![weight],
        Weights::Many(weights) => weights,
    })
}

#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "expected constant, from WEIGHT in N steps, or halved every N steps, or a list of these, one for each of \
                 regularizer.kind"
)]
enum Schedules {
    One(WeightSchedule),
    Many(Vec<WeightSchedule>),
}

fn schedules<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<WeightSchedule>, D::Error> {
    Ok(match Schedules::deserialize(deserializer)? {
        Schedules::One(schedule) => vec![schedule],
        Schedules::Many(schedules) => schedules,
    })
}

#[cfg(test)]
mod tests {
    use super::REGULARIZERS;
    use crate::data::RayGroup;
    use crate::settings::registry::REGISTRY;

    #[test]
    fn the_text_of_rays_names_every_term_on_single_rays() {
        let doc = &REGISTRY.get("regularizer.rays").unwrap().doc;
        for term in REGULARIZERS {
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
        assert_eq!(named, REGULARIZERS.map(|term| (term.name(), term.known().default_weight)));
    }
}

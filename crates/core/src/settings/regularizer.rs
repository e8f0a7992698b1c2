//! Section `regularizer`: terms of the loss next to the photometric one, on density in space or on rays.

use serde::{Deserialize, Deserializer, Serialize};

use super::registry::{choice, numbers, section};

/// An explicit regularizer: the integral over a box of a quantity at a point (paper, appendix "Implementation of
/// explicit regularization").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Regularizer {
    /// abs(density): sparsity.
    L1,
    /// Length of the density gradient: total variation.
    Tv,
    /// abs(Laplacian of density).
    Laplacian,
    /// Spread of the weights along each ray (mip-NeRF 360, equation 15). The other terms are integrals over a box.
    Distortion,
}

/// All regularizers in their fixed order.
pub const REGULARIZERS: [Regularizer; 4] =
    [Regularizer::L1, Regularizer::Tv, Regularizer::Laplacian, Regularizer::Distortion];

impl Regularizer {
    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Regularizer::L1 => "l1",
            Regularizer::Tv => "tv",
            Regularizer::Laplacian => "laplacian",
            Regularizer::Distortion => "distortion",
        }
    }

    /// Returns whether the term is an integral over the box of section `regularizer`, of density or its derivatives at
    /// points.
    pub fn in_space(self) -> bool {
        self != Regularizer::Distortion
    }

    /// Returns the default weight. The term then has a tenth of the photometric loss's gradient norm on fern, preset
    /// `paper-llff`, after 100 steps. Another scene can need hundreds of times as much; `augnerf balance` measures it.
    /// The distortion loss has mip-NeRF 360's weight.
    fn default_weight(self) -> f64 {
        match self {
            Regularizer::L1 => 1.4e-4,
            Regularizer::Tv => 3.8e-6,
            Regularizer::Laplacian => 7.4e-9,
            Regularizer::Distortion => 0.01,
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

choice!(Regularizer, LatticePoints, RegularizedFields);

const POINTS: &[&str] = &["regularizer_points"];

section! {
    /// Explicit regularizers. The loss gains weight * term for each.
    pub struct RegularizerConfig {
        /// `l1`, `tv`, `laplacian`, `distortion`, or a list of several; empty = none.
        #[serde(deserialize_with = "kinds")]
        pub kind: Vec<Regularizer> = Vec::new(), numbers().columns(&["regularizers"]);
        /// Weight of each term in `kind`: a number, or a list in the same order. Empty = the default of each term (l1
        /// 1.4e-4, tv 3.8e-6, laplacian 7.4e-9, distortion 0.01), which is for one scene; `augnerf balance` measures
        /// others. A weight of 0 disables the term.
        #[serde(deserialize_with = "weights")]
        pub weight: Vec<f64> = Vec::new(),
            numbers().real(|weight| weight >= 0.0, "0 (off) or positive").columns(&["regularizers"]).same_time();
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
    }
    sections {}
}

impl RegularizerConfig {
    /// Returns the terms with their weights.
    pub fn terms(&self) -> impl Iterator<Item = (Regularizer, f64)> + '_ {
        self.kind.iter().copied().zip(self.weight.iter().copied())
    }

    /// Returns whether any term is an integral over the box.
    pub fn has_space_terms(&self) -> bool {
        self.kind.iter().any(|kind| kind.in_space())
    }

    /// Fills empty weights and removes settings without effect. Those are terms of weight 0, the box if no term is an
    /// integral over it, and the sampling of a grid that is not sampled. Afterwards the configuration equals that of a
    /// run without them.
    pub(super) fn resolve(&mut self) {
        if self.weight.is_empty() {
            self.weight = self.kind.iter().map(|kind| kind.default_weight()).collect();
        }
        (self.kind, self.weight) = self.terms().filter(|(_, weight)| *weight != 0.0).unzip();
        if self.kind.is_empty() {
            *self = RegularizerConfig::default();
        }
        if !self.has_space_terms() {
            let RegularizerConfig { domain, lattice, points, .. } = RegularizerConfig::default();
            (self.domain, self.lattice, self.points) = (domain, lattice, points);
        }
        if self.points == LatticePoints::Full || !self.has_space_terms() {
            let RegularizerConfig { points_per_step, jitter, .. } = RegularizerConfig::default();
            (self.points_per_step, self.jitter) = (points_per_step, jitter);
        }
    }
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected l1, tv, laplacian or distortion, or a list such as [\"l1\", \"tv\"]")]
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

#[cfg(test)]
mod tests {
    use super::REGULARIZERS;
    use crate::settings::registry::REGISTRY;

    #[test]
    fn the_text_of_weights_names_every_default() {
        let doc = &REGISTRY.get("regularizer.weight").unwrap().doc;
        let named = doc.split_once('(').unwrap().1.split_once(')').unwrap().0;
        let named: Vec<(&str, f64)> = named
            .split(", ")
            .map(|pair| pair.split_once(' ').unwrap())
            .map(|(name, w)| (name, w.parse().unwrap()))
            .collect();
        assert_eq!(named, REGULARIZERS.map(|term| (term.name(), term.default_weight())));
    }
}

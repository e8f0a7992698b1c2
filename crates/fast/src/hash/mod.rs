//! The multiresolution hash encoding of Instant-NGP (Müller et al. 2022, section 3): features at the vertices of grids
//! of growing resolution, interpolated at a point and concatenated.
//!
//! Level l divides the unit cube into N_l^3 cells, N_l = floor(N_min b^l). If its (N_l + 1)^3 vertices fit into a table
//! of T entries, each has its own. Otherwise a spatial hash (equation 4) selects the entry, and vertices share entries.
//! All tables are consecutive in one array, `[entries, features]`: the encoding's only parameters.
//!
//! Points are `[n, 3]` in the unit cube ([`Domain`] maps scene points there). Encodings and their cotangents are
//! `[n, levels * features]`, level after level. The kernels work in f32 on slices, each on one thread, with one order
//! of operations and of additions. The bits are the same on every CPU. The tests compute the same in f64, as written in the
//! paper.
//!
//! A point that is NaN has an encoding that is NaN. A point outside the cube is in the cell next to it, whose
//! interpolation is extrapolated.

mod adam;
mod cell;
mod domain;
mod encode;
mod gradient;
mod operator;
mod scatter;
#[cfg(test)]
mod tests;
mod vertices;

pub(crate) use adam::Moving;
pub use domain::{Contraction, Domain};
pub use encode::fetch_tables;
pub use operator::Operator;
pub use scatter::EncodingGradients;
pub use vertices::{Real, Vertex};

use serde::{Deserialize, Serialize};

/// Runs a kernel on arrays of `[f32; W]`. Two features, the default, are one pair. Other numbers of features are as
/// many parts of one.
macro_rules! by_features {
    ($features:expr, $width:ident => $kernel:expr) => {
        match $features {
            2 => {
                const $width: usize = 2;
                Processor::here().run($kernel)
            }
            _ => {
                const $width: usize = 1;
                Processor::here().run($kernel)
            }
        }
    };
}
use by_features;

/// How a grid's features are interpolated between the corners of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// Trilinear: continuous, with a gradient that jumps at cell faces.
    #[default]
    Linear,
    /// Trilinear in 3 w^2 - 2 w^3 of each coordinate w. The gradient is continuous, and second derivatives exist.
    Smoothstep,
}

impl Interpolation {
    /// Returns the upper vertex's weight at the position `f` in a cell, with its first and its second derivative.
    fn share(self, f: f64) -> [f64; 3] {
        match self {
            Interpolation::Linear => [f, 1.0, 0.0],
            Interpolation::Smoothstep => [f * f * (3.0 - 2.0 * f), 6.0 * f * (1.0 - f), 6.0 - 12.0 * f],
        }
    }
}

/// One grid of the encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level {
    /// Cells along an axis, N_l.
    pub resolution: u32,
    /// Entries of its table.
    pub entries: usize,
    /// Entries of all tables before it.
    pub offset: usize,
    /// Whether each vertex has an entry of its own.
    pub dense: bool,
}

/// Factors of the spatial hash along y and z; along x it is 1.
const PRIMES: [u32; 2] = [2_654_435_761, 805_459_861];

impl Level {
    /// Returns the entry of a vertex, each coordinate in 0..=resolution.
    pub fn entry(&self, [x, y, z]: [u32; 3]) -> usize {
        let vertices = self.resolution as usize + 1;
        if self.dense {
            return x as usize + vertices * (y as usize + vertices * z as usize);
        }
        let hash = x ^ y.wrapping_mul(PRIMES[0]) ^ z.wrapping_mul(PRIMES[1]);
        hash as usize % self.entries
    }
}

/// The grids of an encoding: sizes, without values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HashGrid {
    levels: Vec<Level>,
    features: usize,
    interpolation: Interpolation,
}

impl HashGrid {
    /// The largest number of features of an entry.
    pub const MOST_FEATURES: usize = 8;
    /// The largest log2 of a table's entries.
    pub const LARGEST_TABLE: u32 = 24;
    /// The finest resolution whose cells f32 positions can tell apart.
    pub const FINEST: u32 = 1 << 20;

    /// Creates grids whose resolution grows from `coarsest` to `finest` by equal factors. Each level has at most
    /// 2^`log2_table` entries of `features` numbers.
    ///
    /// # Panics
    /// If there is no level or no cell, or if `finest` is less than `coarsest` or more than [`HashGrid::FINEST`]. Also
    /// if features or tables are none or more than the largest. Settings are checked before.
    pub fn new(
        levels: usize,
        features: usize,
        log2_table: u32,
        (coarsest, finest): (u32, u32),
        interpolation: Interpolation,
    ) -> HashGrid {
        assert!(levels > 0 && (1..=HashGrid::MOST_FEATURES).contains(&features), "no such hash grid");
        assert!(0 < coarsest && coarsest <= finest && finest <= HashGrid::FINEST, "no such resolutions");
        assert!((1..=HashGrid::LARGEST_TABLE).contains(&log2_table), "no such table");
        let growth = (f64::from(finest) / f64::from(coarsest)).ln() / (levels.max(2) - 1) as f64;
        let mut offset = 0;
        let level = |l: usize| {
            // A whole number may come out a rounding error below itself.
            let resolution = (f64::from(coarsest) * (growth * l as f64).exp() * (1.0 + 1e-12)).floor() as u32;
            let vertices = (u64::from(resolution) + 1).pow(3);
            let entries = vertices.min(1 << log2_table) as usize;
            offset += entries;
            Level { resolution, entries, offset: offset - entries, dense: vertices <= 1 << log2_table }
        };
        HashGrid { levels: (0..levels).map(level).collect(), features, interpolation }
    }

    /// Returns the grids, coarsest first.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Returns the number of features of an entry.
    pub fn features(&self) -> usize {
        self.features
    }

    /// Returns the number of parts of `W` features of an entry. For pairs it is one, which the compiler then knows.
    #[inline(always)]
    fn parts<const W: usize>(&self) -> usize {
        if W == 2 { 1 } else { self.features }
    }

    /// Returns the interpolation of features.
    pub fn interpolation(&self) -> Interpolation {
        self.interpolation
    }

    /// Returns the entries of all tables, the first dimension of the parameters.
    pub fn entries(&self) -> usize {
        self.levels.last().map_or(0, |level| level.offset + level.entries)
    }

    /// Returns the length of a point's encoding.
    pub fn channels(&self) -> usize {
        self.levels.len() * self.features
    }

    /// Checks the sizes, and returns the number of points of `[n, 3]`.
    fn check(&self, tables: usize, points: usize, encoded: usize) -> usize {
        assert_eq!(tables, self.entries() * self.features, "the tables are not this grid's");
        assert!(points.is_multiple_of(3) && encoded == points / 3 * self.channels(), "one encoding a point");
        points / 3
    }
}

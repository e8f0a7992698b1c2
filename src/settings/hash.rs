//! Section `field.hash`: the multiresolution hash grid of a field with `encoding = "hash"` (Mueller et al. 2022).

use serde::{Deserialize, Serialize};

use super::registry::{choice, numbers, section};

/// Most cells along a side of the box.
const FINEST: usize = 1 << 16;

/// How a grid's features are interpolated between the corners of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// Trilinear: continuous, with a gradient that jumps at faces.
    #[default]
    Linear,
    /// Trilinear in 3 w^2 - 2 w^3 of each coordinate w: the gradient is continuous, and there are second derivatives.
    Smoothstep,
}

/// What becomes of points outside the box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Contraction {
    /// Nothing is there: their density is 0.
    None,
    /// Each axis by itself, so that boxes stay boxes: all of space is drawn into twice the box.
    Axes,
    /// All together (Barron et al. 2022, equation 10): all of space is drawn into the ball of twice the box's size.
    Ball,
}

choice!(Interpolation, Contraction);

/// The protocol's column for all of it.
const COLUMN: &[&str] = &["hash_grid"];

section! {
    /// The hash grid of a field with `encoding = "hash"`; read by no other.
    pub struct HashConfig {
        /// Levels (L).
        pub levels: usize = 16, numbers().whole(1, 32, "1 to 32 levels").columns(COLUMN);
        /// Features of an entry (F).
        pub features: usize = 2, numbers().whole(1, 8, "1 to 8 features").columns(COLUMN);
        /// Entries of a level's table at most, as a power of two (log2 T); a level whose grid has fewer corners has one entry for
        /// each.
        pub log2_table: usize = 17, numbers().whole(8, 24, "8 to 24").columns(COLUMN);
        /// Cells along a side of the box at the coarsest level (N_min).
        pub coarsest: usize = 16, numbers().whole(1, 1 << 16, "1 to 65536 cells").columns(COLUMN);
        /// The same at the finest level (N_max). Empty = twice the pixels along the longer side of a picture.
        pub finest: Option<usize> = None,
            numbers().whole(1, 1 << 16, "1 to 65536 cells, at least field.hash.coarsest").columns(COLUMN);
        /// Between the corners of a cell: `linear` or `smoothstep`, which the Laplacian needs.
        pub interpolation: Interpolation = Interpolation::Linear, numbers().columns(COLUMN).same_time();
        /// The box that the grid fills, two corners in scene units (NDC: -1 to 1 is the frustum). Empty = 1.5 to each side of the origin;
        /// NDC: 1.5 to each side, and -1 to 1 along the view axis; with a contraction, the cube that reaches as far as the middle of a ray.
        pub bounds: Option<[[f64; 3]; 2]> = None, numbers().corners().columns(COLUMN).same_time();
        /// What becomes of points outside: `none` (nothing is there), `ball` or `axes` (all of space is drawn into it). Empty = `ball` for
        /// captures without a known extent, `none` otherwise.
        pub contraction: Option<Contraction> = None, numbers().columns(COLUMN).same_time();
    }
    sections {}
}

impl HashConfig {
    /// Fills what depends on the scene: seen in NDC or not, within known bounds or not.
    pub(super) fn resolve(&mut self, ndc: bool, bounded: bool, (near, far): (f64, f64), pixels: usize) {
        self.finest.get_or_insert((2 * pixels).clamp(self.coarsest, FINEST));
        let contraction = if bounded || ndc { Contraction::None } else { Contraction::Ball };
        let contraction = *self.contraction.get_or_insert(contraction);
        let reach = if contraction != Contraction::None { 0.5 * (near + far) } else { 1.5 };
        let depth = if ndc { 1.0 } else { reach };
        self.bounds.get_or_insert([[-reach, -reach, -depth], [reach, reach, depth]]);
    }
}

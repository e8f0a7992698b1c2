//! Section `field.hash`: the multiresolution hash grid of a field with `encoding = "hash"` (Mueller et al. 2022).

use augnerf_fast::hash::{Contraction, Domain, HashGrid, Interpolation};

use crate::base::Result;
use crate::base::settings::require;
use crate::base::settings::{numbers, section};

/// Largest number of cells along a side of the box.
const FINEST: usize = 1 << 16;

/// Shortest side of a box, and its farthest coordinate, in scene units. Coordinates between them are safe to compute
/// with.
const SHORTEST: f64 = 1e-6;
const FARTHEST: f64 = 1e12;

/// The protocol's column for all settings of the grid.
const COLUMN: &[&str] = &["hash_grid"];

section! {
    /// The hash grid of a field with `encoding = "hash"`. Other encodings ignore it.
    pub struct HashConfig {
        /// Number of levels (L).
        pub levels: usize = 16, numbers().whole(1, 32, "1 to 32 levels").columns(COLUMN);
        /// Features per entry (F).
        pub features: usize = 2, numbers().whole(1, 8, "1 to 8 features").columns(COLUMN);
        /// Largest number of entries in a level's table, as a power of two (log2 T). A level whose grid has fewer
        /// corners has one entry per corner.
        pub log2_table: usize = 17, numbers().whole(8, 24, "8 to 24").columns(COLUMN);
        /// Cells along a side of the grid at the coarsest level (N_min).
        pub coarsest: usize = 16, numbers().whole(1, 1 << 16, "1 to 65536 cells").columns(COLUMN);
        /// Cells along a side of the grid at the finest level (N_max). Empty = twice the pixels along the longer side of
        /// an image.
        pub finest: Option<usize> = None,
            numbers().whole(1, 1 << 16, "1 to 65536 cells, at least field.hash.coarsest").columns(COLUMN);
        /// Interpolation between the corners of a cell: `linear` or `smoothstep`. The Laplacian needs `smoothstep`.
        pub interpolation: Interpolation = Interpolation::Linear, numbers().columns(COLUMN);
        /// The box that the grid fills: two corners in scene units (in NDC, -1 to 1 is the frustum). Empty, in NDC: 1.5
        /// to each side of the scene's origin, and -1 to 1 along the view axis. Empty, if the cameras look at a common
        /// region (transforms.json, COLMAP, spherified LLFF): that region. Empty otherwise: 1.5 to each side without a
        /// contraction, and with one half of near + far.
        pub bounds: Option<[[f64; 3]; 2]> = None, numbers().corners().columns(COLUMN);
        /// What happens to points outside: `none` (they are empty), `ball` or `axes` (all of space is contracted into
        /// the grid). Empty = `ball` for captures of unknown extent, `none` otherwise.
        pub contraction: Option<Contraction> = None, numbers().columns(COLUMN);
    }
    sections {}
}

impl HashConfig {
    /// Fills the settings that depend on the scene: whether it is in NDC, and whether its extent is known.
    pub(crate) fn resolve(
        &mut self,
        ndc: bool,
        bounded: bool,
        (near, far): (f64, f64),
        domain: Option<[[f64; 3]; 2]>,
        pixels: usize,
    ) {
        self.finest.get_or_insert((2 * pixels).clamp(self.coarsest, FINEST));
        let contraction = if bounded || ndc { Contraction::None } else { Contraction::Ball };
        let contraction = *self.contraction.get_or_insert(contraction);
        let reach = match contraction {
            // In NDC a ray's `t_vals` are 0 to 1, which is not a length of the box.
            _ if ndc => 1.5,
            Contraction::None => 1.5,
            Contraction::Axes | Contraction::Ball => (0.5 * (near + far)).max(SHORTEST),
        };
        if let Some(domain) = domain.filter(|domain| !ndc && is_sound(*domain)) {
            self.bounds.get_or_insert(domain);
        }
        let depth = if ndc { 1.0 } else { reach };
        self.bounds.get_or_insert([[-reach, -reach, -depth], [reach, reach, depth]]);
    }

    /// Returns the grids, and the space that they cover. Outside of a run the box is 1.5 to each side, and the grid is as
    /// fine as for images of 1,024 pixels.
    pub fn grid(&self) -> (HashGrid, Domain) {
        let resolutions = (self.coarsest as u32, self.finest.unwrap_or(2048) as u32);
        let [low, high] = self.bounds.unwrap_or([[-1.5; 3], [1.5; 3]]);
        let domain = Domain::new(low, high, self.contraction.unwrap_or(Contraction::None));
        (HashGrid::new(self.levels, self.features, self.log2_table as u32, resolutions, self.interpolation), domain)
    }

    /// Checks the settings against one another.
    pub(crate) fn validate(&self) -> Result<()> {
        let HashConfig { coarsest, finest, bounds, .. } = *self;
        if let Some(finest) = finest {
            let allowed = format!("{coarsest} (field.hash.coarsest) to {FINEST}");
            require(finest >= coarsest, "field.hash.finest", finest, &allowed)?;
        }
        let allowed = format!("two corners from -{FARTHEST:e} to {FARTHEST:e}, each side at least {SHORTEST:e} long");
        let bounds = bounds.filter(|bounds| !is_sound(*bounds));
        bounds.map_or(Ok(()), |bounds| require(false, "field.hash.bounds", format!("{bounds:?}"), &allowed))
    }
}

/// Returns whether a box is safe to compute with.
fn is_sound([low, high]: [[f64; 3]; 2]) -> bool {
    low.iter().zip(&high).all(|(low, high)| high - low >= SHORTEST && low.abs().max(high.abs()) <= FARTHEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(contraction: Contraction, ndc: bool, interval: (f64, f64)) -> [[f64; 3]; 2] {
        let mut hash = HashConfig { contraction: Some(contraction), ..HashConfig::default() };
        hash.resolve(ndc, false, interval, None, 100);
        hash.validate().unwrap();
        hash.bounds.unwrap()
    }

    /// A ray's interval is 0 to 1 in NDC, whose frustum is -1 to 1.
    #[test]
    fn the_box_of_a_scene_in_ndc_holds_its_frustum_with_a_contraction_too() {
        for contraction in [Contraction::None, Contraction::Axes, Contraction::Ball] {
            assert_eq!(bounds(contraction, true, (0.0, 1.0)), [[-1.5, -1.5, -1.0], [1.5, 1.5, 1.0]]);
        }
        assert_eq!(bounds(Contraction::None, false, (2.0, 6.0)), [[-1.5; 3], [1.5; 3]]);
        assert_eq!(bounds(Contraction::Ball, false, (2.0, 6.0)), [[-4.0; 3], [4.0; 3]]);
        // The largest and the smallest scenes.
        bounds(Contraction::Ball, false, (0.0, 1e12));
        bounds(Contraction::Axes, false, (0.0, f64::MIN_POSITIVE));
    }
}

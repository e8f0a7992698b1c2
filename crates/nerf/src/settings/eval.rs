//! Section `eval`: evaluation and its images.

use std::ops::RangeInclusive;

use crate::base::settings::{numbers, output, path, section};

/// Cells along each side of a mesh's sampling grid.
pub const MESH_SIDES: RangeInclusive<usize> = 8..=1024;

const MESH: &[&str] = &["mesh"];

section! {
    /// Evaluation and its images.
    pub struct EvalConfig {
        /// Rays rendered at once. It bounds memory, and changes results by rounding only.
        pub chunk: usize = 256, numbers().whole(1, 1 << 20, "1 to 1048576 rays").column("eval_chunk");
        /// Number of training views that every evaluation measures as well: columns `train_psnr`, `gap` and the like (0
        /// = none). They are drawn with `data.views_seed`, and each takes as long as a held-out view. Empty = as many
        /// as held-out views.
        pub train_views: Option<usize> = None, output().columns(&["views_seen"]);
        /// Folder with LPIPS weights. Empty = LPIPS is not measured.
        pub lpips_weights: String = String::new(), path().columns(&["lpips_weights"]);
        /// Number of held-out views that `train` saves as images (0 = none). Metrics always cover all views.
        pub pictures: usize = 4, output();
    }
    sections {
        /// The surface that is compared with a reference mesh.
        pub mesh: MeshConfig;
    }
}

section! {
    /// The level set of density that is measured as the scene's surface: columns `chamfer` and `f_score`.
    pub struct MeshConfig {
        /// Cells along each side of the box: 8 to 1024 (0 = no surface is measured).
        pub resolution: usize = 0,
            output().whole(0, *MESH_SIDES.end() as u64, "0 (no surface), or 8 to 1024 cells a side").columns(MESH);
        /// Density at the surface, 1 / length. Empty = the density that stops half of the light within a ray's mean
        /// sample interval, which the run itself can tell from a surface.
        pub threshold: Option<f64> = None, output().real(|density| density > 0.0, "a positive density").columns(MESH);
        /// Corners of the box, in the units in which the field is queried. Empty = the default of the scene's kind.
        #[serde(rename = "box")]
        pub domain: Option<[[f64; 3]; 2]> = None, output().corners().columns(MESH).key("box");
        /// PLY or OBJ file in scene units that the surface is compared with. Empty = the built-in scene's own surface;
        /// other scenes have none. `none` = the surface is only saved as an image.
        pub reference: String = String::new(), path().columns(MESH);
        /// Number of random points on each surface.
        pub points: usize = 200_000, output().whole(100, 20_000_000, "100 to 20000000").columns(MESH);
        /// Distance threshold of the F-score, in scene units.
        pub at: f64 = 0.02, output().real(|distance| distance > 0.0, "a positive distance").columns(MESH);
    }
    sections {}
}

/// The `eval.mesh.reference` of a surface that is drawn but not compared.
pub const NO_REFERENCE: &str = "none";

impl MeshConfig {
    /// Returns whether a surface is computed and compared with a mesh.
    pub fn is_compared(&self) -> bool {
        self.resolution > 0 && self.reference != NO_REFERENCE
    }
}

//! Section `eval`: evaluation and its pictures.

use std::ops::RangeInclusive;

use super::registry::{numbers, output, path, section};

/// Cells along each side of a mesh's lattice.
pub const MESH_SIDES: RangeInclusive<usize> = 8..=1024;

const MESH: &[&str] = &["mesh"];

section! {
    /// Evaluation and its pictures.
    pub struct EvalConfig {
        /// Rays rendered at once; bounds memory. Changes results by rounding only.
        pub chunk: usize = 256, numbers().whole(1, 1 << 20, "1 to 1048576 rays").column("eval_chunk");
        /// How many training views every evaluation measures, too: columns `train_psnr`, `gap` and their like (0 = none). They
        /// are drawn with `data.views_seed`. Empty = as many as are held out. They take as long as held-out ones.
        pub train_views: Option<usize> = None, output().columns(&["views_seen"]).later();
        /// Folder with LPIPS weights; empty = LPIPS is not measured.
        pub lpips_weights: String = String::new(), path().columns(&["lpips_weights"]);
        /// How many held-out views `train` writes pictures of (0 = none; metrics cover all views).
        pub pictures: usize = 4, output();
    }
    sections {
        /// The surface that is compared with a reference mesh.
        pub mesh: MeshConfig, true;
    }
}

section! {
    /// The level set of density that is measured as the scene's surface: columns `chamfer` and `f_score`.
    pub struct MeshConfig {
        /// Cells along each side of the box: 8 to 1024 (0 = no surface is measured).
        pub resolution: usize = 0,
            output().whole(0, *MESH_SIDES.end() as u64, "0 (no surface), or 8 to 1024 cells a side").columns(MESH);
        /// Density of the surface, 1 / length. Empty = that which stops half of the light within a ray's mean sample
        /// interval: what the run itself can tell from a surface.
        pub threshold: Option<f64> = None, output().real(|density| density > 0.0, "a positive density").columns(MESH);
        /// Corners of the box in the units that the field is queried in. Empty = the scene kind's own.
        #[serde(rename = "box")]
        pub domain: Option<[[f64; 3]; 2]> = None, output().corners().columns(MESH).key("box");
        /// PLY or OBJ file in scene units that the surface is compared with; empty = the embedded scene's own, which
        /// other scenes have not; `none` = it is drawn as a picture alone.
        pub reference: String = String::new(), path().columns(MESH);
        /// Points that are drawn on each surface.
        pub points: usize = 200_000, output().whole(100, 20_000_000, "100 to 20000000").columns(MESH);
        /// Distance of the F-score, scene units.
        pub at: f64 = 0.02, output().real(|distance| distance > 0.0, "a positive distance").columns(MESH);
    }
    sections {}
}

/// The `eval.mesh.reference` of a surface that is drawn and not compared.
pub const NO_REFERENCE: &str = "none";

impl MeshConfig {
    /// A surface is drawn and compared with a mesh.
    pub fn is_compared(&self) -> bool {
        self.resolution > 0 && self.reference != NO_REFERENCE
    }
}

//! Section `sampling.occupancy`: which samples are queried (Mueller et al. 2022, appendix E).

use crate::base::settings::{numbers, section};

/// The protocol's column for all of them.
const COLUMN: &[&str] = &["occupancy"];

section! {
    /// The occupied cells of `sampling.kind = "occupancy"`.
    pub struct OccupancyConfig {
        /// Even intervals of a ray, of which those in occupied cells are queried.
        pub intervals: usize = 256, numbers().whole(8, 4096, "8 to 4096 intervals").columns(COLUMN);
        /// Rays of the first steps. They double with every update of the cells, up to `train.rays`.
        pub first_rays: usize = 64, numbers().whole(1, 1 << 20, "1 to 1048576 rays").columns(COLUMN);
        /// Cells along a side of the hash grid's cube.
        pub cells: usize = 64, numbers().whole(8, 256, "8 to 256 cells").columns(COLUMN);
        /// A cell is empty if the optical depth of an interval in it is below this, and below the mean of all cells.
        pub threshold: f64 = 0.01, numbers().positive().columns(COLUMN);
        /// Factor of a cell's largest depth when it is queried again.
        pub decay: f64 = 0.8, numbers().real(|decay| (0.0..1.0).contains(&decay), "0 to below 1").columns(COLUMN);
        /// Steps between two updates of the cells. An update queries a sixteenth of all at random, and as many
        /// of the occupied ones.
        pub refresh: u64 = 16, numbers().whole(1, 1 << 20, "1 to 1048576 steps").columns(COLUMN);
        /// Number of first steps in which an update queries all cells.
        pub warmup: u64 = 64, numbers().columns(COLUMN);
        /// Samples behind the place where less than this of a ray's light is left are hidden.
        pub transmittance: f64 = 1e-4,
            numbers().real(|left| (0.0..1.0).contains(&left), "0 (none are hidden) to below 1").columns(COLUMN);
    }
    sections {}
}

//! Section `sampling`: samples along a ray.

use super::registry::{numbers, section};

section! {
    /// Samples along a ray.
    pub struct SamplingConfig {
        /// Stratified samples of the coarse pass (MipNeRF and hash grids: intervals).
        pub coarse: usize = 64, numbers().whole(3, 4096, "3 to 4096 samples").column("samples_coarse");
        /// Further inverse-CDF samples of the fine pass, which has `coarse + fine` (MipNeRF and hash grids: its
        /// intervals, `fine` in all; 0 = coarse pass only, not with hash grids).
        pub fine: usize = 64, numbers().whole(0, 4096, "0 (coarse only) to 4096 samples").column("samples_fine");
        /// MipNeRF and hash grids: added to the blurred weights that the fine pass's intervals are drawn from.
        pub resample_padding: f64 = 0.01,
            numbers().real(|padding| padding > 0.0, "positive: where all weights are 0, intervals are drawn from it alone")
                .column("resample_padding").later().same_time();
        /// Jitter in training.
        pub jitter: bool = true, numbers().column("jitter");
        /// Standard deviation of the noise on raw density in training. Empty = 1 for forward-facing
        /// scenes, 0 otherwise.
        pub density_noise: Option<f64> = None, numbers().real(|noise| noise >= 0.0, "0 or positive").column("density_noise");
    }
    sections {}
}

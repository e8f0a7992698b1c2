//! The peak speed of this machine's matrix kernels.

use std::time::Instant;

use rayon::prelude::*;

use crate::fused::kernels::{Matrix, multiply};

/// Returns the GFLOP/s of products of 256 x 256 matrices, with each of rayon's threads on its own. It is the peak of
/// this machine's matrix kernels.
pub fn peak_gflops() -> f64 {
    const SIDE: usize = 256;
    const TIMES: usize = 200;
    let threads = rayon::current_num_threads();
    let values = vec![0.5f32; SIDE * SIDE];
    let matrix = || Matrix::new(&values, SIDE, SIDE, SIDE);
    let round = || {
        let started = Instant::now();
        (0..threads).into_par_iter().for_each(|_| {
            let mut out = vec![0f32; SIDE * SIDE];
            (0..TIMES).for_each(|_| multiply(&mut out, SIDE, matrix(), matrix(), false));
        });
        2e-9 * (threads * TIMES * SIDE * SIDE * SIDE) as f64 / started.elapsed().as_secs_f64()
    };
    (0..4).map(|_| round()).fold(0.0, f64::max)
}

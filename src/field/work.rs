//! Counts what the fused core does.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::fused::kernels::{Matrix, multiply};

static MULTIPLY_ADDS: AtomicU64 = AtomicU64::new(0);
static POINTS: AtomicU64 = AtomicU64::new(0);
static ACTIVE: AtomicU64 = AtomicU64::new(0);

/// What was done since the last [`reset`].
#[derive(Clone, Copy, Debug)]
pub struct Work {
    /// Multiply-adds of matrix products.
    pub multiply_adds: u64,
    /// Points that backward passes were asked for.
    pub points: u64,
    /// Those of them whose gradient was not 0.
    pub active_points: u64,
}

/// Starts counting anew.
pub fn reset() {
    [&MULTIPLY_ADDS, &POINTS, &ACTIVE].into_iter().for_each(|count| count.store(0, Ordering::Relaxed));
}

/// What was done.
pub fn done() -> Work {
    let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
    Work { multiply_adds: load(&MULTIPLY_ADDS), points: load(&POINTS), active_points: load(&ACTIVE) }
}

pub(super) fn count_multiply_adds(count: usize) {
    MULTIPLY_ADDS.fetch_add(count as u64, Ordering::Relaxed);
}

pub(super) fn count_points(points: usize, active: usize) {
    POINTS.fetch_add(points as u64, Ordering::Relaxed);
    ACTIVE.fetch_add(active as u64, Ordering::Relaxed);
}

/// GFLOP/s of products of 256 x 256 matrices, each of rayon's threads on its own: what this machine's
/// matrix kernels can do.
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

//! Chooses the tiles of wide layers by measuring them on the adapter. Products have the same bits in all tiles of f32, so
//! that the choice changes no number.

use std::time::{Duration, Instant};

use augnerf_base::Result;
use wgpu::Buffer;

use crate::device::{Dispatch, Gpu};
use crate::kernels::{Tile, Tiles};
use crate::record::Words;

/// Rows of the product that is measured, and its inputs and outputs.
const ROWS: usize = 16_384;
const WIDTH: usize = 256;
/// Products that are measured at once, and times.
const PRODUCTS: usize = 8;
const TIMES: usize = 3;

/// Returns those of some tiles with which a wide layer takes the shortest time.
///
/// # Panics
/// There are no candidates.
pub(crate) fn fastest(gpu: &Gpu, candidates: &[Tiles]) -> Result<Tiles> {
    Ok(least(candidates.iter().map(|tiles| Ok((seconds(gpu, *tiles)?, *tiles))).collect::<Result<_>>()?))
}

/// Returns the tiles with the shortest time.
fn least(timed: Vec<(Duration, Tiles)>) -> Tiles {
    timed.into_iter().min_by_key(|(took, _)| *took).expect("there are candidates").1
}

fn seconds(gpu: &Gpu, tiles: Tiles) -> Result<Duration> {
    let (a, w, c) = operands(gpu);
    let work: Vec<Dispatch> =
        gpu.checked("measuring tiles", || (0..PRODUCTS).map(|_| product(gpu, tiles, ROWS, &a, &w, &c)).collect())?;
    // The first time pays for compilation.
    let once = || -> Result<Duration> {
        let started = Instant::now();
        gpu.submit(&work);
        gpu.wait()?;
        Ok(started.elapsed())
    };
    once()?;
    (0..TIMES).map(|_| once()).try_fold(Duration::MAX, |least, took| Ok(least.min(took?)))
}

/// Makes rows, weights with a bias, and outputs.
fn operands(gpu: &Gpu) -> (Buffer, Buffer, Buffer) {
    let numbers = |count: usize| -> Vec<f32> { (0..count).map(|i| (i as f32 * 0.37).sin()).collect() };
    (gpu.storage(&numbers(ROWS * WIDTH)), gpu.storage(&numbers((WIDTH + 1) * WIDTH)), gpu.numbers(ROWS * WIDTH))
}

/// Records C = A W + b with a ReLU.
fn product(gpu: &Gpu, tiles: Tiles, rows: usize, a: &Buffer, w: &Buffer, c: &Buffer) -> Dispatch {
    let tile = Tile::of(WIDTH, tiles);
    let words = Words::default().u(rows).u(WIDTH).u(WIDTH).u(0).u(WIDTH).u(1).u(1).u(WIDTH).u(0);
    let words = words.u(WIDTH).u(0).u(1).u(WIDTH).u(0).u(0).u(0);
    let uniform = gpu.uniform(words.words());
    let size = [rows.div_ceil(tile.rows) as u32, WIDTH.div_ceil(tile.columns) as u32, 1];
    gpu.dispatch(&tile.kernel("product"), &[(0, &uniform), (1, a), (3, w), (4, c)], size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[ignore = "a software device compiles large tiles for long"]
    fn all_tiles_of_f32_have_the_same_bits() {
        let gpu = Gpu::open(0).expect("a device; install mesa-vulkan-drivers and libvulkan1");
        let rows = 200;
        let of = |tiles: Tiles| {
            let (a, w, c) = operands(&gpu);
            gpu.submit(&[product(&gpu, tiles, rows, &a, &w, &c)]);
            gpu.read_f32(&c, rows * WIDTH).unwrap()
        };
        let (small, large) = (of(Tiles::Small), of(Tiles::Large));
        assert_eq!(small, large);
        assert!(small.iter().any(|x| *x > 1.0) && small.iter().all(|x| *x >= 0.0));
    }

    #[test]
    fn the_shortest_time_chooses() {
        let [short, long] = [3, 5].map(Duration::from_millis);
        assert_eq!(least(vec![(long, Tiles::Small), (short, Tiles::Large)]), Tiles::Large);
        assert_eq!(least(vec![(short, Tiles::Small), (long, Tiles::Large)]), Tiles::Small);
        let gpu = Gpu::open(0).expect("a device; install mesa-vulkan-drivers and libvulkan1");
        assert!(seconds(&gpu, Tiles::Small).unwrap() > Duration::ZERO);
    }
}

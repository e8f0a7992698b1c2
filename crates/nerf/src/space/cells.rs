//! Work over the cells of a sampling grid, chunk by chunk.

use candle_core::{DType, Device, Tensor};

use super::{Lattice, Quadrature};
use crate::base::Result;
use crate::base::machine::over_parts;
use crate::base::place::is_host;
use crate::field::Density;

/// Points per thread. The activations of a trunk of 8 x 256 then stay in its core's cache.
const CHUNK: usize = 1024;
/// Points per chunk on an accelerator, which needs many.
const DEVICE_CHUNK: usize = 65_536;
/// The same for derivatives of density, of which candle's graph keeps up to 13 tensors `[points, width]` a layer.
const DEVICE_CHUNK_OF_DERIVATIVES: usize = 8192;
/// Largest number of chunks whose gradients are in memory at once.
pub const CHUNKS_AT_ONCE: usize = 16;

/// Computes densities at the midpoints of a sampling grid, in the order of the cells. `take` gets them in parts, so
/// that memory does not grow with the grid.
pub fn densities(density: &dyn Density, lattice: &Lattice, take: impl FnMut(Vec<f32>) -> Result<()>) -> Result<()> {
    let query = |points: &Tensor| {
        let density = density.density(points, lattice.cell_variance())?;
        Ok(density.to_dtype(DType::F32)?.to_vec1::<f32>()?)
    };
    over_cells(density, lattice, query, take)
}

/// Queries a density at the midpoints of a sampling grid, in parts that suit it, in the order of the cells.
pub fn over_cells<T: Send>(
    density: &dyn Density,
    lattice: &Lattice,
    query: impl Fn(&Tensor) -> Result<T> + Sync,
    mut take: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let (points, dtype, device) = (Quadrature::full(*lattice), density.dtype(), density.device());
    let Some(size) = density.at_once() else {
        let size = if is_host(device) { CHUNK } else { DEVICE_CHUNK };
        return over_chunks_of(size, &points, dtype, device, query, take);
    };
    let count = points.count();
    for start in (0..count).step_by(size) {
        take(query(&points.tensor(start, size.min(count - start), dtype, device)?)?)?;
    }
    Ok(())
}

/// Processes items that each take `each` points of a density, in parts that suit it. Returns the results in order.
pub fn over_queries<T: Sync, R: Send>(
    density: &dyn Density,
    items: &[T],
    each: usize,
    work: impl Fn(&[T]) -> Result<R> + Send + Sync,
) -> Result<Vec<R>> {
    match density.at_once() {
        None => over_parts(density.device(), items, CHUNK.div_ceil(each), work),
        Some(size) => items.chunks((size / each).max(1)).map(work).collect(),
    }
}

/// Returns the number of points in a chunk of [`over_chunks`].
pub fn chunk_size(device: &Device) -> usize {
    if is_host(device) { CHUNK } else { DEVICE_CHUNK_OF_DERIVATIVES }
}

/// Processes points of a precision on a device in chunks that suit derivatives of density, some at once, and returns the
/// results in order. Memory does not grow with their number, and the number of threads changes no bit.
pub fn over_chunks<T: Send>(
    points: &Quadrature,
    dtype: DType,
    device: &Device,
    work: impl Fn(&Tensor) -> Result<T> + Sync,
    take: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    over_chunks_of(chunk_size(device), points, dtype, device, work, take)
}

fn over_chunks_of<T: Send>(
    size: usize,
    points: &Quadrature,
    dtype: DType,
    device: &Device,
    work: impl Fn(&Tensor) -> Result<T> + Sync,
    mut take: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let count = points.count();
    let starts: Vec<usize> = (0..count).step_by(size).collect();
    let one = |start: &[usize]| {
        let start = start[0];
        work(&points.tensor(start, size.min(count - start), dtype, device)?)
    };
    for group in starts.chunks(CHUNKS_AT_ONCE) {
        over_parts(device, group, 1, one)?.into_iter().try_for_each(&mut take)?;
    }
    Ok(())
}

//! The machine: memory, host, clocks, the process and what it counts, and work that its threads share.

use candle_core::Device;
use rayon::prelude::*;

use crate::Result;
use crate::place::is_host;

pub mod host;
mod memory;
mod process;
mod work;

pub use host::{Host, Timing, free_memory_mib, host_name, instructions, peak_memory_mib};
pub use memory::MemoryWatch;
pub use process::{in_background, prepare, round_products, with_own_variables};
pub use work::{Counter, count_multiply_adds};

/// Does `work` on parts of so many `items`, the last one perhaps smaller: on a CPU as many at once as there are threads, on
/// another device in turn. The results are in the order of the parts, so that sums over them depend on neither.
///
/// # Errors
/// Those of `work`.
pub fn over_parts<T: Sync, R: Send>(
    device: &Device,
    items: &[T],
    size: usize,
    work: impl Fn(&[T]) -> Result<R> + Sync + Send,
) -> Result<Vec<R>> {
    in_parts(is_host(device), items, size, work)
}

/// Does the same: parts `at_once`, or in turn.
///
/// # Errors
/// Those of `work`.
pub fn in_parts<T: Sync, R: Send>(
    at_once: bool,
    items: &[T],
    size: usize,
    work: impl Fn(&[T]) -> Result<R> + Sync + Send,
) -> Result<Vec<R>> {
    match at_once {
        // One at a time, because the first parts of rays in occupied cells are the longest.
        true => items.par_chunks(size).with_max_len(1).map(work).collect(),
        false => items.chunks(size).map(work).collect(),
    }
}

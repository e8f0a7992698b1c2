//! The machine that a run is computed on: memory, host, clocks.

pub mod allocator;
pub mod host;

pub use host::{Host, Timing, free_memory_mib, host_name, peak_memory_mib};

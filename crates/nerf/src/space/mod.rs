//! Sampling grids, and work over their cells.

mod cells;
mod lattice;

pub use cells::{CHUNKS_AT_ONCE, chunk_size, densities, over_cells, over_chunks, over_queries};
pub use lattice::{Lattice, Quadrature};

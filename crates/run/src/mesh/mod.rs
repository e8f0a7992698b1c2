//! Surfaces: level sets of trained densities, meshes and their files, distances between surfaces.
//!
//! A density field has no surface of its own. A level set, density = threshold, stands for one. Marching cubes computes
//! it from the midpoints of a grid of cells.

mod colouring;
mod level;

pub use augnerf_measure::mesh::*;
pub use colouring::{finish_mesh, in_scene};
pub use level::{DensityRange, Drawing, LevelSet, level_set};

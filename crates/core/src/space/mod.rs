//! Surfaces: level sets of trained densities, meshes and their files, distances between surfaces.
//!
//! A density field has no surface of its own. A level set, density = threshold, stands for one. Marching cubes computes
//! it from the midpoints of a grid of cells.

mod cells;
mod colouring;
mod distance;
mod files;
mod lattice;
mod level;
mod marching;
mod mesh;
mod nearest;
mod shading;

pub use cells::{chunk_count, chunk_size, chunks_at_once, densities, over_cells, over_chunks, over_queries};
pub use colouring::{FinishedMesh, Normals, finish_mesh, in_scene};
pub use distance::{Chamfer, PointCloud, Reference, Score, chamfer, sample};
pub use files::{read_mesh, write_obj, write_ply};
pub use lattice::{Lattice, Quadrature};
pub use level::{DensityRange, Drawing, LevelSet, level_set};
pub use marching::Marcher;
pub use mesh::{Component, Mesh, with_origin};
pub use shading::{Paint, around, resized, shade};

//! Surfaces: level sets of trained densities, meshes and their files, distances between surfaces.
//!
//! A density field has no surface of its own. A level set, density = threshold, stands for one. Marching cubes computes
//! it from the midpoints of a grid of cells.

mod colouring;
mod distance;
mod files;
mod level;
mod marching;
mod nearest;
mod shading;
mod triangles;

pub use colouring::{FinishedMesh, Normals, finish_mesh, in_scene};
pub use distance::{Chamfer, PointCloud, Reference, Score, chamfer, sample};
pub use files::{read_mesh, write_obj, write_ply};
pub use level::{DensityRange, Drawing, LevelSet, level_set};
pub use marching::Marcher;
pub use shading::{Paint, around, resized, shade};
pub use triangles::{Component, Mesh, with_origin};

//! Surfaces: marching cubes, meshes and their files, distances between surfaces.

mod distance;
mod files;
mod marching;
mod nearest;
mod shading;
mod triangles;

pub use distance::{Chamfer, PointCloud, Reference, chamfer, sample};
pub use files::{read_mesh, write_obj, write_ply};
pub use marching::Marcher;
pub use shading::{Paint, around, resized, shade};
pub use triangles::{Component, Mesh, with_origin};

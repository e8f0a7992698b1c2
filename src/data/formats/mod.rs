//! The kinds of scene folders that are read, a module each.

pub mod blender;
pub mod builtin;
pub mod llff;
pub mod transforms;

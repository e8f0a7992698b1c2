//! Meshes as binary little-endian PLY.

use std::io::{Result, Write};

/// Vertices with normals and colours, if known, and triangles.
#[derive(Clone, Copy)]
pub struct Surface<'a> {
    /// Positions.
    pub vertices: &'a [[f32; 3]],
    /// A unit normal per vertex; may be empty.
    pub normals: &'a [[f32; 3]],
    /// RGB per vertex; may be empty.
    pub colours: &'a [[u8; 3]],
    /// Vertex indices.
    pub triangles: &'a [[u32; 3]],
}

impl Surface<'_> {
    /// Writes x, y, z (and nx, ny, nz) as floats, and red, green, blue as bytes. Each line of `comment` is one in the file.
    pub fn write_ply(&self, comment: &str, out: &mut impl Write) -> Result<()> {
        writeln!(out, "ply\nformat binary_little_endian 1.0")?;
        comment.lines().try_for_each(|line| writeln!(out, "comment {line}"))?;
        writeln!(out, "element vertex {}", self.vertices.len())?;
        writeln!(out, "property float x\nproperty float y\nproperty float z")?;
        if !self.normals.is_empty() {
            writeln!(out, "property float nx\nproperty float ny\nproperty float nz")?;
        }
        if !self.colours.is_empty() {
            writeln!(out, "property uchar red\nproperty uchar green\nproperty uchar blue")?;
        }
        writeln!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header", self.triangles.len())?;
        for (index, position) in self.vertices.iter().enumerate() {
            let floats = position.iter().chain(self.normals.get(index).into_iter().flatten());
            floats.into_iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))?;
            if let Some(colour) = self.colours.get(index) {
                out.write_all(colour)?;
            }
        }
        for triangle in self.triangles {
            out.write_all(&[3])?;
            triangle.iter().try_for_each(|i| out.write_all(&i.to_le_bytes()))?;
        }
        Ok(())
    }
}

//! Finishing a level set: scene units, normals and colours.

use candle_core::Tensor;
use serde::Serialize;

use super::Mesh;
use crate::base::{Error, Result};
use crate::data::Ndc;
use crate::data::vector::{Vec3, length, scale};
use crate::field::Density;
use crate::space::{Lattice, over_queries};

/// The source of a mesh's normals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Normals {
    /// The area-weighted mean of the triangles around a vertex: the normals of the mesh's own shape.
    #[default]
    Triangles,
    /// The exact density gradient at the vertex, reversed. It is rough where density is.
    Density,
}

/// A finished mesh.
pub struct FinishedMesh {
    /// In scene units, with normals and colours.
    pub mesh: Mesh,
    /// Vertices with the mean normal of the triangles around them: all, or with [`Normals::Density`] those where
    /// density is flat. An interpolated vertex may be where the field is empty.
    pub flat: usize,
}

/// Finishes the level set of `density` on `lattice`. It converts from NDC to scene units if `ndc` is given. Each vertex
/// gets its outward normal, and the colour that a ray against the normal sees there.
pub fn finish_mesh(
    density: &dyn Density,
    level_set: Mesh,
    lattice: &Lattice,
    ndc: Option<&Ndc>,
    normals: Normals,
) -> Result<FinishedMesh> {
    let queried = level_set.vertices.clone();
    let mut mesh = in_scene(level_set, ndc)?;
    let faces = mesh.face_normals();
    let device = density.device();
    let indices: Vec<usize> = (0..mesh.vertices.len()).collect();
    let one = |part: &[usize]| -> Result<Part> {
        let points: Vec<f32> = part.iter().flat_map(|&i| queried[i]).collect();
        let points = Tensor::from_vec(points, (part.len(), 3), device)?;
        let variance = lattice.cell_variance();
        let slopes = match normals {
            Normals::Triangles => vec![vec![0.0; 3]; part.len()],
            Normals::Density => density.gradient(&points, variance)?.to_vec2::<f32>()?,
        };
        let outward = |(&i, slope): (&usize, &Vec<f32>)| {
            let slope: Vec3 = std::array::from_fn(|axis| f64::from(slope[axis]));
            let slope = ndc.map_or(slope, |ndc| ndc.backward(mesh.vertex(i as u32), slope));
            let flat = length(slope) == 0.0;
            let normal = if flat { faces[i] } else { scale(slope, -1.0) };
            // A vertex with only degenerate triangles has no direction, so that any is right.
            let normal = if length(normal) > 0.0 { scale(normal, 1.0 / length(normal)) } else { [0.0, 0.0, 1.0] };
            (normal.map(|v| v as f32), flat)
        };
        let (normals, flat): (Vec<[f32; 3]>, Vec<bool>) = part.iter().zip(&slopes).map(outward).unzip();
        let eyes: Vec<f32> = normals.iter().flatten().map(|v| -v).collect();
        let eyes = Tensor::from_vec(eyes, (part.len(), 3), device)?;
        let rgb = density.rgb(&points, variance, &eyes)?.to_vec2::<f32>()?;
        let byte = |rgb: Vec<f32>| std::array::from_fn(|c| (rgb[c].clamp(0.0, 1.0) * 255.0).round() as u8);
        Ok((normals, rgb.into_iter().map(byte).collect(), flat.into_iter().filter(|&flat| flat).count()))
    };
    let mut flat = 0;
    for (normals, colours, part_flat) in over_queries(density, &indices, 1, one)? {
        mesh.normals.extend(normals);
        mesh.colours.extend(colours);
        flat += part_flat;
    }
    Ok(FinishedMesh { mesh, flat })
}

/// Normals and colours of some vertices, and the number of flat ones.
type Part = (Vec<[f32; 3]>, Vec<[u8; 3]>, usize);

/// Returns a level set in scene units, converted from NDC if `ndc` is given. It is an error if a vertex is infinitely
/// far away.
pub fn in_scene(level_set: Mesh, ndc: Option<&Ndc>) -> Result<Mesh> {
    let mut mesh = level_set;
    let Some(ndc) = ndc else { return Ok(mesh) };
    for vertex in &mut mesh.vertices {
        let point = vertex.map(f64::from);
        *vertex = ndc.unmap(point).map(|point| point.map(|v| v as f32)).ok_or_else(|| {
            Error::Config(format!(
                "the box reaches beyond z = 1 in normalized device coordinates, which is infinitely far away: the surface has \
                 a vertex at {point:?}; choose a box that ends below 1"
            ))
        })?;
    }
    // The map turns left-handed into right-handed.
    mesh.flip();
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_from_ndc_still_faces_outwards() {
        let corner = [[-0.2, -0.2, -0.2], [0.2, -0.2, -0.2], [-0.2, 0.2, -0.2], [-0.2, -0.2, 0.2]];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        let mesh = Mesh { vertices: corner.to_vec(), triangles, ..Mesh::default() };
        assert!(mesh.volume() > 0.0);
        let ndc = Ndc { width: 40.0, height: 30.0, focal: 35.0 };
        let world = in_scene(mesh.clone(), Some(&ndc)).unwrap();
        assert!(world.volume() > 0.0);
        assert!(world.vertices.iter().all(|v| v[2] < -1.0), "beyond the near plane: {:?}", world.vertices);
        let beyond = Mesh { vertices: vec![[0.0, 0.0, 1.5]; 4], ..mesh };
        assert!(in_scene(beyond, Some(&ndc)).unwrap_err().to_string().contains("below 1"));
    }
}

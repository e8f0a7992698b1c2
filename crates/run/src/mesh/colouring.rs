//! Finishing a level set: scene units, normals and colours.

use candle_core::Tensor;

use super::Mesh;
use crate::base::{Error, Result};
use crate::data::Ndc;
use crate::data::vector::{Vec3, length, scale};
use crate::field::Density;
use crate::space::{Lattice, over_queries};

/// Finishes the level set of `density` on `lattice`. It converts from NDC to scene units if `ndc` is given. Each vertex
/// gets its outward normal, the area-weighted mean of the triangles around it, and the colour that a ray against the normal
/// sees there.
pub fn finish_mesh(density: &dyn Density, level_set: Mesh, lattice: &Lattice, ndc: Option<&Ndc>) -> Result<Mesh> {
    let queried = level_set.vertices.clone();
    let mut mesh = in_scene(level_set, ndc)?;
    // A vertex with only degenerate triangles has no direction, so that any is right.
    let unit = |normal: Vec3| match length(normal) {
        long if long > 0.0 => scale(normal, 1.0 / long),
        _ => [0.0, 0.0, 1.0],
    };
    mesh.normals = mesh.face_normals().into_iter().map(|normal| unit(normal).map(|v| v as f32)).collect();
    let rows = |part: &[usize], of: &dyn Fn(usize) -> [f32; 3]| {
        let values: Vec<f32> = part.iter().flat_map(|&i| of(i)).collect();
        Tensor::from_vec(values, (part.len(), 3), density.device())
    };
    let colours = |part: &[usize]| -> Result<Vec<[u8; 3]>> {
        let points = rows(part, &|i| queried[i])?;
        let eyes = rows(part, &|i| mesh.normals[i].map(|v| -v))?;
        let rgb = density.rgb(&points, lattice.cell_variance(), &eyes)?.to_vec2::<f32>()?;
        let byte = |rgb: Vec<f32>| std::array::from_fn(|c| (rgb[c].clamp(0.0, 1.0) * 255.0).round() as u8);
        Ok(rgb.into_iter().map(byte).collect())
    };
    let indices: Vec<usize> = (0..queried.len()).collect();
    mesh.colours = over_queries(density, &indices, 1, colours)?.concat();
    Ok(mesh)
}

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

//! Indexed triangle meshes.

use std::collections::HashMap;

use augnerf_scenes::vector::{Vec3, add, cross, dot, length, scale, sub};

/// Triangles over shared vertices.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions in scene units, less the origin.
    pub vertices: Vec<[f32; 3]>,
    /// The origin of the positions: 0, or near a mesh that is so far from 0 that single precision would move its vertices.
    pub origin: Vec3,
    /// Outward unit normal at each vertex. Empty for a mesh without normals.
    pub normals: Vec<[f32; 3]>,
    /// RGB at each vertex, 8-bit display values. Empty for a mesh without colours.
    pub colours: Vec<[u8; 3]>,
    /// Vertex indices, anticlockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A mesh farther from 0 than this many of its sizes has an origin of its own, which keeps 17 of 24 bits at least.
const FAR: f64 = 100.0;

/// Returns the positions less an origin, and the origin: 0 along an axis on which the points are near it, otherwise a round
/// number near them.
pub fn with_origin(points: &[Vec3]) -> (Vec<[f32; 3]>, Vec3) {
    let end =
        |axis: usize, pick: fn(f64, f64) -> f64| points.iter().map(|point| point[axis]).reduce(pick).unwrap_or(0.0);
    let ends: [[f64; 2]; 3] = std::array::from_fn(|axis| [end(axis, f64::min), end(axis, f64::max)]);
    let size = ends.iter().map(|[low, high]| high - low).fold(0.0, f64::max);
    let round = 10f64.powi(size.log10().ceil() as i32);
    let origin = ends.map(|[low, high]| {
        let middle = 0.5 * (low + high);
        if size > 0.0 && middle.abs() > FAR * size { (middle / round).round() * round } else { 0.0 }
    });
    (points.iter().map(|point| sub(*point, origin).map(|v| v as f32)).collect(), origin)
}

/// A connected part of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    /// Number of its first vertex.
    pub root: u32,
    /// Number of triangles.
    pub triangles: usize,
    /// Area.
    pub area: f64,
}

impl Mesh {
    /// Returns a vertex in double precision, less the origin.
    pub fn vertex(&self, index: u32) -> Vec3 {
        self.vertices[index as usize].map(f64::from)
    }

    /// Returns the corners of a triangle.
    pub fn corners(&self, triangle: [u32; 3]) -> [Vec3; 3] {
        triangle.map(|index| self.vertex(index))
    }

    /// Returns twice the area of a triangle along its normal.
    pub(super) fn area_vector(&self, triangle: [u32; 3]) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        cross(sub(b, a), sub(c, a))
    }

    /// Iterates over the area of each triangle.
    pub fn areas(&self) -> impl Iterator<Item = f64> {
        self.triangles.iter().map(|&triangle| 0.5 * length(self.area_vector(triangle)))
    }

    /// Returns the area of all triangles.
    pub fn area(&self) -> f64 {
        self.areas().sum()
    }

    /// Returns the volume that a closed mesh encloses. It is positive if triangles face outwards. It has no meaning for
    /// an open mesh.
    pub fn volume(&self) -> f64 {
        // From a vertex of the mesh, so that its distance from the origin costs no precision.
        let Some(origin) = self.triangles.first().map(|t| self.vertex(t[0])) else { return 0.0 };
        let cone = |triangle: &[u32; 3]| {
            let [a, b, c] = self.corners(*triangle).map(|p| sub(p, origin));
            dot(a, cross(b, c)) / 6.0
        };
        self.triangles.iter().map(cone).sum()
    }

    /// Returns the number of directed edges that are not walked once in each direction. It is 0 for a closed and
    /// oriented mesh.
    pub fn open_edges(&self) -> usize {
        let directed = |t: &[u32; 3]| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])];
        // Both directions next to each other: (lower vertex, higher vertex, direction).
        let mut edges: Vec<(u32, u32, bool)> =
            self.triangles.iter().flat_map(directed).map(|(a, b)| (a.min(b), a.max(b), a < b)).collect();
        edges.sort_unstable();
        let same = |a: &(u32, u32, bool), b: &(u32, u32, bool)| (a.0, a.1) == (b.0, b.1);
        let paired = |group: &[(u32, u32, bool)]| group.len() == 2 && group[0].2 != group[1].2;
        edges.chunk_by(same).filter(|group| !paired(group)).map(<[_]>::len).sum()
    }

    /// Returns, for each vertex, the least number of a vertex that it is connected with.
    fn roots(&self) -> Vec<u32> {
        let mut parents: Vec<u32> = (0..self.vertices.len() as u32).collect();
        fn root(parents: &mut [u32], mut at: u32) -> u32 {
            while parents[at as usize] != at {
                parents[at as usize] = parents[parents[at as usize] as usize];
                at = parents[at as usize];
            }
            at
        }
        for &[a, b, c] in &self.triangles {
            for (a, b) in [(a, b), (b, c)] {
                let (a, b) = (root(&mut parents, a), root(&mut parents, b));
                parents[a.max(b) as usize] = a.min(b);
            }
        }
        (0..parents.len() as u32).map(|vertex| root(&mut parents, vertex)).collect()
    }

    /// Returns the connected parts, the one of largest area first.
    pub fn components(&self) -> Vec<Component> {
        let roots = self.roots();
        let mut places = HashMap::new();
        let mut components: Vec<Component> = Vec::new();
        for (triangle, area) in self.triangles.iter().zip(self.areas()) {
            let root = roots[triangle[0] as usize];
            let place = *places.entry(root).or_insert(components.len());
            if place == components.len() {
                components.push(Component { root, triangles: 0, area: 0.0 });
            }
            components[place].triangles += 1;
            components[place].area += area;
        }
        components.sort_by(|a, b| b.area.total_cmp(&a.area).then(a.root.cmp(&b.root)));
        components
    }

    /// Returns the mesh of one component.
    pub fn keep(&self, component: &Component) -> Mesh {
        let roots = self.roots();
        let kept: Vec<usize> = (0..self.vertices.len()).filter(|&i| roots[i] == component.root).collect();
        let mut places = vec![u32::MAX; self.vertices.len()];
        kept.iter().enumerate().for_each(|(new, &old)| places[old] = new as u32);
        fn pick<T: Copy>(values: &[T], kept: &[usize]) -> Vec<T> {
            if values.is_empty() { Vec::new() } else { kept.iter().map(|&i| values[i]).collect() }
        }
        let ours = self.triangles.iter().filter(|t| roots[t[0] as usize] == component.root);
        Mesh {
            vertices: pick(&self.vertices, &kept),
            normals: pick(&self.normals, &kept),
            colours: pick(&self.colours, &kept),
            triangles: ours.map(|t| t.map(|i| places[i as usize])).collect(),
            origin: self.origin,
        }
    }

    /// Returns the area-weighted mean normal of the triangles around each vertex, not normalized.
    pub fn face_normals(&self) -> Vec<Vec3> {
        let mut normals = vec![[0.0; 3]; self.vertices.len()];
        for &triangle in &self.triangles {
            let area = scale(self.area_vector(triangle), 0.5);
            triangle.iter().for_each(|&i| normals[i as usize] = add(normals[i as usize], area));
        }
        normals
    }

    /// Reverses every triangle.
    pub fn flip(&mut self) {
        self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two tetrahedra, the second twice as large.
    fn tetrahedra() -> Mesh {
        let corner = |size: f32, x: f32| [[x, 0.0, 0.0], [x + size, 0.0, 0.0], [x, size, 0.0], [x, 0.0, size]];
        let faces = |first: u32| [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]].map(|t| t.map(|i: u32| i + first));
        Mesh {
            vertices: [corner(1.0, 5.0), corner(2.0, 0.0)].concat(),
            colours: (0..8).map(|i| [i; 3]).collect(),
            triangles: [faces(0), faces(4)].concat(),
            ..Mesh::default()
        }
    }

    #[test]
    fn volume_area_and_parts_are_those_of_tetrahedra() {
        let mesh = tetrahedra();
        assert!((mesh.volume() - (1.0 + 8.0) / 6.0).abs() < 1e-12);
        assert_eq!(mesh.open_edges(), 0);
        let area = |size: f64| size * size * (1.5 + 0.5 * 3f64.sqrt());
        assert!((mesh.area() - area(1.0) - area(2.0)).abs() < 1e-6);
        let parts = mesh.components();
        assert_eq!(parts.iter().map(|part| (part.root, part.triangles)).collect::<Vec<_>>(), [(4, 4), (0, 4)]);
        let largest = mesh.keep(&parts[0]);
        assert_eq!((largest.vertices.len(), largest.open_edges()), (4, 0));
        assert_eq!(largest.colours[0], [4; 3]);
        assert!((largest.volume() - 8.0 / 6.0).abs() < 1e-12);
    }

    #[test]
    fn holes_and_turned_triangles_are_seen() {
        let mut mesh = tetrahedra();
        mesh.triangles.pop();
        assert_eq!(mesh.open_edges(), 3);
        let mut mesh = tetrahedra();
        mesh.triangles[0].swap(0, 1);
        assert_eq!(mesh.open_edges(), 6);
        let mut mesh = tetrahedra();
        mesh.flip();
        assert!((mesh.volume() + 1.5).abs() < 1e-12);
    }
}

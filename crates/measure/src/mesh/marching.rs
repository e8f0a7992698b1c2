//! Marching cubes over a sampling grid that arrives plane by plane (Lorensen and Cline 1987).
//!
//! The classic table of 15 cases leaves holes if two cells disagree about a face whose inside corners are diagonal.
//! This table follows one rule per face, which both of its cells read alike: a face separates each run of inside
//! corners by a segment of its own. The segments of a cell's six faces join to closed loops. Triangles fill the loops
//! without a chord within a face. Each edge of the mesh then belongs to two triangles, and is walked once in each
//! direction. Where the level set leaves the grid, it stays open.

use std::sync::OnceLock;

/// No vertex on this edge of the grid.
const NONE: u32 = u32::MAX;
/// Least distance of vertices from an edge's ends, as a fraction of its length. No triangle then shrinks to a point if
/// a value equals the threshold.
const MARGIN: f64 = 1e-4;

/// A cell's edge, along `axis` from the corner whose bit `axis` is clear.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Edge {
    /// Bit 0 is x, bit 1 y, bit 2 z of a corner.
    corner: usize,
    axis: usize,
}

impl Edge {
    /// Returns the edge between two corners that differ in one bit.
    fn between(a: usize, b: usize) -> Edge {
        Edge { corner: a & b, axis: (a ^ b).trailing_zeros() as usize }
    }

    /// Returns whether both are on one face of the cell.
    fn shares_face(self, other: Edge) -> bool {
        let fixed = |edge: Edge, axis: usize| (edge.axis != axis).then_some(edge.corner >> axis & 1);
        (0..3).any(|axis| fixed(self, axis).is_some() && fixed(self, axis) == fixed(other, axis))
    }
}

/// Returns the triangles for each of the 256 combinations of inside corners.
fn table() -> &'static [Vec<[Edge; 3]>] {
    static TABLE: OnceLock<Vec<Vec<[Edge; 3]>>> = OnceLock::new();
    TABLE.get_or_init(|| (0..256).map(triangles_of).collect())
}

fn triangles_of(inside: usize) -> Vec<[Edge; 3]> {
    let mut segments: Vec<(Edge, Edge)> = (0..6).flat_map(|face| face_segments(inside, face)).collect();
    let mut triangles = Vec::new();
    while let Some((first, mut end)) = segments.pop() {
        let mut polygon = vec![first];
        while end != first {
            polygon.push(end);
            let next = segments.iter().position(|(start, _)| *start == end).expect("segments join to loops");
            end = segments.swap_remove(next).1;
        }
        triangles.extend(fill(&polygon).expect("each loop can be filled without a chord in a face"));
    }
    triangles
}

/// Returns the segments that separate a face's runs of inside corners. Seen from outside of the cell, the inside is on
/// their right.
fn face_segments(inside: usize, face: usize) -> Vec<(Edge, Edge)> {
    let (axis, side) = (face / 2, face % 2);
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let mut ring = [0, u, u | v, v].map(|corner| corner | side << axis);
    // Anticlockwise, seen from outside of the cell.
    if side == 0 {
        ring.reverse();
    }
    let is_inside = |i: usize| inside >> ring[i % 4] & 1 == 1;
    let mut segments = Vec::new();
    for start in (0..4).filter(|&i| is_inside(i) && !is_inside(i + 3)) {
        let last = (start..start + 4).take_while(|&i| is_inside(i)).last().expect("the start is inside");
        let enter = Edge::between(ring[(start + 3) % 4], ring[start]);
        let leave = Edge::between(ring[last % 4], ring[(last + 1) % 4]);
        segments.push((enter, leave));
    }
    segments
}

/// Returns triangles that fill a polygon, without a chord between edges of one face: that face's other cell could have
/// the same chord. `None` if there is no such filling.
fn fill(polygon: &[Edge]) -> Option<Vec<[Edge; 3]>> {
    let last = polygon.len() - 1;
    if last < 2 {
        return Some(Vec::new());
    }
    let clear = |a: usize, b: usize| b - a < 2 || !polygon[a].shares_face(polygon[b]);
    (1..last).filter(|&apex| clear(0, apex) && clear(apex, last)).find_map(|apex| {
        let mut triangles = fill(&polygon[..=apex])?;
        triangles.extend(fill(&polygon[apex..])?);
        triangles.push([polygon[0], polygon[apex], polygon[last]]);
        Some(triangles)
    })
}

/// One plane of the grid, at fixed x.
struct Plane {
    /// `[ny * nz]`, z fastest.
    values: Vec<f32>,
    /// Vertex on the edge from (y, z) to (y + 1, z).
    along_y: Vec<u32>,
    /// Vertex on the edge from (y, z) to (y, z + 1).
    along_z: Vec<u32>,
}

/// Takes the planes of a grid in order, and grows the level set's triangles. It keeps two planes and the mesh. All
/// cells around a vertex share it.
pub struct Marcher {
    /// Points along y and z.
    size: [usize; 2],
    threshold: f32,
    previous: Option<Plane>,
    /// Number of planes so far.
    planes: usize,
    /// In units of the grid: (0, 0, 0) is the first point, (1, 0, 0) that of the next plane.
    pub vertices: Vec<[f32; 3]>,
    /// Vertex indices, anticlockwise seen from the side of lower values.
    pub triangles: Vec<[u32; 3]>,
}

impl Marcher {
    /// Creates a marcher for planes of `size` points along y and z. Values of at least `threshold` are inside.
    pub fn new(size: [usize; 2], threshold: f32) -> Marcher {
        Marcher { size, threshold, previous: None, planes: 0, vertices: Vec::new(), triangles: Vec::new() }
    }

    /// Returns the bytes of a marcher's planes at `size` points along y and z, including a plane that is being filled.
    pub fn plane_bytes([ny, nz]: [usize; 2]) -> usize {
        // Three planes of values, two of them with two edge tables, and one table between them.
        ny * nz * (3 * size_of::<f32>() + 5 * size_of::<u32>())
    }

    /// Returns the bytes of the vertices and triangles so far.
    pub fn mesh_bytes(&self) -> usize {
        size_of_val(self.vertices.as_slice()) + size_of_val(self.triangles.as_slice())
    }

    /// Takes the next plane, `[ny * nz]` finite values, z fastest.
    pub fn push(&mut self, values: Vec<f32>) {
        let [ny, nz] = self.size;
        assert_eq!(values.len(), ny * nz, "a plane has ny * nz values");
        let x = self.planes as f32;
        self.planes += 1;
        let mut plane = Plane { values, along_y: vec![NONE; ny * nz], along_z: vec![NONE; ny * nz] };
        for y in 0..ny {
            for z in 0..nz {
                let (at, from) = (y * nz + z, [x, y as f32, z as f32]);
                if y + 1 < ny {
                    plane.along_y[at] = self.vertex(from, 1, plane.values[at], plane.values[at + nz]);
                }
                if z + 1 < nz {
                    plane.along_z[at] = self.vertex(from, 2, plane.values[at], plane.values[at + 1]);
                }
            }
        }
        if let Some(previous) = self.previous.take() {
            self.cells(&previous, &plane);
        }
        self.previous = Some(plane);
    }

    /// Returns the vertex between the values at `from` and at the next point along `axis`, if the level set passes
    /// there.
    fn vertex(&mut self, from: [f32; 3], axis: usize, a: f32, b: f32) -> u32 {
        if (a >= self.threshold) == (b >= self.threshold) {
            return NONE;
        }
        let [a, b, level] = [a, b, self.threshold].map(f64::from);
        let mut point = from;
        point[axis] += ((level - a) / (b - a)).clamp(MARGIN, 1.0 - MARGIN) as f32;
        self.vertices.push(point);
        (self.vertices.len() - 1) as u32
    }

    /// Adds the triangles of the cells between two planes.
    fn cells(&mut self, low: &Plane, high: &Plane) {
        let [ny, nz] = self.size;
        let x = (self.planes - 2) as f32;
        let mut along_x = vec![NONE; ny * nz];
        for (at, between) in along_x.iter_mut().enumerate() {
            *between = self.vertex([x, (at / nz) as f32, (at % nz) as f32], 0, low.values[at], high.values[at]);
        }
        let planes = [low, high];
        for y in 0..ny.saturating_sub(1) {
            for z in 0..nz.saturating_sub(1) {
                let point = |corner: usize| (y + (corner >> 1 & 1)) * nz + z + (corner >> 2);
                let inside = |corner: usize| planes[corner & 1].values[point(corner)] >= self.threshold;
                let case = (0..8).filter(|&corner| inside(corner)).fold(0, |case, corner| case | 1 << corner);
                let vertex = |edge: Edge| match edge.axis {
                    0 => along_x[point(edge.corner)],
                    1 => planes[edge.corner & 1].along_y[point(edge.corner)],
                    _ => planes[edge.corner & 1].along_z[point(edge.corner)],
                };
                self.triangles.extend(table()[case].iter().map(|triangle| triangle.map(vertex)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use proptest::prelude::*;

    /// The level set 0.5 of values on a lattice of `side`^3 points.
    fn march(side: usize, value: impl Fn([usize; 3]) -> f32) -> Marcher {
        let mut marcher = Marcher::new([side, side], 0.5);
        for x in 0..side {
            marcher.push((0..side * side).map(|i| value([x, i / side, i % side])).collect());
        }
        marcher
    }

    fn mesh(marcher: Marcher) -> Mesh {
        Mesh { vertices: marcher.vertices, triangles: marcher.triangles, ..Mesh::default() }
    }

    #[test]
    fn every_case_uses_all_cut_edges() {
        for (case, triangles) in table().iter().enumerate() {
            let mut used: Vec<(usize, usize)> = triangles.iter().flatten().map(|e| (e.corner, e.axis)).collect();
            used.sort_unstable();
            used.dedup();
            let is_cut = |corner: usize, axis: usize| {
                corner >> axis & 1 == 0 && (case >> corner ^ case >> (corner | 1 << axis)) & 1 == 1
            };
            let mut cut: Vec<_> = (0..24).map(|i| (i / 3, i % 3)).filter(|&(c, a)| is_cut(c, a)).collect();
            cut.sort_unstable();
            assert_eq!(used, cut, "case {case}");
        }
        // A cell with one corner inside, and its complement.
        assert_eq!((table()[1].len(), table()[254].len()), (1, 1));
    }

    #[test]
    fn a_single_inside_point_gives_an_octahedron_that_faces_outwards() {
        let mesh = mesh(march(3, |p| if p == [1; 3] { 1.0 } else { 0.0 }));
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (6, 8));
        assert_eq!(mesh.open_edges(), 0);
        // Half-diagonal 1/2: volume 4/3 * (1/2)^3.
        assert!((mesh.volume() - 4.0 / 3.0 * 0.125).abs() < 1e-6, "{}", mesh.volume());
    }

    proptest! {
        #[test]
        fn any_lattice_with_an_empty_border_gives_a_closed_oriented_mesh(
            values in proptest::collection::vec(prop_oneof![Just(0f32), Just(1.0), Just(0.5), 0f32..1.0], 5 * 5 * 5),
        ) {
            let border = |p: [usize; 3]| p.into_iter().any(|i| i == 0 || i == 6);
            let at = |p: [usize; 3]| values[((p[0] - 1) * 5 + p[1] - 1) * 5 + p[2] - 1];
            let mesh = mesh(march(7, |p| if border(p) { 0.0 } else { at(p) }));
            prop_assert_eq!(mesh.open_edges(), 0);
            let inside = values.iter().filter(|&&v| v >= 0.5).count();
            prop_assert_eq!(mesh.triangles.is_empty(), inside == 0);
            if inside > 0 {
                prop_assert!(mesh.volume() > 0.0, "the mesh is inside out");
            }
            // Every vertex is used, none twice in a triangle.
            let mut used = vec![false; mesh.vertices.len()];
            for t in &mesh.triangles {
                prop_assert!(t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
                t.iter().for_each(|&i| used[i as usize] = true);
            }
            prop_assert!(used.into_iter().all(|used| used));
        }
    }

    /// Volume and area of what lies within `distance` 0 on a lattice of 48 points over [-1, 1]^3.
    fn measured(distance: impl Fn([f64; 3]) -> f64) -> (Mesh, f64, f64) {
        const SIDE: usize = 48;
        let step = 2.0 / (SIDE - 1) as f64;
        let at = |i: usize| -1.0 + step * i as f64;
        let mesh = mesh(march(SIDE, |p| (0.5 - distance(p.map(at)) / step) as f32));
        let (volume, area) = (mesh.volume() * step.powi(3), mesh.area() * step.powi(2));
        (mesh, volume, area)
    }

    #[test]
    fn a_sphere_and_a_torus_have_their_volume_and_area() {
        use std::f64::consts::PI;
        // Linear interpolation errs by the square of cell over radius: 0.04 / 0.2 at the tube.
        let (mesh, volume, area) = measured(|[x, y, z]| (x * x + y * y + z * z).sqrt() - 0.7);
        assert_eq!(mesh.open_edges(), 0);
        assert_eq!(mesh.components().len(), 1);
        assert!((volume / (4.0 / 3.0 * PI * 0.343) - 1.0).abs() < 4e-3, "{volume}");
        assert!((area / (4.0 * PI * 0.49) - 1.0).abs() < 4e-3, "{area}");
        let (mesh, volume, area) = measured(|[x, y, z]| (x.hypot(y) - 0.6).hypot(z) - 0.25);
        assert_eq!(mesh.open_edges(), 0);
        // Vertices - edges + faces: a ring has genus 1.
        assert_eq!(mesh.vertices.len() as i64 - mesh.triangles.len() as i64 / 2, 0);
        assert!((volume / (2.0 * PI * PI * 0.6 * 0.0625) - 1.0).abs() < 1.5e-2, "{volume}");
        assert!((area / (4.0 * PI * PI * 0.6 * 0.25) - 1.0).abs() < 1.5e-2, "{area}");
    }

    #[test]
    fn a_level_set_that_leaves_the_lattice_is_open_there() {
        let mesh = mesh(march(4, |p| if p[0] < 2 { 1.0 } else { 0.0 }));
        assert_eq!((mesh.triangles.len(), mesh.open_edges()), (18, 12));
    }
}

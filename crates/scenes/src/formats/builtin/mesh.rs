//! Triangles of the built-in scene, with every vertex exactly on a surface.

use std::f64::consts::{PI, TAU};
use std::io::Write;
use std::ops::Range;

use super::shapes::{Shape, Solid};
use super::stage::Stage;
use crate::ply;
use crate::vector::Vec3;

/// Facets around each round solid.
const AROUND: usize = 64;
/// Facets from pole to pole of a ball, and around a ring's tube.
const ACROSS: usize = 32;

/// Closed triangle surfaces, one per solid. Where solids touch or overlap, both surfaces are kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions in the still life's units, which are the Blender-style scene's.
    pub vertices: Vec<[f32; 3]>,
    /// Albedo at each vertex, 8-bit display values.
    pub colours: Vec<[u8; 3]>,
    /// Vertex indices, anticlockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// The triangles of each solid, in the order of [`Stage::solids`].
    pub parts: Vec<Range<usize>>,
}

impl Mesh {
    /// Creates the surfaces of every solid of a stage.
    pub fn of(stage: &Stage) -> Mesh {
        of_solids(stage.solids())
    }

    fn append(&mut self, solid: &Solid) {
        let (vertices, triangles) = triangulate(&solid.shape);
        let (first_vertex, first_triangle) = (self.vertices.len() as u32, self.triangles.len());
        self.vertices.extend(vertices.iter().map(|&p| solid.global(p).map(|v| v as f32)));
        let colour = |p: Vec3| solid.material.albedo(p).map(|v| (255.0 * v.powf(1.0 / 2.2)).round() as u8);
        self.colours.extend(vertices.iter().map(|&p| colour(p)));
        self.triangles.extend(triangles.iter().map(|t| t.map(|i| i + first_vertex)));
        self.parts.push(first_triangle..self.triangles.len());
    }

    /// Writes binary little-endian PLY: x, y, z as floats, red, green, blue as bytes.
    pub fn write_ply(&self, out: &mut impl Write) -> std::io::Result<()> {
        let Mesh { vertices, colours, triangles, .. } = self;
        let surface = ply::Surface { vertices, normals: &[], colours, triangles };
        surface.write_ply("surfaces of the augnerf builtin scene", out)
    }
}

/// Creates the surfaces of solids.
pub(super) fn of_solids(solids: &[Solid]) -> Mesh {
    let mut mesh = Mesh::default();
    solids.iter().for_each(|solid| mesh.append(solid));
    mesh
}

type Surface = (Vec<Vec3>, Vec<[u32; 3]>);

fn triangulate(shape: &Shape) -> Surface {
    match *shape {
        Shape::Sphere { radius } => {
            let arc = |i: usize| PI * i as f64 / ACROSS as f64;
            let point = |i: usize| (radius * arc(i).sin(), -radius * arc(i).cos());
            let rings: Vec<_> = (1..ACROSS).map(point).collect();
            revolve(-radius, &rings, radius)
        }
        Shape::Frustum { bottom, top, half_height } => {
            let rings = [(bottom, -half_height), (top, half_height)];
            let rings: Vec<_> = rings.into_iter().filter(|&(radius, _)| radius > 0.0).collect();
            revolve(-half_height, &rings, half_height)
        }
        Shape::Torus { major, minor } => torus(major, minor),
        Shape::Cuboid { half } => cuboid(half),
    }
}

/// Returns a surface of revolution around z: a pole, rings as (radius, z) upwards, a pole.
fn revolve(low: f64, rings: &[(f64, f64)], high: f64) -> Surface {
    let mut vertices = vec![[0.0, 0.0, low]];
    let mut triangles = Vec::new();
    let at = |ring: usize, j: usize| (1 + ring * AROUND + j % AROUND) as u32;
    let last = (1 + rings.len() * AROUND) as u32;
    for (ring, &(radius, z)) in rings.iter().enumerate() {
        for j in 0..AROUND {
            let (s, c) = (TAU * j as f64 / AROUND as f64).sin_cos();
            vertices.push([radius * c, radius * s, z]);
            if ring == 0 {
                triangles.push([0, at(0, j + 1), at(0, j)]);
            } else {
                triangles.extend(quad([at(ring - 1, j), at(ring - 1, j + 1), at(ring, j + 1), at(ring, j)]));
            }
            if ring + 1 == rings.len() {
                triangles.push([at(ring, j), at(ring, j + 1), last]);
            }
        }
    }
    vertices.push([0.0, 0.0, high]);
    (vertices, triangles)
}

fn torus(major: f64, minor: f64) -> Surface {
    let at = |i: usize, j: usize| ((i % AROUND) * ACROSS + j % ACROSS) as u32;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..AROUND {
        let (s, c) = (TAU * i as f64 / AROUND as f64).sin_cos();
        for j in 0..ACROSS {
            let (rise, out) = (TAU * j as f64 / ACROSS as f64).sin_cos();
            let radius = major + minor * out;
            vertices.push([radius * c, radius * s, minor * rise]);
            triangles.extend(quad([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]));
        }
    }
    (vertices, triangles)
}

fn cuboid(half: Vec3) -> Surface {
    let corner = |i: usize| std::array::from_fn(|axis| if i >> axis & 1 == 1 { half[axis] } else { -half[axis] });
    // Bit `axis` of a corner's number is its side. Each face is anticlockwise seen from outside.
    const FACES: [[u32; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    ((0..8).map(corner).collect(), FACES.into_iter().flat_map(quad).collect())
}

fn quad([a, b, c, d]: [u32; 4]) -> [[u32; 3]; 2] {
    [[a, b, c], [a, c, d]]
}

//! The cells of points in a level.

use super::Interpolation;

use super::{Level, PRIMES};
use crate::simd::{LANES, Lanes, Simd};

/// Points that pass through all levels before the next ones. They, their encodings and a level's table stay in near
/// caches.
pub const BLOCK: usize = 512;

/// A block's points by axes, in groups of [`LANES`]. Missing ones in the last group are 0.
pub struct Block {
    groups: [[Lanes; 3]; BLOCK / LANES],
    points: usize,
}

impl Block {
    pub fn empty() -> Block {
        Block { groups: [[[0.0; LANES]; 3]; BLOCK / LANES], points: 0 }
    }

    /// Replaces the points by `points [n, 3]`, n <= [`BLOCK`].
    #[inline(always)]
    pub fn fill(&mut self, points: &[f32]) {
        self.points = points.len() / 3;
        for (group, points) in self.groups.iter_mut().zip(points.chunks(3 * LANES)) {
            if points.len() < 3 * LANES {
                *group = [[0.0; LANES]; 3];
            }
            for (i, point) in points.as_chunks::<3>().0.iter().enumerate() {
                for axis in 0..3 {
                    group[axis][i] = point[axis];
                }
            }
        }
    }

    /// Iterates over each group's first point, number of points, and coordinates.
    #[inline(always)]
    pub fn groups(&self) -> impl Iterator<Item = (usize, usize, &[Lanes; 3])> {
        let points = self.points;
        let starts = (0..points).step_by(LANES);
        starts.zip(&self.groups).map(move |(start, group)| (start, LANES.min(points - start), group))
    }
}

/// The cells of points, and the positions in them.
pub struct Cells<S: Simd> {
    /// Each cell's lowest vertex.
    vertex: [S::Ints; 3],
    /// The position in the cell, 0..1.
    pub position: [S::Floats; 3],
}

impl<S: Simd> Cells<S> {
    /// Returns the cells of points. A point on a face belongs to the cell above it, and on the cube's last face to the
    /// one below.
    #[inline(always)]
    pub fn of(simd: S, level: &Level, points: &[Lanes; 3]) -> Cells<S> {
        let resolution = simd.splat(level.resolution as f32);
        let last = simd.splat((level.resolution - 1) as f32);
        let mut cells = Cells { vertex: [simd.splat_ints(0); 3], position: [simd.splat(0.0); 3] };
        for (axis, points) in points.iter().enumerate() {
            let scaled = simd.mul(simd.load(points), resolution);
            let (vertex, floor) = simd.floor_within(scaled, last);
            cells.vertex[axis] = vertex;
            cells.position[axis] = simd.sub(scaled, floor);
        }
        cells
    }

    /// Returns the entries of the cells' eight vertices, all within the level's table: x changes first, then y, then z.
    #[inline(always)]
    pub fn corners(&self, simd: S, level: &Level) -> [S::Ints; 8] {
        let [x, y, z] = self.vertex;
        let one = simd.splat_ints(1);
        let x1 = simd.add_ints(x, one);
        let mut corners = [x; 8];
        let pairs = corners.as_chunks_mut::<2>().0;
        if level.dense {
            let row = simd.splat_ints(level.resolution + 1);
            let plane = simd.mul_ints(row, row);
            let start = simd.mul_ints(row, simd.add_ints(y, simd.mul_ints(row, z)));
            let above = simd.add_ints(start, plane);
            let edges = [start, simd.add_ints(start, row), above, simd.add_ints(above, row)];
            for (pair, edge) in pairs.iter_mut().zip(edges) {
                *pair = [simd.add_ints(x, edge), simd.add_ints(x1, edge)];
            }
        } else {
            let mask = simd.splat_ints(level.entries as u32 - 1);
            let primes = [simd.splat_ints(PRIMES[0]), simd.splat_ints(PRIMES[1])];
            let (y, z) = (simd.mul_ints(y, primes[0]), simd.mul_ints(z, primes[1]));
            let (y1, z1) = (simd.add_ints(y, primes[0]), simd.add_ints(z, primes[1]));
            let edges = [simd.xor(y, z), simd.xor(y1, z), simd.xor(y, z1), simd.xor(y1, z1)];
            for (pair, edge) in pairs.iter_mut().zip(edges) {
                *pair = [simd.and(simd.xor(x, edge), mask), simd.and(simd.xor(x1, edge), mask)];
            }
        }
        corners
    }
}

/// Returns the position of a part of the eight entries, given its number and the number of parts. For pairs an entry
/// has one part.
#[inline(always)]
pub fn of_part<const W: usize, S: Simd>(
    simd: S,
    mut entries: [S::Ints; 8],
    (part, parts): (usize, usize),
) -> [S::Ints; 8] {
    if W != 2 {
        for entry in &mut entries {
            let first = simd.mul_ints(*entry, simd.splat_ints(parts as u32));
            *entry = simd.add_ints(first, simd.splat_ints(part as u32));
        }
    }
    entries
}

/// Returns each of a part's features at the cells' eight vertices.
#[inline(always)]
pub fn gather_corners<const W: usize, S: Simd>(
    simd: S,
    level: &Level,
    table: &[[f32; W]],
    entries: [S::Ints; 8],
    (part, parts): (usize, usize),
) -> [[S::Floats; 8]; W] {
    assert!(table.len() >= level.entries * parts && part < parts);
    let corners = of_part::<W, S>(simd, entries, (part, parts));
    let mut features = [[simd.splat(0.0); 8]; W];
    for k in 0..8 {
        // SAFETY: the corners are within the level's entries, and the table has all parts of those.
        let corner = unsafe { simd.gather(table, corners[k]) };
        for feature in 0..W {
            features[feature][k] = corner[feature];
        }
    }
    features
}

/// Interleaves the features of each lane.
#[inline(always)]
pub fn interleaved<const W: usize, S: Simd>(simd: S, features: [S::Floats; W]) -> [[f32; W]; LANES] {
    let mut rows = [[0.0; W]; LANES];
    for (feature, values) in features.into_iter().enumerate() {
        for (row, value) in rows.iter_mut().zip(simd.store(values)) {
            row[feature] = value;
        }
    }
    rows
}

impl Level {
    /// Returns its part of all tables, whose entries have this many parts.
    #[inline(always)]
    pub fn table<'a, const W: usize>(&self, tables: &'a [[f32; W]], parts: usize) -> &'a [[f32; W]] {
        &tables[self.offset * parts..][..self.entries * parts]
    }
}

impl Interpolation {
    /// Returns the upper vertex's weight at a position in a cell.
    #[inline(always)]
    pub(super) fn shares<S: Simd>(self, simd: S, mut position: [S::Floats; 3]) -> [S::Floats; 3] {
        for f in &mut position {
            *f = match self {
                Interpolation::Linear => *f,
                Interpolation::Smoothstep => {
                    simd.mul(simd.mul(*f, *f), simd.neg_mul_add(simd.splat(2.0), *f, simd.splat(3.0)))
                }
            };
        }
        position
    }

    /// Returns the derivative of the weight.
    #[inline(always)]
    pub(super) fn slopes<S: Simd>(self, simd: S, mut position: [S::Floats; 3]) -> [S::Floats; 3] {
        for f in &mut position {
            *f = match self {
                Interpolation::Linear => simd.splat(1.0),
                Interpolation::Smoothstep => simd.mul(simd.mul(simd.splat(6.0), *f), simd.sub(simd.splat(1.0), *f)),
            };
        }
        position
    }

    /// Returns the second derivative of the weight.
    #[inline(always)]
    pub(super) fn bends<S: Simd>(self, simd: S, mut position: [S::Floats; 3]) -> [S::Floats; 3] {
        for f in &mut position {
            *f = match self {
                Interpolation::Linear => simd.splat(0.0),
                Interpolation::Smoothstep => simd.neg_mul_add(simd.splat(12.0), *f, simd.splat(6.0)),
            };
        }
        position
    }
}

/// Returns `(1 - share) a + share b`: a where the weight is 0 and b where it is 1, bit for bit.
#[inline(always)]
pub fn mix<S: Simd>(simd: S, share: S::Floats, a: S::Floats, b: S::Floats) -> S::Floats {
    simd.mul_add(share, b, simd.neg_mul_add(share, a, a))
}

/// Interpolates along x between the vertices of a cell's four edges in that direction.
#[inline(always)]
pub fn mix_edges<S: Simd>(simd: S, x: S::Floats, corners: &[S::Floats; 8]) -> [S::Floats; 4] {
    let mut edges = [x; 4];
    for (edge, [a, b]) in edges.iter_mut().zip(corners.as_chunks::<2>().0) {
        *edge = mix(simd, x, *a, *b);
    }
    edges
}

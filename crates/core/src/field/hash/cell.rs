//! The cells of points in a level.

use crate::settings::Interpolation;

use super::simd::{LANES, Lanes, Simd};
use super::{Level, PRIMES};

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
        let axis = |points: &Lanes| {
            let scaled = simd.mul(simd.load(points), resolution);
            let (vertex, floor) = simd.floor_within(scaled, last);
            (vertex, simd.sub(scaled, floor))
        };
        let [x, y, z] = [axis(&points[0]), axis(&points[1]), axis(&points[2])];
        Cells { vertex: [x.0, y.0, z.0], position: [x.1, y.1, z.1] }
    }

    /// Returns the entries of the cells' eight vertices, all within the level's table: x changes first, then y, then z.
    #[inline(always)]
    pub fn corners(&self, simd: S, level: &Level) -> [S::Ints; 8] {
        let [x, y, z] = self.vertex;
        let add = |a, b| simd.add_ints(a, b);
        let one = simd.splat_ints(1);
        if level.dense {
            let row = simd.splat_ints(level.resolution + 1);
            let plane = simd.mul_ints(row, row);
            let a = add(x, simd.mul_ints(row, add(y, simd.mul_ints(row, z))));
            let (b, c) = (add(a, row), add(a, plane));
            let d = add(b, plane);
            return [a, add(a, one), b, add(b, one), c, add(c, one), d, add(d, one)];
        }
        let mask = simd.splat_ints(level.entries as u32 - 1);
        let primes = [simd.splat_ints(PRIMES[0]), simd.splat_ints(PRIMES[1])];
        let (x1, y, z) = (add(x, one), simd.mul_ints(y, primes[0]), simd.mul_ints(z, primes[1]));
        let (y1, z1) = (add(y, primes[0]), add(z, primes[1]));
        let edges = [simd.xor(y, z), simd.xor(y1, z), simd.xor(y, z1), simd.xor(y1, z1)];
        let entry = |x, edge: usize| simd.and(simd.xor(x, edges[edge]), mask);
        [entry(x, 0), entry(x1, 0), entry(x, 1), entry(x1, 1), entry(x, 2), entry(x1, 2), entry(x, 3), entry(x1, 3)]
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

/// Returns a part's features at the cells' eight vertices.
#[inline(always)]
pub fn gather_corners<const W: usize, S: Simd>(
    simd: S,
    level: &Level,
    table: &[[f32; W]],
    entries: [S::Ints; 8],
    (part, parts): (usize, usize),
) -> [[S::Floats; W]; 8] {
    assert!(table.len() >= level.entries * parts && part < parts);
    let corners = of_part::<W, S>(simd, entries, (part, parts));
    let mut features = [[simd.splat(0.0); W]; 8];
    for k in 0..8 {
        // SAFETY: the corners are within the level's entries, and the table has all parts of those.
        features[k] = unsafe { simd.gather(table, corners[k]) };
    }
    features
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
    pub fn shares<S: Simd>(self, simd: S, position: [S::Floats; 3]) -> [S::Floats; 3] {
        let share = |f| match self {
            Interpolation::Linear => f,
            Interpolation::Smoothstep => {
                simd.mul(simd.mul(f, f), simd.neg_mul_add(simd.splat(2.0), f, simd.splat(3.0)))
            }
        };
        [share(position[0]), share(position[1]), share(position[2])]
    }

    /// Returns the derivative of the weight.
    #[inline(always)]
    pub fn slopes<S: Simd>(self, simd: S, position: [S::Floats; 3]) -> [S::Floats; 3] {
        let slope = |f| match self {
            Interpolation::Linear => simd.splat(1.0),
            Interpolation::Smoothstep => simd.mul(simd.mul(simd.splat(6.0), f), simd.sub(simd.splat(1.0), f)),
        };
        [slope(position[0]), slope(position[1]), slope(position[2])]
    }

    /// Returns the second derivative of the weight.
    #[inline(always)]
    pub fn bends<S: Simd>(self, simd: S, position: [S::Floats; 3]) -> [S::Floats; 3] {
        let bend = |f| match self {
            Interpolation::Linear => simd.splat(0.0),
            Interpolation::Smoothstep => simd.neg_mul_add(simd.splat(12.0), f, simd.splat(6.0)),
        };
        [bend(position[0]), bend(position[1]), bend(position[2])]
    }
}

/// Returns `(1 - share) a + share b`: a where the weight is 0 and b where it is 1, bit for bit.
#[inline(always)]
pub fn mix<S: Simd>(simd: S, share: S::Floats, a: S::Floats, b: S::Floats) -> S::Floats {
    simd.mul_add(share, b, simd.neg_mul_add(share, a, a))
}

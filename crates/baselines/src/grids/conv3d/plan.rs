//! The cells that each row of a convolution reads.

use std::ops::Range;

use rayon::prelude::*;

/// A cell that a row reads, and its matrix.
pub(super) struct Tap {
    pub(super) weight: usize,
    /// The grid of the cell.
    pub(super) source: usize,
    /// Row `r` reads cell `stride * r + offset`.
    pub(super) offset: [isize; 3],
}

/// Rows that read alike: a grid of their own, `spread` cells of the result apart.
pub(super) struct Group {
    pub(super) cells: [usize; 3],
    /// In the order of source and offset.
    pub(super) taps: Vec<Tap>,
}

/// A convolution as products over taps. Sources, and the rows of groups, are consecutive in memory.
pub(super) struct Plan {
    pub(super) sources: Vec<[usize; 3]>,
    pub(super) stride: usize,
    /// One for each corner of a cube of `spread` cells, in the order of [`cube`].
    pub(super) groups: Vec<Group>,
    /// Of the result.
    pub(super) sides: [usize; 3],
    pub(super) spread: usize,
}

/// Iterates over the cells of a cube, x fastest.
pub(super) fn cube(side: usize) -> impl Iterator<Item = [usize; 3]> {
    (0..side * side * side).map(move |flat| [flat / (side * side), flat / side % side, flat % side])
}

pub(super) fn count(sides: [usize; 3]) -> usize {
    sides.iter().product()
}

const AXES: [usize; 3] = [0, 1, 2];

/// Returns start and end of consecutive blocks.
pub(super) fn blocks(lengths: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
    let mut end = 0;
    lengths
        .map(|length| {
            end += length;
            end - length..end
        })
        .collect()
}

impl Plan {
    /// Pads as TensorFlow's `same`. With stride 2 the dilation must be 1 and sides even: settings have no others.
    pub(super) fn convolution(sides: [usize; 3], stride: usize, dilation: usize) -> Plan {
        let out = sides.map(|side| side.div_ceil(stride));
        let before = if stride == 1 { dilation as isize } else { 0 };
        let offset = |at: [usize; 3]| AXES.map(|axis| (at[axis] * dilation) as isize - before);
        let taps = cube(3).enumerate().map(|(weight, at)| Tap { weight, source: 0, offset: offset(at) }).collect();
        Plan { sources: vec![sides], stride, groups: vec![Group { cells: out, taps }], sides: out, spread: 1 }
    }

    /// Also returns the position of each tap in the kernel.
    pub(super) fn transposed(sides: [usize; 3]) -> (Plan, Vec<[usize; 3]>) {
        // Output 2m + parity reads input m + offset through position k of the kernel where 2m + parity + 1 = 2 (m + offset) + k.
        const READS: [[(usize, isize); 2]; 2] = [[(3, -1), (1, 0)], [(2, 0), (0, 1)]];
        let mut kernel = Vec::new();
        let groups = cube(2).map(|parity| {
            let taps = cube(2).map(|which| {
                let read = |axis: usize| READS[parity[axis]][which[axis]];
                kernel.push(AXES.map(|axis| read(axis).0));
                Tap { weight: kernel.len() - 1, source: 0, offset: AXES.map(|axis| read(axis).1) }
            });
            Group { cells: sides, taps: taps.collect() }
        });
        let groups = groups.collect();
        (Plan { sources: vec![sides], stride: 1, groups, sides: sides.map(|side| 2 * side), spread: 2 }, kernel)
    }

    /// Returns the plan of the source's gradient, which reads this plan's rows where this one reads its source.
    pub(super) fn reversed(&self) -> Plan {
        let step = self.stride as isize;
        let groups = cube(self.stride).map(|first| {
            let mut taps = Vec::new();
            for (source, group) in self.groups.iter().enumerate() {
                for tap in &group.taps {
                    let gap = AXES.map(|axis| first[axis] as isize - tap.offset[axis]);
                    if gap.iter().all(|gap| gap.rem_euclid(step) == 0) {
                        taps.push(Tap { weight: tap.weight, source, offset: gap.map(|gap| gap.div_euclid(step)) });
                    }
                }
            }
            taps.sort_by_key(|tap| (tap.source, tap.offset));
            let cells = AXES.map(|axis| (self.sources[0][axis] + self.stride - 1 - first[axis]) / self.stride);
            Group { cells, taps }
        });
        Plan {
            groups: groups.collect(),
            sources: self.groups.iter().map(|group| group.cells).collect(),
            stride: 1,
            sides: self.sources[0],
            spread: self.stride,
        }
    }

    /// Returns the range of each group's rows.
    pub(super) fn rows(&self) -> Vec<Range<usize>> {
        blocks(self.groups.iter().map(|group| count(group.cells)))
    }

    /// Returns the range of each source's cells.
    pub(super) fn cells(&self) -> Vec<Range<usize>> {
        blocks(self.sources.iter().map(|sides| count(*sides)))
    }

    /// Returns, for each group of a line of the result, the row of its first cell.
    fn line(&self, rows: &[Range<usize>], z: usize, y: usize) -> Vec<usize> {
        let spread = self.spread;
        let starts = (0..spread).map(|x| {
            let group = (z % spread * spread + y % spread) * spread + x;
            let [_, height, width] = self.groups[group].cells;
            rows[group].start + (z / spread * height + y / spread) * width
        });
        starts.collect()
    }

    /// Returns the result's cells in order, from rows that are sorted by group.
    pub(super) fn interleaved(&self, rows: Vec<f32>, channels: usize) -> Vec<f32> {
        if self.spread == 1 || channels == 0 {
            return rows;
        }
        let blocks = self.rows();
        let [_, height, width] = self.sides;
        let mut out = vec![0f32; rows.len()];
        out.par_chunks_mut(width * channels).enumerate().for_each(|(line, out)| {
            let starts = self.line(&blocks, line / height, line % height);
            for (x, out) in out.chunks_exact_mut(channels).enumerate() {
                let row = starts[x % self.spread] + x / self.spread;
                out.copy_from_slice(&rows[row * channels..][..channels]);
            }
        });
        out
    }

    /// Returns the gradient of the rows, sorted by group, before negative ones were multiplied by `slope`.
    pub(super) fn deinterleaved(&self, gradient: &[f32], out: &[f32], channels: usize, slope: f32) -> Vec<f32> {
        let mut rows = vec![0f32; gradient.len()];
        let of = |into: &mut [f32], cell: usize| {
            let cells = cell * channels..(cell + 1) * channels;
            let pairs = gradient[cells.clone()].iter().zip(&out[cells]);
            into.iter_mut().zip(pairs).for_each(|(into, (g, out))| *into = if *out > 0.0 { *g } else { slope * g });
        };
        let [_, height, width] = self.sides;
        let mut rest = &mut rows[..];
        let mut lines = Vec::new();
        for (group, first) in self.groups.iter().zip(cube(self.spread)) {
            for line in 0..group.cells[0] * group.cells[1] {
                let (into, after) = std::mem::take(&mut rest).split_at_mut(group.cells[2] * channels);
                let [z, y] = [line / group.cells[1], line % group.cells[1]];
                let start = ((self.spread * z + first[0]) * height + self.spread * y + first[1]) * width + first[2];
                lines.push((start, into));
                rest = after;
            }
        }
        lines.into_par_iter().for_each(|(start, into)| {
            let cells = into.chunks_exact_mut(channels.max(1)).enumerate();
            cells.for_each(|(x, into)| of(into, start + self.spread * x));
        });
        rows
    }
}

impl Group {
    /// Returns z, y and x of a row.
    pub(super) fn place(&self, row: usize) -> [usize; 3] {
        let [_, height, width] = self.cells;
        [row / (height * width), row / width % height, row % width]
    }

    /// Returns runs of taps that read a cell of their source for any of the rows.
    pub(super) fn live(&self, plan: &Plan, rows: &Range<usize>) -> Vec<Range<usize>> {
        let (first, last) = (self.place(rows.start), self.place(rows.end - 1));
        let mut whole = false;
        let spans = AXES.map(|axis| {
            let span = if whole { (0, self.cells[axis] - 1) } else { (first[axis], last[axis]) };
            whole |= first[axis] != last[axis];
            span
        });
        let meets = |tap: &Tap| {
            AXES.into_iter().all(|axis| {
                let at = |row: usize| (plan.stride * row) as isize + tap.offset[axis];
                at(spans[axis].0) < plan.sources[tap.source][axis] as isize && at(spans[axis].1) >= 0
            })
        };
        let mut runs: Vec<Range<usize>> = Vec::new();
        for (index, _) in self.taps.iter().enumerate().filter(|(_, tap)| meets(tap)) {
            match runs.last_mut() {
                Some(run) if run.end == index => run.end += 1,
                _ => runs.push(index..index + 1),
            }
        }
        runs
    }
}

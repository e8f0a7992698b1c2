//! The convolution in f32: tiles of rows, with the cells of their taps gathered, times the weights.

use std::ops::Range;

use rayon::prelude::*;

use augnerf_fast::fused::kernels::{Matrix, multiply};

use super::plan::{Group, Plan, blocks, count};

/// Most numbers that a tile gathers: the size of a core's cache.
const TILE: usize = 1 << 18;
/// Fewest and most rows of a tile.
const ROWS: (usize, usize) = (64, 256);
/// Parts of a gradient over many rows, which are summed in order.
const PARTS: usize = 8;
/// Rows with fewer numbers than this are multiplied with several matrices at once.
const FEW: usize = 32;

/// The right side: for each tap a matrix `[channels, outputs]`.
pub(super) enum Rhs<'a> {
    /// Unchanged, in the order of taps.
    Straight(&'a [f32]),
    /// The transposed ones of a reversed plan, from the taps' `weight`.
    Turned(&'a [f32]),
    /// The same, packed in the order of each group's taps.
    Packed(Vec<Vec<f32>>),
}

impl Rhs<'_> {
    /// Returns the transposed matrices of `weight [taps, inputs, outputs]` for the plan of the input's gradient.
    pub(super) fn turned<'a>(weight: &'a [f32], reversed: &Plan, inputs: usize, outputs: usize) -> Rhs<'a> {
        if outputs >= FEW {
            return Rhs::Turned(weight);
        }
        let of_group = |group: &Group| {
            let mut packed = Vec::with_capacity(group.taps.len() * inputs * outputs);
            for tap in &group.taps {
                let matrix = &weight[tap.weight * inputs * outputs..][..inputs * outputs];
                (0..outputs).for_each(|out| packed.extend((0..inputs).map(|input| matrix[input * outputs + out])));
            }
            packed
        };
        Rhs::Packed(reversed.groups.iter().map(of_group).collect())
    }
}

/// Returns the number of rows in a tile, for this many numbers per row.
fn tile(numbers: usize) -> usize {
    (TILE / numbers.max(1)).clamp(ROWS.0, ROWS.1)
}

/// Iterates over the tiles of a group's rows.
fn tiles(group: &Group, channels: usize) -> impl Iterator<Item = Range<usize>> + use<> {
    let (rows, tile) = (count(group.cells), tile(group.taps.len() * channels));
    (0..rows).step_by(tile).map(move |start| start..(start + tile).min(rows))
}

/// Returns the rows of all groups. `finish` is applied to each while it is in the cache. `source` has `channels`
/// numbers per cell.
pub(super) fn product(
    plan: &Plan,
    source: &[f32],
    channels: usize,
    right: &Rhs,
    outputs: usize,
    finish: &(impl Fn(&mut [f32]) + Sync),
) -> Vec<f32> {
    let rows = plan.rows().last().map_or(0, |last| last.end);
    let mut out = vec![0f32; rows * outputs];
    let (mut work, mut rest) = (Vec::new(), &mut out[..]);
    for (index, group) in plan.groups.iter().enumerate() {
        for rows in tiles(group, channels) {
            let (tile, after) = std::mem::take(&mut rest).split_at_mut(rows.len() * outputs);
            work.push((index, rows, tile));
            rest = after;
        }
    }
    work.into_par_iter().for_each_init(Vec::new, |gathered, (index, rows, out)| {
        let group = &plan.groups[index];
        for run in group.live(plan, &rows) {
            gather(plan, group, &rows, &run, source, channels, gathered);
            let width = run.len() * channels;
            let left = |first: usize, columns: usize| Matrix::new(&gathered[first..], rows.len(), columns, width);
            match right {
                Rhs::Straight(weight) => {
                    let first = group.taps[run.start].weight;
                    let weight = Matrix::new(&weight[first * channels * outputs..], width, outputs, outputs);
                    multiply(out, outputs, left(0, width), weight, true);
                }
                Rhs::Packed(groups) => {
                    let weight = &groups[index][run.start * channels * outputs..];
                    multiply(out, outputs, left(0, width), Matrix::new(weight, width, outputs, outputs), true);
                }
                Rhs::Turned(weight) => {
                    for (at, tap) in group.taps[run.clone()].iter().enumerate() {
                        let weight = &weight[tap.weight * channels * outputs..];
                        let weight = Matrix::new(weight, outputs, channels, channels).transposed();
                        multiply(out, outputs, left(at * channels, channels), weight, true);
                    }
                }
            }
        }
        finish(out);
    });
    out
}

/// Adds `bias` to rows, and multiplies negative sums by `slope`.
pub(super) fn add_bias(rows: &mut [f32], bias: &[f32], slope: f32) {
    for row in rows.chunks_exact_mut(bias.len().max(1)) {
        for (value, bias) in row.iter_mut().zip(bias) {
            let sum = *value + bias;
            // Not `max`: NaN must stay, to be found and reported.
            *value = if sum < 0.0 { slope * sum } else { sum };
        }
    }
}

/// Gathers what `taps` read for `rows`: `taps.len() * channels` numbers for each.
fn gather(
    plan: &Plan,
    group: &Group,
    rows: &Range<usize>,
    taps: &Range<usize>,
    source: &[f32],
    channels: usize,
    gathered: &mut Vec<f32>,
) {
    let width = taps.len() * channels;
    gathered.resize(rows.len() * width, 0.0);
    let (starts, runs) = (plan.cells(), runs(group, taps));
    let mut place = group.place(rows.start);
    for row in gathered.chunks_exact_mut(width.max(1)) {
        let at = |axis: usize, offset: isize| (plan.stride * place[axis]) as isize + offset;
        let mut rest = row;
        for run in &runs {
            let tap = &group.taps[run.start];
            let [depth, height, length] = plan.sources[tap.source];
            let [z, y, x] = [0, 1, 2].map(|axis| at(axis, tap.offset[axis]));
            let (into, after) = rest.split_at_mut(run.len() * channels);
            rest = after;
            if z < 0 || y < 0 || z >= depth as isize || y >= height as isize {
                into.fill(0.0);
                continue;
            }
            // The part of the run within the line; nearly always all of it.
            let first = (-x).clamp(0, run.len() as isize) as usize;
            let last = (length as isize - x).clamp(first as isize, run.len() as isize) as usize;
            let line = starts[tap.source].start + (z as usize * height + y as usize) * length;
            let cell = line as isize + x + first as isize;
            into[..first * channels].fill(0.0);
            if first < last {
                let read = &source[cell as usize * channels..][..(last - first) * channels];
                into[first * channels..last * channels].copy_from_slice(read);
            }
            into[last * channels..].fill(0.0);
        }
        place[2] += 1;
        for axis in [2, 1] {
            if place[axis] == group.cells[axis] {
                place[axis] = 0;
                place[axis - 1] += 1;
            }
        }
    }
}

/// Returns runs of taps that read neighbours along x, which are consecutive in memory.
fn runs(group: &Group, taps: &Range<usize>) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for index in taps.clone() {
        let tap = &group.taps[index];
        match runs.last_mut() {
            Some(run) => {
                let first = &group.taps[run.start];
                let [z, y, x] = first.offset;
                let next = [z, y, x + run.len() as isize];
                if tap.source == first.source && tap.offset == next {
                    run.end += 1;
                } else {
                    runs.push(index..index + 1);
                }
            }
            None => runs.push(index..index + 1),
        }
    }
    runs
}

/// Returns the weights' gradient `[taps, channels, outputs]` from that of the rows, `d_rows`, sorted by group.
pub(super) fn weight_gradient(
    plan: &Plan,
    source: &[f32],
    channels: usize,
    d_rows: &[f32],
    outputs: usize,
) -> Vec<f32> {
    let matrix = channels * outputs;
    let taps: usize = plan.groups.iter().map(|group| group.taps.len()).sum();
    let parts = PARTS.div_ceil(plan.groups.len());
    let mut sums = vec![0f32; parts * taps * matrix];
    let (rows, mut work, mut rest) = (plan.rows(), Vec::new(), &mut sums[..]);
    for part in 0..parts {
        for (group, rows) in plan.groups.iter().zip(&rows) {
            let (sum, after) = std::mem::take(&mut rest).split_at_mut(group.taps.len() * matrix);
            work.push((part, group, rows.start, sum));
            rest = after;
        }
    }
    work.into_par_iter().for_each_init(Vec::new, |gathered, (part, group, start, sum)| {
        for rows in tiles(group, channels).skip(part).step_by(parts) {
            let d_tile = &d_rows[(start + rows.start) * outputs..(start + rows.end) * outputs];
            for run in group.live(plan, &rows) {
                gather(plan, group, &rows, &run, source, channels, gathered);
                let width = run.len() * channels;
                let left = Matrix::new(gathered, rows.len(), width, width).transposed();
                let sum = &mut sum[run.start * matrix..run.end * matrix];
                multiply(sum, outputs, left, Matrix::new(d_tile, rows.len(), outputs, outputs), true);
            }
        }
    });
    let (total, others) = sums.split_at_mut(taps * matrix);
    for other in others.chunks_exact(total.len().max(1)) {
        total.iter_mut().zip(other).for_each(|(total, other)| *total += other);
    }
    sums.truncate(taps * matrix);
    sums
}

/// Returns the bias's gradient: sums over rows, within tiles in f32 and over tiles in f64.
pub(super) fn bias_gradient(d_rows: &[f32], outputs: usize) -> Vec<f32> {
    let of_part = |part: &[f32]| {
        let mut total = vec![0f64; outputs];
        for tile in part.chunks(ROWS.1 * outputs.max(1)) {
            let mut sum = vec![0f32; outputs];
            for row in tile.chunks_exact(outputs.max(1)) {
                sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
            }
            total.iter_mut().zip(sum).for_each(|(total, sum)| *total += f64::from(sum));
        }
        total
    };
    let rows = d_rows.len() / outputs.max(1);
    let parts = blocks((0..PARTS).map(|part| (part + 1) * rows / PARTS - part * rows / PARTS));
    let sums: Vec<Vec<f64>> =
        parts.into_par_iter().map(|rows| of_part(&d_rows[rows.start * outputs..rows.end * outputs])).collect();
    (0..outputs).map(|column| sums.iter().map(|sum| sum[column]).sum::<f64>() as f32).collect()
}

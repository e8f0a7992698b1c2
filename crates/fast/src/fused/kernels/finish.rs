//! The operations on rows of sums before they leave the registers, and their targets.

use super::panels::{Form, PanelsMut, View, padded};
use super::{load, store};
use crate::simd::{LANES, Simd};

/// The sums of a block of rows.
pub(super) type Block<S, const MR: usize, const NV: usize> = [[<S as Simd>::Floats; NV]; MR];

/// Added to every row.
#[derive(Clone, Copy)]
pub struct Bias<'a> {
    /// Padded to a panel. `[rays, columns]` if each ray has its own.
    pub values: &'a [f32],
    /// Number of the first row, and rows per ray. It is 0 rows per ray if all rows share one bias.
    pub of_rays: (usize, usize),
}

/// A target for f32, row by row.
pub struct Out<'a> {
    /// The target numbers.
    pub values: &'a mut [f32],
    /// Distance from one row to the next.
    pub stride: usize,
    /// Whether they are added. Then nothing else is done with the rows.
    pub accumulate: bool,
}

/// Sums by ray, `[rays, columns]` with columns padded to a panel, and each row's ray.
pub struct ByRay<'a> {
    /// The sums.
    pub sums: &'a mut [f32],
    /// The ray of each row.
    pub rays: &'a [usize],
}

/// The operations on each row, in this order.
#[derive(Default)]
pub struct Finish<'a> {
    /// Added to every row.
    pub bias: Option<Bias<'a>>,
    /// Added: a number for each row, times a row of weights padded to a panel.
    pub density: Option<(&'a [f32], &'a [f32])>,
    /// Sets negative numbers to 0.
    pub relu: bool,
    /// Receives a bit for each positive number.
    pub positive: Option<View<&'a mut [u16]>>,
    /// Receives the numbers at this stage.
    pub out: Option<Out<'a>>,
    /// Sets numbers without their bit to 0.
    pub mask: Option<View<&'a [u16]>>,
    /// Adds the numbers to the sum of their row's ray.
    pub by_ray: Option<ByRay<'a>>,
    /// Receives the numbers at this stage as the left side of bf16.
    pub across: Option<PanelsMut<'a>>,
    /// Added, `[rows, columns]`.
    pub delta: Option<&'a [f32]>,
    /// Receives the final numbers in f32, or as bf16 for weight gradients.
    pub panels: Option<PanelsMut<'a>>,
}

impl Finish<'_> {
    /// Checks the slices.
    pub(super) fn check(&self, rows: usize, columns: usize) {
        let whole = padded(columns);
        let bias = self.bias.is_none_or(|bias| match bias.of_rays {
            (_, 0) => bias.values.len() == whole,
            (first, samples) => rows == 0 || ((first + rows - 1) / samples + 1) * whole <= bias.values.len(),
        });
        let density = self.density.is_none_or(|(d, w)| d.len() == rows && w.len() == whole);
        let masks = self.positive.as_ref().is_none_or(|bits| bits.fits(rows, columns))
            && self.mask.is_none_or(|bits| bits.fits(rows, columns));
        let plain = self.out.as_ref().is_none_or(|out| columns <= out.stride && out.values.len() >= rows * out.stride)
            && self.delta.is_none_or(|delta| delta.len() == rows * columns);
        let by_ray = self.by_ray.as_ref().is_none_or(|by_ray| {
            by_ray.rays.len() == rows && by_ray.rays.iter().all(|ray| (ray + 1) * whole <= by_ray.sums.len())
        });
        let across = self.across.as_ref().is_none_or(|to| to.shape.form == Form::Across && to.fits(rows, columns));
        let panels = self.panels.as_ref().is_none_or(|to| to.shape.form != Form::Across && to.fits(rows, columns));
        let alone = !self.out.as_ref().is_some_and(|out| out.accumulate) || self.is_out_alone();
        assert!(
            bias && density && masks && plain && by_ray && across && panels && alone,
            "what rows are finished with does not fit"
        );
    }
}

impl Finish<'_> {
    /// Returns whether rows only go to `out`, unchanged. Sums of few rows then start with its content.
    fn is_out_alone(&self) -> bool {
        let Finish { bias, density, relu, positive, out: _, mask, by_ray, across, delta, panels } = self;
        let elsewhere = positive.is_some() || by_ray.is_some() || across.is_some() || panels.is_some();
        !(elsewhere || *relu || bias.is_some() || density.is_some() || mask.is_some() || delta.is_some())
    }

    /// Finishes a block of sums from a row and a column on. `holds_out`: they include the content of `out`.
    #[inline(always)]
    pub(super) unsafe fn block<S: Simd, const MR: usize, const NV: usize>(
        &mut self,
        simd: S,
        sums: &mut Block<S, MR, NV>,
        (row, column): (usize, usize),
        columns: usize,
        holds_out: bool,
    ) {
        // SAFETY: `check` has seen that all slices have these rows and columns.
        unsafe {
            self.add::<S, MR, NV>(simd, sums, (row, column), columns);
            if self.relu {
                for sum in sums.iter_mut() {
                    for v in sum {
                        *v = simd.relu(*v);
                    }
                }
            }
            if let Some(positive) = &mut self.positive {
                let (mut to, step) = (positive.at_mut(row, column), positive.shape.step(column) / LANES);
                for sums in sums.iter() {
                    for v in 0..NV {
                        *to.add(v) = simd.positive(sums[v]);
                    }
                    to = to.wrapping_add(step);
                }
            }
            if let Some(out) = &mut self.out {
                for r in 0..MR {
                    let to = &mut out.values[(row + r) * out.stride..][..columns];
                    put(simd, to, &sums[r], column, out.accumulate && !holds_out);
                }
            }
            if let Some(mask) = self.mask {
                let (mut bits, step) = (mask.at(row, column), mask.shape.step(column) / LANES);
                for sums in sums.iter_mut() {
                    for v in 0..NV {
                        sums[v] = simd.keep(sums[v], *bits.add(v));
                    }
                    bits = bits.wrapping_add(step);
                }
            }
            self.leave::<S, MR, NV>(simd, sums, (row, column), columns);
        }
    }

    /// Adds bias and density.
    #[inline(always)]
    unsafe fn add<S: Simd, const MR: usize, const NV: usize>(
        &self,
        simd: S,
        sums: &mut Block<S, MR, NV>,
        (row, column): (usize, usize),
        columns: usize,
    ) {
        // SAFETY: as in `block`.
        unsafe {
            if let Some(bias) = self.bias {
                let values = bias.values.as_ptr().wrapping_add(column);
                for (r, sums) in sums.iter_mut().enumerate() {
                    let from = match bias.of_rays {
                        (_, 0) => values,
                        (first, samples) => values.wrapping_add((first + row + r) / samples * padded(columns)),
                    };
                    for v in 0..NV {
                        sums[v] = simd.add(sums[v], load(simd, from.add(LANES * v)));
                    }
                }
            }
            if let Some((d, weights)) = self.density {
                for r in 0..MR {
                    let d = simd.splat(*d.as_ptr().add(row + r));
                    for v in 0..NV {
                        let weight = load(simd, weights.as_ptr().add(column + LANES * v));
                        sums[r][v] = simd.add(sums[r][v], simd.mul(d, weight));
                    }
                }
            }
        }
    }

    /// The second half of it: writes the numbers to their targets.
    #[inline(always)]
    unsafe fn leave<S: Simd, const MR: usize, const NV: usize>(
        &mut self,
        simd: S,
        sums: &mut Block<S, MR, NV>,
        (row, column): (usize, usize),
        columns: usize,
    ) {
        // SAFETY: as in `block`.
        unsafe {
            if let Some(by_ray) = &mut self.by_ray {
                for r in 0..MR {
                    let ray = *by_ray.rays.as_ptr().add(row + r);
                    let to = by_ray.sums.as_mut_ptr().add(ray * padded(columns) + column);
                    for v in 0..NV {
                        let to = to.add(LANES * v);
                        store(simd, to, simd.add(load(simd, to), sums[r][v]));
                    }
                }
            }
            if let Some(across) = self.across.as_mut() {
                let (mut to, step) = (across.at_mut(row, column), across.shape.step(column));
                for sums in sums.iter() {
                    for v in 0..NV {
                        to.add(LANES / 2 * v).cast::<[f32; LANES / 2]>().write(simd.rounded(sums[v]));
                    }
                    to = to.wrapping_add(step);
                }
            }
            if let Some(delta) = self.delta {
                for r in 0..MR {
                    let delta = given::<S, NV>(simd, &delta[(row + r) * columns..][..columns], column);
                    for v in 0..NV {
                        sums[r][v] = simd.add(sums[r][v], delta[v]);
                    }
                }
            }
            let Some(panels) = &mut self.panels else { return };
            let (mut to, step) = (panels.at_mut(row, column), panels.shape.step(column));
            if panels.shape.form == Form::Down {
                for r in (0..MR).step_by(2) {
                    for v in 0..NV {
                        let next = if r + 1 < MR { sums[r + 1][v] } else { simd.splat(0.0) };
                        store(simd, to.add(LANES * v), simd.pair(sums[r][v], next));
                    }
                    to = to.wrapping_add(step);
                }
            } else {
                for sums in sums.iter() {
                    for v in 0..NV {
                        store(simd, to.add(LANES * v), sums[v]);
                    }
                    to = to.wrapping_add(step);
                }
            }
        }
    }
}

/// Writes a row's numbers from `column` on, or adds them to the target.
#[inline(always)]
pub(super) fn put<S: Simd, const NV: usize>(
    simd: S,
    row: &mut [f32],
    numbers: &[S::Floats; NV],
    column: usize,
    accumulate: bool,
) {
    for (v, numbers) in numbers.iter().enumerate() {
        let Some(to) = row.get_mut(column + LANES * v..) else { return };
        let sum = if accumulate { simd.add(given_vector(simd, to), *numbers) } else { *numbers };
        match to.first_chunk_mut::<LANES>() {
            Some(to) => *to = simd.store(sum),
            None => simd.store_first(to, sum),
        }
    }
}

/// Returns numbers of a row from `column` on, and 0 beyond its end.
#[inline(always)]
pub(super) fn given<S: Simd, const NV: usize>(simd: S, row: &[f32], column: usize) -> [S::Floats; NV] {
    let mut out = [simd.splat(0.0); NV];
    for (v, out) in out.iter_mut().enumerate() {
        *out = given_vector(simd, row.get(column + LANES * v..).unwrap_or_default());
    }
    out
}

#[inline(always)]
fn given_vector<S: Simd>(simd: S, from: &[f32]) -> S::Floats {
    match from.first_chunk::<LANES>() {
        Some(from) => simd.load(from),
        None => simd.load_first(from),
    }
}

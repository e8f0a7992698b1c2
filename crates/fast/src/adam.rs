//! Adam's update in f32 on the CPU.

use std::cell::RefCell;

use candle_core::{CpuStorage, InplaceOp1, Layout, Result, Storage, Tensor, Var};
use rayon::prelude::*;

use crate::hash::Moving;
use crate::simd::vectorized;

/// An update (Kingma and Ba 2015, algorithm 1): one pass over parameter, moments and gradient, in place.
pub struct Update {
    /// Decays of gradients, and of squared gradients; Instant-NGP takes 0.9 and 0.99.
    pub betas: [f64; 2],
    /// Added to the divisor; Instant-NGP takes 1e-15.
    pub epsilon: f64,
    /// The learning rate over the first moment's correction.
    pub rate: f64,
    /// The second moment's correction.
    pub correction2: f64,
}

impl Update {
    /// Updates a parameter and its two moments, f32 on the CPU. A missing gradient counts as 0. Of a `sparse` parameter, a hash
    /// grid's table, entries without gradient stay as they are, including moments.
    ///
    /// # Errors
    /// Moments or gradient are of another type.
    pub fn apply(&self, var: &Var, moments: [&Tensor; 2], gradient: Option<&Tensor>, sparse: bool) -> Result<()> {
        if sparse && gradient.is_none() {
            return Ok(());
        }
        let zero;
        let gradient = match gradient {
            Some(gradient) => &gradient.contiguous()?,
            None => {
                zero = var.zeros_like()?;
                &zero
            }
        };
        let (gradient, layout) = gradient.storage_and_layout();
        let Storage::Cpu(gradient) = &*gradient else { unreachable!("parameters are on the processor") };
        let (start, end) = layout.contiguous_offsets().expect("made contiguous");
        let features = if sparse { var.dim(1)? } else { 1 };
        let update = |p: &mut CpuStorage, m: &mut CpuStorage, v: &mut CpuStorage| match (p, m, v, gradient) {
            (CpuStorage::F32(values), CpuStorage::F32(first), CpuStorage::F32(second), CpuStorage::F32(gradient)) => {
                let (moving, gradient) = (Moving { values, first, second }, &gradient[start..end]);
                if sparse {
                    self.pass_table(moving, gradient, features)
                } else {
                    self.pass(moving, gradient)
                }
                Ok(())
            }
            _ => candle_core::bail!("adam: parameters, moments and gradients are all f32"),
        };
        lend(var, |p| lend(moments[0], |m| lend(moments[1], |v| update(p, m, v))))
    }

    /// Updates blocks of a table in parallel, because it is far larger than all other parameters together.
    fn pass_table(&self, Moving { values, first, second }: Moving, gradient: &[f32], features: usize) {
        const ENTRIES: usize = 1 << 14;
        let size = ENTRIES * features;
        let moments = first.par_chunks_mut(size).zip(second.par_chunks_mut(size));
        let blocks = values.par_chunks_mut(size).zip(moments).zip(gradient.par_chunks(size));
        blocks.for_each(|((values, (first, second)), gradient)| {
            self.table(Moving { values, first, second }, gradient, features);
        });
    }

    fn pass(&self, Moving { values, first, second }: Moving, gradient: &[f32]) {
        let sizes = [first.len(), second.len(), gradient.len()];
        assert!(sizes.iter().all(|size| *size == values.len()), "one moment and one gradient a parameter");
        let Update { betas: [beta1, beta2], epsilon, rate, correction2 } = *self;
        let [keep1, take1, keep2, take2] = [beta1, 1.0 - beta1, beta2, 1.0 - beta2].map(|beta| beta as f32);
        let [rate, correction2, epsilon] = [rate, correction2, epsilon].map(|number| number as f32);
        vectorized(
            #[inline(always)]
            || {
                for (((p, m), v), g) in values.iter_mut().zip(&mut *first).zip(&mut *second).zip(gradient) {
                    *m = *m * keep1 + take1 * *g;
                    *v = *v * keep2 + take2 * (*g * *g);
                    *p -= *m * rate / ((*v / correction2).sqrt() + epsilon);
                }
            },
        );
    }
}

/// Lends a tensor's values to a closure that may change them. The tensor must be the only one of its storage.
fn lend(tensor: &Tensor, change: impl FnOnce(&mut CpuStorage) -> Result<()>) -> Result<()> {
    tensor.inplace_op1(&Lend(RefCell::new(Some(change))))
}

struct Lend<F>(RefCell<Option<F>>);

impl<F: FnOnce(&mut CpuStorage) -> Result<()>> InplaceOp1 for Lend<F> {
    fn name(&self) -> &'static str {
        "adam"
    }

    fn cpu_fwd(&self, storage: &mut CpuStorage, _: &Layout) -> Result<()> {
        self.0.take().expect("called once")(storage)
    }
}

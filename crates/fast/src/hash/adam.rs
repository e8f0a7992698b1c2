//! Adam for tables of which a step changes only some entries.

use crate::adam::Update;
use crate::simd::{LANES, vectorized};

/// Parameters with their moments, `[entries, features]` each.
pub struct Moving<'a> {
    /// The parameters.
    pub values: &'a mut [f32],
    /// Means of gradients.
    pub first: &'a mut [f32],
    /// Means of squared gradients.
    pub second: &'a mut [f32],
}

impl Update {
    /// Updates a table. An entry whose gradient is 0 in all its `features` stays as it is, including moments: it
    /// was not read in this step (Instant-NGP, section 4).
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub(crate) fn table(&self, moving: Moving, gradient: &[f32], features: usize) {
        let Moving { values, first, second } = moving;
        let sizes = [values.len(), first.len(), second.len()];
        assert!(sizes.iter().all(|size| *size == gradient.len()), "one moment and one gradient a parameter");
        assert!(gradient.len().is_multiple_of(features), "whole entries");
        macro_rules! update {
            ($($number:literal)*) => {
                match features {
                    $($number => vectorized(
                        #[inline(always)]
                        || self.entries::<$number>(Moving { values, first, second }, gradient),
                    ),)*
                    _ => unreachable!("{features} features were refused"),
                }
            };
        }
        update!(1 2 3 4 5 6 7 8);
    }

    /// Updates with checked sizes.
    #[inline(always)]
    fn entries<const F: usize>(&self, moving: Moving, gradient: &[f32]) {
        let [keep1, keep2] = self.betas.map(
            #[inline(always)]
            |x| x as f32,
        );
        let [take1, take2] = self.betas.map(
            #[inline(always)]
            |x| (1.0 - x) as f32,
        );
        let (rate, correction2, epsilon) = (self.rate as f32, self.correction2 as f32, self.epsilon as f32);
        let Moving { values, first, second } = moving;
        let blocks = values.chunks_mut(LANES * F).zip(first.chunks_mut(LANES * F));
        let blocks = blocks.zip(second.chunks_mut(LANES * F)).zip(gradient.chunks(LANES * F));
        for (((values, first), second), gradient) in blocks {
            let mut reached = [[false; F]; LANES];
            let mut any = false;
            for (reached, gradient) in reached.iter_mut().zip(gradient.as_chunks::<F>().0) {
                let mut here = false;
                for g in gradient {
                    here |= *g != 0.0;
                }
                *reached = [here; F];
                any |= here;
            }
            if !any {
                continue;
            }
            let block = values.iter_mut().zip(first).zip(second).zip(gradient).zip(reached.as_flattened());
            for ((((value, m), v), g), reached) in block {
                let first = keep1.mul_add(*m, take1 * g);
                let second = keep2.mul_add(*v, take2 * (g * g));
                let moved = *value - rate * first / ((second / correction2).sqrt() + epsilon);
                *m = if *reached { first } else { *m };
                *v = if *reached { second } else { *v };
                *value = if *reached { moved } else { *value };
            }
        }
    }
}

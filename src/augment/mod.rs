//! The perturbation module: deltas of the three levels, the sets they live in, and the search for
//! the worst case.
//!
//! Nothing here knows a field or a renderer: the search ascends a loss that it is handed as a
//! closure, so it can be tested on a quadratic with a known maximum.

use candle_core::Tensor;

use crate::settings::Level;

mod search;
mod sets;

pub use search::{StepSizes, worst_case};
pub use sets::{DeltaSet, Draw, PassGeometry, PixelScale, Sets};

/// The deltas of one pass. Shapes: `t` `[rays, samples]`, `xyz` `[rays, samples, 3]`, `view`
/// `[rays, 2]`, `feature` `[rays, samples, width]`, `rgb` `[rays, samples, 3]`, `density`
/// `[rays, samples]`. A level that is off has none.
#[derive(Clone, Default)]
pub struct Deltas([Option<Tensor>; 6]);

impl Deltas {
    /// The delta of a level, where it is on.
    pub fn get(&self, level: Level) -> Option<&Tensor> {
        self.0[level as usize].as_ref()
    }

    /// Sets the delta of a level.
    pub fn set(&mut self, level: Level, delta: Tensor) {
        self.0[level as usize] = Some(delta);
    }

    /// This delta of `level` alone, all other levels off.
    pub fn only(&self, level: Level) -> Deltas {
        let mut alone = Deltas::default();
        alone.0[level as usize] = self.0[level as usize].clone();
        alone
    }
}

//! Accelerators that are no device of candle.

use std::any::Any;
use std::fmt::Debug;

use crate::base::Result;

/// A device that trains and renders with its own program, such as a GPU. candle computes on the CPU beside it.
pub trait Accelerator: Any + Debug + Send + Sync {
    /// Returns adapter and driver, for a run's provenance: `NVIDIA H200, Vulkan, driver 580.159`.
    fn description(&self) -> String;

    /// Waits until its work is done.
    ///
    /// # Errors
    /// If the device is lost.
    fn synchronize(&self) -> Result<()>;

    /// Returns itself, for those who know its type.
    fn as_any(&self) -> &dyn Any;
}

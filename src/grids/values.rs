//! The values of tensors on a processor, for operations of our own.

use std::ops::Deref;

use candle_core::{CpuStorage, Layout, Result, Storage, Tensor, WithDType};

/// A tensor's values, readable while this lives.
pub(super) struct Values<'a> {
    storage: Box<dyn Deref<Target = Storage> + 'a>,
    layout: &'a Layout,
}

impl<'a> Values<'a> {
    pub(super) fn of(tensor: &'a Tensor) -> Values<'a> {
        let (storage, layout) = tensor.storage_and_layout();
        Values { storage: Box::new(storage), layout }
    }

    /// Row after row.
    pub(super) fn slice<T: WithDType>(&self) -> Result<&[T]> {
        match &**self.storage {
            Storage::Cpu(storage) => slice(storage, self.layout),
            _ => candle_core::bail!("this operation is for processors"),
        }
    }
}

/// The values of a contiguous argument.
pub(super) fn slice<'a, T: WithDType>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [T]> {
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&T::cpu_storage_as_slice(storage)?[start..end]),
        None => candle_core::bail!("this operation needs contiguous arguments, got {layout:?}"),
    }
}

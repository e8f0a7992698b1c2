//! Where operations run: on a CPU this project's own, elsewhere candle's, which every device has. `field.core = "plain"` takes
//! candle's on a CPU, too, for a field's layers. A device that is none of candle's, such as a GPU, computes whole steps and
//! takes no part in this choice.

use std::cell::Cell;

use candle_core::{DType, Device, Tensor};

thread_local! {
    static PLAINLY: Cell<bool> = const { Cell::new(false) };
}

/// Returns whether this project's own operations compute on a device, on all of its threads at once.
pub fn is_host(device: &Device) -> bool {
    device.is_cpu() && !PLAINLY.get()
}

/// Returns whether this project's own operations in f32 compute with a tensor.
pub fn is_ours_in_f32(tensor: &Tensor) -> bool {
    is_host(tensor.device()) && tensor.dtype() == DType::F32
}

/// Does `work` on this thread as on a device that is no CPU: in turn, by candle's operations. For tests of what such
/// devices compute.
pub fn plainly<T>(work: impl FnOnce() -> T) -> T {
    struct Restore(bool);
    impl Drop for Restore {
        fn drop(&mut self) {
            PLAINLY.set(self.0);
        }
    }
    let _restore = Restore(PLAINLY.replace(true));
    work()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cpu_computes_plainly_where_it_is_asked_to() {
        let half = Tensor::zeros(1, DType::F16, &Device::Cpu).unwrap();
        let single = Tensor::zeros(1, DType::F32, &Device::Cpu).unwrap();
        let double = Tensor::zeros(1, DType::F64, &Device::Cpu).unwrap();
        assert_eq!([&half, &single, &double].map(is_ours_in_f32), [false, true, false]);
        plainly(|| {
            plainly(|| ());
            assert!(!is_host(&Device::Cpu) && !is_ours_in_f32(&single));
        });
        assert!(is_host(&Device::Cpu));
    }
}

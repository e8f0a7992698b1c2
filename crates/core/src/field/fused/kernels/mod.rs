//! Kernels on tiles: products with their finishing operations, weight gradients, heads, and passes over rows. Each uses
//! one thread. The CPU's widest instructions are chosen at run time, and change no bit.

#![allow(
    clippy::needless_range_loop,
    reason = "rows and vectors of a block are counted: several blocks, and addresses, go by them"
)]

mod finish;
mod gradients;
mod heads;
pub mod panels;
pub mod product;
mod rows;
mod simd;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use gradients::{bias_gradient, weight_gradient};
pub use heads::{Head, head_forward, head_gradient};
pub use rows::{
    Matrix, add_bias, add_bias_relu, add_rows, few_forward, few_input_gradient, few_weight_gradient, mask_where_zero,
    multiply, scale_rows,
};

use simd::{Portable, Simd};

/// A loop over vectors.
trait Kernel {
    /// # Safety
    /// The CPU must have the instructions of `S`. Everything else was checked when the kernel was created.
    unsafe fn run<S: Simd>(self);
}

/// The implementation of [`Simd`] that runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Backend {
    #[cfg(target_arch = "x86_64")]
    Avx512Bf16,
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
}

impl Backend {
    /// Returns all that this CPU has, fastest first. `pairs`: bf16 is used.
    fn all(pairs: bool) -> impl Iterator<Item = Backend> {
        #[cfg(target_arch = "x86_64")]
        let fast = {
            let wide = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl");
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            [
                (Backend::Avx512Bf16, wide && is_x86_feature_detected!("avx512bf16")),
                (Backend::Avx512, wide && !pairs),
                (Backend::Avx2, avx2),
            ]
        };
        #[cfg(not(target_arch = "x86_64"))]
        let (fast, _): ([(Backend, bool); 0], bool) = ([], pairs);
        fast.into_iter().filter_map(|(backend, has)| has.then_some(backend)).chain([Backend::Portable])
    }

    /// Runs a kernel. The CPU must have this backend.
    fn run(self, kernel: impl Kernel) {
        // SAFETY: backends are made by `all`, which asks the CPU.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Backend::Avx512Bf16 => on_avx512_bf16(kernel),
                #[cfg(target_arch = "x86_64")]
                Backend::Avx512 => on_avx512(kernel),
                #[cfg(target_arch = "x86_64")]
                Backend::Avx2 => on_avx2(kernel),
                Backend::Portable => kernel.run::<Portable>(),
            }
        }
    }
}

/// Runs a kernel in the widest instructions. `pairs`: it uses bf16.
fn launch(pairs: bool, kernel: impl Kernel) {
    #[cfg(test)]
    let best = tests::CHOSEN.get().or(Backend::all(pairs).next());
    #[cfg(not(test))]
    let best = Backend::all(pairs).next();
    best.unwrap_or(Backend::Portable).run(kernel);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512bf16,avx2,fma")]
unsafe fn on_avx512_bf16(kernel: impl Kernel) {
    // SAFETY: as the caller promises; the same goes for those that follow.
    unsafe { kernel.run::<x86::Avx512<true>>() }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
unsafe fn on_avx512(kernel: impl Kernel) {
    unsafe { kernel.run::<x86::Avx512<false>>() }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn on_avx2(kernel: impl Kernel) {
    unsafe { kernel.run::<x86::Avx2>() }
}

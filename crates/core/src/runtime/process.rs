//! What can only be set for a whole process, set once.

use std::sync::{Once, OnceLock};

use crate::base::{Error, Result};

/// Prepares the process for fast training, the first time that it is called: see [`super::Runtime`].
pub(super) fn prepare() {
    static DONE: Once = Once::new();
    DONE.call_once(|| {
        keep_freed_memory();
        // Rayon's global pool is not ours. Started now, it has the threads that it would have had without the variables.
        rayon::current_num_threads();
        keep_tensors_to_their_thread();
    });
}

/// Keeps freed memory with the process. By default glibc maps every block above 32 MiB afresh and
/// returns it on free; each tensor then pays for its pages again, which costs half of a training
/// step's time. Does nothing on other systems.
fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: mallopt sets parameters of the allocator, under the allocator's lock.
    unsafe {
        libc::mallopt(libc::M_MMAP_MAX, 0);
        libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
        libc::mallopt(libc::M_TOP_PAD, 256 << 20);
    }
}

/// Switches candle's own threads off: chunks of rays share the threads of a runtime, and threads inside tensor operations would
/// wait for one another more than they compute. candle has no function for it. It reads one variable at its first large
/// operation and the other at every matrix product (and would read the list of processors instead, if that were not set).
fn keep_tensors_to_their_thread() {
    // SAFETY: Rust's readers and writers of the environment wait for one another. C code that reads it on another thread at this
    // moment would not: hence the first runtime is to be made before such code runs, as the documentation of Runtime::new asks.
    unsafe {
        std::env::set_var("RAYON_NUM_THREADS", "1");
        std::env::set_var("CANDLE_NUM_THREADS", "1");
    }
    // The variable is read now and not later, when somebody may have changed it.
    candle_core::utils::barrier_pool();
}

/// Rounds the factors of matrix products on CUDA to 10 bits, or does not. candle has one switch for the process: whoever
/// comes first decides.
///
/// # Errors
/// The process computes the other way already.
pub(super) fn round_products(rounded: bool, device: &str) -> Result<()> {
    static ROUNDED: OnceLock<bool> = OnceLock::new();
    let decided = *ROUNDED.get_or_init(|| {
        candle_core::cuda::set_gemm_reduced_precision_f32(rounded);
        rounded
    });
    if decided == rounded {
        return Ok(());
    }
    let other = if decided { "with" } else { "without" };
    Err(Error::Config(format!(
        "device {device}: this process computes {other} TF32 already, and cannot do both; use another process"
    )))
}

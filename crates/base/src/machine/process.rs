//! Settings of the complete process, set once.

use std::ffi::OsString;
use std::process::Command;
use std::sync::OnceLock;

use crate::{Error, Result};

/// Prepares the process for fast training, at the first call: see `augnerf_nerf::runtime::Runtime`.
///
/// # Errors
/// [`Error::Config`]: the system gives the process no threads.
pub fn prepare() -> Result<()> {
    static DONE: OnceLock<Option<String>> = OnceLock::new();
    let failed = DONE.get_or_init(|| {
        keep_freed_memory();
        // Rayon's global pool is not ours. Started now, it has the threads that it would have had without the
        // variables. A pool that is there already is no failure.
        let started = rayon::ThreadPoolBuilder::new().build_global();
        let failed = started.err().filter(|error| std::error::Error::source(error).is_some());
        keep_tensors_to_their_thread();
        failed.map(|error| error.to_string())
    });
    failed.as_ref().map_or(Ok(()), |error| {
        Err(Error::Config(format!("no threads can be started ({error}); raise the limit of processes (ulimit -u)")))
    })
}

/// Keeps freed memory with the process. By default glibc maps every block above 32 MiB anew, and unmaps it on free.
/// Each tensor would then pay for its pages again, which takes half of a training step's time. It does nothing on other
/// systems.
fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: mallopt sets parameters of the allocator, under the allocator's lock.
    unsafe {
        libc::mallopt(libc::M_MMAP_MAX, 0);
        libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
        libc::mallopt(libc::M_TOP_PAD, 256 << 20);
    }
}

/// Switches off candle's own threads. Chunks of rays share the threads of a runtime, and threads inside tensor
/// operations would mostly wait for one another. candle has no function for it. It reads one variable at its first
/// large operation, and the other at every matrix product. Without the other it would read the list of CPUs.
fn keep_tensors_to_their_thread() {
    variables_before();
    // SAFETY: Rust's readers and writers of the environment wait for one another. C code that reads it on another thread at this
    // moment would not: hence the first runtime is to be made before such code runs, as the documentation of Runtime::new asks.
    unsafe {
        THREADS.iter().for_each(|name| std::env::set_var(name, "1"));
    }
    // The variable is read now, before other code can change it.
    candle_core::utils::barrier_pool();
}

/// The variables that the first runtime sets.
const THREADS: [&str; 2] = ["RAYON_NUM_THREADS", "CANDLE_NUM_THREADS"];

fn variables_before() -> &'static [Option<OsString>; 2] {
    static BEFORE: OnceLock<[Option<OsString>; 2]> = OnceLock::new();
    BEFORE.get_or_init(|| THREADS.map(std::env::var_os))
}

/// Gives a command the variables that the first runtime sets, as they were before it.
pub fn with_own_variables(command: &mut Command) -> &mut Command {
    THREADS.iter().zip(variables_before()).for_each(|(name, value)| {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    });
    command
}

/// Returns whether the terminal belongs to another program: the shell has this one in the background, where bars would
/// overwrite what is typed. It is false without a terminal at standard error.
pub fn in_background() -> bool {
    #[cfg(unix)]
    {
        // SAFETY: both functions only read the state of the process.
        let (foreground, own) = unsafe { (libc::tcgetpgrp(libc::STDERR_FILENO), libc::getpgrp()) };
        foreground > 0 && foreground != own
    }
    #[cfg(not(unix))]
    false
}

/// Sets whether the factors of matrix products on CUDA are rounded to 10 bits. candle has one switch for the process:
/// the first caller decides.
///
/// # Errors
/// If the process already computes the other way.
pub fn round_products(rounded: bool, device: &str) -> Result<()> {
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

//! The C allocator's settings.

/// Keeps freed memory with the process. By default glibc maps every block above 32 MiB afresh and
/// returns it on free; each tensor then pays for its pages again, which costs half of a training
/// step's time. Call it once, before the first tensor. Does nothing elsewhere.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: mallopt only sets parameters of the allocator and is called before other threads start.
    unsafe {
        libc::mallopt(libc::M_MMAP_MAX, 0);
        libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
        libc::mallopt(libc::M_TOP_PAD, 256 << 20);
    }
}

//! The peak memory of one piece of work in a process that does several.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::host::peak_memory_mib;

/// Number of watches that are held now.
static HELD: AtomicUsize = AtomicUsize::new(0);
/// Number of watches that ever began.
static BEGUN: AtomicUsize = AtomicUsize::new(0);

/// Watches the memory of this process.
///
/// The system keeps one peak for the complete process. Linux can reset it, so that a small run does not show what came
/// before it, such as a larger run or the measurement of step times. It is reset before each piece of work. If it
/// cannot be reset, the first watch includes what came before, and later ones have no number. Neither have pieces of
/// work that run at the same time.
pub struct MemoryWatch {
    /// No other watch was held at the start, and the system's number covers this time only.
    own: bool,
    /// The number of this watch.
    number: usize,
}

impl MemoryWatch {
    /// Starts to watch this process.
    pub fn begin() -> MemoryWatch {
        let others = HELD.fetch_add(1, Ordering::SeqCst);
        let before = BEGUN.fetch_add(1, Ordering::SeqCst);
        let own = others == 0 && (start_anew() || before == 0);
        MemoryWatch { own, number: before + 1 }
    }

    /// Returns the peak resident memory since the start, in MiB. `None` if the system does not tell or could not reset
    /// it, or if other work was watched at the same time.
    pub fn peak_mib(&self) -> Option<f64> {
        let alone = self.own && BEGUN.load(Ordering::SeqCst) == self.number;
        alone.then(peak_memory_mib).flatten()
    }
}

impl Drop for MemoryWatch {
    fn drop(&mut self) {
        HELD.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Resets the system's peak to the current use. Returns false if it cannot (all systems but Linux).
fn start_anew() -> bool {
    return_freed_memory();
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Returns freed blocks to the system. Training keeps them, and they would count as memory of the next piece of work.
fn return_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: malloc_trim returns free pages to the system, under the allocator's locks.
    unsafe {
        libc::malloc_trim(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block whose pages are all in use.
    fn block(mib: usize) -> Vec<u8> {
        let block = vec![1u8; mib << 20];
        assert!(block.iter().step_by(4096).all(|&byte| byte == 1));
        block
    }

    /// What a block of so many MiB comes to. Other tests may train at the same time: then again.
    fn measured(mib: usize) -> f64 {
        let once = |_| {
            let watch = MemoryWatch::begin();
            drop(block(mib));
            watch.peak_mib()
        };
        (0..1000).find_map(once).expect("some time nothing else is watched")
    }

    /// One test, because watches know of each other. Others' blocks come and go: bounds are wide.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_small_work_after_a_large_one_has_its_own_memory() {
        let (large, small) = (measured(1024), measured(1));
        assert!(large >= 1024.0 && small < large - 512.0, "{large} then {small}");
        let small = MemoryWatch::begin();
        // Two at once: neither's can be told.
        let other = MemoryWatch::begin();
        assert_eq!((small.peak_mib(), other.peak_mib()), (None, None));
        drop(other);
        assert_eq!(small.peak_mib(), None, "nor afterwards");
    }
}

//! The highest memory of one piece of work in a process that does several.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::host::peak_memory_mib;

/// Watches that are held right now.
static HELD: AtomicUsize = AtomicUsize::new(0);
/// Watches that were ever begun.
static BEGUN: AtomicUsize = AtomicUsize::new(0);

/// Watches the memory of this process from its making on.
///
/// The system keeps one number for the whole process, the highest so far. It is started anew (Linux) before each piece of work,
/// the first one too, so that a small run does not show what came before it: a larger one, the measurement of step times.
/// Where it cannot be started anew, the first has what the process took until then, and later ones have no number; nor has what
/// works at the same time.
pub struct MemoryWatch {
    /// Nothing else was watched when this one began, and the system's number is of its time alone.
    own: bool,
    /// Of all watches, this is the so-many-th.
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

    /// Highest resident memory since then, in MiB; none where the system does not say, could not start anew, or where other
    /// work was watched at the same time.
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

/// Starts the system's record of the highest memory anew, from what is in use now; false where it cannot (all but Linux).
fn start_anew() -> bool {
    return_freed_memory();
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Gives back what freed blocks still hold: training keeps it, and it would count as the next piece of work's.
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

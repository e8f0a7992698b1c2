//! Counts of the fused core's multiply-adds, with one counter per runtime.

use std::cell::OnceCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A counter that the threads of one runtime share.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

thread_local! {
    /// The counter of the runtime of this thread.
    static OWN: OnceCell<Arc<Counter>> = const { OnceCell::new() };
}

impl Counter {
    /// Returns the multiply-adds of matrix products so far.
    pub fn read(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    /// Makes this thread count here from now on.
    pub fn adopt_thread(self: Arc<Counter>) {
        OWN.with(|own| {
            // A thread belongs to one pool all its life.
            let _ = own.set(self);
        });
    }
}

/// Counts multiply-adds for the runtime of this thread. Other threads count nothing.
pub fn count_multiply_adds(count: usize) {
    OWN.with(|own| own.get().map(|own| own.0.fetch_add(count as u64, Ordering::Relaxed)));
}

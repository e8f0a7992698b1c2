//! Counts of the fused core's work, with one set of counters per runtime.

use std::cell::OnceCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counters that the threads of one runtime share.
#[derive(Debug, Default)]
pub struct Counters {
    multiply_adds: AtomicU64,
    table_bytes: AtomicU64,
    points: AtomicU64,
    active_points: AtomicU64,
}

/// The work of a runtime's threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Work {
    /// Multiply-adds of matrix products.
    pub multiply_adds: u64,
    /// Bytes of a hash grid's tables and their gradient: those read and written at the corners of points' cells, and
    /// those that Adam processes.
    pub table_bytes: u64,
    /// Points of backward passes.
    pub points: u64,
    /// Points of backward passes whose gradient was not 0.
    pub active_points: u64,
}

impl std::ops::Sub for Work {
    type Output = Work;

    /// Returns the work between two readings.
    fn sub(self, earlier: Work) -> Work {
        Work {
            multiply_adds: self.multiply_adds - earlier.multiply_adds,
            table_bytes: self.table_bytes - earlier.table_bytes,
            points: self.points - earlier.points,
            active_points: self.active_points - earlier.active_points,
        }
    }
}

thread_local! {
    /// The counters of the runtime of this thread.
    static OWN: OnceCell<Arc<Counters>> = const { OnceCell::new() };
}

impl Counters {
    /// Returns the work so far.
    pub fn read(&self) -> Work {
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Work {
            multiply_adds: load(&self.multiply_adds),
            table_bytes: load(&self.table_bytes),
            points: load(&self.points),
            active_points: load(&self.active_points),
        }
    }

    /// Makes this thread count here from now on.
    pub fn adopt_thread(self: Arc<Counters>) {
        OWN.with(|own| {
            // A thread belongs to one pool all its life.
            let _ = own.set(self);
        });
    }
}

/// Counts multiply-adds for the runtime of this thread. Other threads count nothing.
pub fn count_multiply_adds(count: usize) {
    count_with(|own| {
        own.multiply_adds.fetch_add(count as u64, Ordering::Relaxed);
    });
}

/// Counts bytes of a hash grid's tables.
pub fn count_table_bytes(count: usize) {
    count_with(|own| {
        own.table_bytes.fetch_add(count as u64, Ordering::Relaxed);
    });
}

/// Counts points of a backward pass, and those with a gradient.
pub fn count_points(points: usize, active: usize) {
    count_with(|own| {
        own.points.fetch_add(points as u64, Ordering::Relaxed);
        own.active_points.fetch_add(active as u64, Ordering::Relaxed);
    });
}

fn count_with(add: impl Fn(&Counters)) {
    OWN.with(|own| own.get().map(|own| add(own)));
}

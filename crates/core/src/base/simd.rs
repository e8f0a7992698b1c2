//! Loops over numbers in the widest instructions of the CPU, chosen at run time.

use pulp::{Arch, NullaryFnOnce};

/// Calls `work` once, compiled for the widest instructions of this CPU. `work` and everything that it calls must be
/// `#[inline(always)]`.
pub fn vectorized(work: impl FnMut()) {
    Arch::new().dispatch(Work(work));
}

/// A closure with a type of its own. A bare closure is called through `FnOnce::call_once`, which the compiler shares
/// between instruction sets instead of inlining it. Its loops would be compiled for the smallest set.
struct Work<F>(F);

impl<F: FnMut()> NullaryFnOnce for Work<F> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        (self.0)();
    }
}

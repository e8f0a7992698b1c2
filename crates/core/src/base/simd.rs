//! Loops over numbers in the widest instructions that the processor has, chosen at run time.

use pulp::{Arch, NullaryFnOnce};

/// Calls `work` once, compiled for the widest instructions of this processor, if it and all that it calls are
/// `#[inline(always)]`.
pub fn vectorized(work: impl FnMut()) {
    Arch::new().dispatch(Work(work));
}

/// A closure of its own type. One that is handed over bare is called through `FnOnce::call_once`, which the compiler shares
/// between instruction sets instead of inlining it: its loops would be compiled for the least of them.
struct Work<F>(F);

impl<F: FnMut()> NullaryFnOnce for Work<F> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        (self.0)();
    }
}

//! How far a long piece of work has got.

/// Who is told how far a load has got. The library itself prints nothing.
pub trait Progress: Sync {
    /// A stretch of `total` steps begins.
    fn start(&self, label: &str, total: u64);
    /// One step is done; called from several threads.
    fn advance(&self);
    /// The stretch is over.
    fn finish(&self);
}

/// Tells nobody.
impl Progress for () {
    fn start(&self, _label: &str, _total: u64) {}
    fn advance(&self) {}
    fn finish(&self) {}
}

//!
//! Two rules hold throughout. A file that is replaced is replaced by a rename, so that a reader
//! (or a kill at any moment) sees the old content or the new one and never half of either. And
//! everything written is a function of configuration and seed, with three exceptions that say so:
//! or process numbers.

pub mod atomic;
pub mod run_dir;

pub use atomic::{AtomicDir, clean_temporaries, write_atomic, write_json};
pub use run_dir::{RunDir, RunLock};

//! Everything a run leaves behind: its folder, tables, event files, pictures and provenance.
//!
//! Two rules hold throughout. A file that is replaced is replaced by a rename, so that a reader
//! (or a kill at any moment) sees the old content or the new one and never half of either. And
//! everything written is a function of configuration and seed, with three exceptions that say so:
//! `timing.json`, the event files under `tensorboard/` and `run.lock` hold clock times, host names
//! or process numbers.

pub mod atomic;
pub(crate) mod drawing;
pub mod host;
pub mod picture;
pub mod revision;
pub mod run_dir;
pub mod scalars;
pub mod tensorboard;

pub use atomic::{AtomicDir, clean_temporaries, write_atomic, write_json};
pub use drawing::Figure;
pub use host::{Host, Timing, free_memory_mib, host_name, peak_memory_mib};
pub use picture::{
    SOLID, beside, depth_colour, depth_range, quantise, scale_colour, write_depth16, write_gif, write_png8,
    write_timed_gif,
};
pub use revision::{revision, version};
pub use run_dir::{RunDir, RunLock};
pub use scalars::Scalars;
pub use tensorboard::EventWriter;

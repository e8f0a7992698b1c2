//! The one error type: a sentence for the user and a class that becomes the exit code.

use std::path::Path;

/// Everything that can stop the program. Each message is one sentence that says which file or
/// field, what was found, what is allowed and what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A setting that is unknown, of the wrong type, out of range or contradicts another one.
    #[error("{0}")]
    Config(String),
    /// An input file or folder that is missing, broken or not what it should be.
    #[error("{0}")]
    Data(String),
    /// An output folder that cannot be written, or that already holds something.
    #[error("{0}")]
    Output(String),
    /// A checkpoint or run folder that is missing, damaged or of another architecture.
    #[error("{0}")]
    Checkpoint(String),
    /// Training that went non-finite or collapsed.
    #[error("{0}")]
    Diverged(String),
    /// A stop that a signal asked for; a checkpoint was written first.
    #[error("{message}")]
    Interrupted {
        /// The signal's number (2 for Ctrl-C, 15 for SIGTERM).
        signal: i32,
        /// What was saved and how to go on.
        message: String,
    },
    /// A sweep that ran to its end while some of its points failed.
    #[error("{0}")]
    PointsFailed(String),
    /// A sweep that ran to its end while scenes of some of its points are not on this machine.
    #[error("{0}")]
    PointsWithoutData(String),
    /// A table whose rows differ in what its definition does not vary.
    #[error("{0}")]
    NotComparable(String),
    /// A failure inside the tensor library: a defect of this program or of the device.
    #[error("tensor operation failed: {0}")]
    Tensor(#[from] candle_core::Error),
}

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The process exit code of this class of error; docs/exit-codes.md lists them.
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Tensor(_) => 1,
            Error::Config(_) => 2,
            Error::Data(_) => 3,
            Error::Output(_) => 4,
            Error::Checkpoint(_) => 5,
            Error::Diverged(_) => 6,
            Error::PointsFailed(_) => 7,
            Error::PointsWithoutData(_) => 8,
            Error::NotComparable(_) => 9,
            Error::Interrupted { signal, .. } => 128 + *signal as u8,
        }
    }

    /// An input file that the operating system would not read.
    pub fn unreadable(path: &Path, error: &std::io::Error) -> Error {
        Error::Data(format!("cannot read {}: {error}", path.display()))
    }

    /// An output file that the operating system would not write.
    pub fn unwritable(path: &Path, error: &std::io::Error) -> Error {
        Error::Output(format!("cannot write {}: {error}", path.display()))
    }
}

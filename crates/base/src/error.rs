//! The error type: a sentence for the user, and an exit code.

use std::path::Path;

use super::text::shown;

/// Everything that can stop the program. A message names the file or setting, what was found, what is allowed, and what
/// to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A setting that is unknown, of the wrong type, out of range, or in contradiction to another one.
    #[error("{}", shown(.0))]
    Config(String),
    /// A setting out of its range: field, value and range as data.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// An input file or folder that is missing, damaged, or not of the expected kind.
    #[error("{}", shown(.0))]
    Data(String),
    /// An output folder that cannot be written, or that is not empty.
    #[error("{}", shown(.0))]
    Output(String),
    /// A run folder that another process has locked. It has the exit code of [`Error::Output`].
    #[error("{}", shown(.0))]
    InUse(String),
    /// A checkpoint or run folder that is missing, damaged, or of another architecture.
    #[error("{}", shown(.0))]
    Checkpoint(String),
    /// Training that became non-finite or collapsed.
    #[error("{}", shown(.0))]
    Diverged(String),
    /// A stop by a signal. A checkpoint was written first.
    #[error("{}", shown(.message))]
    Interrupted {
        /// The signal's number (2 for Ctrl-C, 15 for SIGTERM).
        signal: i32,
        /// What was saved, and how to resume.
        message: String,
    },
    /// A sweep that finished although some of its points failed.
    #[error("{}", shown(.0))]
    PointsFailed(String),
    /// A sweep that finished although the scenes of some of its points are not on this machine.
    #[error("{}", shown(.0))]
    PointsWithoutData(String),
    /// A sweep of which some points are not done yet.
    #[error("{}", shown(.0))]
    PointsWaiting(String),
    /// A table whose rows differ in a setting that its definition does not vary.
    #[error("{}", shown(.0))]
    NotComparable(String),
    /// Results that do not follow from their stated sources.
    #[error("{}", shown(.0))]
    Mismatch(String),
    /// A failure inside the tensor library: a defect of this program or of the device.
    #[error("tensor operation failed: {}", shown(&tensor_sentence(.0)))]
    Tensor(#[from] candle_core::Error),
}

/// Returns the message of a failed tensor operation, without the stack that `RUST_BACKTRACE` adds.
pub fn tensor_sentence(error: &candle_core::Error) -> String {
    match error {
        candle_core::Error::WithBacktrace { inner, .. } => tensor_sentence(inner),
        candle_core::Error::Context { inner, context } => format!("{}: {context}", tensor_sentence(inner)),
        candle_core::Error::WithPath { inner, path } => format!("{}: {}", path.display(), tensor_sentence(inner)),
        other => other.to_string(),
    }
}

/// A setting, or a flag that stands for one, whose value is not allowed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} = {} is out of range: it must be {}", shown(.path), shown(.value), shown(.allowed))]
pub struct SettingError {
    /// Its dotted name: `train.steps`.
    pub path: String,
    /// What was found.
    pub value: String,
    /// What is allowed, as it follows "it must be".
    pub allowed: String,
}

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// The exit codes of errors, which a script can tell apart, and their meanings. There is no other such list.
pub const EXIT_CODES: [(u8, &str); 11] = [
    (INTERNAL, "internal error"),
    (2, "wrong setting or usage"),
    (3, "bad input data"),
    (4, "output cannot be written or is in the way"),
    (BAD_CHECKPOINT, "bad checkpoint or run folder"),
    (6, "training collapsed or went non-finite"),
    (7, "points of a sweep failed"),
    (8, "points of a sweep have no data"),
    (9, "rows of a table are not comparable"),
    (10, "results do not verify"),
    (11, "points of a sweep are not done yet"),
];
/// The exit code of [`Error::Tensor`].
pub const INTERNAL: u8 = 1;
/// The exit code of [`Error::Checkpoint`].
pub const BAD_CHECKPOINT: u8 = 5;

impl Error {
    /// Returns the program's exit code ([`EXIT_CODES`], docs/exit-codes.md), or 128 plus a signal's number, as in shells.
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Interrupted { signal, .. } => 128 + *signal as u8,
            Error::Tensor(_) => INTERNAL,
            Error::Config(_) | Error::Setting(_) => 2,
            Error::Data(_) => 3,
            Error::Output(_) | Error::InUse(_) => 4,
            Error::Checkpoint(_) => BAD_CHECKPOINT,
            Error::Diverged(_) => 6,
            Error::PointsFailed(_) => 7,
            Error::PointsWithoutData(_) => 8,
            Error::NotComparable(_) => 9,
            Error::Mismatch(_) => 10,
            Error::PointsWaiting(_) => 11,
        }
    }

    /// Returns whether the error is about settings.
    pub fn is_of_settings(&self) -> bool {
        matches!(self, Error::Config(_) | Error::Setting(_))
    }

    /// Returns the error with the location of the settings in front, if it is about settings: `row 'NeRF': ...`.
    pub fn within(self, place: &str) -> Error {
        if self.is_of_settings() { Error::Config(format!("{place}: {self}")) } else { self }
    }

    /// Returns the error for an input file that the operating system does not read.
    pub fn unreadable(path: &Path, error: &std::io::Error) -> Error {
        Error::Data(format!("cannot read {}: {error}", path.display()))
    }

    /// Returns the error for an output file that the operating system does not write.
    pub fn unwritable(path: &Path, error: &std::io::Error) -> Error {
        Error::Output(format!("cannot write {}: {error}", path.display()))
    }
}

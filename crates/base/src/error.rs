//! The error type: a sentence for the user, and a class that becomes the exit code.

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

/// The kinds of errors that a script can tell apart by the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// See [`Error::Tensor`].
    Internal,
    /// See [`Error::Config`].
    Config,
    /// See [`Error::Data`].
    Data,
    /// See [`Error::Output`] and [`Error::InUse`].
    Output,
    /// See [`Error::Checkpoint`].
    Checkpoint,
    /// See [`Error::Diverged`].
    Diverged,
    /// See [`Error::PointsFailed`].
    PointsFailed,
    /// See [`Error::PointsWithoutData`].
    PointsWithoutData,
    /// See [`Error::NotComparable`].
    NotComparable,
    /// See [`Error::Mismatch`].
    Mismatch,
    /// See [`Error::PointsWaiting`].
    PointsWaiting,
}

impl Class {
    /// All classes, in the order of their codes.
    pub const ALL: [Class; 11] = [
        Class::Internal,
        Class::Config,
        Class::Data,
        Class::Output,
        Class::Checkpoint,
        Class::Diverged,
        Class::PointsFailed,
        Class::PointsWithoutData,
        Class::NotComparable,
        Class::Mismatch,
        Class::PointsWaiting,
    ];

    /// Returns the exit code and its meaning for the list of codes. There is no other such list.
    const fn code(self) -> (u8, &'static str) {
        match self {
            Class::Internal => (1, "internal error"),
            Class::Config => (2, "wrong setting or usage"),
            Class::Data => (3, "bad input data"),
            Class::Output => (4, "output cannot be written or is in the way"),
            Class::Checkpoint => (5, "bad checkpoint or run folder"),
            Class::Diverged => (6, "training collapsed or went non-finite"),
            Class::PointsFailed => (7, "points of a sweep failed"),
            Class::PointsWithoutData => (8, "points of a sweep have no data"),
            Class::NotComparable => (9, "rows of a table are not comparable"),
            Class::Mismatch => (10, "results do not verify"),
            Class::PointsWaiting => (11, "points of a sweep are not done yet"),
        }
    }

    /// Returns the program's exit code.
    pub const fn exit_code(self) -> u8 {
        self.code().0
    }

    /// Returns the code's meaning in a few words.
    pub const fn words(self) -> &'static str {
        self.code().1
    }

    /// Returns the class whose exit code this is.
    pub fn of_exit_code(code: u8) -> Option<Class> {
        Class::ALL.into_iter().find(|class| class.exit_code() == code)
    }
}

impl Error {
    /// Returns the program's exit code (docs/exit-codes.md): the code of the error's class, or 128 plus the signal's
    /// number, as in shells.
    pub fn exit_code(&self) -> u8 {
        let class = match self {
            Error::Interrupted { signal, .. } => return 128 + *signal as u8,
            Error::Tensor(_) => Class::Internal,
            Error::Config(_) | Error::Setting(_) => Class::Config,
            Error::Data(_) => Class::Data,
            Error::Output(_) | Error::InUse(_) => Class::Output,
            Error::Checkpoint(_) => Class::Checkpoint,
            Error::Diverged(_) => Class::Diverged,
            Error::PointsFailed(_) => Class::PointsFailed,
            Error::PointsWithoutData(_) => Class::PointsWithoutData,
            Error::NotComparable(_) => Class::NotComparable,
            Error::Mismatch(_) => Class::Mismatch,
            Error::PointsWaiting(_) => Class::PointsWaiting,
        };
        class.exit_code()
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

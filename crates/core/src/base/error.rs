//! The one error type: a sentence for the user and a class that becomes the exit code.

use std::path::Path;

use super::text::shown;

/// Everything that can stop the program. Each message is one sentence that says which file or
/// field, what was found, what is allowed and what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A setting that is unknown, of the wrong type, out of range or contradicts another one.
    #[error("{}", shown(.0))]
    Config(String),
    /// A setting out of its range: field, value and range as data.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// An input file or folder that is missing, broken or not what it should be.
    #[error("{}", shown(.0))]
    Data(String),
    /// An output folder that cannot be written, or that already holds something.
    #[error("{}", shown(.0))]
    Output(String),
    /// A checkpoint or run folder that is missing, damaged or of another architecture.
    #[error("{}", shown(.0))]
    Checkpoint(String),
    /// Training that went non-finite or collapsed.
    #[error("{}", shown(.0))]
    Diverged(String),
    /// A stop that a signal asked for; a checkpoint was written first.
    #[error("{}", shown(.message))]
    Interrupted {
        /// The signal's number (2 for Ctrl-C, 15 for SIGTERM).
        signal: i32,
        /// What was saved and how to go on.
        message: String,
    },
    /// A sweep that ran to its end while some of its points failed.
    #[error("{}", shown(.0))]
    PointsFailed(String),
    /// A sweep that ran to its end while scenes of some of its points are not on this machine.
    #[error("{}", shown(.0))]
    PointsWithoutData(String),
    /// A table whose rows differ in what its definition does not vary.
    #[error("{}", shown(.0))]
    NotComparable(String),
    /// Results that do not come out of what they are said to be made of.
    #[error("{}", shown(.0))]
    Mismatch(String),
    /// A failure inside the tensor library: a defect of this program or of the device.
    #[error("tensor operation failed: {}", shown(&tensor_sentence(.0)))]
    Tensor(#[from] candle_core::Error),
}

/// What a tensor operation says of its failure, without the stack that it adds where `RUST_BACKTRACE` is set.
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

impl SettingError {
    /// The same of a flag that stands for the setting.
    pub fn renamed(self, flag: &str) -> SettingError {
        SettingError { path: flag.into(), ..self }
    }
}

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// What kind of trouble an error is: the kinds that a script tells apart by the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// See [`Error::Tensor`].
    Internal,
    /// See [`Error::Config`].
    Config,
    /// See [`Error::Data`].
    Data,
    /// See [`Error::Output`].
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
}

impl Class {
    /// All of them, in the order of their codes.
    pub const ALL: [Class; 10] = [
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
    ];

    /// The program's exit code, and what it means in a list of codes. There is no other such list.
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
        }
    }

    /// The program's exit code.
    pub const fn exit_code(self) -> u8 {
        self.code().0
    }

    /// The code's meaning in a few words.
    pub const fn words(self) -> &'static str {
        self.code().1
    }

    /// The class that ends the program with this code.
    pub fn of_exit_code(code: u8) -> Option<Class> {
        Class::ALL.into_iter().find(|class| class.exit_code() == code)
    }
}

impl Error {
    /// The program's exit code (docs/exit-codes.md): that of the error's class, or 128 and the signal's number, as shells have it.
    pub fn exit_code(&self) -> u8 {
        let class = match self {
            Error::Interrupted { signal, .. } => return 128 + *signal as u8,
            Error::Tensor(_) => Class::Internal,
            Error::Config(_) | Error::Setting(_) => Class::Config,
            Error::Data(_) => Class::Data,
            Error::Output(_) => Class::Output,
            Error::Checkpoint(_) => Class::Checkpoint,
            Error::Diverged(_) => Class::Diverged,
            Error::PointsFailed(_) => Class::PointsFailed,
            Error::PointsWithoutData(_) => Class::PointsWithoutData,
            Error::NotComparable(_) => Class::NotComparable,
            Error::Mismatch(_) => Class::Mismatch,
        };
        class.exit_code()
    }

    /// It is about settings.
    pub fn is_of_settings(&self) -> bool {
        matches!(self, Error::Config(_) | Error::Setting(_))
    }

    /// The same with where the settings stand, if it is about settings: `row 'NeRF': ...`.
    pub fn within(self, place: &str) -> Error {
        if self.is_of_settings() { Error::Config(format!("{place}: {self}")) } else { self }
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

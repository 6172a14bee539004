//! The error of every job.

use std::fmt;

use srflow_core::SettingError;

/// Why a job failed. Displays as one line: the error and its causes, without repetition.
#[derive(Debug)]
pub struct Error(anyhow::Error);

/// What kind of error it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// A setting of the job is wrong.
    Setting,
    /// Anything else: a file, a network, a device.
    Failed,
}

/// Settings that are wrong together, or a setting that is missing.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct WrongSettings(pub String);

/// Returns [`WrongSettings`] from a function that returns `anyhow::Result`.
#[doc(hidden)]
#[macro_export]
macro_rules! wrong_settings {
    ($($text:tt)*) => { return Err($crate::error::WrongSettings(format!($($text)*)).into()) };
}
pub use wrong_settings;

impl Error {
    /// Settings that are wrong, in words.
    pub fn wrong_settings(words: String) -> Self {
        Self(WrongSettings(words).into())
    }

    pub fn kind(&self) -> ErrorKind {
        if is_wrong_settings(&self.0) { ErrorKind::Setting } else { ErrorKind::Failed }
    }

    /// The setting that is out of range, with its field; `None` for other errors.
    pub fn setting(&self) -> Option<&SettingError> {
        self.0.chain().find_map(|cause| cause.downcast_ref())
    }

    /// The first cause of this type.
    pub fn cause<E: std::error::Error + Send + Sync + 'static>(&self) -> Option<&E> {
        self.0.chain().find_map(|cause| cause.downcast_ref())
    }
}

/// Whether a setting, or settings together, are wrong.
pub fn is_wrong_settings(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.is::<WrongSettings>() || cause.is::<SettingError>())
}

impl From<anyhow::Error> for Error {
    fn from(error: anyhow::Error) -> Self {
        Self(error)
    }
}

impl std::error::Error for Error {
    /// The error of the library, which [`Display`](fmt::Display) includes.
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&*self.0)
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&in_words(&self.0))
    }
}

/// The error and its causes; a cause that is already part of the text is not repeated.
pub fn in_words(error: &anyhow::Error) -> String {
    let mut words = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if !words.contains(&cause) {
            let colon = if words.is_empty() { "" } else { ": " };
            words.push_str(colon);
            words.push_str(&cause);
        }
    }
    words
}

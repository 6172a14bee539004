use srflow_core::{Size, SizeMismatch};

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AugmentError {
    /// A number of the configuration is out of range.
    #[error("augmentation.{key} = {found}: expected {expected}")]
    Setting { key: &'static str, found: String, expected: &'static str },
    #[error("the frames are {0} (WIDTHxHEIGHT): expected at least one pixel")]
    Empty(Size),
    /// The parts of a sample have different sizes.
    #[error(transparent)]
    SizeMismatch(#[from] SizeMismatch),
}

use srflow_core::SizeMismatch;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AugmentError {
    /// A number of the configuration is out of range.
    #[error("augmentation.{key} = {found}: expected {expected}")]
    Setting { key: &'static str, found: String, expected: &'static str },
    #[error("the frames are {}x{} (WIDTHxHEIGHT): expected at least one pixel", .0.0, .0.1)]
    Empty((usize, usize)),
    /// The parts of a sample have different sizes.
    #[error(transparent)]
    SizeMismatch(#[from] SizeMismatch),
}

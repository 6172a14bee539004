use srflow_files::SettingsError;
use srflow_nets::SettingError;

use crate::loss::LossError;

/// Errors of reading or checking a configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error(transparent)]
    Settings(#[from] SettingsError),
    #[error("{key} = {found}: expected {expected}")]
    Value { key: &'static str, found: String, expected: String },
    #[error("network.settings: {0}")]
    Setting(#[from] SettingError),
    #[error(transparent)]
    Loss(#[from] LossError),
}

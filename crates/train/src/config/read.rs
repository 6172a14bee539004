//! Reads configurations from files, presets and the command line.

use std::path::Path;

use srflow_files::{Preset, parse_settings, read_settings, settings_text, with_setting};

use super::Config;
use super::error::ConfigError;

macro_rules! presets {
    ($($name:literal),*) => {
        &[$(Preset { name: $name, text: include_str!(concat!("../../../../configs/", $name, ".toml")) }),*]
    };
}

/// The built-in configurations: the rows of the paper's Tables III and V, SEA-RAFT, our own network, and two for small computers.
pub const PRESETS: &[Preset] = presets![
    "skflow",
    "rpknet",
    "memflow",
    "dpflow",
    "srflownet-tvr",
    "srflownet-fdr",
    "srflownet-migar",
    "srflownet-igvar",
    "sea-raft",
    "ssa",
    "srflow",
    "finetune",
    "cpu-small",
    "cpu-srflownet"
];

impl Config {
    /// Reads the preset called `name`, or else the file at that path; missing keys have their defaults.
    ///
    /// # Errors
    /// When neither exists, or the file is not a valid configuration.
    pub fn read(name: &Path) -> Result<Self, ConfigError> {
        Ok(read_settings(name, PRESETS)?)
    }

    /// Parses TOML; missing keys have their defaults. Errors call the text `file`.
    ///
    /// # Errors
    /// Names the line and the key.
    pub fn parse(text: &str, file: &str) -> Result<Self, ConfigError> {
        Ok(parse_settings(text, file)?)
    }

    /// This configuration as TOML, with every key.
    pub fn to_toml(&self) -> String {
        settings_text(self)
    }

    /// This configuration with one key changed: `SECTION.KEY=VALUE`, e.g. `training.batch=4`. Strings need no quotes.
    ///
    /// # Errors
    /// When the key does not exist, or the value has the wrong type.
    pub fn with_override(&self, given: &str) -> Result<Self, ConfigError> {
        Ok(with_setting(self, given)?)
    }
}

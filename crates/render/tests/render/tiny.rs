//! The smallest dataset that has everything.

use srflow_render::generate::Settings;

/// One scene of three pairs, without the optional files.
pub fn settings() -> Settings {
    Settings {
        scenes: 1,
        frames: 3.0,
        size: srflow_core::Size { width: 110, height: 160 },
        splits: srflow_core::Numbers([1.0, 0.0, 0.0]),
        seed: 4,
        ..Settings::default()
    }
}

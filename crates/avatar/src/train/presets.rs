use srflow_files::Preset;

macro_rules! presets {
    ($($name:literal),*) => {
        &[$(Preset { name: $name, text: include_str!(concat!("../../../../configs/avatar/", $name, ".toml")) }),*]
    };
}

/// The built-in configurations of trainings, the default first; [`srflow_files::read_settings`] reads them.
pub const PRESETS: &[Preset] = presets!["gaussian-avatars", "cpu", "video"];

#[cfg(test)]
mod tests {
    use std::path::Path;

    use srflow_files::{parse_settings, read_settings, settings_text};

    use super::*;
    use crate::train::TrainConfig;

    #[test]
    fn every_preset_is_valid_and_survives_text() {
        for preset in PRESETS {
            let config: TrainConfig = read_settings(Path::new(preset.name), PRESETS).expect(preset.name);
            config.check().expect(preset.name);
            let again: TrainConfig = parse_settings(&settings_text(&config), "again").expect("its own text");
            assert_eq!(again, config);
        }
        let first: TrainConfig = read_settings(Path::new(PRESETS[0].name), PRESETS).unwrap();
        assert_eq!(first, TrainConfig::default());
    }
}

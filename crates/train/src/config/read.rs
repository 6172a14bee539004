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

#[cfg(test)]
mod tests {
    use toml::{Table, Value};

    use super::*;

    #[test]
    fn every_preset_is_complete_and_valid() {
        for preset in PRESETS {
            let config = Config::read(Path::new(preset.name)).expect(preset.name);
            config.check().expect(preset.name);
            assert_eq!(Config::parse(&config.to_toml(), "again").expect("its own text"), config);
        }
    }

    #[test]
    fn the_papers_baseline_is_the_default() {
        let preset = Config::read(Path::new("skflow")).expect("a preset");
        assert_eq!(preset, Config::default());
    }

    #[test]
    fn parse_errors_name_the_line_and_the_key() {
        let error = Config::parse("[training]\nbatch = 4\nlr = 1\n", "my.toml").expect_err("no key lr");
        let message = error.to_string();
        for part in ["my.toml", "line 3", "`lr`", "learning_rate"] {
            assert!(message.contains(part), "{part} in {message}");
        }
        let error = Config::parse("[data]\ncrop = \"512\"\n", "my.toml").expect_err("no size");
        assert!(
            error.to_string().contains("line 2") && error.to_string().contains("WIDTHxHEIGHT"),
            "{error}"
        );
        let error =
            Config::parse("[network]\narchitecture = \"skflo\"\n", "my.toml").expect_err("no network");
        assert!(error.to_string().contains("raft-small"), "{error}");
    }

    #[test]
    fn every_key_can_be_overridden() {
        let config = Config::default();
        let table = Table::try_from(&config).expect("a table");
        for (section, keys) in &table {
            for (key, value) in keys.as_table().expect("a section") {
                let text = match value {
                    Value::String(text) => text.clone(),
                    other => other.to_string(),
                };
                let given = format!("{section}.{key}={text}");
                let same = config.with_override(&given).unwrap_or_else(|error| panic!("{given}: {error}"));
                assert_eq!(same, config, "{given}");
            }
        }
        let config = config.with_override("training.learning_rate=1e-3").expect("a number");
        assert_eq!(config.training.learning_rate, 1e-3);
        let config = config.with_override("data.train=folder:/data*3").expect("a dataset");
        assert_eq!(config.data.train[0].times, 3);
    }

    #[test]
    fn wrong_overrides_list_the_keys() {
        let error = |given: &str| Config::default().with_override(given).expect_err(given).to_string();
        assert!(error("training.lr=1").contains("learning_rate"), "{}", error("training.lr=1"));
        assert!(error("train.batch=1").contains("training"));
        assert!(error("batch").contains("KEY=VALUE"));
        assert!(error("training.batch=many").contains("training.batch=many"));
        for given in ["training.batch=many", "training.batch=-1", "augmentation.max_shift=1.5"] {
            assert!(error(given).contains("expected a whole number from 0"), "{}", error(given));
        }
        assert!(error("loss.fdr=some").contains("expected a number"), "{}", error("loss.fdr=some"));
        assert!(
            error("data.train=5").contains("expected a text or a list of texts"),
            "{}",
            error("data.train=5")
        );
        let whole = Config::parse("training = 3\n", "my.toml").expect_err("no section").to_string();
        assert!(whole.contains("expected keys with values") && !whole.contains("Config"), "{whole}");
    }

    #[test]
    fn wrong_settings_of_made_data_are_reported() {
        let error = |train: &str, keys: &str| {
            let text = format!("[data]\ntrain = \"{train}\"\ncrop = \"64x48\"\n{keys}");
            Config::parse(&text, "my.toml").expect(keys).check().expect_err(keys).to_string()
        };
        for (train, keys, parts) in [
            (
                "shapes:",
                "[data.shapes]\nsize = \"63x60\"",
                ["data.shapes.size = 63x60", "at least the crop, 64x48"],
            ),
            ("rendered:", "[data.rendered]\nsize = \"64x47\"", ["data.rendered.size = 64x47", "64x48"]),
            ("shapes:", "[data.shapes]\npairs = 0", ["data.shapes.pairs = 0", "1 to 99999"]),
            ("rendered:", "[data.rendered]\nscenes = 0", ["data.rendered.scenes = 0", "1 to 10000"]),
            ("rendered:", "[data.rendered]\nframes = 0", ["data.rendered.frames = 0", "1 to 1000"]),
            (
                "shapes:",
                "[training]\nclip_frames = 3",
                ["training.clip_frames = 3", "do not follow each other"],
            ),
            (
                "rendered:",
                "[data.rendered]\nframes = 3\n[training]\nclip_frames = 5",
                ["data.rendered.frames = 3", "4 to 1000"],
            ),
            ("shapes:", "[validation]\ndata = \"shapes:\"", ["validation.data = shapes:", "in files"]),
        ] {
            let error = error(train, keys);
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
        // What is not used is not checked.
        let config = Config::parse("[data]\ntrain = \"folder:a\"\n[data.shapes]\npairs = 0\n", "my.toml");
        config.expect("a configuration").check().expect("files alone");
        let unknown = Config::parse("[data.rendered.recording]\nnois = 1\n", "my.toml").expect_err("nois");
        assert!(unknown.to_string().contains("`noise`"), "{unknown}");
    }

    #[test]
    fn made_frames_contain_the_crop() {
        for crop in ["320x320", "192x280", "512x800", "8x1000", "1x1"] {
            let data = Config::default().with_override(&format!("data.crop={crop}")).expect(crop).data;
            for size in [data.shapes_size(), data.rendered_size()] {
                assert!(size.width > data.crop.width && size.height > data.crop.height, "{crop}: {size}");
            }
        }
        let data = Config::default().with_override("data.crop=320x320").expect("a size").data;
        assert_eq!(
            (data.shapes_size().to_string(), data.rendered_size().to_string()),
            ("360x360".into(), "360x525".into())
        );
    }

    #[test]
    fn invalid_numbers_are_reported() {
        for given in
            ["training.batch=0", "training.clip=-1", "training.rising=1", "loss.gamma=2", "data.workers=0"]
        {
            let config = Config::default().with_override(given).expect(given);
            let message = config.check().expect_err(given).to_string();
            assert!(message.starts_with(given.split('=').next().expect("a key")), "{message}");
        }
    }
}

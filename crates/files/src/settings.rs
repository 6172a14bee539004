//! Settings in TOML: files, built-in presets, and keys changed on the command line.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use crate::{FileError, FileKind, parse_error_in_words, read_text};

/// Why settings could not be read.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    #[error("{error}; pass a TOML file or one of the presets: {presets}")]
    Read {
        #[source]
        error: FileError,
        presets: String,
    },
    #[error("{file}: {reason}")]
    File {
        file: String,
        /// Names the line and the key, and what was expected.
        reason: String,
    },
    #[error("`set` {given}: {reason}")]
    Override { given: String, reason: String },
}

/// Built-in settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preset {
    pub name: &'static str,
    /// TOML.
    pub text: &'static str,
}

impl Preset {
    /// The names of `presets`, for messages.
    pub fn names(presets: &[Self]) -> String {
        presets.iter().map(|preset| preset.name).collect::<Vec<_>>().join(", ")
    }
}

/// Reads the preset called `name`, or else the file at that path.
///
/// # Errors
/// When neither exists, or the file does not hold valid settings.
pub fn read_settings<S: DeserializeOwned>(name: &Path, presets: &[Preset]) -> Result<S, SettingsError> {
    if let Some(preset) = presets.iter().find(|preset| Path::new(preset.name) == name) {
        return parse_settings(preset.text, &format!("preset {}", preset.name));
    }
    let text = read_text(name, FileKind::Settings)
        .map_err(|error| SettingsError::Read { error, presets: Preset::names(presets) })?;
    parse_settings(&text, &name.display().to_string())
}

/// Parses TOML. Errors call the text `file`.
///
/// # Errors
/// Names the line and the key.
pub fn parse_settings<S: DeserializeOwned>(text: &str, file: &str) -> Result<S, SettingsError> {
    toml::from_str(text)
        .map_err(|error| SettingsError::File { file: file.to_owned(), reason: parse_error_in_words(&error) })
}

/// These settings as TOML, with every key that has a value.
///
/// Panics when they are not a table of plain values.
pub fn settings_text(settings: &impl Serialize) -> String {
    toml::to_string(settings).expect("settings are a table of plain values")
}

/// These settings with one key changed: `KEY=VALUE` or `SECTION.KEY=VALUE`, e.g. `training.batch=4`. Texts need no quotes.
///
/// Panics as [`settings_text`].
///
/// # Errors
/// When the key does not exist, or the value has the wrong type.
pub fn with_setting<S: Serialize + DeserializeOwned>(settings: &S, given: &str) -> Result<S, SettingsError> {
    let wrong = |reason: String| SettingsError::Override { given: given.to_owned(), reason };
    let mut settings = Table::try_from(settings).expect("settings are a table of plain values");
    let (key, value) = given.split_once('=').ok_or_else(|| {
        wrong(format!("expected KEY=VALUE, found no `=`; the keys are {}", names(&settings)))
    })?;
    let (sections, name) = match key.trim().rsplit_once('.') {
        Some((sections, name)) => (Some(sections), name),
        None => (None, key.trim()),
    };
    let mut table = &mut settings;
    for section in sections.into_iter().flat_map(|sections| sections.split('.')) {
        let known = names(table);
        table = table
            .get_mut(section)
            .and_then(Value::as_table_mut)
            .ok_or_else(|| wrong(format!("no section `{section}`; there are {known}")))?;
    }
    // A key without a value has no entry: that there is no such key is said by the parser.
    table.insert(name.to_owned(), parsed(value.trim()));
    settings.try_into().map_err(|error| wrong(parse_error_in_words(&error).replace('\n', "; ")))
}

fn names(table: &Table) -> String {
    table.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
}

/// A TOML value, or else a text.
fn parsed(value: &str) -> Value {
    let line = format!("value = {value}");
    match line.parse::<Table>() {
        Ok(mut table) => table.remove("value").expect("the line has it"),
        Err(_) => Value::String(value.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct Outer {
        seed: u64,
        name: String,
        inner: Inner,
    }

    #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct Inner {
        rate: f32,
        #[serde(skip_serializing_if = "Option::is_none")]
        limit: Option<f32>,
    }

    const PRESETS: &[Preset] = &[Preset { name: "small", text: "seed = 3\n[inner]\nrate = 0.1\n" }];

    #[test]
    fn presets_and_files_are_read_and_keys_changed() {
        let small: Outer = read_settings(Path::new("small"), PRESETS).unwrap();
        assert_eq!((small.seed, small.inner.rate), (3, 0.1));
        assert_eq!(parse_settings::<Outer>(&settings_text(&small), "again").unwrap(), small);
        let set = |given: &str| with_setting(&small, given).unwrap();
        assert_eq!(set("seed = 7").seed, 7);
        assert_eq!(set("name=a b").name, "a b");
        assert_eq!(set("name=\"7\"").name, "7");
        assert_eq!(set("inner.rate=2e-4").inner.rate, 2e-4);
        assert_eq!(set("inner.limit=5").inner.limit, Some(5.0), "a key without a value");
        assert_eq!(with_setting(&set("inner.limit=5"), "seed=3").unwrap().inner.limit, Some(5.0));
    }

    #[test]
    fn mistakes_name_the_key_and_those_that_there_are() {
        let error = |given: &str| with_setting(&Outer::default(), given).unwrap_err().to_string();
        for (given, parts) in [
            ("seed", &["KEY=VALUE", "inner"][..]),
            ("sed=1", &["`sed`", "`seed`"]),
            ("iner.rate=1", &["`iner`", "inner"]),
            ("seed.rate=1", &["no section `seed`"]),
            ("inner.rat=1", &["`rat`", "`limit`"]),
            ("seed=many", &["`set` seed=many", "a whole number from 0", "many"]),
            ("seed=-1", &["a whole number from 0"]),
            ("inner=5", &["expected keys with values"]),
            ("=5", &["unknown key"]),
        ] {
            let error = error(given);
            assert!(
                parts.iter().all(|part| error.contains(part)) && !error.contains('\n'),
                "{given}: {error}"
            );
        }
        let folder = tempfile::tempdir().unwrap();
        let missing = read_settings::<Outer>(&folder.path().join("large"), PRESETS).unwrap_err().to_string();
        assert!(missing.contains("large") && missing.contains("presets: small"), "{missing}");
        let file = folder.path().join("a.toml");
        std::fs::write(&file, "seed = 3\nsed = 4\n").unwrap();
        let error = read_settings::<Outer>(&file, PRESETS).unwrap_err().to_string();
        assert!(error.contains("a.toml") && error.contains("line 2") && error.contains("`sed`"), "{error}");
    }
}

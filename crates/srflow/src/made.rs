//! Data that is made while training, with the settings of `srflow shapes` and `srflow render` in the configuration of a training.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use srflow_avatar::HeadSource;
use srflow_core::SettingError;
use srflow_data::flow::{MadeError, MadePairs};
use srflow_files::parse_error_in_words;
use srflow_render::RenderError;
use srflow_render::generate::{ScenePairs, Settings};
use srflow_render::shapes::{ShapePairs, ShapesSettings};
use srflow_train::config::{Config, MadeKind, MadeSpec, RenderedConfig, ShapesConfig};

/// Opens `shapes:` and `rendered:`; see [`srflow_train::OpenMade`].
pub fn open_made(spec: &MadeSpec, config: &Config) -> Result<Box<dyn MadePairs>, MadeError> {
    Ok(match spec.kind {
        MadeKind::Shapes => {
            let textures = (!spec.of.is_empty()).then(|| spec.of.clone().into());
            let settings = ShapesSettings { textures, ..shapes(config)? };
            Box::new(ShapePairs::new(settings).map_err(|error| in_configuration(error, SHAPES))?)
        }
        MadeKind::Rendered => {
            let head = if spec.of.is_empty() { HeadSource::builtin() } else { spec.of.parse()? };
            let settings = Settings { head, ..rendered(config)? };
            Box::new(ScenePairs::new(settings).map_err(|error| in_configuration(error, RENDERED))?)
        }
    })
}

/// Checks the settings of data that is made, also of kinds that are not trained on.
///
/// # Errors
/// Names the key that is unknown or has no such value.
pub fn check_made(config: &Config) -> Result<(), String> {
    shapes(config)?;
    rendered(config)?;
    Ok(())
}

/// Sections of the configuration.
const SHAPES: &str = "data.shapes";
const RENDERED: &str = "data.rendered";

/// The settings of `shapes:`, without textures, which the name of the data gives.
fn shapes(config: &Config) -> Result<ShapesSettings, String> {
    let ShapesConfig { pairs, settings, .. } = &config.data.shapes;
    let size = config.data.shapes_size();
    let base = ShapesSettings { pairs: *pairs, size, ..ShapesSettings::default() };
    with_settings(&base, settings, SHAPES, &["textures"])
}

/// The settings of `rendered:` with the built-in head; the name of the data may give another.
fn rendered(config: &Config) -> Result<Settings, String> {
    let RenderedConfig { scenes, frames, settings, recording, .. } = &config.data.rendered;
    let base = Settings {
        scenes: *scenes,
        frames: f64::from(*frames),
        size: config.data.rendered_size(),
        recording: *recording,
        ..Settings::wild()
    };
    let effects = object(recording);
    let elsewhere: Vec<&str> = effects.keys().map(String::as_str).chain(["head"]).collect();
    with_settings(&base, settings, RENDERED, &elsewhere)
}

/// `base` with these settings, which are in `section` of the configuration; those `elsewhere` cannot be given here.
fn with_settings<S: Serialize + DeserializeOwned + Clone>(
    base: &S,
    settings: &Map<String, Value>,
    section: &str,
    elsewhere: &[&str],
) -> Result<S, String> {
    let mut all = object(base);
    let known: Vec<String> = all.keys().filter(|name| !elsewhere.contains(&name.as_str())).cloned().collect();
    let mut made = base.clone();
    for (name, value) in settings {
        if !known.contains(name) {
            return Err(format!("{section}.{name}: unknown key; expected one of {}", known.join(", ")));
        }
        all.insert(name.clone(), value.clone());
        made = serde_json::from_value(Value::Object(all.clone()))
            .map_err(|error| format!("{section}.{name}: {}", parse_error_in_words(&error)))?;
    }
    Ok(made)
}

fn object(settings: &impl Serialize) -> Map<String, Value> {
    match json!(settings) {
        Value::Object(all) => all,
        _ => Map::new(),
    }
}

/// The error with the path of the setting in the configuration.
fn in_configuration(error: RenderError, section: &str) -> MadeError {
    match &error {
        // The name of the data says what they are of.
        RenderError::Setting(SettingError { field: "head" | "textures", found, expected }) => {
            format!("{found}: expected {expected}").into()
        }
        RenderError::Setting(SettingError { field, found, expected }) => {
            format!("{section}.{field} = {found}: expected {expected}").into()
        }
        RenderError::Folder { path, error, expected, .. } => {
            format!("{}: {error}; expected {expected}", path.display()).into()
        }
        _ => error.into(),
    }
}

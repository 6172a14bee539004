//! Data that is made while training: the settings of `srflow shapes` and `srflow render` from the configuration of a training.

use srflow_avatar::HeadSource;
use srflow_core::{Numbers, SettingError};
use srflow_read::flow::{MadeError, MadePairs};
use srflow_render::RenderError;
use srflow_render::generate::{MotionSource, ScenePairs, Settings};
use srflow_render::shapes::{ShapePairs, ShapesSettings};
use srflow_train::config::{Config, MadeKind, MadeSpec, RenderedConfig, ShapesConfig};

/// Opens `shapes:` and `rendered:`; see [`srflow_train::training_set::OpenMade`].
pub fn open_made(spec: &MadeSpec, config: &Config) -> Result<Box<dyn MadePairs>, MadeError> {
    Ok(match spec.kind {
        MadeKind::Shapes => Box::new(
            ShapePairs::new(shapes(spec, config)).map_err(|error| in_configuration(error, "data.shapes"))?,
        ),
        MadeKind::Rendered => Box::new(
            ScenePairs::new(rendered(spec, config)?)
                .map_err(|error| in_configuration(error, "data.rendered"))?,
        ),
    })
}

fn shapes(spec: &MadeSpec, config: &Config) -> ShapesSettings {
    let ShapesConfig { pairs, motion, seed, .. } = config.data.shapes;
    let size = config.data.shapes_size();
    ShapesSettings {
        pairs,
        size,
        seed,
        motion: Numbers(motion),
        textures: (!spec.of.is_empty()).then(|| spec.of.clone().into()),
        ..ShapesSettings::default()
    }
}

fn rendered(spec: &MadeSpec, config: &Config) -> Result<Settings, MadeError> {
    let RenderedConfig { scenes, frames, background, motion, seed, recording, .. } = &config.data.rendered;
    let size = config.data.rendered_size();
    let Ok(motion) = motion.parse::<MotionSource>();
    Ok(Settings {
        head: if spec.of.is_empty() { HeadSource::builtin() } else { spec.of.parse()? },
        scenes: *scenes,
        frames: f64::from(*frames),
        size,
        seed: *seed,
        background: background
            .parse()
            .map_err(|error: String| format!("data.rendered.background: {error}"))?,
        motion,
        recording: *recording,
        ..Settings::default()
    })
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

//! Data that is made while training.

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value, json};
use srflow_core::Size;
use srflow_data::manifest::Recording;

use super::text::{self, MadeKind};
use super::{ConfigError, DataConfig};

/// The pairs of `shapes:`, those of `srflow shapes` with the same settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ShapesConfig {
    /// Pairs in an epoch; every epoch has new ones.
    pub pairs: u32,
    /// Size of the frames, WIDTHxHEIGHT; empty for the crop and some more.
    #[serde(with = "text::optional_size")]
    pub size: Option<Size>,
    /// The other settings, by the names that they have in `srflow shapes`, such as `motion` and `seed`. Their maker checks them.
    #[serde(flatten, deserialize_with = "with_defaults_of_shapes")]
    pub settings: Map<String, Value>,
}

/// The pairs of `rendered:`, those of `srflow render` with the same settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RenderedConfig {
    /// Scenes in an epoch, one subject each; every epoch has new ones.
    pub scenes: u32,
    /// Pairs of a scene.
    pub frames: u32,
    /// Size of the frames, WIDTHxHEIGHT; empty for a portrait around the crop and some more.
    #[serde(with = "text::optional_size")]
    pub size: Option<Size>,
    /// The other settings, by the names that they have in `srflow render`, such as `background`, `motion` and `seed`. Their maker
    /// checks them.
    #[serde(flatten, deserialize_with = "with_defaults_of_rendered")]
    pub settings: Map<String, Value>,
    /// Imaging effects.
    pub recording: Recording,
}

/// Not the seed of datasets in files, so that those have other subjects unless they are asked for the same.
const SEED: u64 = 1000;

impl Default for ShapesConfig {
    fn default() -> Self {
        let settings = [("motion", json!([0.25, 32.0])), ("seed", json!(SEED))];
        Self { pairs: 10_000, size: None, settings: named(settings) }
    }
}

impl Default for RenderedConfig {
    /// The preset `wild`.
    fn default() -> Self {
        let settings =
            [("background", json!("procedural")), ("motion", json!("mixed")), ("seed", json!(SEED))];
        Self { scenes: 200, frames: 48, size: None, settings: named(settings), recording: Recording::wild() }
    }
}

fn named<const N: usize>(settings: [(&str, Value); N]) -> Map<String, Value> {
    settings.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn with_defaults_of_shapes<'de, D: Deserializer<'de>>(given: D) -> Result<Map<String, Value>, D::Error> {
    over(ShapesConfig::default().settings, given)
}

fn with_defaults_of_rendered<'de, D: Deserializer<'de>>(given: D) -> Result<Map<String, Value>, D::Error> {
    over(RenderedConfig::default().settings, given)
}

/// The settings that are given, and defaults for the others.
fn over<'de, D: Deserializer<'de>>(
    mut settings: Map<String, Value>,
    given: D,
) -> Result<Map<String, Value>, D::Error> {
    settings.extend(Map::<String, Value>::deserialize(given)?);
    Ok(settings)
}

impl DataConfig {
    /// Size of the frames of `shapes:`.
    pub fn shapes_size(&self) -> Size {
        self.shapes.size.unwrap_or_else(|| with_margin(self.crop))
    }

    /// Size of the frames of `rendered:`: without one, the proportions of the paper's frames, 2200x3208.
    pub fn rendered_size(&self) -> Size {
        self.rendered.size.unwrap_or_else(|| {
            let Size { width, height } = with_margin(self.crop);
            let of_height = height.saturating_mul(2200).div_ceil(3208);
            let of_width = width.saturating_mul(3208).div_ceil(2200);
            Size { width: width.max(of_height), height: height.max(of_width) }
        })
    }

    /// Checks the settings of the made data in `train`, except for those that only its maker knows.
    pub(super) fn check_made(&self, pairs_of_clip: usize) -> Result<(), ConfigError> {
        let wrong = |key: &'static str, found: String, expected: String| {
            Err(ConfigError::Value { key, found, expected })
        };
        let kinds = || self.train.iter().filter_map(|source| Some(source.made()?.kind));
        let crop = self.crop;
        for kind in kinds() {
            let (key, size) = match kind {
                MadeKind::Shapes => ("data.shapes.size", self.shapes_size()),
                MadeKind::Rendered => ("data.rendered.size", self.rendered_size()),
            };
            if size.width < crop.width || size.height < crop.height {
                return wrong(key, size.to_string(), format!("at least the crop, {crop} (data.crop)"));
            }
        }
        if kinds().any(|kind| kind == MadeKind::Shapes) && pairs_of_clip > 1 {
            let expected = "2: the pairs of shapes: do not follow each other; rendered: makes clips";
            return wrong("training.clip_frames", (pairs_of_clip + 1).to_string(), expected.to_owned());
        }
        if kinds().any(|kind| kind == MadeKind::Shapes) && !(1..=99_999).contains(&self.shapes.pairs) {
            return wrong("data.shapes.pairs", self.shapes.pairs.to_string(), "1 to 99999".to_owned());
        }
        if kinds().any(|kind| kind == MadeKind::Rendered) {
            let RenderedConfig { scenes, frames, .. } = self.rendered;
            if !(1..=10_000).contains(&scenes) {
                return wrong("data.rendered.scenes", scenes.to_string(), "1 to 10000".to_owned());
            }
            if !(pairs_of_clip..=1000).contains(&(frames as usize)) {
                let expected = match pairs_of_clip {
                    1 => "1 to 1000".to_owned(),
                    pairs => {
                        format!("{pairs} to 1000, as many pairs as a clip has or more (training.clip_frames)")
                    }
                };
                return wrong("data.rendered.frames", frames.to_string(), expected);
            }
        }
        Ok(())
    }
}

/// The crop and an eighth more along each side, for augmentation; a multiple of 8.
fn with_margin(Size { width, height }: Size) -> Size {
    let wider = |side: usize| side.saturating_add(side / 8).saturating_add(7) / 8 * 8;
    Size { width: wider(width), height: wider(height) }
}

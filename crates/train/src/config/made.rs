//! Data that is made while training.

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value, json};
use srflow_core::Size;
use srflow_data::manifest::Recording;

use super::text;

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

/// How rendered heads look, as after `srflow render --look`.
const LOOK: u8 = 2;

impl Default for ShapesConfig {
    fn default() -> Self {
        let settings = [("motion", json!([0.25, 32.0])), ("seed", json!(SEED))];
        Self { pairs: 10_000, size: None, settings: named(settings) }
    }
}

impl Default for RenderedConfig {
    /// The preset `wild`.
    fn default() -> Self {
        let settings = [
            ("background", json!("procedural")),
            ("look", json!(LOOK)),
            ("motion", json!("mixed")),
            ("seed", json!(SEED)),
        ];
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

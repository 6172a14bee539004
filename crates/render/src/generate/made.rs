//! Scenes whose pairs are rendered when they are asked for.

use std::ops::Range;

use srflow_avatar::Avatars;
use srflow_core::{Recent, Spares};
use srflow_data::flow::{MadeError, MadePairs, SCENES_AT_ONCE, Sample};
use srflow_data::manifest::SceneSplit;

use super::background::{self, Background};
use super::rig::Rig;
use super::scene::{Scene, subject};
use super::settings::Settings;
use super::work::Worker;
use crate::RenderError;
use crate::error::require;

/// Scenes that are kept: those of which pairs are asked for in turn, and some more, since threads run ahead of each other.
const KEPT: usize = SCENES_AT_ONCE as usize + 4;

/// The scenes that [`generate`](super::generate) renders with the same settings, as [`MadePairs`]; they go on beyond
/// `settings.scenes`. The head and the background of a scene take seconds, so the scenes used last are kept.
pub struct ScenePairs {
    settings: Settings,
    pairs: u32,
    rig: Rig,
    /// Names and sizes of the background images, if there are any.
    backgrounds: Vec<(String, u64)>,
    scenes: Recent<u32, Scene>,
    /// One for each thread that has rendered.
    workers: Spares<Worker>,
}

impl ScenePairs {
    /// # Errors
    /// As [`generate`](super::generate) before any work; and when the pairs per scene are not a whole number.
    pub fn new(settings: Settings) -> Result<Self, RenderError> {
        super::checked_plan(&settings, &Avatars::keeping(1))?;
        let expected = "a whole number: every scene has as many pairs";
        require("frames", settings.frames, expected, settings.frames.fract() == 0.0)?;
        let backgrounds = match &settings.background {
            Background::Images(dir) => background::images(dir)?,
            Background::Colour(_) | Background::Procedural => Vec::new(),
        };
        Ok(Self {
            pairs: settings.frames as u32,
            rig: settings.rig(),
            backgrounds,
            scenes: Recent::new(KEPT),
            workers: Spares::default(),
            settings,
        })
    }

    fn scene(&self, number: u32) -> Result<Scene, RenderError> {
        let background = background::chosen(&self.backgrounds, number, self.settings.seed);
        let entry = self.settings.entry(number, SceneSplit::Train, self.pairs, background);
        // Scenes are kept with their avatars.
        let avatar = subject(&Avatars::keeping(1), &self.settings.dressed_head(), &entry)?;
        Scene::new(&self.settings, &self.rig, number, &entry, avatar)
    }
}

impl MadePairs for ScenePairs {
    fn pairs_per_scene(&self) -> u32 {
        self.pairs
    }

    fn name(&self, scene: u32, pair: u32) -> String {
        format!("scene {scene} of seed {}, pair {pair}", self.settings.seed)
    }

    fn make(&self, scene: u32, run: Range<u32>) -> Result<Vec<Sample>, MadeError> {
        let scene = self.scenes.get(scene, || self.scene(scene))?;
        let mut worker = self.workers.take().unwrap_or_else(|| Worker::new(&self.settings));
        let samples = worker.samples(&scene, run)?;
        self.workers.put(worker);
        Ok(samples)
    }
}

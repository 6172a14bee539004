//! Generating an SRFlow dataset: moving heads in front of moving cameras, with exact flow.
//!
//! [`Settings`] become a plan ([`Manifest`]), which [`crate::job`] renders pair by pair; a complete dataset gets its
//! statistics. Every file's bytes depend on the settings alone: not on shards, interruptions, or the number of threads.

mod background;
mod lamps;
mod made;
mod motion;
mod occlusion;
mod path;
mod pictures;
mod rig;
mod scene;
mod settings;
mod work;

use std::path::Path;

use rayon::prelude::*;
use srflow_avatar::{Avatar, Avatars};
use srflow_files::write_file;

use crate::RenderError;
use crate::error::require;
use crate::job::{self, Made, Request};
use crate::record::{PairRecord, json_text};
use crate::statistics::{FlowSummary, Statistics};
use srflow_data::manifest::{Manifest, STATISTICS_NAME};

pub use background::Background;
pub use made::ScenePairs;
pub use motion::MotionSource;
pub use occlusion::DEPTH_TOLERANCE;
pub(crate) use path::Path as SmoothPath;
pub use pictures::DEPTH_UNITS_PER_METRE;
pub use pictures::write_alpha;
pub use rig::{CANONICAL_CAMERA, FULL_SIZE, Rig, View};
pub(crate) use scene::{Action, Views, record};
pub use settings::{Settings, with_flat_recording};
#[cfg(feature = "clap")]
pub(crate) use settings::{flow_format_help, head_help};

/// The result of [`generate`].
#[derive(Debug, Clone)]
pub struct Report {
    /// The pairs rendered by this run.
    pub run: Made,
    /// Statistics of the dataset; `None` until it is complete.
    pub statistics: Option<Statistics>,
}

/// Renders a dataset, or one shard of it, with the threads of the current rayon pool. Existing files with the same settings
/// are kept.
///
/// # Errors
/// Before any work when a setting is wrong or the folder has another dataset; later when a file cannot be written or a
/// background image cannot be read. Complete files stay, and the next call with the same settings continues.
pub fn generate(settings: &Settings, request: Request) -> Result<Report, RenderError> {
    generate_with(settings, request, &Avatars::keeping(1))
}

/// As [`generate`], with the avatars that were made before of the same subjects.
///
/// # Errors
/// Those of [`generate`].
pub fn generate_with(
    settings: &Settings,
    request: Request,
    avatars: &Avatars,
) -> Result<Report, RenderError> {
    let manifest = checked_plan(settings, avatars)?;
    let plan = work::Scenes { settings, avatars, rig: settings.rig(), manifest };
    let (run, statistics) = job::make(&plan, request, |dir| write_statistics(dir, &plan.manifest))?;
    Ok(Report { run, statistics })
}

/// The plan, once the files of head and motion have been read: fails before anything is made.
fn checked_plan(settings: &Settings, avatars: &Avatars) -> Result<Manifest, RenderError> {
    let manifest = settings.plan()?;
    let from_files = !settings.head.is_builtin() || settings.motion.is_of_files();
    if let (true, Some(entry)) = (from_files, manifest.scenes.first()) {
        let avatar = scene::subject(avatars, &settings.dressed_head(), entry)?;
        check_length(settings, &manifest, &avatar)?;
    }
    Ok(manifest)
}

/// A recorded motion has a pose for every frame of every scene.
fn check_length(settings: &Settings, manifest: &Manifest, avatar: &Avatar) -> Result<(), RenderError> {
    let Some(poses) = settings.motion.poses(avatar)? else { return Ok(()) };
    let longest = manifest.scenes.iter().map(|scene| scene.pairs).max().unwrap_or(0);
    let expected = format!("less than the {} timesteps of the motion", poses.len());
    require("frames", settings.frames, expected, (longest as usize) < poses.len())
}

/// Writes the statistics of a complete dataset.
pub(crate) fn write_statistics(dir: &Path, manifest: &Manifest) -> Result<Statistics, RenderError> {
    let mut flow = FlowSummary::default();
    for scene in &manifest.scenes {
        let records = (0..scene.pairs).into_par_iter();
        let flows = records
            .map(|pair| PairRecord::read(&manifest.files(dir, scene, pair).record).map(|record| record.flow));
        // Summed in order, so that the last bits do not depend on the threads.
        for of_pair in flows.collect::<Result<Vec<_>, _>>()? {
            flow.add(&of_pair);
        }
    }
    let statistics = Statistics::new(manifest, flow);
    write_file(&dir.join(STATISTICS_NAME), json_text(&statistics))?;
    Ok(statistics)
}

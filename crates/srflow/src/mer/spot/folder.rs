//! A folder of results: finished videos are kept when a run is repeated.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use serde_json::{Value, json};
use srflow_core::Shard;
use srflow_files::{FileKind, create_folder, read_text, write_file};

use super::files::{write_events, write_megc};
use super::settings::SpottingArgs;
use super::spotted::SpottedVideo;
use super::video::Video;
use crate::error::wrong_settings;
use crate::output::ensure_folder;
use crate::{Watch, methods};

/// The list of the settings.
const SETTINGS_NAME: &str = "spot.json";
/// Ending of the record of a finished video.
const RECORD_ENDING: &str = ".events.json";
pub const EVENTS_NAME: &str = "events.csv";
const MEGC_NAME: &str = "megc.csv";

/// The videos of a folder.
pub struct SpottedVideos {
    /// The flow method's name.
    pub method: String,
    pub videos: Vec<SpottedVideo>,
    /// Whether the run was stopped before the last one.
    pub stopped: bool,
}

/// Spots the expressions in a part of the videos, and writes their files; what the folder holds of them already is kept, unless `force` begins
/// anew. The tables of all videos are written where the part is all of them.
///
/// # Errors
/// When settings are wrong, the folder has results of others, a video cannot be read, or a file cannot be written.
pub fn spot_videos(
    settings: &SpottingArgs,
    videos: &[PathBuf],
    out: &Path,
    force: bool,
    shard: Shard,
    watch: &Watch,
) -> anyhow::Result<SpottedVideos> {
    settings.limits()?;
    ensure_folder(out)?;
    let mut names = BTreeSet::new();
    let mut opened = Vec::new();
    for path in videos {
        let video = Video::open(path, settings.fps)?;
        if !names.insert(video.name.clone()) {
            wrong_settings!(
                "{}: another video is called `{}`, too; rename one",
                video.path.display(),
                video.name
            );
        }
        opened.push(video);
    }
    let estimator = methods::estimator(&settings.method, &settings.parameters, watch)?;
    claim(settings, out, force)?;

    let method = estimator.name().to_owned();
    let mut spotted = SpottedVideos { method, videos: Vec::new(), stopped: false };
    let Range { start, end } = shard.range(opened.len() as u64);
    for video in &opened[start as usize..end as usize] {
        let record = out.join(format!("{}{RECORD_ENDING}", video.name));
        let result = match record.is_file() {
            true => kept(video, &record)?,
            false => match video.spot(settings, estimator.as_ref(), out, watch)? {
                Some(result) => {
                    // The record says that the video is finished, so it comes last.
                    write_file(&record, serde_json::to_string_pretty(&result)? + "\n")?;
                    result
                }
                None => {
                    spotted.stopped = true;
                    return Ok(spotted);
                }
            },
        };
        spotted.videos.push(result);
    }
    if shard == Shard::WHOLE {
        write_events(&out.join(EVENTS_NAME), &spotted.videos)?;
        write_megc(&out.join(MEGC_NAME), &spotted.videos)?;
    }
    Ok(spotted)
}

/// What an earlier run spotted in this video.
fn kept(video: &Video, record: &Path) -> anyhow::Result<SpottedVideo> {
    let spotted: SpottedVideo = serde_json::from_str(&read_text(record, FileKind::Json)?)
        .with_context(|| format!("{}: delete it and run the command again", record.display()))?;
    ensure!(
        spotted.path == video.path,
        "{}: expected the events of {}, found those of {}; choose another folder",
        record.display(),
        video.path.display(),
        spotted.path.display()
    );
    Ok(spotted)
}

/// Writes the settings into the folder, which has none or the same.
fn claim(settings: &SpottingArgs, out: &Path, force: bool) -> anyhow::Result<()> {
    let settings = json!({ "srflow_version": env!("CARGO_PKG_VERSION"), "settings": settings });
    let path = out.join(SETTINGS_NAME);
    if path.is_file() && !force {
        let found: Value = serde_json::from_str(&read_text(&path, FileKind::Json)?).unwrap_or_default();
        ensure!(
            found == settings,
            "{}: the folder has results of other settings; choose another, or `force` to start over",
            out.display()
        );
        return Ok(());
    }
    create_folder(out)?;
    if force {
        forget(out)?;
    }
    Ok(write_file(&path, serde_json::to_string_pretty(&settings)? + "\n")?)
}

/// Removes the records of all videos: they may be of other settings.
fn forget(out: &Path) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(out).with_context(|| out.display().to_string())? {
        let path = entry?.path();
        if path.to_string_lossy().ends_with(RECORD_ENDING) {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

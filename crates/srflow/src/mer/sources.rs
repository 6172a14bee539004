//! Which micro-expression datasets, and how they are read.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::{
    CLASS_SETS, CLIP_KINDS, Classes, ClipDataset, ClipSource, Labels, check_distinct,
};
use srflow_files::write_image_png;
use tempfile::TempDir;

use crate::Watch;
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::video::{VideoReader, is_video};

/// Where annotations are, which classes to use, and how to treat missing frames.
#[derive(Args, Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SourceArgs {
    /// Annotation file outside its dataset's folder, such as samm:FILE or clips:FILE
    #[arg(long, value_name = "KIND:FILE")]
    pub annotations: Vec<String>,
    /// CSV list of apex frames, for clips without a usable one [default: SMIC's smic_apex.csv or data_apex.csv in its
    /// folder]
    #[arg(long, value_name = "FILE")]
    pub apex_list: Option<PathBuf>,
    /// Classes: a name (see below), or your own TOML file (docs/reference/micro-expression-files.md)
    #[arg(long, value_name = "CLASSES", default_value_t = Self::default().classes)]
    pub classes: String,
    /// Tolerate missing frames; clips without onset or apex are dropped
    #[arg(long)]
    pub allow_missing: bool,
    /// Accept clips that contain only the onset, apex and offset frames
    #[arg(long)]
    pub only_key_frames: bool,
}

impl Default for SourceArgs {
    fn default() -> Self {
        Self {
            annotations: Vec::new(),
            apex_list: None,
            classes: CLASS_SETS[0].0.to_owned(),
            allow_missing: false,
            only_key_frames: false,
        }
    }
}

impl SourceArgs {
    /// The classes.
    ///
    /// # Errors
    /// When there are no classes of that name.
    pub(super) fn classes(&self) -> anyhow::Result<Classes> {
        Classes::open(&self.classes).context("`classes`")
    }

    /// The datasets with these settings.
    ///
    /// # Errors
    /// When there is no dataset, or a setting is for none of them.
    pub(super) fn complete(&self, sources: &[ClipSource]) -> anyhow::Result<Vec<ClipSource>> {
        if sources.is_empty() {
            wrong_settings!("expected at least one dataset, KIND:DIR, found none");
        }
        let mut sources = sources.to_vec();
        let classes = self.classes()?;
        for text in &self.annotations {
            let Some((kind, file)) = text.split_once(':').filter(|(_, file)| !file.is_empty()) else {
                bail!("`annotations` {text}: expected KIND:FILE, e.g. samm:SAMM_Micro_FACS_Codes_v2.xlsx");
            };
            let Some(source) = sources.iter_mut().find(|source| source.kind.name == kind) else {
                bail!("`annotations` {text}: none of the datasets is of the kind `{kind}`");
            };
            source.annotations = Some(file.into());
        }
        if let Some(list) = &self.apex_list {
            let mut taking = sources.iter_mut().filter(|source| source.kind.takes_apex_list).peekable();
            if taking.peek().is_none() {
                bail!("`apex_list` {}: no dataset takes it; clips.csv has a column apex", list.display());
            }
            taking.for_each(|source| source.apex_list = Some(list.clone()));
        }
        for source in &mut sources {
            source.classes = classes.clone();
            source.only_key_frames = self.only_key_frames;
        }
        Ok(sources)
    }

    /// Opens the datasets; with `spots_apexes`, clips without a usable apex are kept where no published list leaves them out. The frames of
    /// clips that are videos lie in the folder that is returned.
    ///
    /// # Errors
    /// Those of [`ClipDataset::open`], when two have the same name, or when a video cannot be read.
    pub(super) fn open(
        &self,
        sources: &[ClipSource],
        spots_apexes: bool,
        watch: &Watch,
    ) -> anyhow::Result<(Vec<ClipDataset>, TempDir)> {
        let frames = folder_for_frames()?;
        let mut sources = self.complete(sources)?;
        sources.iter_mut().for_each(|source| source.spots_apexes = spots_apexes);
        let open = |source| self.open_one(source, frames.path(), watch);
        let datasets = sources.iter_mut().map(open).collect::<anyhow::Result<Vec<_>>>()?;
        check_distinct(datasets.iter().map(|dataset| dataset.name.as_str()))?;
        Ok((datasets, frames))
    }

    /// Opens a dataset; the frames of videos go into folders below `frames`.
    ///
    /// # Errors
    /// Those of [`ClipDataset::open`], or when a video cannot be read.
    pub(super) fn open_one(
        &self,
        source: &mut ClipSource,
        frames: &Path,
        watch: &Watch,
    ) -> anyhow::Result<ClipDataset> {
        let open = unpack_videos(source, frames, watch)
            .and_then(|()| Ok(ClipDataset::open(source, self.allow_missing)?));
        open.with_context(|| format!("reading {source}"))
    }
}

/// A folder for the frames of videos, which goes when the value does.
pub(super) fn folder_for_frames() -> anyhow::Result<TempDir> {
    tempfile::tempdir().context("creating a folder for the frames of videos")
}

/// Writes the frames of clips that are videos, from onset to offset, into folders below `into`.
fn unpack_videos(source: &mut ClipSource, into: &Path, watch: &Watch) -> anyhow::Result<()> {
    let annotations = Labels::read(source)?.annotations;
    let mut videos = BTreeMap::<PathBuf, Vec<RangeInclusive<u64>>>::new();
    for (annotation, place) in annotations.iter().zip(source.places(&annotations)) {
        if is_video(&place) && place.is_file() {
            videos.entry(place).or_default().push(annotation.onset..=annotation.offset);
        }
    }
    if videos.is_empty() {
        return Ok(());
    }
    let done = watch.count("videos", videos.len() as u64);
    for (video, clips) in videos {
        let folder = tempfile::tempdir_in(into)?.keep();
        let last = clips.iter().map(|clip| *clip.end()).max().unwrap_or_default();
        let mut frames = VideoReader::open(&video)?;
        for number in 1..=last {
            ensure!(!(watch.stop)(), "stopped while reading {}", video.display());
            let Some(frame) = frames.next_frame()? else { break };
            if clips.iter().any(|clip| clip.contains(&number)) {
                write_image_png(&folder.join(format!("{number:06}.png")), &frame)?;
            }
        }
        source.frames_of_videos.insert(video, folder);
        done.inc();
    }
    Ok(())
}

/// Help on the names of datasets and classes.
pub fn kinds_help() -> String {
    let line = |name: String, about: &str| format!("  {name:<29} {about}\n");
    let kinds: String = CLIP_KINDS.iter().map(|kind| line(kind.to_string(), kind.about)).collect();
    let classes: String = CLASS_SETS.iter().map(|(name, about, _)| line((*name).to_owned(), about)).collect();
    format!("Kinds of dataset:\n{kinds}\nClasses:\n{}", classes.trim_end_matches('\n'))
}

//! What is packed.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;
use srflow_core::{FlowField, Size};
use srflow_files::{FileKind, FlowFormat, parse_error_in_words, read_file, read_mask, read_text};

use crate::error::{PackError, ReadError};
use crate::index::FlowStatistics;
use crate::settings::PackedFlow;
use crate::split::SceneSplit;

/// A complete dataset to pack, described by what knows its layout.
pub struct Source {
    /// Its folder.
    pub dir: PathBuf,
    /// The command that made it, such as `srflow render`.
    pub command: &'static str,
    /// The arguments that made it.
    pub description: Value,
    /// Whether it shows heads, in scenes.
    pub faces: bool,
    /// Format of the flow, if all files have the same.
    pub flow_format: Option<FlowFormat>,
    /// Of the frames.
    pub size: Size,
    /// A dataset without scenes has one for each split.
    pub scenes: Vec<Scene>,
    /// The pair of a scene, by the index of the scene in `scenes` and its own number.
    pub pair: PairOf,
}

/// Finds the files of a pair by the index of its scene and its number there.
pub type PairOf = Box<dyn Fn(usize, u64) -> Option<PairSource> + Sync>;

/// Consecutive pairs of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scene {
    pub split: SceneSplit,
    pub pairs: u64,
}

/// A pair to pack.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PairSource {
    /// Empty in datasets without scenes.
    pub scene: String,
    pub frame: String,
    pub flow: PathBuf,
    /// Flow beside it, of the same format: field and file.
    pub other_flows: Vec<(&'static str, PathBuf)>,
    /// The record with cameras and statistics.
    pub record: Option<PathBuf>,
    pub occlusion: Option<PathBuf>,
    /// Everything else, which is packed as it is: field and file.
    pub pictures: Vec<(&'static str, PathBuf)>,
}

impl PairSource {
    /// First part of its members' names.
    pub(crate) fn key(&self) -> String {
        if self.scene.is_empty() { self.frame.clone() } else { format!("{}_{}", self.scene, self.frame) }
    }

    /// The files of flow, with their fields.
    pub(crate) fn flows(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let others = self.other_flows.iter().map(|(field, path)| (*field, path.as_path()));
        [("flow", self.flow.as_path())].into_iter().chain(others)
    }

    /// The files that are packed as they are, with their fields.
    pub(crate) fn copied(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let pictures = self.pictures.iter().map(|(field, path)| (*field, path.as_path()));
        let occlusion = self.occlusion.iter().map(|path| ("occlusion", path.as_path()));
        let record = self.record.iter().map(|path| ("meta", path.as_path()));
        pictures.chain(occlusion).chain(record)
    }

    /// Statistics of the flow: those of the record, which are of the head, or else of the whole flow.
    pub(crate) fn statistics(&self, flow: &FlowField) -> Result<FlowStatistics, ReadError> {
        #[derive(Deserialize)]
        struct Record {
            flow: FlowStatistics,
        }
        if let Some(path) = &self.record {
            let text = read_text(path, FileKind::Json)?;
            let record: Record = serde_json::from_str(&text).map_err(|error| ReadError::Content {
                path: path.clone(),
                reason: parse_error_in_words(&error),
            })?;
            return Ok(record.flow);
        }
        let occluded = match &self.occlusion {
            Some(path) => read_mask(path)?.pixels().iter().filter(|hidden| **hidden).count() as u64,
            None => 0,
        };
        let mut statistics = FlowStatistics { occluded, ..FlowStatistics::default() };
        for [u, v] in flow.pixels() {
            let magnitude = u.hypot(*v);
            if !magnitude.is_nan() {
                statistics.pixels += 1;
                statistics.sum += f64::from(magnitude);
                statistics.max = statistics.max.max(magnitude);
            }
        }
        Ok(statistics)
    }
}

impl Source {
    /// The scenes of `split`, with their indices.
    pub(crate) fn scenes_of(&self, split: SceneSplit) -> impl Iterator<Item = (usize, &Scene)> {
        self.scenes.iter().enumerate().filter(move |(_, scene)| scene.split == split)
    }

    /// Number of pairs in `split`.
    pub(crate) fn pairs(&self, split: SceneSplit) -> u64 {
        self.scenes_of(split).map(|(_, scene)| scene.pairs).sum()
    }

    /// Calls `on_pair` with the pairs of `split` from number `first`, `count` of them, in order.
    pub(crate) fn each<E>(
        &self,
        split: SceneSplit,
        first: u64,
        count: u64,
        mut on_pair: impl FnMut(PairSource) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut start = 0;
        for (index, scene) in self.scenes_of(split) {
            let end = first.saturating_add(count).min(start + scene.pairs);
            for number in first.max(start)..end {
                if let Some(pair) = (self.pair)(index, number - start) {
                    on_pair(pair)?;
                }
            }
            start += scene.pairs;
        }
        Ok(())
    }

    /// The first pair.
    pub(crate) fn first(&self) -> Option<PairSource> {
        let split = SceneSplit::ALL.into_iter().find(|split| self.pairs(*split) > 0)?;
        let (index, _) = self.scenes_of(split).find(|(_, scene)| scene.pairs > 0)?;
        (self.pair)(index, 0)
    }

    /// A flow of the dataset as it is packed: the file itself if it has that format.
    pub(crate) fn encoded(
        &self,
        format: PackedFlow,
        path: &Path,
        flow: &FlowField,
    ) -> Result<Vec<u8>, PackError> {
        if format.format().is_some() && format.format() == self.flow_format {
            return Ok(read_file(path, FileKind::Flow)?);
        }
        format.encode(flow).map_err(|problem| PackError::Flow { path: path.to_owned(), problem })
    }
}

//! What is packed: a complete dataset of `srflow render`, or of `srflow shapes`.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;
use srflow_core::FlowField;
use srflow_files::{FileKind, FlowFormat, parse_error_in_words, read_image_size, read_mask, read_text};

use super::index::FlowStatistics;
use super::writer::PackError;
use crate::flow::{DatasetSpec, Entry, EntryFile, FlowDataset, Occlusion, Split};
use crate::manifest::{MANIFEST_NAME, Manifest, PairFiles, SceneEntry, SceneSplit};

/// Name of the file with the arguments in the folder of `srflow shapes`.
const SHAPES_NAME: &str = "shapes.json";

/// A dataset to pack.
pub(super) struct Source {
    /// What made it: `srflow render` or `srflow shapes`.
    pub command: &'static str,
    /// The arguments that made it.
    pub description: Value,
    dir: PathBuf,
    data: Data,
}

enum Data {
    Scenes(Box<Manifest>),
    /// The pairs of train and of val, by number.
    Pairs([Vec<PairSource>; 2]),
}

/// A pair to pack.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PairSource {
    /// Empty in datasets without scenes.
    pub scene: String,
    pub frame: String,
    pub flow: PathBuf,
    pub flow_backward: Option<PathBuf>,
    /// The record with cameras and statistics.
    pub record: Option<PathBuf>,
    pub occlusion: Option<PathBuf>,
    /// Everything else, which is packed as it is: field and file.
    pub pictures: Vec<(&'static str, PathBuf)>,
}

impl PairSource {
    /// First part of its members' names.
    pub fn key(&self) -> String {
        if self.scene.is_empty() { self.frame.clone() } else { format!("{}_{}", self.scene, self.frame) }
    }

    /// The files of flow, with their fields.
    pub fn flows(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let backward = self.flow_backward.iter().map(|path| ("flow_backward", path.as_path()));
        [("flow", self.flow.as_path())].into_iter().chain(backward)
    }

    /// The files that are packed as they are, with their fields.
    pub fn copied(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let pictures = self.pictures.iter().map(|(field, path)| (*field, path.as_path()));
        let occlusion = self.occlusion.iter().map(|path| ("occlusion", path.as_path()));
        let record = self.record.iter().map(|path| ("meta", path.as_path()));
        pictures.chain(occlusion).chain(record)
    }

    pub fn frame1(&self) -> Option<&Path> {
        self.copied().find_map(|(field, path)| (field == "frame1").then_some(path))
    }

    /// Statistics of the flow: those of the record, which are of the head, or else of the whole flow.
    pub fn statistics(&self, flow: &FlowField) -> Result<FlowStatistics, PackError> {
        #[derive(Deserialize)]
        struct Record {
            flow: FlowStatistics,
        }
        if let Some(path) = &self.record {
            let text = read_text(path, FileKind::Json)?;
            let record: Record = serde_json::from_str(&text).map_err(|error| PackError::Content {
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
    /// Opens the dataset in `dir`.
    ///
    /// # Errors
    /// When it is neither of `srflow render` nor of `srflow shapes`.
    pub fn open(dir: &Path) -> Result<Self, PackError> {
        let dir = dir.to_owned();
        if dir.join(MANIFEST_NAME).exists() {
            let manifest = Manifest::read(&dir)?;
            let description = serde_json::to_value(&manifest).unwrap_or_default();
            let data = Data::Scenes(Box::new(manifest));
            return Ok(Self { command: "srflow render", description, dir, data });
        }
        let path = dir.join(SHAPES_NAME);
        if !path.exists() {
            return Err(PackError::NoDataset { dir });
        }
        let description = serde_json::from_str(&read_text(&path, FileKind::Json)?)
            .map_err(|error| PackError::Content { path, reason: parse_error_in_words(&error) })?;
        let spec = DatasetSpec { kind: "chairs".to_owned(), dir: dir.clone() };
        let pairs = |split| match FlowDataset::open(&spec, Some(split)) {
            Ok(dataset) => Ok(dataset.entries().iter().filter_map(pair_of_entry).collect()),
            Err(error) => Err(error),
        };
        // A small dataset has no pair for validation.
        let all: Vec<PairSource> = pairs(Split::All)?;
        let train: Vec<PairSource> = pairs(Split::Train).unwrap_or_default();
        let val = if train.len() == all.len() { Vec::new() } else { pairs(Split::Val)? };
        Ok(Self { command: "srflow shapes", description, dir, data: Data::Pairs([train, val]) })
    }

    /// Name of the scenes in `split` with their numbers of pairs; one without a name for all pairs of a dataset without scenes.
    fn scenes(&self, split: SceneSplit) -> Vec<(Option<&SceneEntry>, u64)> {
        match (&self.data, split) {
            (Data::Scenes(manifest), _) => {
                manifest.scenes_of(split).map(|scene| (Some(scene), u64::from(scene.pairs))).collect()
            }
            (Data::Pairs([train, _]), SceneSplit::Train) => vec![(None, train.len() as u64)],
            (Data::Pairs([_, val]), SceneSplit::Val) => vec![(None, val.len() as u64)],
            (Data::Pairs(_), SceneSplit::Test) => Vec::new(),
        }
    }

    /// Number of pairs in `split`.
    pub fn pairs(&self, split: SceneSplit) -> u64 {
        self.scenes(split).iter().map(|(_, pairs)| pairs).sum()
    }

    /// Number of scenes in `split`; 0 in datasets without scenes.
    pub fn scene_count(&self, split: SceneSplit) -> usize {
        self.scenes(split).iter().filter(|(scene, _)| scene.is_some()).count()
    }

    /// Calls `on_pair` with the pairs of `split` from number `first`, `count` of them, in order.
    pub fn each<E>(
        &self,
        split: SceneSplit,
        first: u64,
        count: u64,
        mut on_pair: impl FnMut(PairSource) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut start = 0;
        for (scene, pairs) in self.scenes(split) {
            let from = first.max(start);
            let to = first.saturating_add(count).min(start + pairs);
            for number in from..to {
                if let Some(pair) = self.pair(split, scene, number - start) {
                    on_pair(pair)?;
                }
            }
            start += pairs;
        }
        Ok(())
    }

    fn pair(&self, split: SceneSplit, scene: Option<&SceneEntry>, number: u64) -> Option<PairSource> {
        match (&self.data, scene) {
            (Data::Scenes(manifest), Some(scene)) => {
                let number = u32::try_from(number).ok()?;
                let files = manifest.files(&self.dir, scene, number);
                Some(pair_of_files(&scene.name, number, files))
            }
            (Data::Pairs([train, val]), _) => {
                let pairs = if split == SceneSplit::Train { train } else { val };
                pairs.get(usize::try_from(number).ok()?).cloned()
            }
            (Data::Scenes(_), None) => None,
        }
    }

    /// Format of the dataset's flow, if all files have the same.
    pub fn flow_format(&self) -> Option<FlowFormat> {
        match &self.data {
            Data::Scenes(manifest) => manifest.arguments.flow_format.parse().ok(),
            Data::Pairs(pairs) => FlowFormat::from_path(&pairs.iter().flatten().next()?.flow),
        }
    }

    /// Whether it shows heads, in scenes.
    pub fn is_of_faces(&self) -> bool {
        matches!(self.data, Data::Scenes(_))
    }

    /// Width and height of the frames.
    pub fn size(&self) -> Result<(usize, usize), PackError> {
        match &self.data {
            Data::Scenes(manifest) => Ok((manifest.arguments.width, manifest.arguments.height)),
            Data::Pairs(pairs) => {
                let frame = pairs.iter().flatten().next().and_then(|pair| pair.frame1());
                Ok(frame.map(read_image_size).transpose()?.unwrap_or_default())
            }
        }
    }

    /// The first pair.
    pub fn first(&self) -> Option<PairSource> {
        let mut first = None;
        for split in SceneSplit::ALL {
            _ = self.each(split, 0, 1, |pair| {
                first = first.take().or(Some(pair));
                Ok::<_, PackError>(())
            });
        }
        first
    }
}

fn pair_of_files(scene: &str, number: u32, files: PairFiles) -> PairSource {
    let PairFiles { frame1, frame2, flow, flow_backward, alpha, mask, occlusion, depth, regions, record } =
        files;
    let mut pictures = vec![("alpha", alpha), ("frame1", frame1), ("frame2", frame2), ("mask", mask)];
    pictures.extend(depth.map(|path| ("depth", path)));
    pictures.extend(regions.map(|path| ("regions", path)));
    PairSource {
        scene: scene.to_owned(),
        frame: format!("{number:05}"),
        flow,
        flow_backward,
        record: Some(record),
        occlusion: Some(occlusion),
        pictures,
    }
}

fn pair_of_entry(entry: &Entry) -> Option<PairSource> {
    let path = EntryFile::on_disk;
    let occlusion = match &entry.occlusion {
        Some(Occlusion::Picture(file)) => path(file),
        _ => None,
    };
    Some(PairSource {
        scene: String::new(),
        frame: entry.frame.clone(),
        flow: path(entry.flow.as_ref()?)?,
        flow_backward: None,
        record: None,
        occlusion,
        pictures: vec![("frame1", path(&entry.frame1)?), ("frame2", path(&entry.frame2)?)],
    })
}

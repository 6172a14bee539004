//! What is packed of a dataset of `srflow render`, or of `srflow shapes`.

use std::path::{Path, PathBuf};

use srflow_core::Size;
use srflow_files::{FileKind, FlowFormat, parse_error_in_words, read_image_size, read_text};
use srflow_pack::{PairSource, Scene, Source};

use crate::flow::{DatasetError, DatasetSpec, Entry, EntryFile, FlowDataset, Occlusion, Split};
use crate::manifest::{MANIFEST_NAME, Manifest, PairFiles, SceneSplit};

/// Name of the file with the arguments in the folder of `srflow shapes`.
const SHAPES_NAME: &str = "shapes.json";

/// The dataset in `dir`, to pack.
///
/// # Errors
/// When it is neither of `srflow render` nor of `srflow shapes`, or cannot be read.
pub fn pack_source(dir: &Path) -> Result<Source, DatasetError> {
    if dir.join(MANIFEST_NAME).exists() {
        return Ok(rendered(dir, Manifest::read(dir)?));
    }
    let path = dir.join(SHAPES_NAME);
    if path.exists() {
        return shapes(dir, path);
    }
    let reason = "expected the folder of a dataset of `srflow render` or `srflow shapes` (with dataset.json or shapes.json), found none";
    Err(DatasetError::Format { path: dir.to_owned(), reason: reason.to_owned() })
}

fn rendered(dir: &Path, manifest: Manifest) -> Source {
    let scenes = manifest.scenes.iter();
    Source {
        dir: dir.to_owned(),
        command: "srflow render",
        description: serde_json::to_value(&manifest).unwrap_or_default(),
        faces: true,
        flow_format: manifest.arguments.flow_format.parse().ok(),
        size: Size::new(manifest.arguments.width, manifest.arguments.height),
        scenes: scenes.map(|scene| Scene { split: scene.split, pairs: scene.pairs.into() }).collect(),
        pair: {
            let dir = dir.to_owned();
            Box::new(move |scene, number| {
                let (scene, number) = (manifest.scenes.get(scene)?, u32::try_from(number).ok()?);
                Some(pair_of_files(&scene.name, number, manifest.files(&dir, scene, number)))
            })
        },
    }
}

/// `path` is that of the arguments.
fn shapes(dir: &Path, path: PathBuf) -> Result<Source, DatasetError> {
    let description = serde_json::from_str(&read_text(&path, FileKind::Json)?)
        .map_err(|error| DatasetError::Format { path, reason: parse_error_in_words(&error) })?;
    let spec = DatasetSpec { kind: "chairs".to_owned(), dir: dir.to_owned() };
    let pairs = |split| -> Result<Vec<PairSource>, DatasetError> {
        Ok(FlowDataset::open(&spec, Some(split))?.entries().iter().filter_map(pair_of_entry).collect())
    };
    // A small dataset has no pair for validation.
    let all = pairs(Split::All)?;
    let train = pairs(Split::Train).unwrap_or_default();
    let val = if train.len() == all.len() { Vec::new() } else { pairs(Split::Val)? };
    let first = all.first();
    let frame1 = first.and_then(|pair| pair.pictures.iter().find(|(field, _)| *field == "frame1"));
    let splits = [(SceneSplit::Train, &train), (SceneSplit::Val, &val)];
    Ok(Source {
        dir: dir.to_owned(),
        command: "srflow shapes",
        description,
        faces: false,
        flow_format: first.and_then(|pair| FlowFormat::from_path(&pair.flow)),
        size: frame1.map(|(_, path)| read_image_size(path)).transpose()?.unwrap_or_default(),
        scenes: splits.map(|(split, pairs)| Scene { split, pairs: pairs.len() as u64 }).to_vec(),
        pair: Box::new(move |scene, number| {
            [&train, &val].get(scene)?.get(usize::try_from(number).ok()?).cloned()
        }),
    })
}

fn pair_of_files(scene: &str, number: u32, files: PairFiles) -> PairSource {
    let other_flows = files.other_flows().map(|(field, path)| (field, path.clone())).collect();
    let PairFiles {
        frame1,
        frame2,
        flow,
        shading_change,
        alpha,
        mask,
        occlusion,
        depth,
        regions,
        record,
        ..
    } = files;
    let mut pictures = vec![("alpha", alpha), ("frame1", frame1), ("frame2", frame2), ("mask", mask)];
    pictures.extend(depth.map(|path| ("depth", path)));
    pictures.extend(regions.map(|path| ("regions", path)));
    pictures.extend(shading_change.map(|path| ("shading_change", path)));
    PairSource {
        scene: scene.to_owned(),
        frame: format!("{number:05}"),
        flow,
        other_flows,
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
        other_flows: Vec::new(),
        record: None,
        occlusion,
        pictures: vec![("frame1", path(&entry.frame1)?), ("frame2", path(&entry.frame2)?)],
    })
}

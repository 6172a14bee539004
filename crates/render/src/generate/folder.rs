//! The output folder: whose it is, what it still lacks, and what a killed run left in it.

use std::fs;
use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::Value;
use srflow_field::{FileKind, PARTIAL_EXTENSION, create_folder, excerpt, read_text, write_atomically};

use super::error::GenerateError;
use super::settings::Shard;
use srflow_read::manifest::{MANIFEST_NAME, Manifest, PairFiles, STATISTICS_NAME, SceneEntry, SceneSplit};

/// How old a file that is being written must be before it is taken for a killed run's, where another part may be at
/// work in the same folder.
const ABANDONED_AFTER: Duration = Duration::from_secs(60);

/// Makes `dir` the folder of the dataset that `manifest` plans: a new one, or the same one begun before.
///
/// # Errors
/// When the folder holds something else or a dataset made with other arguments, unless `force` deletes that dataset.
pub(super) fn claim(dir: &Path, manifest: &Manifest, force: bool) -> Result<(), GenerateError> {
    let path = dir.join(MANIFEST_NAME);
    let mut planned =
        serde_json::to_string_pretty(manifest).map_err(|error| io_error(&path, error.into()))?;
    planned.push('\n');
    if path.exists() {
        let found = read_text(&path, FileKind::Json)?;
        if force {
            delete(dir, &Manifest::read(dir)?)?;
        } else if found != planned {
            return Err(difference(dir, &found, &planned)?);
        } else {
            return Ok(());
        }
    } else if has_visible_entries(dir).map_err(|error| io_error(dir, error))? {
        return Err(GenerateError::NotADataset(dir.to_owned()));
    }
    create_folder(dir)?;
    write_atomically(&path, |writer| writer.write_all(planned.as_bytes()))?;
    Ok(())
}

/// Whether there is anything in a folder beside hidden files, which other parts may just be writing.
fn has_visible_entries(dir: &Path) -> io::Result<bool> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
        entries => entries?,
    };
    for entry in entries {
        if !entry?.file_name().to_string_lossy().starts_with('.') {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The error that names the first field in which two manifests differ.
fn difference(dir: &Path, found: &str, planned: &str) -> Result<GenerateError, GenerateError> {
    Manifest::read(dir)?; // what is no manifest at all is said as such
    let parse = |text| serde_json::from_str::<Value>(text).unwrap_or_default();
    let (found, planned) = (parse(found), parse(planned));
    let other = |field: &str, found: &Value, asked: &Value| GenerateError::OtherDataset {
        path: dir.to_owned(),
        field: field.to_owned(),
        found: excerpt(&found.to_string()),
        asked: asked.to_string(),
    };
    let version = "srflow_version";
    if found[version] != planned[version] {
        return Ok(other(version, &found[version], &planned[version]));
    }
    if let Value::Object(arguments) = &planned["arguments"] {
        for (name, asked) in arguments {
            if found["arguments"][name] != *asked {
                return Ok(other(name, &found["arguments"][name], asked));
            }
        }
    }
    let (found, asked) =
        (Value::from("other cameras or scenes"), Value::from("those that its arguments give"));
    Ok(other(MANIFEST_NAME, &found, &asked))
}

/// Deletes the files that a dataset's manifest speaks of, and nothing else.
fn delete(dir: &Path, manifest: &Manifest) -> Result<(), GenerateError> {
    // First, so that a deletion cut short is not taken for a dataset that lacks some files.
    let gone = |path: &Path, result: io::Result<()>| match result {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(io_error(path, error)),
        _ => Ok(()),
    };
    for scene in &manifest.scenes {
        for kind in manifest.kinds() {
            let folder = scene_folder(dir, scene, kind);
            gone(&folder, fs::remove_dir_all(&folder))?;
        }
    }
    for split in SceneSplit::ALL {
        let split = dir.join(split.to_string());
        for folder in manifest.kinds().map(|kind| split.join(kind)).chain([split.clone()]) {
            let _ = fs::remove_dir(&folder); // stays where something else lies in it
        }
    }
    for name in [STATISTICS_NAME, MANIFEST_NAME] {
        gone(&dir.join(name), fs::remove_file(dir.join(name)))?;
    }
    Ok(())
}

fn scene_folder(dir: &Path, scene: &SceneEntry, kind: &str) -> PathBuf {
    dir.join(scene.split.to_string()).join(kind).join(&scene.name)
}

/// Consecutive pairs of one scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Run {
    /// Number of the scene.
    pub scene: u32,
    /// Numbers of the pairs.
    pub pairs: Range<u32>,
}

/// The pairs of each scene that are a shard's to make: the pairs of all scenes in a row are cut into equal parts.
pub(super) fn pairs_of_shard(manifest: &Manifest, shard: Shard) -> Vec<Run> {
    let total = manifest.pairs();
    let cut = |part: u32| u64::from(part) * total / u64::from(shard.of);
    let (from, to) = (cut(shard.number - 1), cut(shard.number));
    let mut before = 0;
    let mut runs = Vec::new();
    for (number, scene) in (0..).zip(&manifest.scenes) {
        let after = before + u64::from(scene.pairs);
        let within = |place: u64| (place.clamp(before, after) - before) as u32;
        let pairs = within(from)..within(to);
        if !pairs.is_empty() {
            runs.push(Run { scene: number, pairs });
        }
        before = after;
    }
    runs
}

/// What of `runs` is not there yet, as runs.
pub(super) fn missing(dir: &Path, manifest: &Manifest, runs: &[Run]) -> Vec<Run> {
    let mut missing = Vec::new();
    for run in runs {
        let scene = &manifest.scenes[run.scene as usize];
        let mut start = None;
        for pair in run.pairs.clone() {
            match (is_whole(dir, manifest, scene, pair), start) {
                (false, None) => start = Some(pair),
                (true, Some(first)) => {
                    missing.push(Run { scene: run.scene, pairs: first..pair });
                    start = None;
                }
                _ => {}
            }
        }
        if let Some(first) = start {
            missing.push(Run { scene: run.scene, pairs: first..run.pairs.end });
        }
    }
    missing
}

/// Whether every file that is made with a pair is there: files get their names when they are complete. A frame is made
/// with the pair that it begins, a scene's last frame with the last pair.
fn is_whole(dir: &Path, manifest: &Manifest, scene: &SceneEntry, pair: u32) -> bool {
    let PairFiles { flow, flow_backward, occlusion, record, .. } = manifest.files(dir, scene, pair);
    let frames = if pair + 1 == scene.pairs { pair..pair + 2 } else { pair..pair + 1 };
    let of_frames = frames.map(|frame| manifest.frame_files(dir, scene, frame));
    [record, flow, occlusion].iter().chain(&flow_backward).all(|file| file.exists())
        && of_frames.into_iter().all(|files| files.all().all(|file| file.exists()))
}

/// Cuts runs into pieces of at most `length` pairs.
pub(super) fn cut(runs: Vec<Run>, length: u32) -> Vec<Run> {
    let pieces = |run: Run| {
        let starts = run.pairs.clone().step_by(length.max(1) as usize);
        starts.map(move |start| Run {
            scene: run.scene,
            pairs: start..start.saturating_add(length).min(run.pairs.end),
        })
    };
    runs.into_iter().flat_map(pieces).collect()
}

/// Makes the folders of the scenes in `runs`, and removes what a killed run was just writing into them.
pub(super) fn tidy(dir: &Path, manifest: &Manifest, runs: &[Run]) -> Result<(), GenerateError> {
    remove_partial(dir, |_, age| age >= ABANDONED_AFTER)?;
    for run in runs {
        let scene = &manifest.scenes[run.scene as usize];
        let made_in_run = |name: &str, _| {
            let frame: Option<u32> = name.split('.').next().and_then(|digits| digits.parse().ok());
            frame.is_some_and(|frame| run.pairs.contains(&frame.min(scene.pairs - 1)))
        };
        for kind in manifest.kinds() {
            let folder = scene_folder(dir, scene, kind);
            create_folder(&folder)?;
            remove_partial(&folder, made_in_run)?;
        }
    }
    Ok(())
}

/// Removes the half-written files of a folder whose final name and age are `abandoned`.
fn remove_partial(dir: &Path, abandoned: impl Fn(&str, Duration) -> bool) -> Result<(), GenerateError> {
    let failed = |error| io_error(dir, error);
    for entry in fs::read_dir(dir).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_partial = Path::new(&name).extension().is_some_and(|extension| extension == PARTIAL_EXTENSION);
        let Some(name) = name.strip_prefix('.').filter(|_| is_partial) else { continue };
        let modified = entry.metadata().and_then(|metadata| metadata.modified());
        let age = modified.ok().and_then(|modified| modified.elapsed().ok()).unwrap_or_default();
        if abandoned(name, age) {
            match fs::remove_file(entry.path()) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(io_error(&entry.path(), error));
                }
                _ => {}
            }
        }
    }
    Ok(())
}

fn io_error(path: &Path, error: io::Error) -> GenerateError {
    GenerateError::Io { path: path.to_owned(), error }
}

#[cfg(test)]
mod tests {
    use srflow_field::FlowFormat;

    use super::*;
    use crate::generate::{Background, Head, Settings};
    use srflow_read::manifest::FrameFiles;

    fn manifest(scenes: u32, frames: f64) -> Manifest {
        let settings = Settings {
            head: Head::Builtin,
            scenes,
            frames,
            width: 110,
            height: 160,
            splits: [1.0, 0.0, 0.0],
            seed: 1,
            flow_format: FlowFormat::Npz16,
            backward: false,
            depth: false,
            background: Background::Colour([255; 3]),
        };
        settings.plan().unwrap()
    }

    fn pairs(runs: &[Run]) -> Vec<(u32, u32)> {
        runs.iter().flat_map(|run| run.pairs.clone().map(|pair| (run.scene, pair))).collect()
    }

    #[test]
    fn parts_are_equal_and_together_the_whole() {
        let manifest = manifest(5, 7.4);
        let whole = pairs(&pairs_of_shard(&manifest, Shard::WHOLE));
        assert_eq!(whole.len() as u64, manifest.pairs());
        for of in [1, 2, 3, 8, 37, 50] {
            let parts = (1..=of).map(|number| pairs(&pairs_of_shard(&manifest, Shard { number, of })));
            let parts: Vec<Vec<(u32, u32)>> = parts.collect();
            assert_eq!(parts.concat(), whole);
            let sizes = || parts.iter().map(Vec::len);
            assert!(sizes().max().unwrap() - sizes().min().unwrap() <= 1);
        }
    }

    #[test]
    fn runs_are_cut_without_loss() {
        let runs = vec![Run { scene: 0, pairs: 3..11 }, Run { scene: 2, pairs: 0..1 }];
        let short = cut(runs.clone(), 3);
        assert_eq!(pairs(&short), pairs(&runs));
        assert_eq!(short.iter().map(|run| run.pairs.len()).collect::<Vec<_>>(), [3, 3, 2, 1]);
    }

    #[test]
    fn a_pair_lacks_what_any_of_its_files_lacks() {
        let dir = tempfile::tempdir().unwrap();
        let manifest = manifest(1, 3.0);
        claim(dir.path(), &manifest, false).unwrap();
        let everything = pairs_of_shard(&manifest, Shard::WHOLE);
        tidy(dir.path(), &manifest, &everything).unwrap();
        let left = || pairs(&missing(dir.path(), &manifest, &everything));
        assert_eq!(left().len(), 3);
        let scene = &manifest.scenes[0];
        for pair in 0..3 {
            let of_frames = [pair, pair + 1].map(|frame| manifest.frame_files(dir.path(), scene, frame));
            let files = manifest.files(dir.path(), scene, pair);
            for file in files.all().chain(of_frames.iter().flat_map(FrameFiles::all)) {
                fs::write(file, "x").unwrap();
            }
        }
        assert_eq!(left(), []);
        fs::remove_file(manifest.frame_files(dir.path(), scene, 3).alpha).unwrap();
        assert_eq!(left(), [(0, 2)]);
        fs::remove_file(manifest.files(dir.path(), scene, 0).occlusion).unwrap();
        assert_eq!(left(), [(0, 0), (0, 2)]);
    }
}

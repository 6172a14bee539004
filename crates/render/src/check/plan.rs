//! The expected contents of `dataset.json`, the records and the folders, derived from the dataset's arguments.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use srflow_data::manifest::{MANIFEST_NAME, Manifest, RigCamera, SceneEntry, SceneSplit};
use srflow_head::HeadModel;

use super::problem::Problem;
use crate::camera::{camera_from_record, record_from_camera};
use crate::generate::{Action, Settings, Views, record};
use crate::job::first_difference;
use crate::record::FrameRecord;

/// Problems of `dataset.json`. If another version of srflow wrote the dataset, whose plan may differ, only numbers and
/// cameras are checked.
pub fn problems_of_manifest(dir: &Path, manifest: &Manifest) -> Vec<Problem> {
    let problem = |what| Problem { file: dir.join(MANIFEST_NAME), what };
    let planned = match Settings::of(manifest) {
        Ok((_, planned)) => planned,
        Err(what) => return vec![problem(format!("its arguments: {what}"))],
    };
    let mut wrong = Vec::new();
    if manifest.scenes.len() != planned.scenes.len() {
        let (found, expected) = (manifest.scenes.len(), planned.scenes.len());
        wrong.push(format!("it lists {found} scenes, expected {expected} from its arguments"));
    }
    let mut found: BTreeMap<&str, &SceneEntry> = BTreeMap::new();
    for scene in &manifest.scenes {
        if found.insert(&scene.name, scene).is_some() {
            wrong.push(format!("it lists {} twice", scene.name));
        }
    }
    for scene in &planned.scenes {
        match found.remove(scene.name.as_str()) {
            None => wrong
                .push(format!("it does not list {} ({}, {} pairs)", scene.name, scene.split, scene.pairs)),
            Some(there) if is_of_this_version(manifest) => {
                wrong.extend(differs(there, scene).map(|what| format!("{}: {what}", scene.name)));
            }
            Some(there) if there.pairs != scene.pairs => {
                wrong.push(format!("{}: pairs {}, expected {}", scene.name, there.pairs, scene.pairs));
            }
            Some(_) => {}
        }
    }
    wrong.extend(
        found.keys().map(|name| format!("it lists `{name}`, which does not follow from its arguments")),
    );
    wrong.extend(problems_of_rig(manifest, &planned.rig));
    wrong.into_iter().map(problem).collect()
}

fn problems_of_rig(manifest: &Manifest, planned: &[RigCamera]) -> Vec<String> {
    let rig = &manifest.rig;
    if rig.len() != planned.len() {
        return vec![format!("its rig has {} cameras, expected {}", rig.len(), planned.len())];
    }
    let wrong = |(found, planned): (&RigCamera, &RigCamera)| {
        let what = if is_of_this_version(manifest) {
            differs(found, planned)
        } else {
            camera_from_record(&found.camera).validate().err().map(|error| error.to_string())
        };
        what.map(|what| format!("camera {}: {what}", found.number))
    };
    rig.iter().zip(planned).filter_map(wrong).collect()
}

pub fn is_of_this_version(manifest: &Manifest) -> bool {
    manifest.srflow_version == env!("CARGO_PKG_VERSION")
}

/// The first field that differs from the plan.
fn differs<T: Serialize>(found: &T, planned: &T) -> Option<String> {
    let value = |of| serde_json::to_value(of).unwrap_or_default();
    let (field, found, expected) = first_difference(&value(found), &value(planned))?;
    Some(format!("{field} {found}, expected {expected}"))
}

/// The expected records of a scene.
pub struct Expected {
    views: Views,
    /// For the built-in heads in random motion, which follow from the manifest alone.
    action: Option<(HeadModel, Action)>,
}

impl Expected {
    /// `None` if another version of srflow wrote the dataset.
    pub fn of_scene(manifest: &Manifest, number: u32, scene: &SceneEntry) -> Option<Self> {
        let (settings, _) = Settings::of(manifest).ok().filter(|_| is_of_this_version(manifest))?;
        let rig = settings.rig();
        let follows = settings.head.is_builtin() && !settings.motion.is_of_files();
        let model = follows.then(|| settings.dressed_head().model(scene.subject).ok()).flatten();
        let action = model.map(|model| {
            let action = Action::new(&settings, &rig, number, scene, &model);
            (model, action)
        });
        Some(Self { views: Views::new(&settings, &rig, number, scene.pairs), action })
    }

    /// Problems of the record of a frame.
    pub fn differs(&self, found: &FrameRecord) -> Option<String> {
        let expected = match &self.action {
            Some((model, action)) => record(model, found.frame, &action.frame(model, found.frame)),
            None => {
                let (camera, view, subject) = self.views.at(f64::from(found.frame));
                FrameRecord { camera: record_from_camera(&camera), view, subject, ..found.clone() }
            }
        };
        differs(found, &expected)
    }
}

/// Unexpected files and folders within the splits.
pub fn unexpected_files(dir: &Path, manifest: &Manifest) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut unexpected = |file: PathBuf, what: &str| problems.push(Problem { file, what: what.to_owned() });
    let kinds: BTreeSet<&str> = manifest.kinds().collect();
    for split in SceneSplit::ALL {
        for kind in entries(&dir.join(split.to_string())) {
            if !kinds.contains(name(&kind).as_str()) {
                unexpected(kind, "not a part of this dataset");
                continue;
            }
            let scenes: BTreeSet<&str> = manifest.scenes_of(split).map(|scene| scene.name.as_str()).collect();
            for scene in entries(&kind).into_iter().filter(|scene| !scenes.contains(name(scene).as_str())) {
                unexpected(scene, "not a scene of this dataset");
            }
        }
    }
    for scene in &manifest.scenes {
        let mut expected = BTreeSet::new();
        for pair in 0..scene.pairs {
            let of_last = manifest.frame_files(dir, scene, pair + 1);
            expected.extend(manifest.files(dir, scene, pair).all().chain(of_last.all()).cloned());
        }
        let folders: BTreeSet<&Path> = expected.iter().filter_map(|file| file.parent()).collect();
        for file in folders.into_iter().flat_map(entries).filter(|file| !expected.contains(file)) {
            unexpected(
                file,
                "not a file of this dataset; an interrupted run leaves such files, and the next one removes them",
            );
        }
    }
    problems
}

/// The entries of a folder by name; empty if there is no folder, since missing files are reported one by one.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    found.sort();
    found
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> Manifest {
        let (splits, seed) = ([0.6, 0.2, 0.2], 3);
        let settings = Settings {
            scenes: 5,
            frames: 7.4,
            size: srflow_core::Size { width: 110, height: 160 },
            splits: srflow_core::Numbers(splits),
            seed,
            ..Settings::default()
        };
        settings.plan().unwrap()
    }

    /// The problems of the manifest after `change`.
    fn said(change: impl FnOnce(&mut Manifest)) -> String {
        let mut manifest = manifest();
        change(&mut manifest);
        let problems = problems_of_manifest(Path::new("data"), &manifest);
        problems
            .into_iter()
            .map(|problem| format!("{}: {}\n", problem.file.display(), problem.what))
            .collect()
    }

    #[test]
    fn deviations_from_the_arguments_are_reported() {
        assert_eq!(said(|_| {}), "");
        let all = said(|manifest| manifest.scenes.clear());
        assert!(all.starts_with("data/dataset.json: it lists 0 scenes, expected 5"), "{all}");
        let one = said(|manifest| drop(manifest.scenes.remove(2)));
        assert!(one.contains("it lists 4 scenes") && one.contains("does not list scene-0002 ("), "{one}");
        assert!(
            said(|manifest| manifest.scenes[1].pairs = 4_000_000_000)
                .contains("scene-0001: pairs 4000000000")
        );
        assert!(said(|manifest| manifest.scenes[1].subject ^= 1).contains("scene-0001: subject"));
        assert!(said(|manifest| manifest.scenes[1].background = Some("x.png".into())).contains("background"));
        assert!(
            said(|manifest| manifest.scenes[1].name = "scene-0000".into()).contains("lists scene-0000 twice")
        );
        assert!(said(|manifest| manifest.scenes[1].name = "other".into()).contains("lists `other`"));
        let swap = |manifest: &mut Manifest| {
            let split = &mut manifest.scenes[0].split;
            *split = if *split == SceneSplit::Val { SceneSplit::Test } else { SceneSplit::Val };
        };
        assert!(said(swap).contains("scene-0000: split"));
        assert!(said(|manifest| manifest.rig[3].camera.fx = -1.0).contains("camera 4: fx -1.0, expected"));
        assert!(said(|manifest| manifest.rig.clear()).contains("its rig has 0 cameras, expected 16"));
        for (change, named) in [
            (
                (|manifest| _ = manifest.arguments.others.insert("scenes".into(), 0.into()))
                    as fn(&mut Manifest),
                "scenes 0",
            ),
            (|manifest| _ = manifest.arguments.others.insert("frames".into(), (-1.0).into()), "frames -1"),
            (
                |manifest| _ = manifest.arguments.others.insert("splits".into(), vec![1.0; 3].into()),
                "splits 1,1,1",
            ),
            (|manifest| manifest.arguments.width = usize::MAX, "size"),
            (|manifest| _ = manifest.arguments.others.insert("head".into(), "flame".into()), "head `flame`"),
            (
                |manifest| _ = manifest.arguments.others.insert("background".into(), "sky".into()),
                "background `sky`",
            ),
        ] {
            assert!(said(change).contains(named), "{named}");
        }
    }

    #[test]
    fn another_versions_plan_may_differ_but_not_its_numbers() {
        let other = |change: fn(&mut Manifest)| {
            said(|manifest| {
                manifest.srflow_version = "0.0.9".into();
                change(manifest);
            })
        };
        assert_eq!(other(|manifest| manifest.scenes[1].subject ^= 1), "");
        assert!(other(|manifest| manifest.scenes.clear()).contains("it lists 0 scenes"));
        assert!(other(|manifest| manifest.scenes[1].pairs = 1).contains("scene-0001: pairs 1"));
        assert!(other(|manifest| manifest.rig[3].camera.fx = -1.0).contains("camera 4"));
    }
}

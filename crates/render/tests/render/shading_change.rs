//! The change of brightness that is no motion: it is on the head alone, only of heads whose light changes, and changes nothing else.

use std::path::Path;

use srflow_data::manifest::Manifest;
use srflow_files::{SHA256SUMS, read_grey16, read_mask};
use srflow_head::Look;
use srflow_render::check::check;
use srflow_render::generate::{MotionSource, Settings, generate};
use srflow_render::job::Request;

use crate::{tiny, tree};

/// In levels of 255, of all pixels of all pairs, with whether each is on the head; of a dataset that is rendered into `dir`.
fn rendered(dir: &Path, look: Look) -> Vec<(f32, bool)> {
    generate(&settings(look, true), Request::new(dir)).unwrap();
    let manifest = Manifest::read(dir).unwrap();
    let scene = &manifest.scenes[0];
    let mut changes = Vec::new();
    for pair in 0..scene.pairs {
        let files = manifest.files(dir, scene, pair);
        let change = read_grey16(&files.shading_change.unwrap()).unwrap();
        let mask = read_mask(&files.mask).unwrap();
        let levels = change.pixels().iter().map(|value| (value - 32_768.0) / 128.0);
        changes.extend(levels.zip(mask.pixels().iter().copied()));
    }
    changes
}

fn settings(look: Look, shading_change: bool) -> Settings {
    // Region maps paint the Gaussians.
    Settings { look, shading_change, regions: true, motion: MotionSource::Mixed, seed: 9, ..tiny::settings() }
}

#[test]
fn skin_changes_in_the_second_look_and_nothing_in_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second, without] = ["first", "second", "without"].map(|name| folder.path().join(name));
    assert!(rendered(&first, Look::First).iter().all(|(change, _)| *change == 0.0));

    let changes = rendered(&second, Look::Second);
    let most = |on_head: bool| {
        changes
            .iter()
            .filter(|(_, head)| *head == on_head)
            .map(|(change, _)| change.abs())
            .fold(0.0, f32::max)
    };
    assert!(most(true) > 1.0 && most(true) < 128.0, "{}", most(true));
    assert!(most(false) < most(true), "the background does not change");
    assert_eq!(check(&second, &|| {}).unwrap().problems.len(), 0);

    generate(&settings(Look::Second, false), Request::new(&without)).unwrap();
    let others = |dir: &Path| {
        let mut files = tree::contents(dir);
        files.retain(|(path, _)| {
            !path.starts_with("train/shading_change")
                && !path.ends_with("dataset.json")
                && !path.ends_with(SHA256SUMS)
        });
        files
    };
    assert!(others(&second) == others(&without), "all other files are the same");

    let bare = folder.path().join("bare");
    generate(&Settings { regions: false, ..settings(Look::Second, true) }, Request::new(&bare)).unwrap();
    let of = |dir: &Path| {
        let mut files = tree::contents(dir);
        files.retain(|(path, _)| path.starts_with("train/shading_change"));
        files
    };
    assert!(of(&bare).len() == 3 && of(&bare) == of(&second), "region maps do not matter");

    let all = tree::contents(&second);
    std::fs::remove_file(second.join("train/shading_change/scene-0000/00001.png")).unwrap();
    let problems = check(&second, &|| {}).unwrap().problems;
    assert!(problems.iter().any(|problem| problem.file.ends_with("shading_change/scene-0000/00001.png")));
    generate(&settings(Look::Second, true), Request::new(&second)).unwrap();
    assert!(all == tree::contents(&second), "a missing file is rendered again");
}

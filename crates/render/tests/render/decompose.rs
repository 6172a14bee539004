//! A flow in parts: that of the head and that of the expression add up to it, and nothing else of a dataset changes.

use std::path::{Path, PathBuf};

use srflow_core::{FlowField, Shard};
use srflow_data::flow::{DatasetSpec, FlowDataset, Split};
use srflow_data::region_map::HeadPart;
use srflow_files::{SHA256SUMS, read_flow, write_flow};
use srflow_render::check::check;
use srflow_render::generate::{MotionSource, Settings, generate};
use srflow_render::job::Request;

use crate::tiny;
use crate::tree;

/// Large motion of camera, head and face.
fn settings(decompose: bool) -> Settings {
    Settings { decompose, regions: true, motion: MotionSource::Mixed, seed: 9, ..tiny::settings() }
}

fn render(dir: &Path) {
    generate(&settings(true), Request::new(dir)).unwrap();
}

fn length([u, v]: [f32; 2]) -> f32 {
    u.hypot(v)
}

#[test]
fn parts_change_nothing_else_and_do_not_depend_on_shards() {
    let folder = tempfile::tempdir().unwrap();
    let [with, without, shards] = ["with", "without", "shards"].map(|name| folder.path().join(name));
    render(&with);
    generate(&settings(false), Request::new(&without)).unwrap();
    let [first, second] = [1, 2].map(|number| Shard { number, of: 2 });
    let request = || Request::new(&shards);
    generate(&settings(true), Request { shard: second, stop_after: Some(1), ..request() }).unwrap();
    generate(&settings(true), Request { shard: second, ..request() }).unwrap();
    generate(&settings(true), Request { shard: first, ..request() }).unwrap();
    let files = tree::contents(&with);
    assert!(files == tree::contents(&shards), "shards and interruptions do not matter");
    // As if it had been killed before the second pair was complete.
    std::fs::remove_file(with.join("train/expression_flow/scene-0000/00001.npz16")).unwrap();
    render(&with);
    assert!(files == tree::contents(&with), "a missing part is rendered again");
    let is_part =
        |path: &Path| ["train/head_flow", "train/expression_flow"].iter().any(|kind| path.starts_with(kind));
    assert_eq!(files.iter().filter(|(path, _)| is_part(path)).count(), 6, "two for each pair");
    let others = |files: Vec<(PathBuf, Vec<u8>)>| -> Vec<(PathBuf, Vec<u8>)> {
        let of_all = |path: &Path| path.ends_with("dataset.json") || path.ends_with(SHA256SUMS);
        files.into_iter().filter(|(path, _)| !is_part(path) && !of_all(path)).collect()
    };
    assert!(others(files) == others(tree::contents(&without)), "all other files are the same");
    assert!(!std::fs::read_to_string(without.join("dataset.json")).unwrap().contains("decompose"));
}

#[test]
fn the_parts_add_up_and_the_hair_has_no_expression() {
    let folder = tempfile::tempdir().unwrap();
    render(folder.path());
    let spec = DatasetSpec { kind: "srflow".to_owned(), dir: folder.path().to_owned() };
    let dataset = FlowDataset::open(&spec, Some(Split::Train)).unwrap();
    let mut longest = [0.0_f32; 2];
    for entry in dataset.entries() {
        let flow = dataset.read(entry).unwrap().flow.unwrap();
        let head = entry.read_head_flow().unwrap().unwrap();
        let expression = entry.read_expression_flow().unwrap().unwrap();
        let map = entry.read_regions().unwrap().unwrap();
        let (mut in_hair, mut hair) = (0.0, 0.0);
        let pixels = flow.pixels().iter().zip(head.pixels()).zip(expression.pixels());
        for (((flow, head), expression), &label) in pixels.zip(map.pixels()) {
            for axis in 0..2 {
                let rest = flow[axis] - head[axis] - expression[axis];
                assert!(rest.abs() < 0.01, "{}: {rest} px are in neither part", entry.id());
            }
            longest[0] = longest[0].max(length(*head));
            longest[1] = longest[1].max(length(*expression));
            if HeadPart::of_label(label) == Some(HeadPart::Hair) {
                hair += 1.0;
                in_hair += length(*expression);
            }
        }
        assert!(in_hair / hair < 0.01, "{}: the hair moves by {} px", entry.id(), in_hair / hair);
    }
    assert!(longest[0] > 1.0 && longest[1] > 0.1, "both move: {longest:?}");
}

#[test]
fn parts_that_do_not_add_up_are_named() {
    let folder = tempfile::tempdir().unwrap();
    render(folder.path());
    let problems = || check(folder.path(), &|| {}).unwrap().problems;
    assert_eq!(problems(), []);
    let path = folder.path().join("train/expression_flow/scene-0000/00001.npz16");
    let sound = read_flow(&path).unwrap();
    let mut wrong = sound.clone();
    wrong.set(50, 80, [9.0, sound.get(50, 80)[1]]);
    write_flow(&path, &wrong).unwrap();
    let found = problems();
    assert!(found.len() == 1 && found[0].file == path, "{found:?}");
    assert_eq!(found[0].what, "it and the flow of the head do not add up to the flow in 1 pixels");
    write_flow(&path, &FlowField::new(3, 3)).unwrap();
    assert!(problems()[0].what.contains("expected 110x160 as in dataset.json, found 3x3"));
}

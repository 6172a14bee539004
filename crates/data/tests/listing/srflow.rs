use crate::*;

/// A dataset with a scene of two pairs for training and one of one pair for testing, laid out as by `srflow render`.
fn srflow(backward: bool) -> Tree {
    srflow_with(backward, false)
}

fn srflow_with(backward: bool, regions: bool) -> Tree {
    let scenes = [("train", "scene-0000", 2), ("test", "scene-0001", 1)];
    let mut files = Vec::new();
    for (split, scene, pairs) in scenes {
        for part in ["frames", "alpha", "mask"].into_iter().chain(regions.then_some("regions")) {
            files.extend((0..=pairs).map(|n| format!("{split}/{part}/{scene}/{n:05}.png")));
        }
        for n in 0..pairs {
            for (part, ending) in [("flow", "npz"), ("occlusion", "png"), ("pairs", "json")] {
                files.push(format!("{split}/{part}/{scene}/{n:05}.{ending}"));
            }
            if backward {
                files.push(format!("{split}/flow_backward/{scene}/{n:05}.npz"));
            }
        }
    }
    let dir = Tree::of(files);
    let scenes = scenes.map(|(split, name, pairs)| {
        serde_json::json!({ "name": name, "split": split, "subject": 1, "pairs": pairs })
    });
    let mut manifest = serde_json::json!({
        "layout_version": 1, "srflow_version": "0.1.0", "rig": [], "scenes": scenes,
        "arguments": {
            "head": "builtin", "scenes": 2, "frames": 1.5, "width": 8, "height": 8, "splits": [0.5, 0.0, 0.5], "seed": 1,
            "flow_format": "npz", "backward": backward, "depth": false, "background": "#ffffff",
        },
    });
    if regions {
        manifest["arguments"]["regions"] = true.into();
    }
    fs::write(dir.path().join("dataset.json"), manifest.to_string()).unwrap();
    dir
}

#[test]
fn region_maps_are_those_of_the_first_frame_of_a_pair() {
    let dir = srflow_with(true, true);
    let map =
        |frame: &str| Some(EntryFile::from(dir.path().join(format!("train/regions/scene-0000/{frame}.png"))));
    let maps = |kind| {
        let dataset = dir.open(kind, Some(Split::Train));
        dataset.entries().iter().map(|entry| entry.regions.clone()).collect::<Vec<_>>()
    };
    assert_eq!(maps("srflow"), [map("00000"), map("00001")]);
    assert_eq!(maps("srflow-backward"), [map("00001"), map("00002")]);
    let without = open("srflow", srflow(false).path(), Some(Split::Train)).unwrap();
    assert!(without.entries().iter().all(|entry| entry.regions.is_none()));
    fs::remove_file(map("00001").unwrap().path()).unwrap();
    dir.refuses("srflow", Some(Split::Train), &["1 problem", "no train/regions/scene-0000/00001.png"]);
}

#[test]
fn forward_pairs_have_the_parts_of_their_flow() {
    let dir = srflow(true);
    let path = dir.path().join("dataset.json");
    let text = fs::read_to_string(&path)
        .unwrap()
        .replace("\"backward\":true", "\"backward\":true,\"decompose\":true");
    fs::write(path, text).unwrap();
    dir.refuses(
        "srflow",
        Some(Split::Test),
        &["no test/head_flow/scene-0001/00000.npz", "no test/expression_flow/"],
    );
    dir.add(["head_flow", "expression_flow"].map(|kind| format!("test/{kind}/scene-0001/00000.npz")));
    let parts = |kind: &str| {
        let entry = dir.open(kind, Some(Split::Test)).entries()[0].clone();
        [entry.head_flow, entry.expression_flow].map(|file| file.map(|file| *file))
    };
    let file = |kind: &str| dir.file(&format!("test/{kind}/scene-0001/00000.npz"));
    assert_eq!(parts("srflow"), [file("head_flow"), file("expression_flow")]);
    assert_eq!(parts("srflow-backward"), [None, None], "they are at the first frame's pixels");
}

#[test]
fn forward_pairs_have_mask_and_occlusion() {
    let dir = srflow(false);
    let dataset = dir.open("srflow", Some(Split::Train));
    let line = |a, b| {
        let frames = "train/frames/scene-0000";
        format!(
            "scene-0000/0000{a}: {frames}/0000{a}.png > {frames}/0000{b}.png = train/flow/scene-0000/0000{a}.npz"
        )
    };
    assert_eq!(listed(&dataset), [line(0, 1), line(1, 2)]);
    let entry = &dataset.entries()[1];
    assert_eq!(entry.mask, dir.file("train/mask/scene-0000/00001.png"));
    let picture = dir.path().join("train/occlusion/scene-0000/00001.png");
    assert_eq!(entry.occlusion, Some(Occlusion::Picture(picture.into())));
    assert_eq!(ids(&dir.open("srflow", None)), ["scene-0001/00000"]);
    assert_eq!(dir.open("srflow", Some(Split::All)).entries().len(), 3);
}

#[test]
fn backward_pairs_run_from_the_later_frame() {
    let dir = srflow(true);
    let dataset = dir.open("srflow-backward", Some(Split::Train));
    let line = |a, b| {
        let frames = "train/frames/scene-0000";
        format!(
            "scene-0000/0000{b}: {frames}/0000{b}.png > {frames}/0000{a}.png = train/flow_backward/scene-0000/0000{a}.npz"
        )
    };
    assert_eq!(listed(&dataset), [line(0, 1), line(1, 2)]);
    assert_eq!(dataset.entries()[0].mask, dir.file("train/mask/scene-0000/00001.png"));
    assert_eq!(dataset.entries()[1].mask, dir.file("train/mask/scene-0000/00002.png"));
    assert_says(
        open("srflow-backward", srflow(false).path(), None),
        &["dataset.json", "no backward flow", "--backward"],
    );
}

#[test]
fn unfinished_and_broken_datasets_are_reported() {
    let dir = srflow(false);
    dir.remove("train/pairs/scene-0000/00001.json");
    dir.remove("test/flow/scene-0001/00000.npz");
    dir.refuses(
        "srflow",
        Some(Split::All),
        &["scene-0000: 1 of 2 pairs exist", "no test/flow/scene-0001/00000.npz"],
    );
    dir.refuses("srflow", Some(Split::Val), &["no val split", "train (2 pairs), test (1 pairs)"]);
    fs::write(dir.path().join("dataset.json"), "{}").unwrap();
    dir.refuses("srflow", None, &["dataset.json: no layout_version"]);
}

#[test]
fn a_count_beyond_the_files_takes_neither_time_nor_memory() {
    let dir = srflow(false);
    let path = dir.path().join("dataset.json");
    let text = fs::read_to_string(&path).unwrap().replace("\"pairs\":2", "\"pairs\":4294967295");
    fs::write(&path, text).unwrap();
    dir.refuses("srflow", Some(Split::Train), &["2 of 4294967295 pairs"]);
}

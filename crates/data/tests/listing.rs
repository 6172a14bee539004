//! Every reader lists the published tree of its dataset, and reports what is missing from an incomplete one.

use std::fs;
use std::path::Path;

use srflow_data::flow::{DatasetSpec, EntryFile, FlowDataset, KINDS, Occlusion, Split};
use tempfile::TempDir;

/// A folder that holds these files, all of them empty.
fn tree<S: AsRef<str>>(files: impl IntoIterator<Item = S>) -> TempDir {
    let dir = TempDir::new().unwrap();
    add(dir.path(), files);
    dir
}

fn add<S: AsRef<str>>(dir: &Path, files: impl IntoIterator<Item = S>) {
    for file in files {
        let path = dir.join(file.as_ref());
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "").unwrap();
    }
}

fn open(kind: &str, dir: &Path, split: Option<Split>) -> Result<FlowDataset, String> {
    let spec = DatasetSpec { kind: kind.to_owned(), dir: dir.to_owned() };
    FlowDataset::open(&spec, split).map_err(|error| error.to_string())
}

/// The pairs as `id: frame1 > frame2 = flow`, with paths relative to the dataset's folder.
fn listed(dataset: &FlowDataset) -> Vec<String> {
    let seen = |path: &Path| path.strip_prefix(dataset.dir()).unwrap().display().to_string();
    let line = |entry: &srflow_data::flow::Entry| {
        let flow = entry.flow.as_ref().map_or("none".to_owned(), |flow| seen(&flow.path()));
        format!("{}: {} > {} = {flow}", entry.id(), seen(&entry.frame1.path()), seen(&entry.frame2.path()))
    };
    dataset.entries().iter().map(line).collect()
}

fn ids(dataset: &FlowDataset) -> Vec<String> {
    dataset.entries().iter().map(|entry| entry.id()).collect()
}

#[track_caller]
fn assert_says(result: Result<FlowDataset, String>, parts: &[&str]) {
    let error = result.expect_err("this dataset must not open");
    for part in parts {
        assert!(error.contains(part), "`{part}` is not in: {error}");
    }
}

#[test]
fn kinds_take_their_options_in_any_order_and_no_others() {
    let name = |text: &str| text.parse::<DatasetSpec>().map(|spec| spec.kind).map_err(|e| e.to_string());
    assert_eq!(name("things-right-final-backward:C:\\data").unwrap(), "things-right-final-backward");
    assert_eq!("hd1k:C:\\data".parse::<DatasetSpec>().unwrap().dir, Path::new("C:\\data"));
    for text in ["/data/Sintel", "sintel", ":dir", "sintel:", ""] {
        assert!(name(text).unwrap_err().contains("expected KIND:DIR"), "{text}");
    }
    assert!(name("sintle:dir").unwrap_err().contains("Kinds: srflow"));
    assert!(
        name("sintel-albedo:dir")
            .unwrap_err()
            .contains("`albedo` is not an option here; sintel takes one of each: clean|final")
    );
    assert!(name("sintel-clean-final:dir").unwrap_err().contains("`final`"));
    assert!(name("hd1k-clean:dir").unwrap_err().contains("hd1k takes none"));
}

#[test]
fn every_option_that_the_list_names_is_taken() {
    for kind in &KINDS {
        for option in kind.options.iter().copied().flatten() {
            let text = format!("{}-{option}:dir", kind.name);
            assert!(text.parse::<DatasetSpec>().is_ok(), "{text}");
        }
    }
}

#[test]
fn the_page_on_datasets_lists_every_kind_with_its_options() {
    let page = fs::read_to_string("../../docs/reference/datasets.md").unwrap();
    for kind in &KINDS {
        let options: Vec<String> =
            kind.options.iter().map(|choices| format!("`{}`", choices.join("`, `"))).collect();
        let row = format!("| `{}` | {} |", kind.name, options.join("; ")).replace("|  |", "| |");
        assert!(page.contains(&row), "docs/reference/datasets.md lacks {row}");
    }
}

#[test]
fn every_kind_reports_empty_and_missing_folders() {
    let empty = TempDir::new().unwrap();
    let missing = empty.path().join("no").join("such");
    let file = empty.path().with_extension("file");
    fs::write(&file, "").unwrap();
    for kind in KINDS.iter().map(|kind| kind.name) {
        assert_says(open(kind, empty.path(), None), &[kind, "looked for", "is empty"]);
        assert_says(
            open(kind, &missing, None),
            &["looked for", &format!("there is no {}", missing.display())],
        );
    }
}

#[test]
fn the_folder_above_or_below_is_pointed_out() {
    let dir =
        tree(["Sintel/training/final/alley_1/frame_0001.png", "Sintel/training/flow/alley_1/frame_0001.flo"]);
    let right = dir.path().join("Sintel");
    let advice = format!("give sintel-final:{}", right.display());
    assert_says(open("sintel-final", dir.path(), None), &["looked for", "training/final", &advice]);
    assert_says(open("sintel-final", &right.join("training"), None), &[&advice]);
    assert_says(open("sintel-final", &right.join("training/flow"), None), &[&advice]);
    let other = tree(["pairs/frames/0.png", "pairs/frames/1.png"]);
    let advice = format!("give folder:{}", other.path().join("pairs").display());
    assert_says(open("folder", &other.path().join("pairs/frames"), None), &[&advice]);
    assert_says(open("folder", other.path(), None), &[&advice]);
    assert_says(open("sintel-clean", &right, None), &["training/clean", "training holds only final, flow"]);
}

#[test]
fn frames_come_in_natural_order() {
    let frames = ["10", "9", "100", "1"].map(|n| format!("frames/frame{n}.png"));
    let dir = tree(frames);
    let dataset = open("folder", dir.path(), None).unwrap();
    assert_eq!(ids(&dataset), ["frame1", "frame9", "frame10"]);
}

mod folder {
    use super::*;

    #[test]
    fn triplets() {
        let dir = tree([
            "b_img1.png",
            "b_img2.png",
            "b_flow.flo",
            "b_mask.png",
            "b_regions.png",
            "a_img1.jpg",
            "a_img2.jpg",
            "a_flow.pfm",
            "notes.txt",
            "._a_flow.flo",
        ]);
        let dataset = open("folder", dir.path(), None).unwrap();
        assert_eq!(
            listed(&dataset),
            ["a: a_img1.jpg > a_img2.jpg = a_flow.pfm", "b: b_img1.png > b_img2.png = b_flow.flo"]
        );
        assert_eq!(dataset.entries()[1].mask, Some(dir.path().join("b_mask.png").into()));
        assert_eq!(dataset.entries()[1].regions, Some(dir.path().join("b_regions.png").into()));
        assert_eq!(dataset.entries()[0].regions, None);
    }

    #[test]
    fn triplets_with_parts_missing_are_named() {
        let dir = tree([
            "a_img1.png",
            "a_img2.png",
            "a_flow.flo",
            "b_img1.png",
            "b_img2.png",
            "c_img2.png",
            "c_flow.flo",
            "a_flow.png",
        ]);
        assert_says(
            open("folder", dir.path(), None),
            &[
                "3 problems",
                "a_flow.png exists twice, also as a_flow.flo",
                "b: no b_flow.*",
                "c: no c_img1.*",
            ],
        );
    }

    #[test]
    fn scenes() {
        let dir = tree([
            "frames/s2/0.png",
            "frames/s2/1.png",
            "frames/s10/0.png",
            "frames/s10/1.png",
            "frames/s10/2.png",
            "flow/s2/0.flo",
            "flow/s10/0.npy",
            "flow/s10/1.png",
            "mask/s10/0.png",
            "occlusion/s10/1.png",
            "regions/s10/1.png",
        ]);
        let dataset = open("folder", dir.path(), None).unwrap();
        assert_eq!(
            listed(&dataset),
            [
                "s2/0: frames/s2/0.png > frames/s2/1.png = flow/s2/0.flo",
                "s10/0: frames/s10/0.png > frames/s10/1.png = flow/s10/0.npy",
                "s10/1: frames/s10/1.png > frames/s10/2.png = flow/s10/1.png",
            ]
        );
        assert_eq!(dataset.entries()[1].mask, Some(dir.path().join("mask/s10/0.png").into()));
        assert_eq!(
            dataset.entries()[2].occlusion,
            Some(Occlusion::Picture(dir.path().join("occlusion/s10/1.png").into()))
        );
        assert_eq!(dataset.entries()[2].regions, Some(dir.path().join("regions/s10/1.png").into()));
    }

    #[test]
    fn files_without_a_frame_are_reported() {
        let dir = tree([
            "frames/0.png",
            "frames/1.png",
            "frames/2.png",
            "flow/0.flo",
            "flow/7.flo",
            "mask/8.png",
            "regions/9.png",
            "flow/s/0.flo",
        ]);
        assert_says(
            open("folder", dir.path(), None),
            &[
                "5 problems",
                "frames/1.png has no flow flow/1.*",
                "flow/7.flo",
                "mask/8.png",
                "regions/9.png",
                "flow/s: no folder frames/s",
            ],
        );
    }

    #[test]
    fn without_flow_there_is_no_truth() {
        let dir = tree(["frames/0.png", "frames/1.png"]);
        assert_eq!(
            listed(&open("folder", dir.path(), None).unwrap()),
            ["0: frames/0.png > frames/1.png = none"]
        );
    }

    #[test]
    fn splits_are_folders() {
        let dir = tree(["train/a_img1.png", "train/a_img2.png", "test/frames/0.png", "test/frames/1.png"]);
        assert_eq!(ids(&open("folder", dir.path(), Some(Split::Train)).unwrap()), ["a"]);
        assert_eq!(ids(&open("folder", dir.path(), Some(Split::Test)).unwrap()), ["0"]);
        assert_says(
            open("folder", dir.path(), Some(Split::Val)),
            &["looked for", "val", "holds only test, train"],
        );
        assert_says(open("folder", dir.path(), None), &["choose one with `split`"]);
    }
}

mod chairs {
    use super::*;

    fn chairs() -> TempDir {
        let pair = |n: u32| ["img1.ppm", "img2.ppm", "flow.flo"].map(|part| format!("data/{n:05}_{part}"));
        tree((1..=4).flat_map(pair))
    }

    #[test]
    fn the_list_chooses_the_split() {
        let dir = chairs();
        fs::write(dir.path().join("FlyingChairs_train_val.txt"), "1\n1\n2\n1\n").unwrap();
        assert_eq!(
            ids(&open("chairs", dir.path(), Some(Split::Train)).unwrap()),
            ["00001", "00002", "00004"]
        );
        let val = open("chairs", dir.path(), None).unwrap();
        assert_eq!(listed(&val), ["00003: data/00003_img1.ppm > data/00003_img2.ppm = data/00003_flow.flo"]);
        assert_says(open("chairs", dir.path(), Some(Split::Test)), &["no test split", "train, val, all"]);
    }

    #[test]
    fn without_a_right_list_only_all_opens() {
        let dir = chairs();
        assert_says(
            open("chairs", dir.path(), None),
            &["FlyingChairs_train_val.txt", "next to data/", "--split all"],
        );
        assert_eq!(open("chairs", dir.path(), Some(Split::All)).unwrap().entries().len(), 4);
        let list = dir.path().join("FlyingChairs_train_val.txt");
        fs::write(&list, "1\n2\n").unwrap();
        assert_says(open("chairs", dir.path(), None), &["2 lines for 4 pairs"]);
        fs::write(&list, "1\n2\ntrain\n1\n").unwrap();
        assert_says(open("chairs", dir.path(), None), &["line 3: expected 1 or 2, found `train`"]);
        fs::write(&list, [0xff, 0xfe, 0]).unwrap();
        assert_says(open("chairs", dir.path(), None), &["FlyingChairs_train_val.txt"]);
    }

    #[test]
    fn a_missing_file_is_named() {
        let dir = chairs();
        fs::remove_file(dir.path().join("data/00002_flow.flo")).unwrap();
        assert_says(open("chairs", dir.path(), Some(Split::All)), &["00002", "no data/00002_flow.*"]);
    }
}

mod things {
    use super::*;

    /// Frames 6 to 8 of two sequences, with a flow for each frame in both directions, as published.
    fn things() -> TempDir {
        let mut files = Vec::new();
        for place in ["TRAIN/A/0000", "TEST/C/0149"] {
            for n in 6..=8 {
                for (camera, letter) in [("left", "L"), ("right", "R")] {
                    files.push(format!("frames_cleanpass/{place}/{camera}/{n:04}.png"));
                    for (folder, word) in [("into_future", "IntoFuture"), ("into_past", "IntoPast")] {
                        files.push(format!(
                            "optical_flow/{place}/{folder}/{camera}/OpticalFlow{word}_{n:04}_{letter}.pfm"
                        ));
                    }
                }
            }
        }
        tree(files)
    }

    #[test]
    fn into_the_future() {
        let dir = things();
        let dataset = open("things", dir.path(), Some(Split::Train)).unwrap();
        assert_eq!(dataset.name(), "things-clean");
        let flow = "optical_flow/TRAIN/A/0000/into_future/left/OpticalFlowIntoFuture";
        let frames = "frames_cleanpass/TRAIN/A/0000/left";
        assert_eq!(
            listed(&dataset),
            [
                format!("TRAIN/A/0000/left/0006: {frames}/0006.png > {frames}/0007.png = {flow}_0006_L.pfm"),
                format!("TRAIN/A/0000/left/0007: {frames}/0007.png > {frames}/0008.png = {flow}_0007_L.pfm"),
            ]
        );
    }

    #[test]
    fn into_the_past_the_flow_is_that_of_the_later_frame() {
        let dir = things();
        let dataset = open("things-backward-right", dir.path(), None).unwrap();
        assert_eq!((dataset.name(), dataset.split()), ("things-clean-backward-right", Split::Test));
        let flow = "optical_flow/TEST/C/0149/into_past/right/OpticalFlowIntoPast";
        let frames = "frames_cleanpass/TEST/C/0149/right";
        assert_eq!(
            listed(&dataset),
            [
                format!("TEST/C/0149/right/0007: {frames}/0007.png > {frames}/0006.png = {flow}_0007_R.pfm"),
                format!("TEST/C/0149/right/0008: {frames}/0008.png > {frames}/0007.png = {flow}_0008_R.pfm"),
            ]
        );
        assert_eq!(open("things", dir.path(), Some(Split::All)).unwrap().entries().len(), 4);
    }

    #[test]
    fn holes_are_named() {
        let dir = things();
        fs::remove_file(
            dir.path().join("optical_flow/TRAIN/A/0000/into_future/left/OpticalFlowIntoFuture_0006_L.pfm"),
        )
        .unwrap();
        fs::remove_file(dir.path().join("frames_cleanpass/TEST/C/0149/left/0007.png")).unwrap();
        add(dir.path(), ["optical_flow/TEST/C/0150/into_future/left/OpticalFlowIntoFuture_0006_L.pfm"]);
        assert_says(
            open("things", dir.path(), Some(Split::All)),
            &[
                "frames_cleanpass/TRAIN/A/0000/left/0006.png has no flow of number 6 in optical_flow/TRAIN/A/0000/into_future/left",
                "0006.png: the next frame is number 8, not 7",
                "OpticalFlowIntoFuture_0007_L.pfm: no pair of frames",
                "optical_flow/TEST/C/0150: no folder frames_cleanpass/TEST/C/0150",
            ],
        );
        assert_says(open("things-final", dir.path(), None), &["frames_finalpass/TEST"]);
    }
}

mod sintel {
    use super::*;

    fn sintel() -> TempDir {
        let mut files =
            vec!["test/final/wall/frame_0001.png".to_owned(), "test/final/wall/frame_0002.png".to_owned()];
        for scene in ["alley_1", "ambush_2"] {
            files.extend((1..=3).map(|n| format!("training/final/{scene}/frame_{n:04}.png")));
            files.extend((1..=2).map(|n| format!("training/flow/{scene}/frame_{n:04}.flo")));
            files.extend((1..=2).map(|n| format!("training/occlusions/{scene}/frame_{n:04}.png")));
        }
        tree(files)
    }

    #[test]
    fn training_scenes_have_truth_and_occlusions() {
        let dir = sintel();
        let dataset = open("sintel-final", dir.path(), None).unwrap();
        assert_eq!(
            ids(&dataset),
            ["alley_1/frame_0001", "alley_1/frame_0002", "ambush_2/frame_0001", "ambush_2/frame_0002"]
        );
        let picture = dir.path().join("training/occlusions/alley_1/frame_0002.png");
        assert_eq!(dataset.entries()[1].occlusion, Some(Occlusion::Picture(picture.into())));
        assert_eq!(
            ids(&open("sintel-final", dir.path(), Some(Split::Train)).unwrap())[1..],
            ["alley_1/frame_0002"]
        );
        assert_eq!(
            ids(&open("sintel-final", dir.path(), Some(Split::Val)).unwrap())[1..],
            ["ambush_2/frame_0002"]
        );
    }

    #[test]
    fn the_test_set_has_frames_only() {
        let dir = sintel();
        let dataset = open("sintel-final", dir.path(), Some(Split::Test)).unwrap();
        assert_eq!(
            listed(&dataset),
            ["wall/frame_0001: test/final/wall/frame_0001.png > test/final/wall/frame_0002.png = none"]
        );
    }

    #[test]
    fn many_missing_files_are_counted() {
        let dir = sintel();
        fs::remove_dir_all(dir.path().join("training/flow/alley_1")).unwrap();
        add(dir.path(), (3..=20).map(|n| format!("training/flow/ambush_2/frame_{n:04}.flo")));
        assert_says(
            open("sintel-final", dir.path(), None),
            &["20 problems", "training/flow/alley_1", "and 12 more"],
        );
    }
}

mod kitti {
    use super::*;

    fn kitti(images: &str) -> TempDir {
        let files = ["000000", "000001"].into_iter().flat_map(|scene| {
            [
                format!("training/{images}/{scene}_10.png"),
                format!("training/{images}/{scene}_11.png"),
                format!("training/flow_occ/{scene}_10.png"),
                format!("testing/{images}/{scene}_10.png"),
                format!("testing/{images}/{scene}_11.png"),
            ]
        });
        let dir = tree(files);
        add(dir.path(), ["training/flow_noc/000001_10.png", &format!("training/{images}/000000_09.png")]);
        dir
    }

    #[test]
    fn both_years() {
        for (kind, name, images) in
            [("kitti", "kitti-2015", "image_2"), ("kitti-2012", "kitti-2012", "colored_0")]
        {
            let dir = kitti(images);
            let dataset = open(kind, dir.path(), None).unwrap();
            assert_eq!(dataset.name(), name);
            let line = |n| {
                format!(
                    "00000{n}_10: training/{images}/00000{n}_10.png > training/{images}/00000{n}_11.png = training/flow_occ/00000{n}_10.png"
                )
            };
            assert_eq!(listed(&dataset), [line(0), line(1)]);
            let visible = dir.path().join("training/flow_noc/000001_10.png");
            assert_eq!(dataset.entries()[1].occlusion, Some(Occlusion::VisibleFlow(visible.into())));
            assert_eq!(dataset.entries()[0].occlusion, None);
            let test = open(kind, dir.path(), Some(Split::Test)).unwrap();
            assert!(test.entries().iter().all(|entry| entry.flow.is_none()));
            assert_says(open(kind, dir.path(), Some(Split::Val)), &["no val split"]);
        }
    }

    #[test]
    fn missing_files_are_named() {
        let dir = kitti("image_2");
        fs::remove_file(dir.path().join("training/image_2/000000_11.png")).unwrap();
        add(dir.path(), ["training/flow_occ/000007_10.png"]);
        assert_says(
            open("kitti", dir.path(), None),
            &["000000: no training/image_2/000000_11.png", "training/flow_occ/000007_10.png: no frame"],
        );
        assert_says(open("kitti-2012", dir.path(), None), &["training/colored_0"]);
    }
}

mod hd1k {
    use super::*;

    fn hd1k() -> TempDir {
        let mut files = Vec::new();
        for (sequence, frames) in [(0, 10..=12), (30, 5..=6)] {
            for n in frames {
                files.push(format!("hd1k_input/image_2/{sequence:06}_{n:04}.png"));
                files.push(format!("hd1k_flow_gt/flow_occ/{sequence:06}_{n:04}.png"));
            }
        }
        files.extend((1..=2).map(|n| format!("hd1k_challenge/image_2/000000_{n:04}.png")));
        tree(files)
    }

    #[test]
    fn frames_pair_within_their_sequence() {
        let dir = hd1k();
        let all = open("hd1k", dir.path(), None).unwrap();
        assert_eq!(ids(&all), ["000000/000000_0010", "000000/000000_0011", "000030/000030_0005"]);
        assert_eq!(open("hd1k", dir.path(), Some(Split::Train)).unwrap().entries().len(), 2);
        assert_eq!(open("hd1k", dir.path(), Some(Split::Val)).unwrap().entries().len(), 1);
        assert_eq!(open("hd1k", dir.path(), Some(Split::Test)).unwrap().entries()[0].flow, None);
    }

    #[test]
    fn odd_names_and_flows_without_frames_are_named() {
        let dir = hd1k();
        add(
            dir.path(),
            [
                "hd1k_input/image_2/picture.png",
                "hd1k_flow_gt/flow_occ/000001_0003.png",
                "hd1k_flow_gt/flow_occ/000000_10.png",
            ],
        );
        assert_says(
            open("hd1k", dir.path(), None),
            &[
                "picture.png: expected a name like 000000_0010.png",
                "000001_0003.png: no pair of frames",
                "000000_10.png",
                "twice",
            ],
        );
    }
}

mod spring {
    use super::*;

    fn spring() -> TempDir {
        let mut files = Vec::new();
        for camera in ["left", "right"] {
            files.extend((1..=3).map(|n| format!("train/0001/frame_{camera}/frame_{camera}_{n:04}.png")));
            files
                .extend((1..=2).map(|n| format!("train/0001/flow_FW_{camera}/flow_FW_{camera}_{n:04}.flo5")));
            files
                .extend((2..=3).map(|n| format!("train/0001/flow_BW_{camera}/flow_BW_{camera}_{n:04}.flo5")));
            files.extend((1..=2).map(|n| format!("test/0003/frame_{camera}/frame_{camera}_{n:04}.png")));
        }
        tree(files)
    }

    #[test]
    fn forward_and_backward() {
        let dir = spring();
        let dataset = open("spring", dir.path(), None).unwrap();
        assert_eq!(
            listed(&dataset)[1],
            "0001/frame_left_0002: train/0001/frame_left/frame_left_0002.png > train/0001/frame_left/frame_left_0003.png \
             = train/0001/flow_FW_left/flow_FW_left_0002.flo5"
        );
        let dataset = open("spring-right-backward", dir.path(), None).unwrap();
        assert_eq!(dataset.name(), "spring-backward-right");
        assert_eq!(
            listed(&dataset)[0],
            "0001/frame_right_0002: train/0001/frame_right/frame_right_0002.png > train/0001/frame_right/frame_right_0001.png \
             = train/0001/flow_BW_right/flow_BW_right_0002.flo5"
        );
        assert_eq!(open("spring", dir.path(), Some(Split::Test)).unwrap().entries()[0].flow, None);
        assert_says(open("spring", dir.path(), Some(Split::Val)), &["no val split"]);
    }

    #[test]
    fn a_missing_camera_is_named() {
        let dir = spring();
        fs::remove_dir_all(dir.path().join("train/0001/frame_right")).unwrap();
        assert_says(open("spring-right", dir.path(), None), &["no folder train/0001/frame_right"]);
    }
}

mod facialflownet {
    use super::*;

    fn facialflownet() -> TempDir {
        let mut files = Vec::new();
        for motion in ["facial", "head"] {
            files.extend((0..3).map(|n| format!("image/{motion}/test/happy/012/{n}.jpg")));
            files.extend((0..2).map(|n| format!("flow/{motion}/test/happy/012/{n}.flo")));
        }
        files.extend((0..3).map(|n| format!("mask/test/happy/012/{n}.npy")));
        tree(files)
    }

    #[test]
    fn images_flows_and_masks_go_by_their_order() {
        let dir = facialflownet();
        let dataset = open("facialflownet-head", dir.path(), None).unwrap();
        assert_eq!(
            listed(&dataset)[1],
            "test/happy/012/1: image/head/test/happy/012/1.jpg > image/head/test/happy/012/2.jpg = flow/head/test/happy/012/1.flo"
        );
        assert_eq!(dataset.entries()[1].mask, Some(dir.path().join("mask/test/happy/012/1.npy").into()));
    }

    #[test]
    fn counts_that_do_not_fit_are_named() {
        let dir = facialflownet();
        fs::remove_file(dir.path().join("flow/facial/test/happy/012/0.flo")).unwrap();
        assert_says(
            open("facialflownet", dir.path(), None),
            &["test/happy/012: 3 images need 2 flows, flow/facial/test/happy/012 holds 1"],
        );
        fs::remove_file(dir.path().join("mask/test/happy/012/0.npy")).unwrap();
        fs::remove_file(dir.path().join("mask/test/happy/012/1.npy")).unwrap();
        assert_says(
            open("facialflownet-head", dir.path(), None),
            &["3 images need 2 masks, mask/test/happy/012 holds 1"],
        );
    }
}

mod srflow {
    use super::*;

    /// A dataset with a scene of two pairs for training and one of one pair for testing, laid out as by `srflow render`.
    fn srflow(backward: bool) -> TempDir {
        srflow_with(backward, false)
    }

    fn srflow_with(backward: bool, regions: bool) -> TempDir {
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
        let dir = tree(files);
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
        let map = |frame: &str| {
            Some(EntryFile::from(dir.path().join(format!("train/regions/scene-0000/{frame}.png"))))
        };
        let maps = |kind| {
            let dataset = open(kind, dir.path(), Some(Split::Train)).unwrap();
            dataset.entries().iter().map(|entry| entry.regions.clone()).collect::<Vec<_>>()
        };
        assert_eq!(maps("srflow"), [map("00000"), map("00001")]);
        assert_eq!(maps("srflow-backward"), [map("00001"), map("00002")]);
        let without = open("srflow", srflow(false).path(), Some(Split::Train)).unwrap();
        assert!(without.entries().iter().all(|entry| entry.regions.is_none()));
        fs::remove_file(map("00001").unwrap().path()).unwrap();
        assert_says(
            open("srflow", dir.path(), Some(Split::Train)),
            &["1 problem", "no train/regions/scene-0000/00001.png"],
        );
    }

    #[test]
    fn forward_pairs_have_mask_and_occlusion() {
        let dir = srflow(false);
        let dataset = open("srflow", dir.path(), Some(Split::Train)).unwrap();
        let line = |a, b| {
            let frames = "train/frames/scene-0000";
            format!(
                "scene-0000/0000{a}: {frames}/0000{a}.png > {frames}/0000{b}.png = train/flow/scene-0000/0000{a}.npz"
            )
        };
        assert_eq!(listed(&dataset), [line(0, 1), line(1, 2)]);
        let entry = &dataset.entries()[1];
        assert_eq!(entry.mask, Some(dir.path().join("train/mask/scene-0000/00001.png").into()));
        let picture = dir.path().join("train/occlusion/scene-0000/00001.png");
        assert_eq!(entry.occlusion, Some(Occlusion::Picture(picture.into())));
        assert_eq!(ids(&open("srflow", dir.path(), None).unwrap()), ["scene-0001/00000"]);
        assert_eq!(open("srflow", dir.path(), Some(Split::All)).unwrap().entries().len(), 3);
    }

    #[test]
    fn backward_pairs_run_from_the_later_frame() {
        let dir = srflow(true);
        let dataset = open("srflow-backward", dir.path(), Some(Split::Train)).unwrap();
        let line = |a, b| {
            let frames = "train/frames/scene-0000";
            format!(
                "scene-0000/0000{b}: {frames}/0000{b}.png > {frames}/0000{a}.png = train/flow_backward/scene-0000/0000{a}.npz"
            )
        };
        assert_eq!(listed(&dataset), [line(0, 1), line(1, 2)]);
        assert_eq!(
            dataset.entries()[0].mask,
            Some(dir.path().join("train/mask/scene-0000/00001.png").into())
        );
        assert_eq!(
            dataset.entries()[1].mask,
            Some(dir.path().join("train/mask/scene-0000/00002.png").into())
        );
        assert_says(
            open("srflow-backward", srflow(false).path(), None),
            &["dataset.json", "no backward flow", "--backward"],
        );
    }

    #[test]
    fn unfinished_and_broken_datasets_are_reported() {
        let dir = srflow(false);
        fs::remove_file(dir.path().join("train/pairs/scene-0000/00001.json")).unwrap();
        fs::remove_file(dir.path().join("test/flow/scene-0001/00000.npz")).unwrap();
        assert_says(
            open("srflow", dir.path(), Some(Split::All)),
            &["scene-0000: 1 of 2 pairs exist", "no test/flow/scene-0001/00000.npz"],
        );
        assert_says(
            open("srflow", dir.path(), Some(Split::Val)),
            &["no val split", "train (2 pairs), test (1 pairs)"],
        );
        fs::write(dir.path().join("dataset.json"), "{}").unwrap();
        assert_says(open("srflow", dir.path(), None), &["dataset.json: no layout_version"]);
    }

    #[test]
    fn a_count_beyond_the_files_takes_neither_time_nor_memory() {
        let dir = srflow(false);
        let path = dir.path().join("dataset.json");
        let text = fs::read_to_string(&path).unwrap().replace("\"pairs\":2", "\"pairs\":4294967295");
        fs::write(&path, text).unwrap();
        assert_says(open("srflow", dir.path(), Some(Split::Train)), &["2 of 4294967295 pairs"]);
    }
}

mod clips {
    use super::*;

    const HEADER: &str = "clip,subject,onset,apex,offset,class\n";

    fn clips(rows: &str) -> TempDir {
        let frames = [3, 4, 5]
            .into_iter()
            .flat_map(|frame| ["s01/c01", "s01/c02"].map(|clip| format!("{clip}/{frame:04}.png")));
        let dir = tree(
            frames.chain(["s01/c01_flow.flo", "s01/c02_flow.npz16", "s01/c02_mask.png"].map(str::to_owned)),
        );
        fs::write(dir.path().join("clips.csv"), format!("{HEADER}{rows}")).unwrap();
        dir
    }

    #[test]
    fn a_pair_is_onset_and_apex() {
        let dir = clips("s01/c01,s01,3,5,5,positive\ns01/c02,s01,3,4,5,negative\n");
        let dataset = open("clips", dir.path(), None).unwrap();
        assert_eq!(
            listed(&dataset),
            [
                "s01/c01/0003: s01/c01/0003.png > s01/c01/0005.png = s01/c01_flow.flo",
                "s01/c02/0003: s01/c02/0003.png > s01/c02/0004.png = s01/c02_flow.npz16",
            ]
        );
        let masks = dataset.entries().iter().map(|entry| entry.mask.is_some());
        assert_eq!(masks.collect::<Vec<_>>(), [false, true]);
        assert_says(open("clips", dir.path(), Some(Split::Test)), &["no test split", "all"]);
    }

    #[test]
    fn clips_without_apex_or_flow_are_named() {
        let dir = clips("s01/c01,s01,3,,5,positive\ns01/c02,s01,3,4,5,negative\n");
        fs::remove_file(dir.path().join("s01/c02_flow.npz16")).unwrap();
        assert_says(
            open("clips", dir.path(), None),
            &["s01/c01 has no apex", "s01/c02 has no flow s01/c02_flow.*"],
        );
        fs::remove_file(dir.path().join("s01/c02/0004.png")).unwrap();
        assert_says(open("clips", dir.path(), None), &["1 frames of 1 clips are missing"]);
    }
}

use crate::*;

/// Frames 6 to 8 of two sequences, with a flow for each frame in both directions, as published.
fn things() -> Tree {
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
    Tree::of(files)
}

#[test]
fn into_the_future() {
    let dir = things();
    let dataset = dir.open("things", Some(Split::Train));
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
    let dataset = dir.open("things-backward-right", None);
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
    assert_eq!(dir.open("things", Some(Split::All)).entries().len(), 4);
}

#[test]
fn holes_are_named() {
    let dir = things();
    dir.remove("optical_flow/TRAIN/A/0000/into_future/left/OpticalFlowIntoFuture_0006_L.pfm");
    dir.remove("frames_cleanpass/TEST/C/0149/left/0007.png");
    dir.add(["optical_flow/TEST/C/0150/into_future/left/OpticalFlowIntoFuture_0006_L.pfm"]);
    dir.refuses("things", Some(Split::All), &[
            "frames_cleanpass/TRAIN/A/0000/left/0006.png has no flow of number 6 in optical_flow/TRAIN/A/0000/into_future/left",
            "0006.png: the next frame is number 8, not 7",
            "OpticalFlowIntoFuture_0007_L.pfm: no pair of frames",
            "optical_flow/TEST/C/0150: no folder frames_cleanpass/TEST/C/0150",
        ],
    );
    dir.refuses("things-final", None, &["frames_finalpass/TEST"]);
}

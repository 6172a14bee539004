use crate::*;

#[test]
fn triplets() {
    let dir = Tree::of(
        "b_img1.png b_img2.png b_flow.flo b_mask.png b_regions.png a_img1.jpg a_img2.jpg \
         a_flow.pfm notes.txt ._a_flow.flo"
            .split(' '),
    );
    let dataset = dir.open("folder", None);
    assert_eq!(
        listed(&dataset),
        ["a: a_img1.jpg > a_img2.jpg = a_flow.pfm", "b: b_img1.png > b_img2.png = b_flow.flo"]
    );
    assert_eq!(dataset.entries()[1].mask, dir.file("b_mask.png"));
    assert_eq!(dataset.entries()[1].regions, dir.file("b_regions.png"));
    assert_eq!(dataset.entries()[0].regions, None);
}

#[test]
fn triplets_with_parts_missing_are_named() {
    let dir = Tree::of(
        "a_img1.png a_img2.png a_flow.flo b_img1.png b_img2.png c_img2.png c_flow.flo a_flow.png".split(' '),
    );
    dir.refuses(
        "folder",
        None,
        &["3 problems", "a_flow.png exists twice, also as a_flow.flo", "b: no b_flow.*", "c: no c_img1.*"],
    );
}

#[test]
fn scenes() {
    let dir = Tree::of(
        "frames/s2/0.png frames/s2/1.png frames/s10/0.png frames/s10/1.png frames/s10/2.png \
         flow/s2/0.flo flow/s10/0.npy flow/s10/1.png mask/s10/0.png occlusion/s10/1.png \
         regions/s10/1.png"
            .split(' '),
    );
    let dataset = dir.open("folder", None);
    assert_eq!(
        listed(&dataset),
        [
            "s2/0: frames/s2/0.png > frames/s2/1.png = flow/s2/0.flo",
            "s10/0: frames/s10/0.png > frames/s10/1.png = flow/s10/0.npy",
            "s10/1: frames/s10/1.png > frames/s10/2.png = flow/s10/1.png",
        ]
    );
    assert_eq!(dataset.entries()[1].mask, dir.file("mask/s10/0.png"));
    assert_eq!(
        dataset.entries()[2].occlusion,
        Some(Occlusion::Picture(dir.path().join("occlusion/s10/1.png").into()))
    );
    assert_eq!(dataset.entries()[2].regions, dir.file("regions/s10/1.png"));
}

#[test]
fn files_without_a_frame_are_reported() {
    let dir = Tree::of(
        "frames/0.png frames/1.png frames/2.png flow/0.flo flow/7.flo mask/8.png regions/9.png \
         flow/s/0.flo"
            .split(' '),
    );
    dir.refuses(
        "folder",
        None,
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
    let dir = Tree::of(["frames/0.png", "frames/1.png"]);
    assert_eq!(listed(&dir.open("folder", None)), ["0: frames/0.png > frames/1.png = none"]);
}

#[test]
fn splits_are_folders() {
    let dir = Tree::of(["train/a_img1.png", "train/a_img2.png", "test/frames/0.png", "test/frames/1.png"]);
    assert_eq!(ids(&dir.open("folder", Some(Split::Train))), ["a"]);
    assert_eq!(ids(&dir.open("folder", Some(Split::Test))), ["0"]);
    dir.refuses("folder", Some(Split::Val), &["looked for", "val", "holds only test, train"]);
    dir.refuses("folder", None, &["choose one with `split`"]);
}

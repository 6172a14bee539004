use crate::*;

fn sintel() -> Tree {
    let mut files =
        vec!["test/final/wall/frame_0001.png".to_owned(), "test/final/wall/frame_0002.png".to_owned()];
    for scene in ["alley_1", "ambush_2"] {
        files.extend((1..=3).map(|n| format!("training/final/{scene}/frame_{n:04}.png")));
        files.extend((1..=2).map(|n| format!("training/flow/{scene}/frame_{n:04}.flo")));
        files.extend((1..=2).map(|n| format!("training/occlusions/{scene}/frame_{n:04}.png")));
    }
    Tree::of(files)
}

#[test]
fn training_scenes_have_truth_and_occlusions() {
    let dir = sintel();
    let dataset = dir.open("sintel-final", None);
    assert_eq!(
        ids(&dataset),
        ["alley_1/frame_0001", "alley_1/frame_0002", "ambush_2/frame_0001", "ambush_2/frame_0002"]
    );
    let picture = dir.path().join("training/occlusions/alley_1/frame_0002.png");
    assert_eq!(dataset.entries()[1].occlusion, Some(Occlusion::Picture(picture.into())));
    assert_eq!(ids(&dir.open("sintel-final", Some(Split::Train)))[1..], ["alley_1/frame_0002"]);
    assert_eq!(ids(&dir.open("sintel-final", Some(Split::Val)))[1..], ["ambush_2/frame_0002"]);
}

#[test]
fn the_test_set_has_frames_only() {
    let dir = sintel();
    let dataset = dir.open("sintel-final", Some(Split::Test));
    assert_eq!(
        listed(&dataset),
        ["wall/frame_0001: test/final/wall/frame_0001.png > test/final/wall/frame_0002.png = none"]
    );
}

#[test]
fn many_missing_files_are_counted() {
    let dir = sintel();
    fs::remove_dir_all(dir.path().join("training/flow/alley_1")).unwrap();
    dir.add((3..=20).map(|n| format!("training/flow/ambush_2/frame_{n:04}.flo")));
    dir.refuses("sintel-final", None, &["20 problems", "training/flow/alley_1", "and 12 more"]);
}

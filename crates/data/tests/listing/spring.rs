use crate::*;

fn spring() -> Tree {
    let mut files = Vec::new();
    for camera in ["left", "right"] {
        files.extend((1..=3).map(|n| format!("train/0001/frame_{camera}/frame_{camera}_{n:04}.png")));
        files.extend((1..=2).map(|n| format!("train/0001/flow_FW_{camera}/flow_FW_{camera}_{n:04}.flo5")));
        files.extend((2..=3).map(|n| format!("train/0001/flow_BW_{camera}/flow_BW_{camera}_{n:04}.flo5")));
        files.extend((1..=2).map(|n| format!("test/0003/frame_{camera}/frame_{camera}_{n:04}.png")));
    }
    Tree::of(files)
}

#[test]
fn forward_and_backward() {
    let dir = spring();
    let dataset = dir.open("spring", None);
    assert_eq!(
        listed(&dataset)[1],
        "0001/frame_left_0002: train/0001/frame_left/frame_left_0002.png > train/0001/frame_left/frame_left_0003.png \
         = train/0001/flow_FW_left/flow_FW_left_0002.flo5"
    );
    let dataset = dir.open("spring-right-backward", None);
    assert_eq!(dataset.name(), "spring-backward-right");
    assert_eq!(
        listed(&dataset)[0],
        "0001/frame_right_0002: train/0001/frame_right/frame_right_0002.png > train/0001/frame_right/frame_right_0001.png \
         = train/0001/flow_BW_right/flow_BW_right_0002.flo5"
    );
    assert_eq!(dir.open("spring", Some(Split::Test)).entries()[0].flow, None);
    dir.refuses("spring", Some(Split::Val), &["no val split"]);
}

#[test]
fn a_missing_camera_is_named() {
    let dir = spring();
    fs::remove_dir_all(dir.path().join("train/0001/frame_right")).unwrap();
    dir.refuses("spring-right", None, &["no folder train/0001/frame_right"]);
}

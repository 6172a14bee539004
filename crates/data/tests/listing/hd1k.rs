use crate::*;

fn hd1k() -> Tree {
    let mut files = Vec::new();
    for (sequence, frames) in [(0, 10..=12), (30, 5..=6)] {
        for n in frames {
            files.push(format!("hd1k_input/image_2/{sequence:06}_{n:04}.png"));
            files.push(format!("hd1k_flow_gt/flow_occ/{sequence:06}_{n:04}.png"));
        }
    }
    files.extend((1..=2).map(|n| format!("hd1k_challenge/image_2/000000_{n:04}.png")));
    Tree::of(files)
}

#[test]
fn frames_pair_within_their_sequence() {
    let dir = hd1k();
    let all = dir.open("hd1k", None);
    assert_eq!(ids(&all), ["000000/000000_0010", "000000/000000_0011", "000030/000030_0005"]);
    assert_eq!(dir.open("hd1k", Some(Split::Train)).entries().len(), 2);
    assert_eq!(dir.open("hd1k", Some(Split::Val)).entries().len(), 1);
    assert_eq!(dir.open("hd1k", Some(Split::Test)).entries()[0].flow, None);
}

#[test]
fn odd_names_and_flows_without_frames_are_named() {
    let dir = hd1k();
    dir.add([
        "hd1k_input/image_2/picture.png",
        "hd1k_flow_gt/flow_occ/000001_0003.png",
        "hd1k_flow_gt/flow_occ/000000_10.png",
    ]);
    dir.refuses(
        "hd1k",
        None,
        &[
            "picture.png: expected a name like 000000_0010.png",
            "000001_0003.png: no pair of frames",
            "000000_10.png",
            "twice",
        ],
    );
}

use crate::*;

const HEADER: &str = "clip,subject,onset,apex,offset,class\n";

fn clips(rows: &str) -> Tree {
    let frames = [3, 4, 5]
        .into_iter()
        .flat_map(|frame| ["s01/c01", "s01/c02"].map(|clip| format!("{clip}/{frame:04}.png")));
    let dir = Tree::of(
        frames.chain(["s01/c01_flow.flo", "s01/c02_flow.npz16", "s01/c02_mask.png"].map(str::to_owned)),
    );
    fs::write(dir.path().join("clips.csv"), format!("{HEADER}{rows}")).unwrap();
    dir
}

#[test]
fn a_pair_is_onset_and_apex() {
    let dir = clips("s01/c01,s01,3,5,5,positive\ns01/c02,s01,3,4,5,negative\n");
    let dataset = dir.open("clips", None);
    assert_eq!(
        listed(&dataset),
        [
            "s01/c01/0003: s01/c01/0003.png > s01/c01/0005.png = s01/c01_flow.flo",
            "s01/c02/0003: s01/c02/0003.png > s01/c02/0004.png = s01/c02_flow.npz16",
        ]
    );
    let masks = dataset.entries().iter().map(|entry| entry.mask.is_some());
    assert_eq!(masks.collect::<Vec<_>>(), [false, true]);
    dir.refuses("clips", Some(Split::Test), &["no test split", "all"]);
}

#[test]
fn key_frames_are_enough() {
    let dir = clips("s01/c01,s01,3,5,5,positive\ns01/c02,s01,3,5,5,negative\n");
    dir.remove("s01/c01/0004.png");
    assert_eq!(dir.open("clips", None).entries().len(), 2);
}

#[test]
fn the_parts_of_the_flow_are_beside_it() {
    let dir = clips("s01/c01,s01,3,5,5,positive\ns01/c02,s01,3,4,5,negative\n");
    dir.add(["s01/c01_head_flow.flo", "s01/c01_expression_flow.npy"]);
    let parts = |number: usize| {
        let entry = dir.open("clips", None).entries()[number].clone();
        [entry.head_flow, entry.expression_flow].map(|file| file.map(|file| *file))
    };
    assert_eq!(parts(0), [dir.file("s01/c01_head_flow.flo"), dir.file("s01/c01_expression_flow.npy")]);
    assert_eq!(parts(1), [None, None]);
}

#[test]
fn clips_without_apex_or_flow_are_named() {
    let dir = clips("s01/c01,s01,3,,5,positive\ns01/c02,s01,3,4,5,negative\n");
    dir.remove("s01/c02_flow.npz16");
    dir.refuses("clips", None, &["s01/c01 has no apex", "s01/c02 has no flow s01/c02_flow.*"]);
    dir.remove("s01/c02/0004.png");
    dir.refuses("clips", None, &["s01/s01/c02: 1 frame: 4"]);
}

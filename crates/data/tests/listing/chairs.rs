use crate::*;

fn chairs() -> Tree {
    let pair = |n: u32| ["img1.ppm", "img2.ppm", "flow.flo"].map(|part| format!("data/{n:05}_{part}"));
    Tree::of((1..=4).flat_map(pair))
}

#[test]
fn the_list_chooses_the_split() {
    let dir = chairs();
    fs::write(dir.path().join("FlyingChairs_train_val.txt"), "1\n1\n2\n1\n").unwrap();
    assert_eq!(ids(&dir.open("chairs", Some(Split::Train))), ["00001", "00002", "00004"]);
    let val = dir.open("chairs", None);
    assert_eq!(listed(&val), ["00003: data/00003_img1.ppm > data/00003_img2.ppm = data/00003_flow.flo"]);
    dir.refuses("chairs", Some(Split::Test), &["no test split", "train, val, all"]);
}

#[test]
fn without_a_right_list_only_all_opens() {
    let dir = chairs();
    dir.refuses("chairs", None, &["FlyingChairs_train_val.txt", "next to data/", "`split` all"]);
    assert_eq!(dir.open("chairs", Some(Split::All)).entries().len(), 4);
    let list = dir.path().join("FlyingChairs_train_val.txt");
    fs::write(&list, "1\n2\n").unwrap();
    dir.refuses("chairs", None, &["2 lines for 4 pairs"]);
    fs::write(&list, "1\n2\ntrain\n1\n").unwrap();
    dir.refuses("chairs", None, &["line 3: expected 1 or 2, found `train`"]);
    fs::write(&list, [0xff, 0xfe, 0]).unwrap();
    dir.refuses("chairs", None, &["FlyingChairs_train_val.txt"]);
}

#[test]
fn a_missing_file_is_named() {
    let dir = chairs();
    dir.remove("data/00002_flow.flo");
    dir.refuses("chairs", Some(Split::All), &["00002", "no data/00002_flow.*"]);
}

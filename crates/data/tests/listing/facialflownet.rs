use crate::*;

fn facialflownet() -> Tree {
    let mut files = Vec::new();
    for motion in ["facial", "head"] {
        files.extend((0..3).map(|n| format!("image/{motion}/test/happy/012/{n}.jpg")));
        files.extend((0..2).map(|n| format!("flow/{motion}/test/happy/012/{n}.flo")));
    }
    files.extend((0..3).map(|n| format!("mask/test/happy/012/{n}.npy")));
    Tree::of(files)
}

#[test]
fn images_flows_and_masks_go_by_their_order() {
    let dir = facialflownet();
    let dataset = dir.open("facialflownet-head", None);
    assert_eq!(
        listed(&dataset)[1],
        "test/happy/012/1: image/head/test/happy/012/1.jpg > image/head/test/happy/012/2.jpg = flow/head/test/happy/012/1.flo"
    );
    assert_eq!(dataset.entries()[1].mask, dir.file("mask/test/happy/012/1.npy"));
}

#[test]
fn counts_that_do_not_fit_are_named() {
    let dir = facialflownet();
    dir.remove("flow/facial/test/happy/012/0.flo");
    dir.refuses(
        "facialflownet",
        None,
        &["test/happy/012: 3 images need 2 flows, flow/facial/test/happy/012 holds 1"],
    );
    dir.remove("mask/test/happy/012/0.npy");
    dir.remove("mask/test/happy/012/1.npy");
    dir.refuses("facialflownet-head", None, &["3 images need 2 masks, mask/test/happy/012 holds 1"]);
}

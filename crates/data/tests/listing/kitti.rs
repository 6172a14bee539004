use crate::*;

fn kitti(images: &str) -> Tree {
    let files = ["000000", "000001"].into_iter().flat_map(|scene| {
        [
            format!("training/{images}/{scene}_10.png"),
            format!("training/{images}/{scene}_11.png"),
            format!("training/flow_occ/{scene}_10.png"),
            format!("testing/{images}/{scene}_10.png"),
            format!("testing/{images}/{scene}_11.png"),
        ]
    });
    let dir = Tree::of(files);
    dir.add(["training/flow_noc/000001_10.png", &format!("training/{images}/000000_09.png")]);
    dir
}

#[test]
fn both_years() {
    for (kind, name, images) in
        [("kitti", "kitti-2015", "image_2"), ("kitti-2012", "kitti-2012", "colored_0")]
    {
        let dir = kitti(images);
        let dataset = dir.open(kind, None);
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
        let test = dir.open(kind, Some(Split::Test));
        assert!(test.entries().iter().all(|entry| entry.flow.is_none()));
        dir.refuses(kind, Some(Split::Val), &["no val split"]);
    }
}

#[test]
fn missing_files_are_named() {
    let dir = kitti("image_2");
    dir.remove("training/image_2/000000_11.png");
    dir.add(["training/flow_occ/000007_10.png"]);
    dir.refuses(
        "kitti",
        None,
        &["000000: no training/image_2/000000_11.png", "training/flow_occ/000007_10.png: no frame"],
    );
    dir.refuses("kitti-2012", None, &["training/colored_0"]);
}

//! Region maps divide the mask of the head into its parts, and change nothing else of a dataset.

use std::path::{Path, PathBuf};

use srflow_core::Shard;
use srflow_data::flow::{DatasetSpec, FlowDataset, Split};
use srflow_data::manifest::Manifest;
use srflow_data::region_map::HeadPart;
use srflow_files::SHA256SUMS;
use srflow_files::{read_labels, read_mask};
use srflow_render::generate::{Settings, generate};
use srflow_render::job::Request;

use crate::tiny;
use crate::tree;

fn settings(regions: bool) -> Settings {
    Settings { regions, ..tiny::settings() }
}

#[test]
fn region_maps_divide_the_mask_and_change_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let [with, without, parts] = ["with", "without", "parts"].map(|name| folder.path().join(name));
    generate(&settings(true), Request::new(&with)).unwrap();
    generate(&settings(false), Request::new(&without)).unwrap();
    // In two shards, the first of them stopped and continued.
    let [first, second] = [1, 2].map(|number| Shard { number, of: 2 });
    let request = || Request::new(&parts);
    generate(&settings(true), Request { shard: second, stop_after: Some(1), ..request() }).unwrap();
    generate(&settings(true), Request { shard: second, ..request() }).unwrap();
    generate(&settings(true), Request { shard: first, ..request() }).unwrap();
    let files = tree::contents(&with);
    assert!(files == tree::contents(&parts), "shards and interruptions do not matter");
    let is_map = |path: &Path| path.starts_with("train/regions");
    assert_eq!(files.iter().filter(|(path, _)| is_map(path)).count(), 4, "one for each frame");
    let others = |files: Vec<(PathBuf, Vec<u8>)>| -> Vec<(PathBuf, Vec<u8>)> {
        let of_all = |path: &Path| path.ends_with("dataset.json") || path.ends_with(SHA256SUMS);
        files.into_iter().filter(|(path, _)| !is_map(path) && !of_all(path)).collect()
    };
    assert!(others(files) == others(tree::contents(&without)), "all other files are the same");
    assert!(!std::fs::read_to_string(without.join("dataset.json")).unwrap().contains("regions"));

    let manifest = Manifest::read(&with).unwrap();
    for frame in 0..=3 {
        let files = manifest.frame_files(&with, &manifest.scenes[0], frame);
        let (map, mask) = (read_labels(&files.regions.unwrap()).unwrap(), read_mask(&files.mask).unwrap());
        for (label, inside) in map.pixels().iter().zip(mask.pixels()) {
            assert_eq!(HeadPart::of_label(*label).is_some(), *inside);
        }
    }

    // The first frame shows the head upright, from the front.
    let spec = DatasetSpec { kind: "srflow".to_owned(), dir: with };
    let dataset = FlowDataset::open(&spec, Some(Split::Train)).unwrap();
    let map = dataset.entries()[0].read_regions().unwrap().unwrap();
    let mean_row = |part: HeadPart| {
        let (mut count, mut sum) = (0, 0);
        for y in 0..map.height() {
            let in_row = map.row(y).iter().filter(|label| **label == part.label()).count();
            (count, sum) = (count + in_row, sum + y * in_row);
        }
        assert!(count > 10, "{count} pixels of {part}");
        sum as f64 / count as f64
    };
    let [skin, eyes, hair, neck] =
        [HeadPart::Skin, HeadPart::Eyes, HeadPart::Hair, HeadPart::Neck].map(mean_row);
    assert!(hair < eyes && eyes < skin && skin < neck, "{hair} {eyes} {skin} {neck}");
}

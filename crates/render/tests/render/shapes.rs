//! A dataset of generic pairs is complete, read as FlyingChairs, and the same however it is made.

use std::fs;
use std::path::Path;

use srflow_core::Image;
use srflow_core::Shard;
use srflow_data::flow::{FlowDataset, Split};
use srflow_files::{read_flow, read_image, read_mask, write_image_png};
use srflow_render::RenderError;
use srflow_render::job::Request;
use srflow_render::shapes::{ShapesReport, ShapesSettings, shapes};

use crate::threads::on_threads;
use crate::tree::contents;

fn settings() -> ShapesSettings {
    ShapesSettings {
        pairs: 37,
        size: srflow_core::Size { width: 48, height: 32 },
        ..ShapesSettings::default()
    }
}

fn make(settings: &ShapesSettings, request: Request, threads: usize) -> Result<ShapesReport, RenderError> {
    on_threads(threads, || shapes(settings, request))
}

#[test]
fn the_bytes_do_not_depend_on_how_pairs_are_made() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    let whole = make(&settings(), Request::new(&one), 1).unwrap();
    assert_eq!((whole.pairs, whole.made, whole.is_whole), (37, 37, true));

    let part =
        |number, stop_after| Request { shard: Shard { number, of: 2 }, stop_after, ..Request::new(&two) };
    let stopped = make(&settings(), part(2, Some(3)), 3).unwrap();
    assert_eq!((stopped.made, stopped.stopped, stopped.is_whole), (3, true, false));
    assert!(!two.join("FlyingChairs_train_val.txt").exists());
    make(&settings(), part(1, None), 2).unwrap();
    // What a killed run leaves.
    fs::remove_file(two.join("data/00021_flow.npz16")).unwrap();
    let rest = make(&settings(), part(2, None), 3).unwrap();
    assert!(rest.is_whole && rest.made >= 15, "{rest:?}");
    assert_eq!(contents(&one), contents(&two));

    let other = ShapesSettings { seed: 2, ..settings() };
    let refused = make(&other, Request::new(&two), 2).unwrap_err().to_string();
    assert!(refused.contains("seed 1, requested is 2"), "{refused}");
    let fewer = ShapesSettings { pairs: 2, ..settings() };
    make(&fewer, Request { force: true, ..Request::new(&two) }, 2).unwrap();
    assert_eq!(fs::read_dir(two.join("data")).unwrap().count(), 2 * 4);
}

#[test]
fn pairs_are_read_as_flying_chairs_with_their_occlusion() {
    let folder = tempfile::tempdir().unwrap();
    make(&settings(), Request::new(folder.path()), 2).unwrap();
    let dataset = |split| {
        let spec = format!("chairs:{}", folder.path().display()).parse().unwrap();
        FlowDataset::open(&spec, Some(split)).unwrap()
    };
    assert_eq!(
        [Split::Train, Split::Val, Split::All].map(|split| dataset(split).entries().len()),
        [36, 1, 37]
    );
    let train = dataset(Split::Train);
    let sample = train.read(&train.entries()[4]).unwrap();
    let data = folder.path().join("data");
    let frame = |name: &str| read_image(&data.join(name)).unwrap();
    assert_eq!([sample.frame1, sample.frame2], [frame("00005_img1.png"), frame("00005_img2.png")]);
    assert_eq!(sample.flow.unwrap(), read_flow(&data.join("00005_flow.npz16")).unwrap());
    assert_eq!(sample.occlusion.unwrap(), read_mask(&data.join("00005_occlusion.png")).unwrap());
}

#[test]
fn photographs_are_shown_and_broken_ones_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let photographs = folder.path().join("photographs");
    fs::create_dir(&photographs).unwrap();
    write_image_png(&photographs.join("red.png"), &Image::filled(2000, 3, [250, 0, 0])).unwrap();
    let with = ShapesSettings { pairs: 6, textures: Some(photographs.clone()), ..settings() };
    let (made, shown) = (folder.path().join("made"), folder.path().join("shown"));
    make(&ShapesSettings { textures: None, ..with.clone() }, Request::new(&made), 2).unwrap();
    make(&with, Request::new(&shown), 2).unwrap();
    let reds = |dir: &Path| {
        let frames = (1..7).map(|number| dir.join(format!("data/{number:05}_img1.png")));
        let is_red = |pixel: &&[u8; 3]| pixel[0] > 150 && pixel[1] < 90 && pixel[2] < 90;
        frames.map(|path| read_image(&path).unwrap().pixels().iter().filter(is_red).count()).sum::<usize>()
    };
    assert!(reds(&shown) > 2 * reds(&made) + 500, "{} {}", reds(&shown), reds(&made));

    fs::write(photographs.join("red.png"), "not a picture").unwrap();
    let error = make(&with, Request { force: true, ..Request::new(&shown) }, 2).unwrap_err().to_string();
    assert!(error.contains("red.png"), "{error}");
    fs::remove_file(photographs.join("red.png")).unwrap();
    let error = make(&with, Request::new(&made), 2).unwrap_err().to_string();
    assert!(error.contains("textures") && error.contains("a folder with images"), "{error}");
}

#[test]
fn settings_out_of_range_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused =
        |settings: ShapesSettings| make(&settings, Request::new(folder.path()), 1).unwrap_err().to_string();
    assert!(refused(ShapesSettings { pairs: 0, ..settings() }).starts_with("pairs 0"));
    assert!(
        refused(ShapesSettings { size: srflow_core::Size { width: 8, ..settings().size }, ..settings() })
            .starts_with("size 8x32")
    );
    assert!(
        refused(ShapesSettings { motion: srflow_core::Numbers([2.0, 1.0]), ..settings() })
            .starts_with("motion 2,1")
    );
    assert!(
        refused(ShapesSettings { motion: srflow_core::Numbers([f32::NAN, 1.0]), ..settings() })
            .starts_with("motion NaN")
    );
}

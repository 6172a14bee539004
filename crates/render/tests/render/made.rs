//! Pairs made in memory are those that are read from files with the same settings.

use std::path::Path;

use srflow_core::Image;
use srflow_data::flow::{FlowDataset, MadePairs, Sample, Split};
use srflow_files::{FlowFormat, write_image_png};
use srflow_render::generate::{Background, ScenePairs, Settings, generate};
use srflow_render::job::Request;
use srflow_render::shapes::{ShapePairs, ShapesSettings, shapes};

use crate::threads::on_threads;

/// All pairs of a dataset in files, by scene and pair.
fn read(kind: &str, dir: &Path) -> Vec<Sample> {
    let spec = format!("{kind}:{}", dir.display()).parse().unwrap();
    let dataset = FlowDataset::open(&spec, Some(Split::All)).unwrap();
    dataset.entries().iter().map(|entry| dataset.read(entry).unwrap()).collect()
}

#[test]
fn generic_pairs_are_those_of_the_files() {
    let folder = tempfile::tempdir().unwrap();
    let photographs = folder.path().join("photographs");
    std::fs::create_dir(&photographs).unwrap();
    let photograph = Image::from_fn(90, 60, |x, y| [(2 * x) as u8, (3 * y) as u8, 77]);
    write_image_png(&photographs.join("a.png"), &photograph).unwrap();
    for textures in [None, Some(photographs)] {
        let settings = ShapesSettings {
            pairs: 5,
            size: srflow_core::Size { width: 48, height: 40 },
            seed: 9,
            textures,
            flow_format: FlowFormat::Flo,
            ..ShapesSettings::default()
        };
        let dir = folder.path().join(if settings.textures.is_some() { "shown" } else { "made" });
        on_threads(2, || shapes(&settings, Request::new(&dir))).unwrap();
        let files = read("chairs", &dir);
        // Out of order, the last beyond the files.
        let pairs = ShapePairs::new(settings).unwrap();
        let made: Vec<_> =
            [3, 0, 4, 2, 1, 5].map(|number| pairs.make(number, 0..1).unwrap().remove(0)).into();
        for (number, sample) in [3, 0, 4, 2, 1].into_iter().zip(&made) {
            assert!(*sample == files[number], "pair {number}");
        }
        assert!(files.iter().all(|file| *file != made[5]));
    }
}

#[test]
fn rendered_pairs_are_those_of_the_files_in_any_runs() {
    let folder = tempfile::tempdir().unwrap();
    let backgrounds = folder.path().join("backgrounds");
    std::fs::create_dir(&backgrounds).unwrap();
    write_image_png(&backgrounds.join("a.png"), &Image::from_fn(9, 7, |x, _| [20 * x as u8; 3])).unwrap();
    for (name, base) in [
        ("wild", Settings::wild()),
        ("images", Settings { background: Background::Images(backgrounds), ..Settings::default() }),
    ] {
        let settings = Settings {
            scenes: 2,
            frames: 5.0,
            size: srflow_core::Size { width: 66, height: 96 },
            splits: srflow_core::Numbers([1.0, 0.0, 0.0]),
            seed: 4,
            flow_format: FlowFormat::Flo,
            ..base
        };
        let dir = folder.path().join(name);
        on_threads(2, || generate(&settings, Request::new(&dir))).unwrap();
        let files = read("srflow", &dir);
        let pairs = ScenePairs::new(settings).unwrap();
        assert_eq!(pairs.pairs_per_scene(), 5);
        for (threads, scene, run) in [(1, 1, 3..5), (2, 0, 0..5), (1, 1, 0..3), (3, 0, 2..3)] {
            let made = on_threads(threads, || pairs.make(scene, run.clone())).unwrap();
            assert_eq!(made.len(), run.len());
            for (pair, sample) in run.zip(&made) {
                assert!(*sample == files[(5 * scene + pair) as usize], "{name}: scene {scene}, pair {pair}");
            }
        }
    }
    assert!(ScenePairs::new(Settings { frames: 2.5, ..Settings::default() }).is_err());
}

//! Frames with imaging effects: of the same scenes with the same labels, the same bytes however they are rendered.

mod tree;

use std::fs;
use std::path::{Path, PathBuf};

use srflow_read::manifest::{Manifest, Recording};
use srflow_render::check::check;
use srflow_render::generate::{Settings, generate};
use srflow_render::job::{Request, Shard};
use tree::contents;

fn settings(recording: Recording) -> Settings {
    Settings {
        scenes: 1,
        frames: 3.0,
        width: 110,
        height: 160,
        splits: [1.0, 0.0, 0.0],
        seed: 4,
        backward: true,
        depth: true,
        regions: true,
        recording,
        ..Settings::wild()
    }
}

fn render(dir: &Path, settings: &Settings, threads: usize) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| generate(settings, Request::new(dir))).unwrap();
}

fn names(files: &[(PathBuf, Vec<u8>)]) -> Vec<&Path> {
    files.iter().map(|(path, _)| path.as_path()).collect()
}

#[test]
fn effects_change_frames_alone_and_no_byte_depends_on_how_they_are_rendered() {
    let folders = [(); 3].map(|()| tempfile::tempdir().unwrap());
    let [clean, wild, parts] = folders.each_ref().map(|folder| folder.path());
    render(clean, &settings(Recording::none()), 2);
    let recorded = settings(Recording::wild());
    render(wild, &recorded, 2);
    let second_half = Shard { number: 2, of: 2 };
    generate(&recorded, Request { shard: second_half, stop_after: Some(1), ..Request::new(parts) }).unwrap();
    render(parts, &recorded, 1);

    let (clean_files, wild_files) = (contents(clean), contents(wild));
    assert!(wild_files == contents(parts));
    assert_eq!(names(&clean_files), names(&wild_files));
    for ((path, clean), (_, wild)) in clean_files.iter().zip(&wild_files) {
        let changes = path.starts_with("train/frames") || path == Path::new("dataset.json");
        assert_eq!(clean != wild, changes, "{}", path.display());
    }
    assert!(!String::from_utf8_lossy(&fs::read(clean.join("dataset.json")).unwrap()).contains("recording"));
    assert_eq!(Manifest::read(wild).unwrap().arguments.recording, Recording::wild());

    let report = check(wild, &|| {}).unwrap();
    assert!(report.problems.is_empty(), "{:?}", report.problems);
}

//! Frames with imaging effects: of the same scenes with the same labels, the same bytes however they are rendered.

use std::fs;
use std::path::{Path, PathBuf};

use srflow_core::Shard;
use srflow_data::manifest::{Manifest, Recording};
use srflow_files::SHA256SUMS;
use srflow_files::read_image;
use srflow_render::check::check;
use srflow_render::generate::{Background, MotionSource, Settings, generate};
use srflow_render::job::Request;

use crate::threads::on_threads;
use crate::tiny;
use crate::tree::contents;

fn settings(recording: Recording) -> Settings {
    let Settings { background, motion, .. } = Settings::wild();
    Settings { backward: true, depth: true, regions: true, background, motion, recording, ..tiny::settings() }
}

fn render(dir: &Path, settings: &Settings, threads: usize) {
    on_threads(threads, || generate(settings, Request::new(dir))).unwrap();
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
        let of_all = ["dataset.json", SHA256SUMS].map(Path::new);
        let changes = path.starts_with("train/frames") || of_all.contains(&path.as_path());
        assert_eq!(clean != wild, changes, "{}", path.display());
    }
    assert!(!String::from_utf8_lossy(&fs::read(clean.join("dataset.json")).unwrap()).contains("recording"));
    let recording = &Manifest::read(wild).unwrap().arguments.others["recording"];
    assert_eq!(serde_json::from_value::<Recording>(recording.clone()).unwrap(), Recording::wild());

    let report = check(wild, &|| {}).unwrap();
    assert!(report.problems.is_empty(), "{:?}", report.problems);
}

/// The centre of what is darker than a white background, in pixels.
fn centre(dir: &Path, frame: u32) -> [f64; 2] {
    let image = read_image(&dir.join(format!("train/frames/scene-0000/{frame:05}.png"))).unwrap();
    let (mut sum, mut total) = ([0.0; 2], 0.0);
    for (place, pixel) in image.pixels().iter().enumerate() {
        let dark = 255.0 * 255.0 - f64::from(pixel[1]).powi(2);
        total += dark;
        sum[0] += dark * (place % image.width()) as f64;
        sum[1] += dark * (place / image.width()) as f64;
    }
    sum.map(|sum| sum / total)
}

#[test]
fn motion_blur_is_centred_at_the_frames_time() {
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let [sharp, blurred] = folders.each_ref().map(|folder| folder.path());
    for (dir, shutter) in [(sharp, 0.0), (blurred, 1.0)] {
        let recording = Recording { shutter, ..Recording::none() };
        let base = Settings {
            background: Background::Colour([255; 3]),
            motion: MotionSource::Curves,
            ..settings(recording)
        };
        render(
            dir,
            &Settings {
                frames: 4.0,
                size: srflow_core::Size { width: 330, height: 480 },
                seed: 8,
                regions: false,
                ..base
            },
            2,
        );
    }
    let mut longest: f64 = 0.0;
    for frame in 1..4 {
        let [here, after] = [frame, frame + 1].map(|frame| centre(sharp, frame));
        let step = (after[0] - here[0]).hypot(after[1] - here[1]);
        let of_blurred = centre(blurred, frame);
        let shift = (of_blurred[0] - here[0]).hypot(of_blurred[1] - here[1]);
        assert!(shift < 0.15 * step, "frame {frame}: {shift} px of {step}");
        longest = longest.max(step);
    }
    // An open shutter that began or ended at the frame would shift it by nearly half of a step.
    assert!(longest > 0.5, "{longest}");
    let frames =
        contents(blurred).into_iter().zip(contents(sharp)).filter(|(blurred, sharp)| blurred.1 != sharp.1);
    assert!(frames.filter(|(blurred, _)| blurred.0.starts_with("train/frames")).count() >= 3);
}

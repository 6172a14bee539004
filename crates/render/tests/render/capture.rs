//! A capture made by `srflow avatar capture` is what its files say: read back and rendered again it gives the same pictures.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec2;
use srflow_avatar::capture::{Capture, CaptureSplit, HeadRecord, LANDMARKS_NAME, Landmarks};
use srflow_avatar::{Avatar, PosedHead};
use srflow_render::capture::{CaptureReport, CaptureSettings, TRUE_FOLDER, capture};
use srflow_render::job::Request;
use srflow_splat::{Frame, Gaussians, Options, Rasterizer};

use crate::threads::on_threads;
use crate::tree;

fn settings() -> CaptureSettings {
    CaptureSettings {
        cameras: 3,
        timesteps: 4,
        size: srflow_core::Size { width: 110, height: 160 },
        seed: 7,
        ..CaptureSettings::default()
    }
}

fn make(dir: &Path, settings: &CaptureSettings, threads: usize, stop_after: Option<u64>) -> CaptureReport {
    on_threads(threads, || capture(settings, Request { stop_after, ..Request::new(dir) })).unwrap()
}

/// Every file below a folder, by relative path.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    tree::contents(dir).into_iter().collect()
}

#[test]
fn a_capture_read_back_and_rendered_again_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let report = make(folder.path(), &settings(), 2, None);
    assert_eq!((report.timesteps, report.made, report.complete), (4, 4, true));
    let read = Capture::read(folder.path()).unwrap();
    assert_eq!((read.views().len(), read.camera_indices()), (12, vec![1, 8, 15]));
    assert_eq!(CaptureSplit::ALL.map(|split| read.of(split).count()), [6, 3, 3]);
    let record = HeadRecord::read(folder.path()).unwrap().expect("head.json");
    assert_eq!((record.head.as_str(), record.subject), ("builtin", 7));
    let avatar = Avatar::builtin(record.subject).unwrap();
    record.check(folder.path(), avatar.model()).unwrap();
    let parameters = read.parameters().unwrap();
    parameters.check(avatar.model()).unwrap();
    let landmarks = Landmarks::read(&folder.path().join(LANDMARKS_NAME)).unwrap();
    let (mut head, mut gaussians, mut frame) = (PosedHead::default(), Gaussians::default(), Frame::new());
    let options = Options { background: [1.0; 3], ..Options::default() };
    for view in read.views() {
        let pose = parameters.poses[view.timestep as usize].pose(avatar.model());
        avatar.gaussians_into(&pose, &mut head, &mut gaussians);
        Rasterizer::new().render(&gaussians, &view.camera, None, &options, &mut frame).unwrap();
        let image = read.image(view).unwrap();
        // The camera went through a matrix of the other direction: its last bit may differ, and with it a rounded value.
        let greatest = |(a, b): (&[u8; 3], &[u8; 3])| (0..3).map(|c| a[c].abs_diff(b[c])).max();
        assert!(frame.image.pixels().iter().zip(image.pixels()).filter_map(greatest).all(|d| d <= 1));
        let mask = read.mask(view).unwrap().expect("a mask");
        let alphas = mask.pixels().iter().zip(frame.alpha.pixels());
        assert!(alphas.clone().all(|(mask, alpha)| (mask - alpha).abs() < 1.0 / 254.0));
        assert!(alphas.filter(|(mask, _)| **mask > 0.5).count() > 3000, "the head fills the picture");

        let face = landmarks.get(view.timestep, view.camera_index).expect("landmarks");
        let places = avatar.model().landmarks_on(head.vertices());
        for (place, landmark) in places.zip(face) {
            let (pixel, _) = view.camera.project(place.as_dvec3()).unwrap();
            assert!(pixel.distance(DVec2::from(landmark.expect("in the picture"))) < 1e-3);
        }
    }
    let mean = parameters.poses.iter().map(|pose| pose.translation).sum::<glam::Vec3>() / 4.0;
    assert!(mean.length() < 1e-6, "the head is at the origin: {mean}");
    assert_ne!(parameters.poses[1], parameters.poses[2], "the head moves");
}

#[test]
fn a_capture_that_is_stopped_goes_on_and_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
    let noisy =
        CaptureSettings { noise: 1.0, calibration_noise: 1.0, landmark_noise: 2.0, cameras: 2, ..settings() };
    make(&whole, &noisy, 3, None);
    let first = make(&parts, &noisy, 1, Some(2));
    assert!(first.stopped && !first.complete && first.made == 2);
    assert!(!parts.join("transforms.json").exists(), "the lists mark a complete capture");
    fs::write(parts.join("images/.00002_08.png.1-1.partial"), "left by a killed run").unwrap();
    let second = make(&parts, &noisy, 2, None);
    assert!(second.complete && second.made == 2);
    let (whole, parts) = (files(&whole), files(&parts));
    assert_eq!(whole.keys().collect::<Vec<_>>(), parts.keys().collect::<Vec<_>>());
    for (path, bytes) in &whole {
        assert!(*bytes == parts[path], "{} differs", path.display());
    }
}

#[test]
fn noise_is_in_the_written_files_and_the_truth_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let [clean, noisy] = ["clean", "noisy"].map(|name| folder.path().join(name));
    let few = CaptureSettings { timesteps: 1, ..settings() };
    make(&clean, &few, 2, None);
    make(
        &noisy,
        &CaptureSettings { noise: 2.0, calibration_noise: 3.0, landmark_noise: 2.0, ..few },
        2,
        None,
    );
    let (a, b) = (files(&clean), files(&noisy));
    for same in
        ["flame_param/00000.npz", "fg_masks/00000_08.png", "true/landmarks.csv", "true/transforms.json"]
    {
        assert!(a[Path::new(same)] == b[Path::new(same)], "{same}");
    }
    assert!(a[Path::new("landmarks.csv")] == a[Path::new("true/landmarks.csv")]);
    for other in ["images/00000_08.png", "landmarks.csv", "transforms.json"] {
        assert!(a[Path::new(other)] != b[Path::new(other)], "{other}");
    }
    let (found, truth) = (Capture::read(&noisy).unwrap(), Capture::read(&noisy.join(TRUE_FOLDER)).unwrap());
    for (found, real) in found.views().iter().zip(truth.views()) {
        assert_ne!(found.camera, real.camera);
        assert_eq!(found.split, real.split);
        truth.image(real).expect("the same pictures, from the folder of the truth");
    }
    let read = |dir: &Path| Landmarks::read(&dir.join(LANDMARKS_NAME)).unwrap();
    let (found, truth) = (read(&noisy), read(&noisy.join(TRUE_FOLDER)));
    let pairs = found.get(0, 8).unwrap().iter().zip(truth.get(0, 8).unwrap());
    let errors: Vec<f64> =
        pairs.flat_map(|(a, b)| [0, 1].map(|axis| a.unwrap()[axis] - b.unwrap()[axis])).collect();
    let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    assert!((1.6..2.4).contains(&deviation), "{deviation}");
}

#[test]
fn another_capture_in_the_folder_is_kept_unless_forced() {
    let folder = tempfile::tempdir().unwrap();
    let few = CaptureSettings { timesteps: 1, cameras: 2, ..settings() };
    make(folder.path(), &few, 2, None);
    fs::write(folder.path().join("images/mine.png"), "mine").unwrap();
    let other = CaptureSettings { cameras: 1, ..few };
    let error = capture(&other, Request::new(folder.path())).unwrap_err().to_string();
    assert!(error.contains("cameras 2, requested is 1"), "{error}");
    capture(&other, Request { force: true, ..Request::new(folder.path()) }).unwrap();
    let mut images: Vec<_> =
        fs::read_dir(folder.path().join("images")).unwrap().map(|e| e.unwrap().file_name()).collect();
    images.sort();
    assert_eq!(images, ["00000_08.png", "mine.png"]);
}

//! The error of an avatar's flow is that by which it differs from the true head's.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use srflow_avatar::Avatar;
use srflow_avatar::capture::{Capture, CaptureSplit, CaptureView, HeadRecord, write_tracked};
use srflow_data::region_map::HeadPart;
use srflow_head::{HeadModel, HeadPose};
use srflow_render::capture::{CaptureSettings, TrueCapture, capture};
use srflow_render::job::Request;
use srflow_render::label_error::{
    FlowComparison, FlowPair, LabelError, LabelErrorSum, MovingHead, PartError, TestedAvatar, flow_pairs,
};
use srflow_render::mesh_error::mesh_error;
use srflow_splat::{Camera, Options};

struct Made {
    /// Removed when the tests end.
    folder: tempfile::TempDir,
    truth: TrueCapture,
}

/// Eight timesteps by three cameras, the last two timesteps for testing.
static MADE: LazyLock<Made> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let settings = CaptureSettings {
        cameras: 3,
        timesteps: 8,
        size: srflow_core::Size { width: 110, height: 160 },
        seed: 3,
        ..CaptureSettings::default()
    };
    capture(&settings, Request::new(folder.path())).expect("a capture");
    let truth = TrueCapture::read(folder.path()).expect("its truth");
    Made { folder, truth }
});

fn tested<'a>(capture: &'a Capture, avatar: &'a Avatar, poses: &'a [HeadPose]) -> TestedAvatar<'a> {
    TestedAvatar { avatar, poses, capture, truth: &MADE.truth, options: Options::default(), faithful: false }
}

fn mean(part: &PartError) -> f64 {
    part.errors.expect("pixels").mean
}

#[test]
fn the_true_head_has_no_error_and_its_parts_make_up_the_whole() {
    let capture = Capture::read(MADE.folder.path()).unwrap();
    let TrueCapture { avatar, poses, .. } = &MADE.truth;
    let pairs = flow_pairs(&capture, CaptureSplit::Test, 1);
    assert_eq!(pairs.iter().map(|pair| pair.camera).collect::<Vec<_>>(), capture.camera_indices());
    assert!(pairs.iter().all(|pair| pair.timesteps == [6, 7]));
    let mut seen = Vec::new();
    let error = tested(&capture, avatar, poses)
        .label_error(&pairs, |pair, flows| {
            seen.push(*pair);
            let counted = flows.errors().filter(|error| !error.is_nan()).count();
            assert_eq!(counted, flows.parts().flatten().count());
        })
        .unwrap();
    assert_eq!((seen, error.pairs), (pairs, 3));
    let LabelError { head, skin, eyes, mouth, hair, neck, surplus, .. } = error;
    assert_eq!((mean(&head), head.missing, head.seen_through, surplus), (0.0, 0, 0, 0));
    assert_eq!(head.errors.unwrap().percentile_95, 0.0);
    let length = head.errors.unwrap().true_length;
    assert!((0.05..20.0).contains(&length), "the head moves by {length} px");
    let parts = [skin, eyes, mouth, hair, neck];
    assert_eq!(parts.iter().map(|part| part.pixels).sum::<u64>(), head.pixels);
    let [skin, eyes, _, hair, neck] = parts.map(|part| part.pixels);
    assert!(skin > 1000 && eyes > 10 && hair > 100 && neck > 500, "{parts:?}");
    assert_eq!(flow_pairs(&capture, CaptureSplit::Val, 2).len(), 4);
    assert_eq!(flow_pairs(&capture, CaptureSplit::Val, u32::MAX), []);
}

/// Compares the true head with itself, seen in the second frame by another camera or in other poses.
fn compared(cameras: [&Camera; 2], avatar_poses: [&HeadPose; 2]) -> LabelError {
    let TrueCapture { avatar, poses, .. } = &MADE.truth;
    let camera = front();
    let truth = MovingHead { avatar, poses: [&poses[0], &poses[1]], cameras: [&camera; 2] };
    let mut flows = FlowComparison::default();
    flows.render(truth, MovingHead { avatar, poses: avatar_poses, cameras }, &Options::default()).unwrap();
    let mut sum = LabelErrorSum::default();
    sum.add(&flows);
    sum.result()
}

fn front() -> Camera {
    MADE.truth.capture.views().iter().find(|view| view.camera_index == 8).expect("the front camera").camera
}

#[test]
fn a_shift_of_the_next_frame_is_the_error_in_pixels() {
    let poses = &MADE.truth.poses;
    let camera = front();
    let beside = Camera { cx: camera.cx + 1.5, cy: camera.cy - 2.0, ..camera };
    let error = compared([&camera, &beside], [&poses[0], &poses[1]]);
    let LabelError { head, skin, eyes, hair, .. } = error;
    for part in [head, skin, eyes, hair] {
        // Flow is blended by alpha, which is not quite 1.
        let errors = part.errors.unwrap();
        assert!((2.35..2.501).contains(&errors.mean) && (2.45..2.51).contains(&errors.median), "{errors:?}");
        assert!(errors.over_1_px > 0.99 && part.missing == 0, "{part:?}");
    }
    let sum = |part: &PartError| {
        part.errors.map_or(0.0, |errors| errors.mean * (part.pixels - part.missing) as f64)
    };
    let parts: f64 = error.parts()[1..].iter().map(|(_, part)| sum(part)).sum();
    assert!((parts / sum(&head) - 1.0).abs() < 1e-9);
}

#[test]
fn a_head_that_is_moved_too_far_has_the_error_of_its_projection() {
    let poses = &MADE.truth.poses;
    let camera = front();
    let mut farther = poses[1].clone();
    farther.translation.x += 0.004;
    let error = compared([&camera; 2], [&poses[0], &farther]);
    // The face is about 0.93 m from the camera, the hair about 1 m.
    let expected = |distance: f64| 0.004 * camera.fx / distance;
    assert!((expected(1.05)..expected(0.88)).contains(&mean(&error.head)), "{error:?}");
    assert!(mean(&error.skin) > mean(&error.hair), "the face is nearer");
}

#[test]
fn where_the_avatar_does_not_show_the_head_pixels_are_missing() {
    let poses = &MADE.truth.poses;
    let camera = front();
    let beside = Camera { cx: camera.cx + 8.0, ..camera };
    let error = compared([&beside; 2], [&poses[0], &poses[1]]);
    let LabelError { head, surplus, .. } = error;
    assert!(head.missing > 200 && surplus > 100 && head.missing_mean.unwrap() > 0.0, "{error:?}");
    assert_eq!(error.parts()[1..].iter().map(|(_, part)| part.missing).sum::<u64>(), head.missing);
    assert!(mean(&head) < head.errors.unwrap().true_length, "the flow is similar, only elsewhere");
}

#[test]
fn what_is_behind_the_true_surface_is_seen_through_it() {
    let camera = front();
    let seen_through = |metres: f32| {
        let [first, second] = [0, 1].map(|timestep| {
            let mut pose = MADE.truth.poses[timestep].clone();
            pose.translation.z -= metres;
            pose
        });
        let PartError { pixels, missing, seen_through, .. } = compared([&camera; 2], [&first, &second]).head;
        seen_through as f64 / (pixels - missing) as f64
    };
    assert!(seen_through(0.03) > 0.95 && seen_through(-0.03) < 0.05);
}

#[test]
fn an_avatar_in_another_world_is_compared_through_its_own_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let TrueCapture { capture, avatar, .. } = &MADE.truth;
    let mut parameters = capture.parameters().unwrap();
    parameters.poses.iter_mut().for_each(|pose| pose.translation.x += 0.1);
    let views: Vec<CaptureView> = capture
        .views()
        .iter()
        .map(|view| {
            let moved = glam::DMat4::from_translation(glam::DVec3::new(-0.1, 0.0, 0.0));
            let mut view = view.clone();
            view.camera.camera_from_world *= moved;
            view
        })
        .collect();
    let record = HeadRecord::new("builtin".to_owned(), 3, avatar.model());
    let timesteps = capture.timesteps();
    write_tracked(folder.path(), avatar.model(), &record, &views, &timesteps, parameters).unwrap();
    let tracked = Capture::read(folder.path()).unwrap();
    let found = tracked.parameters().unwrap();
    let poses: Vec<HeadPose> = found.poses.iter().map(|pose| pose.pose(avatar.model())).collect();
    let pairs = flow_pairs(&tracked, CaptureSplit::Val, 1);
    let error = tested(&tracked, avatar, &poses).label_error(&pairs, |_, _| ()).unwrap();
    assert!(mean(&error.head) < 1e-3, "{error:?}");

    let of_mesh = |poses: &[HeadPose]| {
        mesh_error(&MADE.truth, &tracked, avatar.model(), avatar.shaped(), poses).expect("the same mesh")
    };
    let same = of_mesh(&poses);
    assert_eq!((same.timesteps, same.parts.len()), (poses.len(), HeadPart::ALL.len()));
    assert!(same.parts.iter().all(|part| part.percentile_95_mm < 0.01), "{same:?}");
    let mut moved = poses.clone();
    moved.iter_mut().for_each(|pose| pose.translation.y += 0.002);
    for part in of_mesh(&moved).parts {
        assert!((part.mean_mm - 2.0).abs() < 0.01 && (part.percentile_95_mm - 2.0).abs() < 0.01, "{part:?}");
        // Up and down, surfaces that face sideways slide along themselves.
        assert!(part.normal_mean_mm < 1.5 && part.normal_percentile_95_mm < 2.01, "{part:?}");
    }
    let other = HeadModel { triangles: avatar.model().triangles[1..].to_vec(), ..avatar.model().clone() };
    assert_eq!(mesh_error(&MADE.truth, &tracked, &other, avatar.shaped(), &poses), None);

    let unknown = FlowPair { camera: 8, timesteps: [7, 8] };
    let refused = tested(&tracked, avatar, &poses).label_error(&[unknown], |_, _| ()).unwrap_err();
    assert!(refused.to_string().contains("no picture of camera 8 at timestep 8"), "{refused}");
}

/// A copy of the capture's files.
fn copied() -> tempfile::TempDir {
    fn copy(from: &Path, to: &Path) {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let path: PathBuf = entry.unwrap().path();
            let target = to.join(path.file_name().unwrap());
            if path.is_dir() { copy(&path, &target) } else { fs::copy(&path, &target).map(|_| ()).unwrap() }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    copy(MADE.folder.path(), folder.path());
    folder
}

#[test]
fn a_head_that_is_not_the_captures_is_no_truth() {
    let refusal = |dir: &Path| TrueCapture::read(dir).unwrap_err().to_string();
    let folder = copied();
    let dir = folder.path();
    assert!(TrueCapture::read(dir).is_ok());
    let model = MADE.truth.avatar.model();
    let named = |head: &str, subject| HeadRecord::new(head.to_owned(), subject, model).write(dir).unwrap();
    named("builtin", 4);
    let error = refusal(dir);
    assert!(error.contains("its first mask is not that of builtin"), "{error}");
    named("ict:nowhere", 3);
    let error = refusal(dir);
    assert!(error.contains("the files of its head ict:nowhere are missing"), "{error}");
    named("builtin-average", 3);
    let error = refusal(dir);
    assert!(error.contains("show the head `builtin`"), "{error}");
    named("avatar", 3);
    assert!(refusal(dir).contains("head.json"));
    fs::remove_file(dir.join("head.json")).unwrap();
    assert!(refusal(dir).contains("no head.json"));
    fs::write(dir.join("capture.json"), "{}").unwrap();
    assert!(
        refusal(dir).contains("capture.json: arguments: expected srflow_version and head"),
        "{}",
        refusal(dir)
    );
    fs::remove_file(dir.join("capture.json")).unwrap();
    let error = refusal(dir);
    assert!(error.contains("the true flow is not known: it has no capture.json"), "{error}");
}

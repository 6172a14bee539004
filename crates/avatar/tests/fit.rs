//! A fitted head is the one that the landmarks are of, whatever is missing or wrong among them.

mod synthetic;

use std::sync::LazyLock;

use glam::{DMat4, DQuat, DVec3};
use srflow_avatar::fit::{Fit, FitError, FitOptions, LandmarkView, fit};
use srflow_head::{HeadModel, HeadPoints, HeadState};
use synthetic::{Capture, capture, errors};

static MODEL: LazyLock<HeadModel> = LazyLock::new(HeadModel::builtin_average);

const EASY: Capture =
    Capture { seed: 1, cameras: 4, timesteps: 8, noise: 0.0, outliers: 0.0, missing: 0.0, offsets: 0.0 };

fn fitted(views: &[LandmarkView]) -> Fit {
    fit(&MODEL, views, None, &FitOptions::default(), |_, _, _| ()).expect("a fit")
}

fn error(states: &[HeadState], fit: &Fit) -> f64 {
    errors((&MODEL, states), (&MODEL, &fit.states))[0]
}

#[test]
fn exact_landmarks_of_four_cameras_give_the_head() {
    let (views, states) = capture(&MODEL, EASY);
    let fit = fitted(&views);
    let error = error(&states, &fit);
    eprintln!("{error:.3} mm, {:?}", fit.report);
    assert!(error < 0.8, "{error} mm");
    assert_eq!(fit.report.outliers, 0);
    assert_eq!((fit.report.landmarks, fit.report.missing), (8 * 4 * 68, 0));
    assert_eq!(fit.timesteps, (0..8).collect::<Vec<u32>>());
    assert!(fit.states.iter().all(|state| state.identity == fit.states[0].identity));
}

#[test]
fn noise_outliers_and_missing_landmarks_are_survived_and_counted() {
    let (views, states) = capture(&MODEL, Capture { noise: 1.0, outliers: 0.05, missing: 0.1, ..EASY });
    let fit = fitted(&views);
    let error = error(&states, &fit);
    eprintln!("{error:.3} mm, {:?}", fit.report);
    assert!(error < 2.0, "{error} mm");
    assert!((0.8..1.3).contains(&fit.report.noise), "{}", fit.report.noise);
    // A few outliers are near their landmark by chance.
    let share = fit.report.outliers as f64 / fit.report.landmarks as f64;
    assert!((0.035..0.06).contains(&share), "{share}");
    assert!(fit.report.suspect_views.is_empty());
    let missing: usize = views.iter().map(|view| view.landmarks.iter().filter(|l| l.is_none()).count()).sum();
    assert_eq!(fit.report.missing, missing);
}

#[test]
fn a_wrong_camera_is_named_and_does_no_harm() {
    let (mut views, states) = capture(&MODEL, Capture { noise: 0.5, cameras: 5, ..EASY });
    for view in views.iter_mut().filter(|view| view.camera_index == 3) {
        view.landmarks = view.landmarks.map(|pixel| pixel.map(|[x, y]| [x + 60.0, y - 40.0]));
    }
    let fit = fitted(&views);
    assert!(error(&states, &fit) < 2.0, "{} mm", error(&states, &fit));
    let suspects: Vec<u32> = fit.report.suspect_views.iter().map(|view| view.camera_index).collect();
    assert_eq!(suspects, [3; 8]);
}

#[test]
fn timesteps_without_landmarks_follow_from_their_neighbours() {
    let (mut views, states) = capture(&MODEL, EASY);
    for view in views.iter_mut().filter(|view| [0, 4].contains(&view.timestep)) {
        view.landmarks = [None; 68];
    }
    let fit = fitted(&views);
    assert_eq!(fit.report.empty_timesteps, [0, 4]);
    let moved = fit.states[4].translation.distance(states[4].translation);
    assert!(moved < 0.005, "{moved} m");
}

#[test]
fn one_camera_fits_the_picture_and_says_what_it_cannot_know() {
    let made = Capture { noise: 0.5, cameras: 1, ..EASY };
    let one = fitted(&capture(&MODEL, made).0);
    let four = fitted(&capture(&MODEL, Capture { cameras: 4, ..made }).0);
    let (one, reach, sure) = (one.report.clone(), &one.report.reach, &four.report.reach);
    eprintln!("{reach:?}\n{sure:?}");
    assert!(one.cameras[0].median < 1.2, "{}", one.cameras[0].median);
    assert_eq!((reach.cameras, sure.cameras), (1, 4));
    assert!(reach.depth > 5.0 * reach.across && reach.depth > 10.0 * sure.depth, "{reach:?} {sure:?}");
    assert!(reach.unknown_identities.len() >= sure.unknown_identities.len());
    // All landmarks are on the head: whether it turns on the neck or with the shoulders does not show.
    for reach in [reach, sure] {
        assert!(reach.unknown_joints.iter().any(|joint| joint == "neck"), "{reach:?}");
    }
}

#[test]
fn a_detector_with_other_landmarks_does_not_change_the_size_of_the_head() {
    let made = Capture { seed: 4, noise: 0.5, cameras: 1, timesteps: 12, offsets: 0.002, ..EASY };
    let (views, states) = capture(&MODEL, made);
    let corners = |states: &[HeadState]| {
        let at_rest = HeadState { identity: states[0].identity.clone(), ..HeadState::default() };
        let points = HeadPoints::landmarks(&MODEL).positions(&at_rest);
        1000.0 * points[36].distance(points[45])
    };
    let truth = corners(&states);
    let free = fitted(&views);
    let found = corners(&free.states);
    eprintln!("{truth} mm, found {found} mm, {:?}", free.report.reach);
    assert!((found - truth).abs() < 0.1 * truth, "{found} for {truth} mm");
    assert!(free.report.reach.largest_identity < 4.0, "{:?}", free.report.reach);
    assert!((0.3..0.8).contains(&free.report.noise), "{}", free.report.noise);

    let pupils = |state: &HeadState| {
        let at_rest = HeadState { identity: state.identity.clone(), ..HeadState::default() };
        let points = HeadPoints::landmarks(&MODEL).positions(&at_rest);
        let mean = |from: usize| points[from..from + 6].iter().sum::<DVec3>() / 6.0;
        mean(36).distance(mean(42))
    };
    let eye_distance = Some(pupils(&states[0]));
    let options = FitOptions { eye_distance, ..FitOptions::default() };
    let known = fit(&MODEL, &views, None, &options, |_, _, _| ()).expect("a fit");
    let (found, truth) = (1000.0 * pupils(&known.states[0]), 1000.0 * pupils(&states[0]));
    assert!((found - truth).abs() < 1.0, "{found} for {truth} mm");
}

#[test]
fn the_world_may_lie_anywhere() {
    let (views, _) = capture(&MODEL, Capture { noise: 0.5, timesteps: 3, ..EASY });
    let world_from_old = DMat4::from_rotation_translation(
        DQuat::from_scaled_axis(DVec3::new(1.2, -2.0, 0.9)),
        DVec3::new(3.0, -1.0, 7.0),
    );
    let mut turned = views.clone();
    for view in &mut turned {
        view.camera.camera_from_world *= world_from_old.inverse();
    }
    let (here, there) = (fitted(&views), fitted(&turned));
    let points = HeadPoints::landmarks(&MODEL);
    for (here, there) in here.states.iter().zip(&there.states) {
        for (here, there) in points.positions(here).into_iter().zip(points.positions(there)) {
            let distance = world_from_old.transform_point3(here).distance(there);
            assert!(distance < 2e-4, "{distance} m");
        }
    }
    assert!((here.report.noise - there.report.noise).abs() < 0.02);
}

#[test]
fn fits_do_not_depend_on_the_number_of_threads() {
    let (views, _) = capture(&MODEL, Capture { noise: 1.0, outliers: 0.05, timesteps: 3, ..EASY });
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| fitted(&views))
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn too_few_landmarks_are_an_error() {
    let (mut views, _) = capture(&MODEL, Capture { timesteps: 2, ..EASY });
    for view in &mut views {
        view.landmarks[5..].fill(None);
    }
    let best = |views: &[LandmarkView]| match fit(&MODEL, views, None, &FitOptions::default(), |_, _, _| ()) {
        Err(FitError::Landmarks { best }) => Some(best),
        _ => None,
    };
    assert_eq!((best(&views), best(&[])), (Some(5), Some(0)));
}

#[test]
fn shapes_that_are_not_fitted_stay_at_zero() {
    let (views, _) = capture(&MODEL, Capture { timesteps: 2, ..EASY });
    let options = FitOptions { identities: 5, expressions: 9, ..FitOptions::default() };
    let fit = fit(&MODEL, &views, None, &options, |_, _, _| ()).expect("a fit");
    let parameters = fit.parameters(&MODEL);
    assert_eq!(parameters.shape.len(), MODEL.identities.len());
    assert!(
        parameters.shape[..5].iter().all(|w| *w != 0.0) && parameters.shape[5..].iter().all(|w| *w == 0.0)
    );
    for pose in &parameters.poses {
        assert_eq!(pose.expr.len(), MODEL.expressions.len());
        assert!(pose.expr[9..].iter().all(|weight| *weight == 0.0));
    }
    assert_eq!((fit.report.reach.identities, fit.report.reach.expressions), (5, 9));
}

use glam::{DMat3, DQuat, DVec2, DVec3, Vec3};
use srflow_core::random::Key;
use srflow_core::{Image, Size};
use srflow_head::{
    ActionUnit, HeadModel, HeadPoints, HeadState, JointRole, ModelSource, Region, Side, vertex_normals,
};
use srflow_splat::Camera;

use super::arrow::{Step, System};
use super::pictures::{Pictures, face_points, neck_points};
use super::problem::{EYE_CORNERS, Heads, Problem, Window};
use super::{Detector, FitOptions, LandmarkView, fit};
use crate::visible_surface;

/// The derivatives of the cost, of data and of all priors, are its differences.
#[test]
fn the_gradient_is_that_of_the_cost() {
    let model = HeadModel::builtin_average();
    let camera = Camera::centred(Size::new(550, 802), [2050.0; 2])
        .placed(DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)), DVec3::new(0.0, 0.0, 1.1));
    let mut stream = Key::new(3).stream("landmarks");
    let mut random = |scale: f64| f64::from(stream.normal()) * scale;
    let views: Vec<LandmarkView> = (0..3)
        .map(|timestep| LandmarkView {
            timestep,
            camera_index: 0,
            camera,
            landmarks: std::array::from_fn(|_| Some([275.0 + random(40.0), 400.0 + random(40.0)])),
        })
        .collect();
    let options = FitOptions { eye_distance: Some(0.06), ..FitOptions::default() };
    let problem = Problem::new(&model, &views, &options);
    let mut heads = problem.heads();
    for offset in &mut heads.offsets {
        *offset = DVec3::new(random(0.05), random(0.05), random(0.05));
    }
    let identity: Vec<f64> = heads.states[0].identity.iter().map(|_| random(1.0)).collect();
    for state in &mut heads.states {
        state.identity.clone_from(&identity);
        state.expressions.iter_mut().for_each(|weight| *weight = random(0.7));
        state.translation = DVec3::new(random(0.01), random(0.01), random(0.01));
        *state.joint_mut(0) = DQuat::from_scaled_axis(DVec3::new(random(0.1), random(0.1), random(0.1)));
    }
    check_gradient(&problem, &heads, None, 1e-5);
}

fn check_gradient(problem: &Problem, heads: &Heads, pictures: Option<&Pictures>, length: f64) {
    let mut stream = Key::new(4).stream("directions");
    let mut random = |scale: f64| f64::from(stream.normal()) * scale;
    let window = Window::all(heads.states.len()).with_identity();
    let cost = |heads: &_| problem.linearise(heads, &window, 2.0, pictures).1;
    let (System { shared_gradient, blocks, .. }, _) = problem.linearise(heads, &window, 2.0, pictures);
    for _ in 0..20 {
        let mut direction =
            |gradient: &[f64]| -> Vec<f64> { gradient.iter().map(|_| random(length)).collect() };
        let shared = direction(&shared_gradient);
        let own: Vec<Vec<f64>> = blocks.iter().map(|block| direction(&block.gradient)).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let parts = blocks.iter().zip(&own).map(|(block, own)| dot(&block.gradient, own));
        let expected = 2.0 * (dot(&shared_gradient, &shared) + parts.sum::<f64>());
        let negative = |of: &[f64]| -> Vec<f64> { of.iter().map(|value| -value).collect() };
        let (back, back_own) = (negative(&shared), own.iter().map(|own| negative(own)).collect());
        let step = |shared, own| Step { shared, own, shared_covariance: Vec::new() };
        let after = cost(&problem.moved(heads, &window, &step(shared, own)));
        let before = cost(&problem.moved(heads, &window, &step(back, back_own)));
        let found = 0.5 * (after - before);
        assert!((found - expected).abs() < 1e-3 * expected.abs().max(1e4 * length), "{found} {expected}");
    }
}

/// A camera in front of the head.
fn camera() -> Camera {
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    Camera::centred(Size::new(320, 320), [900.0; 2]).placed(facing, DVec3::new(0.0, 0.0, 0.9))
}

/// Heads that turn less than their shoulders, smile and look around, and the landmarks of a detector with noise, pixels.
fn moving_heads(
    model: &HeadModel,
    count: u32,
    detector: Detector,
    noise: f64,
) -> (Vec<HeadState>, Vec<LandmarkView>) {
    let mut stream = Key::new(5).stream("moving heads");
    let mut random = |scale: f64| f64::from(stream.normal().clamp(-1.5, 1.5)) * scale;
    let points = HeadPoints::landmarks(model);
    let offsets = detector.offsets(model, 0.0).map(|offset| offset.mean);
    let [left, right, neck] =
        [JointRole::LeftEye, JointRole::RightEye, JointRole::Neck].map(|role| model.joint(role).unwrap());
    let identity: Vec<f64> = model.identities.iter().map(|_| random(0.7)).collect();
    let smile = model.action_units.iter().find(|unit| unit.number == 12).unwrap().expressions[0].0;
    let state = |timestep: u32| {
        let mut expressions = vec![0.0; model.expressions.len()];
        expressions[smile] = f64::from(timestep) / f64::from(count);
        let mut state = HeadState { identity: identity.clone(), expressions, ..HeadState::default() };
        state.joints = vec![DQuat::IDENTITY; model.joints.len()];
        *state.joint_mut(0) = DQuat::from_rotation_y(0.08 * f64::from(timestep) - 0.2);
        *state.joint_mut(neck) = DQuat::from_rotation_y(0.05 - 0.02 * f64::from(timestep));
        let gaze = DQuat::from_rotation_y(0.3 - 0.1 * f64::from(timestep));
        *state.joint_mut(left) = gaze;
        *state.joint_mut(right) = gaze;
        state.translation = DVec3::new(0.002 * f64::from(timestep), 0.0, 0.0);
        state
    };
    let states: Vec<HeadState> = (0..count).map(state).collect();
    let view = |(timestep, state): (u32, &HeadState)| {
        let true_places: Vec<DVec3> = points.positions(state);
        let size = eye_corners(&true_places);
        let landmarks = std::array::from_fn(|landmark| {
            let seen = true_places[landmark] + state.joint(0) * offsets[landmark] * size;
            let [x, y] = camera().project(seen).unwrap().0.to_array();
            Some([x + random(noise), y + random(noise)])
        });
        LandmarkView { timestep, camera_index: 0, camera: camera(), landmarks }
    };
    let views = (0..).zip(&states).map(view).collect();
    (states, views)
}

fn eye_corners(landmarks: &[DVec3]) -> f64 {
    let [right, left] = EYE_CORNERS;
    landmarks[right].distance(landmarks[left])
}

/// A picture of a head in a light from the side, with a pattern on its skin and dark irises.
fn painted(model: &HeadModel, state: &HeadState, exposure: f64) -> Image {
    let identity: Vec<f32> = state.identity.iter().map(|weight| *weight as f32).collect();
    let shaped = model.shaped(&identity);
    let mut posed = Vec::new();
    model.vertices(&shaped, &state.pose(), &mut posed);
    let normals = vertex_normals(&posed, &model.triangles);
    let points = visible_surface(&posed, &model.triangles, &camera());
    Image::from_fn(camera().width, camera().height, |x, y| {
        let Some(point) = points[y * camera().width + x] else { return [70, 90, 110] };
        let corners = model.triangles[point.triangle];
        let mean = |of: &[Vec3]| -> DVec3 {
            let corners = corners.iter().zip(point.weights.to_array());
            corners.map(|(corner, weight)| of[*corner as usize].as_dvec3() * weight).sum()
        };
        let at = mean(&model.template) * 1e3;
        let light = 0.8 + 0.4 * mean(&normals).normalize_or_zero().x;
        let color = if model.regions[point.triangle] == Region::Eyeball {
            let side = usize::from(at.x < 0.0);
            let centre = model.eye_centres(&shaped).unwrap()[side];
            let from_centre = (mean(&shaped.vertices) - centre.as_dvec3()).normalize();
            [if from_centre.z > 0.87 { 40.0 } else { 190.0 }; 3]
        } else {
            let pattern = |phase: f64| {
                let waves = (0.5 * at.x + phase).sin() + (0.4 * at.y + 2.0 * phase).sin();
                120.0 + 18.0 * waves + 15.0 * (0.9 * (at.x + at.y)).sin()
            };
            [pattern(0.0), pattern(0.3), pattern(0.7)]
        };
        color.map(|level: f64| (level * light * exposure).round().clamp(0.0, 255.0) as u8)
    })
}

fn exposure(timestep: u32) -> f64 {
    1.0 + 0.05 * f64::from(timestep % 3)
}

#[test]
fn the_gradient_with_pictures_is_that_of_the_cost() {
    let model = HeadModel::builtin_average();
    let (states, views) = moving_heads(&model, 3, Detector::Dlib, 1.0);
    let options = FitOptions::default();
    let problem = Problem::new(&model, &views, &options);
    let mut heads = Heads { states, ..problem.heads() };
    let read = |view: &LandmarkView| {
        Ok(painted(&model, &heads.states[view.timestep as usize], exposure(view.timestep)))
    };
    let mut pictures = Pictures::read(&problem, &heads, &read).unwrap();
    pictures.look(&problem, &heads, 48.0);
    pictures.follow_identity(&problem, &heads);
    for state in &mut heads.states {
        state.translation.x += 4e-4;
        state.identity.iter_mut().for_each(|weight| *weight += 0.02);
    }
    // Short steps: slopes of pictures change from pixel to pixel.
    check_gradient(&problem, &heads, Some(&pictures), 1e-9);
}

#[test]
fn pictures_make_the_motion_of_face_neck_and_eyes_exact() {
    let model = HeadModel::builtin_average();
    let (states, views) = moving_heads(&model, 6, Detector::Dlib, 1.0);
    let read =
        |view: &LandmarkView| Ok(painted(&model, &states[view.timestep as usize], exposure(view.timestep)));
    let fitted = |read| fit(&model, &views, read, &FitOptions::default(), |_, _, _| ()).unwrap();
    let [without, with] = [fitted(None), fitted(Some(&read))];
    // How far the motion of points in the pictures is off from one timestep to the next, pixels.
    let error = |points: &HeadPoints, found: &[HeadState]| -> f64 {
        let pixels = |state: &HeadState| -> Vec<_> {
            points.positions(state).iter().map(|at| camera().project(*at).unwrap().0).collect()
        };
        let moved = |states: &[HeadState], timestep: usize| -> Vec<_> {
            let [from, to] = [timestep, timestep + 1].map(|timestep| pixels(&states[timestep]));
            from.into_iter().zip(to).map(|(from, to)| to - from).collect()
        };
        let errors = (0..states.len() - 1).flat_map(|timestep| {
            let [truth, found] = [&states[..], found].map(|states| moved(states, timestep));
            truth.into_iter().zip(found).map(|(a, b)| a.distance(b)).collect::<Vec<f64>>()
        });
        let errors: Vec<f64> = errors.collect();
        errors.iter().sum::<f64>() / errors.len() as f64
    };
    // Nose, lids and mouth; neck and shoulders. Most pixels that a part may be off.
    let parts = [
        (HeadPoints::on_triangles(&model, &model.landmarks[27..]), 0.2),
        (HeadPoints::vertices(&model, neck_points(&model, 0.02)), 0.5),
    ];
    let agreement = with.report.pictures.as_ref().unwrap();
    for (points, most) in parts {
        let [before, after] = [&without, &with].map(|fit| error(&points, &fit.states));
        eprintln!("{before:.3} px, {after:.3} px, {agreement:?}");
        assert!(after < 0.25 * before && after < most, "{before} px, {after} px");
    }
    assert!(agreement.noise < 0.7 * agreement.noise_before && agreement.gazes == 6, "{agreement:?}");
    let left = model.joint(JointRole::LeftEye).unwrap();
    for (truth, found) in states.iter().zip(&with.states) {
        let off = (truth.joint(left) * DVec3::Z).angle_between(found.joint(left) * DVec3::Z).to_degrees();
        assert!(off < 3.0, "{off} degrees");
    }
}

#[test]
fn lids_close_as_in_the_pictures() {
    let model = HeadModel::builtin_average();
    let (open, views) = moving_heads(&model, 8, Detector::Dlib, 1.0);
    let options = FitOptions::default();
    let problem = Problem::new(&model, &views, &options);
    let blink = |side| {
        let is_blink = |unit: &&ActionUnit| (unit.number, unit.side) == (45, side);
        model.action_units.iter().find(is_blink).unwrap().expressions[0].0
    };
    let [left, right] = [Side::Left, Side::Right].map(blink);
    let mut closed = open.clone();
    for (timestep, eye, weight) in [(2, left, 1.0), (2, right, 1.0), (5, left, 0.6), (6, right, 1.0)] {
        closed[timestep].expressions[eye] = weight;
    }
    let read =
        |view: &LandmarkView| Ok(painted(&model, &closed[view.timestep as usize], exposure(view.timestep)));
    let mut heads = Heads { states: open, ..problem.heads() };
    let pictures = Pictures::read(&problem, &heads, &read).unwrap();
    problem.close_lids(&mut heads, &pictures);
    for (truth, found) in closed.iter().zip(&heads.states) {
        for eye in [left, right] {
            let [truth, found] = [truth, found].map(|state| state.expressions[eye]);
            assert!((truth - found).abs() < 0.25, "{truth} {found}");
        }
    }
}

#[test]
fn pictures_with_a_hand_before_the_face_are_left_out() {
    let model = HeadModel::builtin_average();
    let (states, views) = moving_heads(&model, 12, Detector::Dlib, 1.0);
    let options = FitOptions::default();
    let problem = Problem::new(&model, &views, &options);
    let heads = Heads { states, ..problem.heads() };
    let points = HeadPoints::landmarks(&model);
    let read = |view: &LandmarkView| {
        let state = &heads.states[view.timestep as usize];
        let seen = painted(&model, state, exposure(view.timestep));
        let pixel = |landmark: usize| camera().project(points.positions(state)[landmark]).unwrap().0;
        // From one corner of the mouth to the other, and from the nose to the chin.
        let (low, high) = (DVec2::new(pixel(48).x, pixel(33).y), DVec2::new(pixel(54).x, pixel(8).y));
        let fingers = (high.x - low.x) / 6.0;
        Ok(Image::from_fn(seen.width(), seen.height(), |x, y| {
            let at = DVec2::new(x as f64, y as f64);
            let inside = at.cmpgt(low).all() && at.cmplt(high).all();
            let finger = inside && (((at.x - low.x) / fingers) as usize).is_multiple_of(2);
            // At timestep 5 the hand is hard to see, and at 9 it is a fold of the skin: no hand leaves that soon.
            if finger && [4, 6, 9].contains(&view.timestep) {
                [200, 150, 140]
            } else {
                // Skin is smoother than the pattern.
                seen.get(x, y).map(|level| 105 + level / 8)
            }
        }))
    };
    let mut pictures = Pictures::read(&problem, &heads, &read).unwrap();
    pictures.look(&problem, &heads, 64.0);
    let hidden = pictures.leave_out_hidden(&problem, &heads).unwrap();
    assert_eq!(hidden.iter().map(|view| view.timestep).collect::<Vec<_>>(), [4, 5, 6]);
    assert!(
        (0..12).all(|timestep| (pictures.of_timestep(timestep).count() == 0) == (4..7).contains(&timestep))
    );
}

#[test]
fn detectors_are_told_apart_and_heads_have_the_stated_size() {
    let model = HeadModel::builtin_average();
    let points = HeadPoints::landmarks(&model);
    for detector in Detector::ALL {
        let (states, views) = moving_heads(&model, 6, detector, 1.0);
        let fitted = fit(&model, &views, None, &FitOptions::default(), |_, _, _| ()).unwrap();
        assert_eq!(fitted.report.detector, detector);
        let [found, deviation] = fitted.report.reach.eye_corners;
        let truth = eye_corners(&points.positions(&states[0]));
        eprintln!("{detector:?}: {found} m for {truth} m, known to {deviation} m");
        assert!(deviation < 0.004 && (found - truth).abs() < 2.0 * deviation, "{found} {truth} {deviation}");
    }
}

#[test]
fn points_of_the_skin_are_on_the_surface_and_not_carriers_of_gaussians() {
    let folder = std::path::Path::new("../../../shared/data/lam/p2-1");
    if !folder.is_dir() {
        eprintln!("skipped: shared-data: no avatar of LAM at {}", folder.display());
        return;
    }
    let source: ModelSource = format!("lam:{}", folder.display()).parse().unwrap();
    let model = source.model(1).unwrap();
    let points = face_points(&model, 0.004);
    let (vertices, _) = model.surface(&model.template);
    assert!(points.len() > 1000 && points.iter().all(|point| (*point as usize) < vertices.len()));
}

#[test]
fn a_picture_that_cannot_be_read_is_an_error() {
    let model = HeadModel::builtin_average();
    let (_, views) = moving_heads(&model, 3, Detector::Dlib, 0.5);
    let read = |_: &LandmarkView| {
        let problem = srflow_files::FileProblem::field("picture", "one", "none");
        Err(problem.in_file("frames".as_ref()))
    };
    let refused = fit(&model, &views, Some(&read), &FitOptions::default(), |_, _, _| ()).unwrap_err();
    assert!(refused.to_string().starts_with("frames: "), "{refused}");
}

//! Derivatives against central differences of the model's definition in f64.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3, Vec3};
use srflow_core::random::{Key, Stream};

use super::super::tests::{by_definition, model, pose, state};
use super::*;
use crate::{HeadModel, HeadPose, ict};

/// Parameters in the order of [`HeadPoints::columns`], each moved by `step` in turn.
fn moved(from: &HeadState, model: &HeadModel, column: usize, step: f64) -> HeadState {
    let mut state = from.clone();
    let (identities, expressions) = (model.identities.len(), model.expressions.len());
    state.identity.resize(identities, 0.0);
    state.expressions.resize(expressions, 0.0);
    if column < identities {
        state.identity[column] += step;
    } else if column < identities + expressions {
        state.expressions[column - identities] += step;
    } else {
        let (joint, axis) =
            ((column - identities - expressions) / 3, (column - identities - expressions) % 3);
        if joint == model.joints.len() {
            state.translation[axis] += step;
        } else {
            let turn = DQuat::from_scaled_axis(DVec3::AXES[axis] * step);
            *state.joint_mut(joint) = turn * state.joint(joint);
        }
    }
    state
}

const STEP: f64 = 1e-5;

/// A random state of a model whose shapes are meant for weights of 0 to 1, away from the ends of arcs.
fn random_state(model: &HeadModel, stream: &mut Stream) -> HeadState {
    let turn = |stream: &mut Stream| {
        DQuat::from_scaled_axis(Vec3::new(stream.normal(), stream.normal(), stream.normal()).as_dvec3() * 0.3)
    };
    HeadState {
        identity: model.identities.iter().map(|_| f64::from(stream.normal())).collect(),
        expressions: model.expressions.iter().map(|_| f64::from(stream.uniform(0.05, 0.95))).collect(),
        joints: model.joints.iter().map(|_| turn(stream)).collect(),
        translation: DVec3::new(0.03, -0.02, 0.5),
    }
}

#[test]
fn derivatives_of_a_small_model_are_those_of_its_definition() {
    let none = vec![Vec3::ZERO; 60];
    for seed in 0..6 {
        let stream = &mut Key::new(seed).stream("head model");
        let model = model(stream);
        let state = random_state(&model, stream);
        let points = HeadPoints::vertices(&model, (0..60).step_by(7));
        let fast = points.derivatives(&state);
        assert_eq!(fast.positions, points.positions(&state));
        let columns = points.columns();
        let slow = by_definition(&model, &state, &none, &none);
        for (number, position) in fast.positions.iter().enumerate() {
            assert!(position.distance(slow[7 * number]) < 1e-7, "{position} {}", slow[7 * number]);
        }
        for column in 0..columns {
            let [ahead, behind] = [STEP, -STEP]
                .map(|step| by_definition(&model, &moved(&state, &model, column, step), &none, &none));
            for number in 0..fast.positions.len() {
                let slow = (ahead[7 * number] - behind[7 * number]) / (2.0 * STEP);
                let fast = fast.values[number * columns + column];
                // Skinning weights are f32 and sum to 1 within 2e-7.
                assert!(
                    fast.distance(slow) < 5e-7,
                    "seed {seed}, point {number}, column {column}: {fast} {slow}"
                );
            }
        }
    }
}

/// Landmarks of whole heads against central differences of their positions, which the model's own vertices hold.
fn check_landmarks(model: &HeadModel, seed: u64) {
    let stream = &mut Key::new(seed).stream("landmarks");
    let mut state = random_state(model, stream);
    let points = HeadPoints::landmarks(model);
    assert_eq!(points.len(), 68);
    let mut vertices = Vec::new();
    // To f32 first, so that both sides have the same parameters.
    let (pose, identity) = (state.pose(), state.identity.iter().map(|w| *w as f32).collect::<Vec<_>>());
    state = super::super::tests::state(&identity, &pose);
    model.vertices(&model.shaped(&identity), &pose, &mut vertices);
    let fast = points.derivatives(&state);
    for (landmark, position) in model.landmarks_on(&vertices).zip(&fast.positions) {
        assert!(landmark.as_dvec3().distance(*position) < 1e-6, "{landmark} {position}");
    }
    for column in 0..points.columns() {
        let [ahead, behind] = [STEP, -STEP].map(|step| points.positions(&moved(&state, model, column, step)));
        for number in 0..points.len() {
            let slow = (ahead[number] - behind[number]) / (2.0 * STEP);
            let fast = fast.values[number * points.columns() + column];
            assert!(fast.distance(slow) < 1e-8, "point {number}, column {column}: {fast} {slow}");
        }
    }
}

#[test]
fn derivatives_of_the_builtin_head_are_central_differences() {
    check_landmarks(&HeadModel::builtin(3), 1);
}

#[test]
fn derivatives_of_ict_facekit_are_central_differences() {
    let folder = Path::new("../../../shared/data/ict-facekit/FaceXModel");
    if !folder.is_dir() {
        eprintln!("skipped: shared-data: no ICT-FaceKit at {}", folder.display());
        return;
    }
    let model = ict::load(folder).expect("a head model");
    check_landmarks(&model, 2);
    check_backward(&model, 2);
}

/// Backward against forward on all vertices.
fn check_backward(model: &HeadModel, seed: u64) {
    let stream = &mut Key::new(seed).stream("backward");
    let random = random_state(model, stream);
    let (pose, identity) = (random.pose(), random.identity.iter().map(|w| *w as f32).collect::<Vec<_>>());
    let state = super::super::tests::state(&identity, &pose);
    let mut vector = || Vec3::new(stream.normal(), stream.normal(), stream.normal());
    let gradients: Vec<Vec3> = model.template.iter().map(|_| vector()).collect();
    let backward = model.backward(&identity, &model.shaped(&identity), &pose, &gradients);
    let mut forward = vec![0.0; HeadPoints::vertices(model, [0]).columns()];
    for first in (0..gradients.len()).step_by(500) {
        let block = first..gradients.len().min(first + 500);
        let points = HeadPoints::vertices(model, block.clone().map(|v| v as u32)).derivatives(&state);
        for (row, gradient) in points.values.chunks_exact(forward.len()).zip(&gradients[block]) {
            for (sum, value) in forward.iter_mut().zip(row) {
                *sum += value.dot(gradient.as_dvec3());
            }
        }
    }
    let joints = backward.joints.iter().flat_map(|joint| joint.to_array());
    let all = backward.identity.iter().chain(&backward.expressions).copied().chain(joints);
    let all: Vec<f64> = all.chain(backward.translation.to_array()).collect();
    assert_eq!(all.len(), forward.len());
    for (column, (backward, forward)) in all.iter().zip(&forward).enumerate() {
        // Vertices before skinning are f32 in backward.
        let scale = 1.0 + forward.abs();
        assert!((backward - forward).abs() < 2e-5 * scale, "column {column}: {backward} {forward}");
    }
}

#[test]
fn backward_agrees_with_forward() {
    for seed in 0..4 {
        check_backward(&model(&mut Key::new(seed).stream("head model")), seed);
    }
    check_backward(&HeadModel::builtin(3), 9);
}

#[test]
fn gradients_of_offsets_are_central_differences() {
    for seed in 0..4 {
        let stream = &mut Key::new(seed).stream("head model");
        let (model, pose) = (model(stream), pose(stream));
        let identity = [0.7, -1.3];
        let offset: Vec<Vec3> =
            (0..60).map(|_| Vec3::new(stream.normal(), stream.normal(), 0.3) * 1e-3).collect();
        let gradients: Vec<Vec3> =
            (0..60).map(|_| Vec3::new(stream.normal(), 1.0, stream.normal())).collect();
        let shaped = model.shaped_with_offset(&identity, &offset);
        let backward = model.backward(&identity, &shaped, &pose, &gradients);
        let state = state(&identity, &pose);
        let scalar = |still: &[Vec3], moving: &[Vec3]| -> f64 {
            let vertices = by_definition(&model, &state, still, moving);
            vertices.iter().zip(&gradients).map(|(vertex, gradient)| vertex.dot(gradient.as_dvec3())).sum()
        };
        // Linear in the offsets: any step gives the derivative.
        let by = |offsets: &[Vec3], vertex: usize, axis: usize| {
            let mut offsets = offsets.to_vec();
            offsets[vertex] += Vec3::AXES[axis] * 0.125;
            let step = f64::from(offsets[vertex][axis]);
            (offsets, step)
        };
        let before = scalar(&offset, &pose.offset);
        for vertex in (0..60).step_by(11) {
            for axis in 0..3 {
                let (still, at) = by(&offset, vertex, axis);
                let slow = (scalar(&still, &pose.offset) - before) / (at - f64::from(offset[vertex][axis]));
                let fast = f64::from(backward.static_offset[vertex][axis]);
                assert!((fast - slow).abs() < 1e-5, "{fast} {slow}");
                let (moving, at) = by(&pose.offset, vertex, axis);
                let slow = (scalar(&offset, &moving) - before) / (at - f64::from(pose.offset[vertex][axis]));
                let fast = f64::from(backward.offset[vertex][axis]);
                assert!((fast - slow).abs() < 1e-5, "{fast} {slow}");
            }
        }
    }
}

#[test]
fn gradients_of_vertices_do_not_depend_on_the_number_of_threads() {
    let model = HeadModel::builtin(1);
    let gradients: Vec<Vec3> = model.template.iter().map(|v| Vec3::new(v.y, v.z, v.x)).collect();
    let pose = HeadPose { expressions: vec![0.4; 8], ..HeadPose::default() };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| model.backward(&[], &model.shaped(&[]), &pose, &gradients))
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn axis_angle_moves_as_the_small_rotation_says() {
    for r in
        [DVec3::ZERO, DVec3::new(1e-6, 0.0, 2e-6), DVec3::new(0.3, -0.2, 0.1), DVec3::new(1.5, 2.0, -0.7)]
    {
        let matrix = rotation_of_axis_angle(r);
        for axis in DVec3::AXES {
            let rotation = |step: f64| DMat3::from_quat(DQuat::from_scaled_axis(r + axis * step));
            let slope = (rotation(1e-6) - rotation(-1e-6)) * (0.5 / 1e-6);
            let expected = cross_matrix(matrix * axis) * rotation(0.0);
            assert!((slope - expected).to_cols_array().iter().all(|d| d.abs() < 1e-8), "{r} {axis}");
        }
    }
}

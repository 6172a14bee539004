//! From a picture back to the pose of a head, through the rasterizer, the binding and the head model.

use glam::{DMat3, DVec3, Quat, Vec3, Vec4};
use srflow_avatar::{Avatar, BoundGradients, PosedHead};
use srflow_core::Size;
use srflow_head::HeadPose;
use srflow_splat::{
    Camera, Frame, FrameGradients, GaussianGradients, Gaussians, Options, Outputs, Rasterizer,
};

const SIZE: Size = Size::new(150, 220);

/// Facing the head, which is seen from a side when it turns.
fn camera() -> Camera {
    let facing = DMat3::from_cols(DVec3::X, -DVec3::Y, -DVec3::Z);
    Camera::centred(SIZE, [600.0; 2]).placed(facing, DVec3::new(0.0, 0.0, 0.8))
}

/// Gradients of a loss: waves over the picture, other ones for each output.
fn waves() -> FrameGradients {
    let wave = |x: f32, y: f32, phase: f32| (0.11 * x + phase).sin() * (0.07 * y - 2.0 * phase).cos();
    let pixels = (0..SIZE.pixels()).map(|i| ((i % SIZE.width) as f32, (i / SIZE.width) as f32));
    FrameGradients {
        color: pixels.clone().map(|(x, y)| [0.3, 1.1, 2.0].map(|phase| wave(x, y, phase))).collect(),
        alpha: pixels.clone().map(|(x, y)| wave(x, y, 0.7)).collect(),
        depth: pixels.map(|(x, y)| wave(x, y, 1.7)).collect(),
        ..FrameGradients::default()
    }
}

/// How a scalar with these gradients changes between two sets of Gaussians, by its gradients. Quaternions of `after` may have the
/// other sign.
fn change(gradients: &GaussianGradients, before: &Gaussians, after: &Gaussians) -> f64 {
    let mut sum = 0.0;
    for i in 0..before.len() {
        let turn = if before.rotations[i].dot(after.rotations[i]) < 0.0 { -1.0 } else { 1.0 };
        let rotation = Vec4::from(after.rotations[i] * turn) - Vec4::from(before.rotations[i]);
        sum += gradients.positions[i].dot(after.positions[i] - before.positions[i]) as f64;
        sum += gradients.scales[i].dot(after.scales[i] - before.scales[i]) as f64;
        sum += gradients.rotations[i].dot(rotation) as f64;
    }
    sum
}

#[test]
fn gradients_of_pictures_reach_the_pose() {
    let avatar = Avatar::builtin(3).expect("an avatar");
    let mut pose = HeadPose { translation: Vec3::new(0.01, -0.02, 0.03), ..HeadPose::default() };
    pose.expressions = vec![0.2; avatar.model().expressions.len()];
    *pose.joint_mut(0) = Quat::from_rotation_y(0.3);
    *pose.joint_mut(1) = Quat::from_rotation_x(0.1);
    let (mut head, mut gaussians) = (PosedHead::default(), Gaussians::default());
    avatar.gaussians_into(&pose, &mut head, &mut gaussians);

    let options = Options { outputs: Outputs::NONE, ..Options::default() };
    let (mut rasterizer, mut frame) = (Rasterizer::new(), Frame::new());
    let (mut world, mut bound) = (GaussianGradients::default(), BoundGradients::default());
    rasterizer
        .render(&gaussians, &camera(), None, &options, &mut frame)
        .expect("renders")
        .backward(&waves(), &mut world)
        .expect("gradients that fit");
    let gradient = avatar.backward(&[], &pose, &head, &world, &mut bound);

    type Change = Box<dyn Fn(&mut HeadPose, f32)>;
    let mut parameters: Vec<(String, f64, f32, Change)> = Vec::new();
    for axis in 0..3 {
        let change = move |pose: &mut HeadPose, step: f32| pose.translation[axis] += step;
        parameters.push((format!("translation {axis}"), gradient.translation[axis], 1e-4, Box::new(change)));
        for joint in 0..2 {
            let change = move |pose: &mut HeadPose, step: f32| {
                let rotation = pose.joint_mut(joint);
                *rotation = Quat::from_axis_angle(Vec3::AXES[axis], step) * *rotation;
            };
            let name = format!("joint {joint}, {axis}");
            parameters.push((name, gradient.joints[joint][axis], 1e-3, Box::new(change)));
        }
    }
    for expression in 0..pose.expressions.len().min(6) {
        let change = move |pose: &mut HeadPose, step: f32| pose.expressions[expression] += step;
        let name = format!("expression {expression}");
        parameters.push((name, gradient.expressions[expression], 2e-2, Box::new(change)));
    }
    let (mut before, mut after) = (Gaussians::default(), Gaussians::default());
    for (name, found, step, move_by) in parameters {
        for (step, out) in [(-step, &mut before), (step, &mut after)] {
            let mut pose = pose.clone();
            move_by(&mut pose, step);
            avatar.gaussians_into(&pose, &mut head, out);
        }
        let expected = change(&world, &before, &after) / f64::from(2.0 * step);
        let error = (found - expected).abs();
        assert!(found != 0.0 && error < 2e-3 * expected.abs() + 0.02, "{name}: {found}, expected {expected}");
    }
}

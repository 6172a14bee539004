use glam::{Mat4, Quat, Vec3};
use srflow_field::random::{Key, Stream};

use super::*;

fn vector(stream: &mut Stream) -> Vec3 {
    Vec3::new(stream.normal(), stream.normal(), stream.normal())
}

fn model(stream: &mut Stream) -> HeadModel {
    let count = 60;
    let shape = |stream: &mut Stream, name: &str| Shape {
        name: name.to_owned(),
        offsets: (0..count).step_by(3).map(|v| (v, vector(stream) * 0.02)).collect(),
        arc: (0..count).step_by(5).map(|v| (v, vector(stream) * 0.01)).collect(),
    };
    let unit = |number, side, expression, weight, joints| ActionUnit {
        number,
        side,
        expressions: vec![(expression, weight)],
        joints,
    };
    HeadModel {
        name: "test".to_owned(),
        template: (0..count).map(|_| vector(stream) * 0.1).collect(),
        triangles: (0..count - 2).map(|v| [v, v + 1, v + 2]).collect(),
        regions: vec![Region::Skin; count as usize - 2],
        identities: vec![shape(stream, "wide"), shape(stream, "tall")],
        expressions: vec![shape(stream, "smile_L"), shape(stream, "smile_R"), shape(stream, "close")],
        joints: std::array::from_fn(|_| vector(stream) * 0.05),
        joint_regressor: std::array::from_fn(|joint| {
            vec![(3 * joint as u32, 0.25), (3 * joint as u32 + 1, 0.75)]
        }),
        skinning: (0..count)
            .map(|_| {
                let raw: [f32; 5] = std::array::from_fn(|_| stream.unit());
                let sum: f32 = raw.iter().sum();
                raw.map(|weight| weight / sum)
            })
            .collect(),
        action_units: vec![
            unit(12, Side::Left, 0, 1.0, vec![]),
            unit(12, Side::Right, 1, 1.0, vec![]),
            unit(43, Side::Both, 2, 0.8, vec![]),
            unit(45, Side::Both, 2, 0.8, vec![]),
            unit(26, Side::Both, 2, 0.0, vec![(Joint::Jaw, Vec3::new(0.2, 0.0, 0.0))]),
        ],
        landmarks: vec![(3, Vec3::new(0.2, 0.3, 0.5))],
        eyeballs: [0..2, 2..4],
    }
}

fn pose(stream: &mut Stream) -> HeadPose {
    HeadPose {
        expressions: vec![0.3, 1.0, -0.5],
        joints: std::array::from_fn(|_| Quat::from_scaled_axis(vector(stream) * 0.5)),
        translation: vector(stream) * 0.1,
    }
}

/// Skinning written out with 4x4 matrices, as in FLAME's `lbs.py`.
fn skinned_by_matrices(model: &HeadModel, shaped: &ShapedHead, pose: &HeadPose) -> Vec<Vec3> {
    let chain = |joint: usize| -> Vec<usize> {
        match joint {
            0 => vec![0],
            1 => vec![0, 1],
            other => vec![0, 1, other],
        }
    };
    let global: Vec<Mat4> = (0..5)
        .map(|joint| {
            chain(joint).into_iter().fold(Mat4::IDENTITY, |matrix, j| {
                let about = shaped.joints[j];
                matrix
                    * Mat4::from_translation(about)
                    * Mat4::from_quat(pose.joints[j])
                    * Mat4::from_translation(-about)
            })
        })
        .collect();
    (0..shaped.vertices.len())
        .map(|v| {
            let mut vertex = shaped.vertices[v];
            for (shape, &w) in model.expressions.iter().zip(&pose.expressions) {
                let find =
                    |list: &[(u32, Vec3)]| list.iter().find(|o| o.0 == v as u32).map_or(Vec3::ZERO, |o| o.1);
                let bend = if (0.0..=1.0).contains(&w) { 4.0 * w * (1.0 - w) } else { 0.0 };
                vertex += find(&shape.offsets) * w + find(&shape.arc) * bend;
            }
            let skinned = (0..5).fold(Vec3::ZERO, |sum, joint| {
                sum + model.skinning[v][joint] * global[joint].transform_point3(vertex)
            });
            skinned + pose.translation
        })
        .collect()
}

#[test]
fn skinning_agrees_with_the_matrices_of_flame() {
    for seed in 0..20 {
        let stream = &mut Key::new(seed).stream("head model");
        let (model, pose) = (model(stream), pose(stream));
        let shaped = model.shaped(&[0.7, -1.3]);
        let mut fast = vec![Vec3::ONE; 7];
        model.vertices(&shaped, &pose, &mut fast);
        let slow = skinned_by_matrices(&model, &shaped, &pose);
        assert_eq!(fast.len(), slow.len());
        for (fast, slow) in fast.iter().zip(&slow) {
            assert!(fast.distance(*slow) < 1e-6, "{fast} {slow}");
        }
    }
}

#[test]
fn the_identity_carries_the_joints_along() {
    let model = model(&mut Key::new(1).stream("head model"));
    let shaped = model.shaped(&[2.0]);
    let moved = |vertex: usize| shaped.vertices[vertex] - model.template[vertex];
    let expected = model.joints[2] + 0.25 * moved(6) + 0.75 * moved(7);
    assert!(shaped.joints[2].distance(expected) < 1e-7);
    assert_eq!(model.shaped(&[]).vertices, model.template);
    assert_eq!(model.shaped(&[]).joints, model.joints);
}

#[test]
fn action_units_add_up_to_full_weight() {
    let model = model(&mut Key::new(1).stream("head model"));
    let expressions =
        |units: &[(u8, Side, f32)]| model.pose_of_action_units(units).map(|pose| pose.expressions);
    assert_eq!(expressions(&[(12, Side::Both, 0.5)]), Ok(vec![0.5, 0.5, 0.0]));
    assert_eq!(expressions(&[(12, Side::Left, 1.0), (12, Side::Both, 0.25)]), Ok(vec![1.0, 0.25, 0.0]));
    assert_eq!(expressions(&[(43, Side::Left, 1.0), (45, Side::Both, 1.0)]), Ok(vec![0.0, 0.0, 0.8]));
    assert_eq!(expressions(&[(12, Side::Right, 9.0), (12, Side::Left, f32::NAN)]), Ok(vec![0.0, 1.0, 0.0]));
    let missing = expressions(&[(99, Side::Both, 1.0)]).map_err(|error| error.to_string());
    assert!(missing.is_err_and(|text| text.contains("99") && text.contains("12, 26, 43, 45")));
    let jaw =
        model.pose_of_action_units(&[(26, Side::Both, 0.5)]).map(|pose| pose.joints[Joint::Jaw as usize]);
    assert!(jaw.is_ok_and(|turn| turn.to_scaled_axis().distance(Vec3::new(0.1, 0.0, 0.0)) < 1e-6));
}

#[test]
fn validation_names_each_fault() {
    let sound = || model(&mut Key::new(1).stream("head model"));
    assert_eq!(sound().validate(), Ok(()));
    let fault = |name: &str, spoil: &dyn Fn(&mut HeadModel), part: &str| {
        let mut model = sound();
        spoil(&mut model);
        match model.validate() {
            Ok(()) => panic!("{name} passes"),
            Err(error) => assert!(error.to_string().contains(part), "{name}: {error}"),
        }
    };
    fault("triangle", &|m| m.triangles[4][1] = 60, "a triangle refers to number 60");
    fault("regions", &|m| m.regions.truncate(5), "regions has 5 entries, expected 58");
    fault("skinning", &|m| m.skinning.truncate(5), "skinning has 5 entries, expected 60");
    fault("weights", &|m| m.skinning[9][0] += 0.5, "joint weights of 9 sum to 1.5");
    fault("nan weights", &|m| m.skinning[9][0] = f32::NAN, "joint weights of 9 sum to NaN");
    fault("vertex", &|m| m.template[2].x = f32::INFINITY, "vertex 2 is not");
    fault("shape", &|m| m.expressions[1].offsets[0].0 = 1000, "smile_R refers to number 1000");
    fault("arc", &|m| m.expressions[1].arc[0].1.y = f32::NAN, "smile_R 0 is not");
    fault("regressor", &|m| m.joint_regressor[2][0].0 = 61, "joint regressor refers to number 61");
    fault("unit", &|m| m.action_units[0].expressions[0].0 = 3, "action unit 12 (Left) refers to number 3");
    fault("landmark", &|m| m.landmarks[0].0 = 58, "landmark refers to number 58");
    fault("barycentric", &|m| m.landmarks[0].1 = Vec3::ONE, "barycentric coordinates of 0 sum to 3");
    fault("eyeball", &|m| m.eyeballs[1] = 2..61, "eyeball refers to number 61");
}

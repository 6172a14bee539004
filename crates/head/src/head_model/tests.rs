use glam::{DMat4, DQuat, DVec3, Quat, Vec2, Vec3};
use srflow_core::random::{Key, Stream};

use super::*;

fn vector(stream: &mut Stream) -> Vec3 {
    Vec3::new(stream.normal(), stream.normal(), stream.normal())
}

/// A tree of seven joints: the five of FLAME, and two without a role below the jaw.
fn joints(stream: &mut Stream) -> Vec<Joint> {
    let mut joints = Joint::of_roles(std::array::from_fn(|_| vector(stream) * 0.05));
    for (name, parent) in [("chin", 2), ("tongue", 5)] {
        joints.push(Joint { name: name.to_owned(), role: None, parent: Some(parent), ..joints[0].clone() });
    }
    for (number, joint) in (0..).zip(&mut joints) {
        joint.position = vector(stream) * 0.05;
        joint.follows = vec![(3 * number, 0.25), (3 * number + 1, 0.75)];
        joint.identities = vec![vector(stream) * 0.01, vector(stream) * 0.01];
    }
    joints
}

/// A small model with everything that a model can have.
pub(super) fn model(stream: &mut Stream) -> HeadModel {
    let count = 60;
    let sparse = |stream: &mut Stream, step: usize, size: f32| {
        (0..count).step_by(step).map(|v| (v, vector(stream) * size)).collect::<Vec<_>>()
    };
    let dense = |stream: &mut Stream| Offsets::Dense((0..count).map(|_| vector(stream) * 0.02).collect());
    let shape = |stream: &mut Stream, name: &str| Shape {
        name: name.to_owned(),
        offsets: sparse(stream, 3, 0.02).into(),
        arc: sparse(stream, 5, 0.01),
    };
    let unit = |number, side, expression, weight, joints| ActionUnit {
        number,
        side,
        expressions: vec![(expression, weight)],
        joints,
    };
    let corrective = |stream: &mut Stream, joint: usize| PoseCorrective {
        joint,
        entries: std::array::from_fn(
            |i| if i % 2 == 0 { dense(stream) } else { sparse(stream, 4, 0.02).into() },
        ),
    };
    let joints = joints(stream);
    HeadModel {
        name: "test".to_owned(),
        template: (0..count).map(|_| vector(stream) * 0.1).collect(),
        triangles: (0..count - 2).map(|v| [v, v + 1, v + 2]).collect(),
        regions: vec![Region::Skin; count as usize - 2],
        identities: vec![shape(stream, "wide"), Shape::linear("tall", dense(stream))],
        expressions: vec![shape(stream, "smile_L"), shape(stream, "smile_R"), shape(stream, "close")],
        joints_follow_expressions: stream.unit() < 0.5,
        expressions_are_components: false,
        skinning: (0..count)
            .map(|_| {
                let raw: [f32; 7] = std::array::from_fn(|_| (stream.unit() - 0.3).max(0.0));
                let sum: f32 = raw.iter().sum::<f32>() + 0.1;
                let [first, others @ ..] = raw;
                let mut row = [0.0; 7];
                row[0] = (first + 0.1) / sum;
                row[1..].copy_from_slice(&others.map(|weight| weight / sum));
                row
            })
            .collect(),
        pose_correctives: vec![corrective(stream, 2), corrective(stream, 6)],
        action_units: vec![
            unit(12, Side::Left, 0, 1.0, vec![]),
            unit(12, Side::Right, 1, 1.0, vec![]),
            unit(43, Side::Both, 2, 0.8, vec![]),
            unit(45, Side::Both, 2, 0.8, vec![]),
            unit(26, Side::Both, 2, 0.0, vec![(2, Vec3::new(0.2, 0.0, 0.0))]),
        ],
        landmarks: vec![(3, Vec3::new(0.2, 0.3, 0.5))],
        eyeballs: [vec![0, 1], vec![2, 3]],
        texture: Some(TextureMap {
            points: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
            triangles: vec![[0, 1, 2]; count as usize - 2],
        }),
        colors: None,
        vertex_groups: [("lips".to_owned(), vec![4, 9])].into(),
        carried: Vec::new(),
        joints,
    }
}

pub(super) fn pose(stream: &mut Stream) -> HeadPose {
    HeadPose {
        expressions: vec![0.3, 1.0, -0.5],
        joints: (0..6).map(|_| Quat::from_scaled_axis(vector(stream) * 0.5)).collect(),
        translation: vector(stream) * 0.1,
        offset: (0..60).map(|_| vector(stream) * 0.005).collect(),
    }
}

fn double(v: Vec3) -> DVec3 {
    v.as_dvec3()
}

fn offset(offsets: &Offsets, vertex: usize) -> DVec3 {
    offsets.iter().filter(|(v, _)| *v as usize == vertex).map(|(_, offset)| double(offset)).sum()
}

/// The definition in f64 with 4x4 matrices, vertex by vertex, as in FLAME's `lbs.py`.
pub(super) fn by_definition(
    model: &HeadModel,
    state: &HeadState,
    static_offset: &[Vec3],
    dynamic_offset: &[Vec3],
) -> Vec<DVec3> {
    let count = model.template.len();
    let weighted = |shapes: &[Shape], weights: &[f64], v: usize| -> DVec3 {
        let moved = shapes.iter().zip(weights).map(|(shape, &w)| {
            let bend = if (0.0..=1.0).contains(&w) { 4.0 * w * (1.0 - w) } else { 0.0 };
            offset(&shape.offsets, v) * w + offset(&Offsets::Sparse(shape.arc.clone()), v) * bend
        });
        moved.sum()
    };
    let displacement = |v: usize, expression: bool| {
        let still = weighted(&model.identities, &state.identity, v) + double(static_offset[v]);
        if expression {
            still + weighted(&model.expressions, &state.expressions, v) + double(dynamic_offset[v])
        } else {
            still
        }
    };
    let rest: Vec<DVec3> = model
        .joints
        .iter()
        .map(|joint| {
            let moved = |(v, w): &(u32, f32)| {
                displacement(*v as usize, model.joints_follow_expressions) * f64::from(*w)
            };
            let by_identity = joint.identities.iter().zip(&state.identity).map(|(o, w)| double(*o) * *w);
            double(joint.position)
                + joint.follows.iter().map(moved).sum::<DVec3>()
                + by_identity.sum::<DVec3>()
        })
        .collect();
    let local = |joint: usize| DMat4::from_quat(state.joint(joint).normalize());
    let mut world: Vec<DMat4> = Vec::new();
    for (number, joint) in model.joints.iter().enumerate() {
        let about =
            DMat4::from_translation(rest[number]) * local(number) * DMat4::from_translation(-rest[number]);
        world.push(joint.parent.map_or(DMat4::IDENTITY, |parent| world[parent]) * about);
    }
    let posed = |v: usize| {
        let mut vertex = double(model.template[v]) + displacement(v, true);
        for corrective in &model.pose_correctives {
            let turn = local(corrective.joint);
            for (entry, shape) in corrective.entries.iter().enumerate() {
                let (row, column) = (entry / 3, entry % 3);
                let weight = turn.row(row)[column] - f64::from(u8::from(row == column));
                vertex += offset(shape, v) * weight;
            }
        }
        let skinned = (0..model.joints.len())
            .map(|joint| world[joint].transform_point3(vertex) * f64::from(model.skinning.weight(v, joint)));
        skinned.sum::<DVec3>() + state.translation
    };
    (0..count).map(posed).collect()
}

/// The same parameters in f64.
pub(super) fn state(identity: &[f32], pose: &HeadPose) -> HeadState {
    let wide = |weights: &[f32]| weights.iter().copied().map(f64::from).collect();
    HeadState {
        identity: wide(identity),
        expressions: wide(&pose.expressions),
        joints: pose.joints.iter().map(|rotation| DQuat::normalize(rotation.as_dquat())).collect(),
        translation: double(pose.translation),
    }
}

#[test]
fn vertices_agree_with_their_definition() {
    for seed in 0..20 {
        let stream = &mut Key::new(seed).stream("head model");
        let (model, pose) = (model(stream), pose(stream));
        let (identity, offset) = ([0.7, -1.3], vec![Vec3::new(1e-3, 2e-3, -1e-3); 60]);
        let shaped = model.shaped_with_offset(&identity, &offset);
        let mut fast = vec![Vec3::ONE; 7];
        model.vertices(&shaped, &pose, &mut fast);
        let slow = by_definition(&model, &state(&identity, &pose), &offset, &pose.offset);
        assert_eq!(fast.len(), slow.len());
        for (fast, slow) in fast.iter().zip(&slow) {
            // A millionth of the model's size, which is about half a metre.
            assert!(double(*fast).distance(*slow) < 5e-7, "{fast} {slow}");
        }
    }
}

#[test]
fn a_pose_may_list_fewer_joints_than_the_model_has() {
    let mut pose = HeadPose::default();
    assert_eq!(pose.joint(4), Quat::IDENTITY);
    *pose.joint_mut(2) = Quat::from_rotation_x(0.5);
    assert_eq!(pose.joints, [Quat::IDENTITY, Quat::IDENTITY, Quat::from_rotation_x(0.5)]);
}

#[test]
fn shapes_are_stored_in_the_smaller_form() {
    let few: Vec<Vec3> = (0..100).map(|v| if v % 10 == 3 { Vec3::ONE } else { Vec3::ZERO }).collect();
    let sparse = Offsets::compact(few.clone());
    assert!(matches!(&sparse, Offsets::Sparse(offsets) if offsets.len() == 10));
    let many: Vec<Vec3> = (0..100).map(|v| if v % 10 == 3 { Vec3::ZERO } else { Vec3::ONE }).collect();
    assert_eq!(Offsets::compact(many.clone()), Offsets::Dense(many));
    let mut moved = vec![Vec3::ZERO; 100];
    sparse.add_to(&mut moved, 1.0);
    assert_eq!(moved, few);
    assert!(sparse.iter().all(|(v, offset)| few[v as usize] == offset));
}

#[test]
fn the_identity_carries_the_joints_along() {
    let model = model(&mut Key::new(1).stream("head model"));
    let shaped = model.shaped(&[2.0]);
    let moved = |vertex: usize| shaped.vertices[vertex] - model.template[vertex];
    let joint = &model.joints[2];
    let expected = joint.position + 0.25 * moved(6) + 0.75 * moved(7) + 2.0 * joint.identities[0];
    assert!(shaped.joints[2].distance(expected) < 1e-7);
    assert_eq!(model.shaped(&[]).vertices, model.template);
    assert_eq!(model.shaped(&[]).joints, model.joints.iter().map(|j| j.position).collect::<Vec<_>>());
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
    let jaw = model.pose_of_action_units(&[(26, Side::Both, 0.5)]).map(|pose| pose.joint(2));
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
    fault(
        "skinning",
        &|m| m.skinning = std::iter::repeat_n([1.0], 5).collect(),
        "skinning has 5 entries, expected 60",
    );
    let weigh =
        |m: &mut HeadModel, weights: [f32; 8]| m.skinning = std::iter::repeat_n(weights, 60).collect();
    fault(
        "weights",
        &|m| weigh(m, [1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        "joint weights of 0 sum to 1.5",
    );
    fault("nan weights", &|m| weigh(m, [f32::NAN; 8]), "skinning refers to number 7, but there are only 7");
    fault(
        "nan weight",
        &|m| m.skinning = std::iter::repeat_n([f32::NAN], 60).collect(),
        "joint weights of 0 sum to NaN",
    );
    fault("vertex", &|m| m.template[2].x = f32::INFINITY, "vertex 2 is not");
    fault(
        "shape",
        &|m| m.expressions[1].offsets = Offsets::Sparse(vec![(1000, Vec3::ONE)]),
        "smile_R refers to number 1000",
    );
    fault(
        "dense shape",
        &|m| m.expressions[1].offsets = Offsets::Dense(vec![Vec3::ONE; 59]),
        "a shape has 59 entries, expected 60",
    );
    fault("arc", &|m| m.expressions[1].arc[0].1.y = f32::NAN, "smile_R 0 is not");
    fault("regressor", &|m| m.joints[2].follows[0].0 = 61, "joint regressor refers to number 61");
    fault("no joints", &|m| m.joints.clear(), "the first joint is not the root");
    fault("parent", &|m| m.joints[3].parent = Some(3), "parent of a joint refers to number 3");
    fault("orphan", &|m| m.joints[3].parent = None, "a joint without a parent refers to number 3");
    fault("roles", &|m| m.joints[4].role = Some(JointRole::Jaw), "right_eye has the role of another joint");
    fault("corrective", &|m| m.pose_correctives[0].joint = 7, "pose corrective refers to number 7");
    fault("unit's joint", &|m| m.action_units[4].joints[0].0 = 7, "action unit 26 (Both) refers to number 7");
    fault(
        "group",
        &|m| _ = m.vertex_groups.insert("nose".into(), vec![60]),
        "group nose refers to number 60",
    );
    fault("unit", &|m| m.action_units[0].expressions[0].0 = 3, "action unit 12 (Left) refers to number 3");
    fault("landmark", &|m| m.landmarks[0].0 = 58, "landmark refers to number 58");
    fault("barycentric", &|m| m.landmarks[0].1 = Vec3::ONE, "barycentric coordinates of 0 sum to 3");
    let texture = |m: &mut HeadModel| m.texture.take().unwrap();
    fault(
        "texture",
        &|m| m.texture = Some(TextureMap { triangles: Vec::new(), ..texture(m) }),
        "texture has 0 entries, expected 58",
    );
    fault(
        "point",
        &|m| m.texture = Some(TextureMap { points: vec![Vec2::X; 2], ..texture(m) }),
        "texture of a triangle refers to number 2",
    );
    fault("point", &|m| m.texture.as_mut().unwrap().points[1].y = f32::NAN, "texture coordinate 1 is not");
    fault("eyeball", &|m| m.eyeballs[1] = vec![2, 61], "eyeball refers to number 61");
}

//! A head that moves: its model in the form that `page/head.js` poses.

use glam::Vec3;
use serde_json::{Value, json};
use srflow_avatar::{Avatar, PosedHead};
use srflow_head::{ActionUnit, HeadModel, HeadPose, Joint, Offsets, Shading, ShadingTables, Side, unit_name};
use srflow_splat::Gaussians;

use crate::pack::Pack;
use crate::splats::{Seen, ViewError, add_gaussians, largest_harmonic};

/// Poses over time.
#[derive(Debug, Clone)]
pub struct ViewedMotion {
    pub poses: Vec<HeadPose>,
    pub frames_per_second: f32,
}

/// A page of an avatar: sliders for its action units, gaze and head, the motion on a timeline, and the true flow of both.
///
/// # Errors
/// When the avatar has no Gaussians.
pub fn avatar(title: &str, avatar: &Avatar, motion: &ViewedMotion) -> Result<Pack, ViewError> {
    let (model, shaped, bound) = (avatar.model(), avatar.shaped(), avatar.bound());
    let (mut head, mut world) = (PosedHead::default(), Gaussians::default());
    avatar.gaussians_into(motion.poses.first().unwrap_or(&HeadPose::default()), &mut head, &mut world);
    let joints =
        model.joints.iter().zip(&shaped.joints).map(|(joint, position)| joint_facts(joint, *position));
    let shading = avatar.shading().map(Shading::tables);
    let mut pack = Pack::new(json!({
        "page": "splats",
        "title": title,
        "surroundings": Seen::of(&world)?,
        "sh_degree": bound.local().sh_degree,
        "sh_range": largest_harmonic(bound.local()),
        "antialiased": bound.local().antialiased,
        "head": {
            "joints": joints.collect::<Vec<Value>>(),
            "joints_follow_expressions": model.joints_follow_expressions,
            "expressions_are_components": model.expressions_are_components,
            "correctives": model.pose_correctives.iter().map(|corrective| corrective.joint).collect::<Vec<_>>(),
            "units": units(model),
            "frames_per_second": motion.frames_per_second,
            "shading": shading.as_ref().map(|tables| &tables.facts),
        },
    }));
    add_gaussians(&mut pack, bound.local(), bound.triangles());
    add_model(&mut pack, model, &shaped.vertices);
    add_motion(&mut pack, model, motion);
    if let Some(tables) = shading {
        add_shading(&mut pack, &tables);
    }
    Ok(pack)
}

fn joint_facts(joint: &Joint, position: Vec3) -> Value {
    json!({
        "role": joint.role.map(|role| role.name()),
        "parent": joint.parent,
        "position": position.to_array(),
        "follows": joint.follows,
    })
}

/// The model's action units in the order of their numbers, with the names of FACS.
fn units(model: &HeadModel) -> Vec<Value> {
    let mut units: Vec<&ActionUnit> = model.action_units.iter().collect();
    units.sort_by_key(|unit| unit.number);
    let facts = |unit: &ActionUnit| {
        let (ending, side) = match unit.side {
            Side::Both => ("", ""),
            Side::Left => ("_L", ", left"),
            Side::Right => ("_R", ", right"),
        };
        let joints: Vec<Value> =
            unit.joints.iter().map(|(joint, turn)| json!([joint, turn.to_array()])).collect();
        let colon = if unit_name(unit.number).is_some() { ": " } else { "" };
        let name = format!("AU {}{colon}{}{side}", unit.number, unit_name(unit.number).unwrap_or(""));
        let key = format!("{}{ending}", unit.number);
        json!({ "key": key, "name": name, "expressions": unit.expressions, "joints": joints })
    };
    units.into_iter().map(facts).collect()
}

fn add_model(pack: &mut Pack, model: &HeadModel, vertices: &[Vec3]) {
    let vertices: Vec<[f32; 3]> = vertices.iter().map(|vertex| vertex.to_array()).collect();
    pack.add("vertices", vertices.as_flattened());
    pack.add("triangles", model.triangles.as_flattened());
    add_shapes(pack, "expression", model.expressions.iter().map(|shape| shape.offsets.iter()));
    add_shapes(pack, "arc", model.expressions.iter().map(|shape| shape.arc.iter().copied()));
    add_shapes(
        pack,
        "correction",
        model.pose_correctives.iter().flat_map(|corrective| corrective.entries.iter().map(Offsets::iter)),
    );
    let (mut starts, mut joints, mut weights) = (vec![0_u32], Vec::new(), Vec::new());
    for each in model.skinning.iter() {
        joints.extend(each.iter().map(|(joint, _)| *joint));
        weights.extend(each.iter().map(|(_, weight)| *weight));
        starts.push(joints.len() as u32);
    }
    pack.add("skin_starts", &starts);
    pack.add("skin_joints", &joints);
    pack.add("skin_weights", &weights);
}

/// Adds displacements by shape: where each shape begins, its vertices, and how far they move.
fn add_shapes(pack: &mut Pack, name: &str, shapes: impl Iterator<Item = impl Iterator<Item = (u32, Vec3)>>) {
    let (mut starts, mut vertices, mut offsets) = (vec![0_u32], Vec::new(), Vec::new());
    for shape in shapes {
        for (vertex, offset) in shape {
            vertices.push(vertex);
            offsets.extend(offset.to_array());
        }
        starts.push(vertices.len() as u32);
    }
    pack.add(format!("{name}_starts"), &starts);
    pack.add(format!("{name}_vertices"), &vertices);
    pack.add_halves(format!("{name}_offsets"), offsets);
}

fn add_shading(pack: &mut Pack, tables: &ShadingTables) {
    pack.add_halves("exposures", tables.exposures.iter().flat_map(|exposure| exposure.to_array()));
    add_shapes(pack, "shadow", tables.shadows.iter().map(|changes| changes.iter().copied()));
    // The third coordinate is what is left of 1.
    pack.add_halves("places", tables.places.iter().flat_map(|place| [place.x, place.y]));
    let gaussians: Vec<u32> = tables.creases.iter().map(|crease| crease.gaussian).collect();
    pack.add("crease_gaussians", &gaussians);
    let folds: Vec<u32> = tables.creases.iter().map(|crease| crease.fold).collect();
    pack.add("crease_folds", &folds);
    let reliefs = tables
        .creases
        .iter()
        .flat_map(|crease| [crease.slope.to_array().as_slice(), &[crease.cavity]].concat());
    pack.add_halves("crease_reliefs", reliefs);
}

fn add_motion(pack: &mut Pack, model: &HeadModel, motion: &ViewedMotion) {
    let poses = &motion.poses;
    let expressions = |pose: &HeadPose| -> Vec<f32> {
        let weight = |i: usize| pose.expressions.get(i).copied().unwrap_or(0.0);
        (0..model.expressions.len()).map(weight).collect()
    };
    let joints = |pose: &HeadPose| -> Vec<f32> {
        (0..model.joints.len()).flat_map(|joint| pose.joint(joint).to_array()).collect()
    };
    pack.add("motion_expressions", &poses.iter().flat_map(expressions).collect::<Vec<f32>>());
    pack.add("motion_joints", &poses.iter().flat_map(joints).collect::<Vec<f32>>());
    let translations: Vec<f32> = poses.iter().flat_map(|pose| pose.translation.to_array()).collect();
    pack.add("motion_translations", &translations);
    if poses.iter().any(|pose| !pose.offset.is_empty()) {
        let vertices = model.template.len();
        let offset = |pose: &HeadPose| {
            let given = pose.offset.iter().copied().chain(std::iter::repeat(Vec3::ZERO));
            given.take(vertices).flat_map(|offset| offset.to_array()).collect::<Vec<f32>>()
        };
        pack.add_halves("motion_offsets", poses.iter().flat_map(offset));
    }
}

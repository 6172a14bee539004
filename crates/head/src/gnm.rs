//! GNM Head (google/GNM, Apache-2.0): `gnm_head.npz` of version 3, with the arrays of `gnm_xnp.py` and the equations of
//! `gnm_common.py`. Units and axes are ours.
//!
//! Joints have displacements by identity instead of a regressor, and do not follow expressions; pose correctives are the entries of
//! R - I of all joints. The landmarks are a text file of the same repository, `head_sparse_68.txt`.

use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use srflow_files::{Array, FileError, FileProblem, Npz};

use crate::HeadError;
use crate::landmark_file::{on_triangle, place, read_rows};
use crate::regions::{divide_skin, mark_parts};
use crate::skeleton_names::roles;
use crate::unit_fit::fitted_units;
use crate::unit_table::{UNITS_NAME, read_units};
use crate::{HeadModel, Joint, Look, Offsets, PoseCorrective, Region, Shape, Skinning};

/// The landmarks, beside the model or where the repository has them.
pub(crate) const LANDMARKS: [&str; 2] = ["head_sparse_68.txt", "../../landmarks/head_sparse_68.txt"];

/// Files beside the model that are used if they exist.
pub(crate) const COMPANIONS: [&str; 3] = [LANDMARKS[0], LANDMARKS[1], UNITS_NAME];

/// Smaller weights of a vertex do not make it a member of a group (`_NONZERO_THRESHOLD`).
const MEMBER: f32 = 1e-4;

/// Reads a model, with the landmarks if they are found.
///
/// # Errors
/// Names the file and the array that is missing, malformed, or of another shape.
pub(crate) fn load(path: &Path, look: Look) -> Result<HeadModel, HeadError> {
    let mut file = Npz::open(path)?;
    let template = vectors(&mut file, "template_vertex_positions", None)?;
    let count = template.len();
    let triangles = triangles(&mut file, count)?;
    let joints = joints(&mut file)?;
    let (names, expression_names) = (file.texts("identity_names")?, file.texts("expression_names")?);
    let identities = basis(&mut file, "vertex_identity_basis", &names, count)?;
    let expressions = basis(&mut file, "expression_basis", &expression_names, count)?;
    let skinning = skinning(&mut file, joints.len(), count)?;
    let pose_correctives = pose_correctives(&mut file, joints.len(), count)?;
    let vertex_groups = groups(&mut file, count)?;
    let landmarks = landmarks(path, &template, &triangles)?;
    let group = |name: &str| vertex_groups.get(name).cloned().unwrap_or_default();
    let eyeballs = [group("left_eye"), group("right_eye")];
    let mut model = HeadModel {
        name: "gnm".into(),
        regions: vec![Region::Skin; triangles.len()],
        template,
        triangles,
        identities,
        expressions,
        joints,
        joints_follow_expressions: false,
        expressions_are_components: true,
        skinning,
        pose_correctives,
        action_units: Vec::new(),
        landmarks,
        eyeballs,
        texture: None,
        colors: None,
        vertex_groups,
        carried: Vec::new(),
    };
    model.validate()?;
    set_regions(&mut model);
    let units = read_units(&path.with_file_name(UNITS_NAME), &model)?;
    model.action_units = units.unwrap_or_else(|| fitted_units(&model, &[], look));
    Ok(model)
}

fn wrong_shape(file: &Npz, name: &str, expected: &str, found: &[usize]) -> FileError {
    FileProblem::field("shape", expected, format!("{found:?} of the array `{name}`")).in_file(file.path())
}

/// An array of this shape; `None` stands for any length.
fn array(file: &mut Npz, name: &str, shape: &[Option<usize>]) -> Result<Array, FileError> {
    let array = file.array(name)?;
    let fits = array.shape.len() == shape.len()
        && array
            .shape
            .iter()
            .zip(shape)
            .all(|(found, expected)| expected.is_none_or(|expected| expected == *found));
    if fits {
        return Ok(array);
    }
    let sides: Vec<String> =
        shape.iter().map(|side| side.map_or("any".to_owned(), |side| side.to_string())).collect();
    Err(wrong_shape(file, name, &format!("({})", sides.join(", ")), &array.shape))
}

fn vectors(file: &mut Npz, name: &str, count: Option<usize>) -> Result<Vec<Vec3>, FileError> {
    let array = array(file, name, &[count, Some(3)])?;
    Ok(as_vectors(&array.values).collect())
}

fn as_vectors(values: &[f32]) -> impl Iterator<Item = Vec3> + '_ {
    values.as_chunks().0.iter().map(|vector| Vec3::from_array(*vector))
}

fn triangles(file: &mut Npz, vertices: usize) -> Result<Vec<[u32; 3]>, FileError> {
    let array = array(file, "triangles", &[None, Some(3)])?;
    if let Some(wrong) = array.values.iter().find(|v| !(**v >= 0.0 && (**v as usize) < vertices)) {
        let expected = format!("vertices from 0 to {}", vertices.saturating_sub(1));
        return Err(FileProblem::field("triangles", expected, wrong.to_string()).in_file(file.path()));
    }
    Ok(array.values.as_chunks().0.iter().map(|triangle| triangle.map(|v| v as u32)).collect())
}

fn joints(file: &mut Npz) -> Result<Vec<Joint>, FileError> {
    let names = file.texts("joint_names")?;
    let positions = vectors(file, "template_joint_positions", Some(names.len()))?;
    let parents = array(file, "joint_parent_indices", &[Some(names.len())])?.values;
    let moved = array(file, "joint_identity_basis", &[None, Some(names.len()), Some(3)])?.values;
    let joint = |(number, name): (usize, &String)| Joint {
        name: name.clone(),
        role: None,
        // The root is stored as its own parent.
        parent: (number > 0).then(|| parents[number] as usize),
        position: positions[number],
        follows: Vec::new(),
        identities: as_vectors(&moved).skip(number).step_by(names.len().max(1)).collect(),
    };
    let mut joints: Vec<Joint> = names.iter().enumerate().map(joint).collect();
    for (joint, role) in joints.iter_mut().zip(roles(&names)) {
        joint.role = role;
    }
    Ok(joints)
}

/// The shapes of an array (shapes, vertices, 3).
fn basis(file: &mut Npz, name: &str, names: &[String], vertices: usize) -> Result<Vec<Shape>, FileError> {
    let values = array(file, name, &[Some(names.len()), Some(vertices), Some(3)])?.values;
    let shapes = values.chunks_exact(3 * vertices.max(1)).zip(names);
    Ok(shapes
        .map(|(shape, name)| Shape::linear(name, Offsets::compact(as_vectors(shape).collect())))
        .collect())
}

fn skinning(file: &mut Npz, joints: usize, vertices: usize) -> Result<Skinning, FileError> {
    let values = array(file, "skinning_weights", &[Some(joints), Some(vertices)])?.values;
    let mut skinning = Skinning::default();
    for vertex in 0..vertices {
        skinning.push((0..joints).map(|joint| (joint as u32, values[joint * vertices + vertex])));
    }
    Ok(skinning)
}

/// The correctives of the joints that have some.
fn pose_correctives(
    file: &mut Npz,
    joints: usize,
    vertices: usize,
) -> Result<Vec<PoseCorrective>, FileError> {
    const NAME: &str = "pose_correctives_regressor";
    if !file.has(NAME) {
        return Ok(Vec::new());
    }
    let values = array(file, NAME, &[Some(9 * joints), Some(3 * vertices)])?.values;
    let entry = |row: usize| {
        let row = &values[row * 3 * vertices..][..3 * vertices];
        Offsets::compact(as_vectors(row).collect())
    };
    let of_joint = |joint: usize| PoseCorrective {
        joint,
        entries: std::array::from_fn(|number| entry(9 * joint + number)),
    };
    let moves =
        |corrective: &PoseCorrective| corrective.entries.iter().any(|entry| entry.iter().next().is_some());
    Ok((0..joints).map(of_joint).filter(moves).collect())
}

fn groups(file: &mut Npz, vertices: usize) -> Result<BTreeMap<String, Vec<u32>>, FileError> {
    let names = file.texts("vertex_group_names")?;
    let weights = array(file, "vertex_groups", &[Some(names.len()), Some(vertices)])?.values;
    let members =
        |weights: &[f32]| (0..).zip(weights).filter(|(_, w)| **w > MEMBER).map(|(v, _)| v).collect();
    Ok(names.into_iter().zip(weights.chunks_exact(vertices.max(1)).map(members)).collect())
}

/// The 68 landmarks in dlib's order; none if there is no file.
fn landmarks(model: &Path, template: &[Vec3], triangles: &[[u32; 3]]) -> Result<Vec<(u32, Vec3)>, HeadError> {
    let paths = LANDMARKS.map(|name| model.with_file_name(name));
    let Some(path) = paths.into_iter().find(|path| path.exists()) else { return Ok(Vec::new()) };
    let mut rows = read_rows(&path, template.len())?;
    // The published rows 2 to 6 run from the chin to the ear, against dlib's order.
    let from_chin = |row: usize| place(&rows[row], template).distance(place(&rows[8], template));
    if from_chin(2) < from_chin(6) {
        rows[2..7].reverse();
    }
    Ok(rows.iter().map(|row| on_triangle(row, template, triangles)).collect())
}

/// Sets the regions: by the groups of vertices, and for skin by the landmarks.
fn set_regions(model: &mut HeadModel) {
    let parts = [
        (&["eye_exteriors"][..], Region::Clear),
        (&["left_eye", "right_eye", "eyes"], Region::Eyeball),
        (&["teeth"], Region::Teeth),
        (&["upper_teeth_and_gums", "lower_teeth_and_gums", "tongue", "mouth_sock"], Region::MouthInside),
        (&["eye_sockets"], Region::InnerLid),
        (&["upper_lip", "lower_lip"], Region::Lips),
    ];
    let parts = parts.map(|(names, region)| (model.in_groups(names), region));
    mark_parts(model, &parts);
    let has_lips = model.vertex_groups.contains_key("upper_lip");
    divide_skin(model, if has_lips { &[Region::Lips] } else { &[] });
}

#[cfg(test)]
mod tests;

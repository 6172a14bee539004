//! FLAME (Li et al., *Learning a model of facial shape and expression from 4D scans*, 2017), the 2020 and 2023 files.
//!
//! Arrays of a file, as `smplx` and VHAP (`model/flame.py`) read them: `v_template` (V, 3), `shapedirs` (V, 3, 300 shape and then
//! 100 expression components), `posedirs` (V, 3, 36: the entries of R - I of joints 1 to 4), `J_regressor` (5, V),
//! `kintree_table` (2, 5), `weights` (V, 5) and `f` (triangles). Units and axes are ours.

mod groups;
mod source;
mod teeth;

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use srflow_files::{Array, FileError, FileProblem};

use self::source::Source;
use self::teeth::Teeth;

pub(crate) use self::teeth::FLAME_VERTICES;
use crate::HeadError;
use crate::obj::{Obj, read_obj};
use crate::pickled_arrays::PickledArrays;
use crate::regions::{divide_skin, mark_parts};
use crate::unit_fit::fitted_units;
use crate::unit_table::{UNITS_NAME, read_units};
use crate::{
    ActionUnit, HeadModel, Joint, JointRole, Look, Offsets, PoseCorrective, Region, Shape, Side, Skinning,
    TextureMap,
};

/// Components of shape in `shapedirs`, before those of expression.
const SHAPES: usize = 300;

const JOINTS: usize = 5;

/// Files beside the model that are used if they exist, by their published names: vertices of the regions, landmarks (VHAP's
/// file first, whose 70 include the eyes), and texture coordinates. And the table of action units.
pub(crate) const COMPANIONS: [&str; 5] = [MASKS, LANDMARKS[0], LANDMARKS[1], TEMPLATE, UNITS_NAME];
const MASKS: &str = "FLAME_masks.pkl";
const TEMPLATE: &str = "head_template_mesh.obj";
pub(crate) const LANDMARKS: [&str; 2] = ["landmark_embedding_with_eyes.npy", "landmark_embedding.npy"];

/// Opening of the jaw at full intensity of action units 26 (jaw drop) and 27 (mouth stretch), radians.
const JAW_DROP: f32 = 0.20;
const JAW_STRETCH: f32 = 0.42;

/// Reads a model (`.npz`, or `.pkl` as published) with the landmarks, masks and texture coordinates in its folder, and with VHAP's teeth
/// if asked for.
///
/// # Errors
/// Names the file and the array that is missing, malformed, or of another shape.
pub(crate) fn load(path: &Path, with_teeth: bool, look: Look) -> Result<HeadModel, HeadError> {
    let mut source = Source::open(path)?;
    let mut template = vectors(&mut source, "v_template")?;
    let count = template.len();
    let teeth = with_teeth.then(|| Teeth::on(path, &template)).transpose()?;
    let mut triangles = triangles(&mut source, count)?;
    let joints = joints(&mut source, &template)?;
    let (identities, expressions) = shapes(&mut source, count, teeth.as_ref())?;
    let pose_correctives = pose_correctives(&mut source, count, teeth.as_ref())?;
    let mut skinning = skinning(&mut source, count)?;
    let eyeballs =
        [JointRole::LeftEye, JointRole::RightEye].map(|eye| vertices_of_joint(&skinning, eye as usize));
    let template_mesh = template_mesh(path, count)?;
    let mut texture =
        template_mesh.as_ref().map(|(path, mesh)| texture(path, mesh, &triangles)).transpose()?.flatten();
    let mut vertex_groups = masks(path, count)?;
    let symmetric = template_mesh.as_ref().map(|(_, mesh)| mesh.positions.as_slice());
    groups::add(&mut vertex_groups, &template, &triangles, &eyeballs, symmetric);
    if let Some(teeth) = &teeth {
        if let Some(texture) = &mut texture {
            teeth::add_to_texture(texture);
        }
        teeth::add_to_halves(&mut vertex_groups);
        template.extend(&teeth.vertices);
        triangles.extend(teeth::triangles());
        teeth::joints().for_each(|joint| skinning.push([(joint as u32, 1.0)]));
        vertex_groups.extend(teeth::groups());
    }
    let landmarks = landmarks(path, triangles.len())?;
    let mut model = HeadModel {
        name: "flame".into(),
        regions: vec![Region::Skin; triangles.len()],
        eyeballs,
        texture,
        colors: None,
        template,
        triangles,
        identities,
        expressions,
        joints,
        joints_follow_expressions: true,
        expressions_are_components: true,
        skinning,
        pose_correctives,
        action_units: jaw_units(),
        landmarks,
        vertex_groups,
        carried: Vec::new(),
    };
    model.validate()?;
    set_regions(&mut model);
    if let Some(units) = read_units(&path.with_file_name(UNITS_NAME), &model)? {
        model.action_units = units;
        return Ok(model);
    }
    let known: Vec<u8> = model.action_units.iter().map(|unit| unit.number).collect();
    model.action_units.extend(fitted_units(&model, &known, look));
    model.action_units.sort_by_key(|unit| unit.number);
    Ok(model)
}

fn wrong_shape(path: &Path, name: &str, expected: &str, found: &[usize]) -> FileError {
    FileProblem::field("shape", expected, format!("{found:?} of the array `{name}`")).in_file(path)
}

/// An array of shape (n, 3) as vectors.
fn vectors(source: &mut Source, name: &str) -> Result<Vec<Vec3>, HeadError> {
    let Array { shape, values } = source.array(name)?;
    match shape[..] {
        [count, 3] if count > 0 => Ok(values.as_chunks().0.iter().map(|v| Vec3::from_array(*v)).collect()),
        _ => Err(wrong_shape(source.path(), name, "(vertices, 3)", &shape).into()),
    }
}

/// Whole numbers below `count`.
fn indices(path: &Path, name: &str, values: &[f32], count: usize) -> Result<Vec<u32>, FileError> {
    let index = |value: &f32| (*value >= 0.0 && (*value as usize) < count).then_some(*value as u32);
    values.iter().map(|value| index(value).ok_or(value)).collect::<Result<_, _>>().map_err(|value| {
        let found = format!("{value} in the array `{name}`");
        FileProblem::field("index", format!("a number from 0 to {}", count.saturating_sub(1)), found)
            .in_file(path)
    })
}

fn triangles(source: &mut Source, vertices: usize) -> Result<Vec<[u32; 3]>, HeadError> {
    let Array { shape, values } = source.array("f")?;
    if !matches!(shape[..], [_, 3]) {
        return Err(wrong_shape(source.path(), "f", "(triangles, 3)", &shape).into());
    }
    Ok(indices(source.path(), "f", &values, vertices)?.as_chunks().0.to_vec())
}

/// The joints, with their positions in the template.
fn joints(source: &mut Source, template: &[Vec3]) -> Result<Vec<Joint>, HeadError> {
    let regressor = source.matrix("J_regressor")?;
    if [regressor.rows, regressor.columns] != [JOINTS, template.len()] {
        let expected = format!("({JOINTS}, {}) for the joints and vertices", template.len());
        let found = [regressor.rows, regressor.columns];
        return Err(wrong_shape(source.path(), "J_regressor", &expected, &found).into());
    }
    let Array { shape, values: parents } = source.array("kintree_table")?;
    if shape != [2, JOINTS] {
        return Err(wrong_shape(source.path(), "kintree_table", "(2, 5)", &shape).into());
    }
    let mut positions = [DVec3::ZERO; JOINTS];
    let mut follows = [const { Vec::new() }; JOINTS];
    for &(joint, vertex, weight) in &regressor.entries {
        positions[joint] += template[vertex].as_dvec3() * f64::from(weight);
        follows[joint].push((vertex as u32, weight));
    }
    let mut joints = Joint::of_roles(positions.map(|position| position.as_vec3()));
    for (number, (joint, follows)) in joints.iter_mut().zip(follows).enumerate() {
        // The root's parent is stored as -1.
        joint.parent = (number > 0).then(|| parents[number] as usize);
        joint.follows = follows;
    }
    Ok(joints)
}

/// The identity and expression bases.
fn shapes(
    source: &mut Source,
    vertices: usize,
    teeth: Option<&Teeth>,
) -> Result<(Vec<Shape>, Vec<Shape>), HeadError> {
    let Array { shape, values } = source.array("shapedirs")?;
    let components = match shape[..] {
        [count, 3, components] if count == vertices => components,
        _ => {
            let expected = format!("({vertices}, 3, components)");
            return Err(wrong_shape(source.path(), "shapedirs", &expected, &shape).into());
        }
    };
    let offsets = |component: usize| -> Vec<Vec3> { column(&values, components, component) };
    let identity = |component: usize| {
        let mut offsets = offsets(component);
        if let Some(teeth) = teeth {
            offsets.extend(teeth.follow(&offsets));
        }
        Shape::linear(format!("shape{component:03}"), Offsets::compact(offsets))
    };
    let expression = |component: usize| {
        let mut offsets = offsets(component);
        offsets.resize(vertices + teeth.map_or(0, |teeth| teeth.vertices.len()), Vec3::ZERO);
        Shape::linear(format!("expression{:03}", component - SHAPES), Offsets::compact(offsets))
    };
    let last_identity = components.min(SHAPES);
    Ok(((0..last_identity).map(identity).collect(), (last_identity..components).map(expression).collect()))
}

/// One component of an array of shape (n, 3, components).
fn column(values: &[f32], components: usize, component: usize) -> Vec<Vec3> {
    let axis = |vertex: &[f32], axis: usize| vertex[axis * components + component];
    let vertices = values.chunks_exact(3 * components);
    vertices.map(|vertex| Vec3::new(axis(vertex, 0), axis(vertex, 1), axis(vertex, 2))).collect()
}

fn pose_correctives(
    source: &mut Source,
    vertices: usize,
    teeth: Option<&Teeth>,
) -> Result<Vec<PoseCorrective>, HeadError> {
    let Array { shape, values } = source.array("posedirs")?;
    const ENTRIES: usize = 9 * (JOINTS - 1);
    if shape != [vertices, 3, ENTRIES] {
        let expected = format!("({vertices}, 3, {ENTRIES})");
        return Err(wrong_shape(source.path(), "posedirs", &expected, &shape).into());
    }
    let entry = |component: usize| {
        let mut offsets = column(&values, ENTRIES, component);
        offsets.resize(vertices + teeth.map_or(0, |teeth| teeth.vertices.len()), Vec3::ZERO);
        Offsets::compact(offsets)
    };
    let of_joint = |joint: usize| PoseCorrective {
        joint,
        entries: std::array::from_fn(|component| entry(9 * (joint - 1) + component)),
    };
    Ok((1..JOINTS).map(of_joint).collect())
}

fn skinning(source: &mut Source, vertices: usize) -> Result<Skinning, HeadError> {
    let Array { shape, values } = source.array("weights")?;
    if shape != [vertices, JOINTS] {
        let expected = format!("({vertices}, {JOINTS})");
        return Err(wrong_shape(source.path(), "weights", &expected, &shape).into());
    }
    Ok(values.as_chunks::<JOINTS>().0.iter().copied().collect())
}

/// Vertices that follow a joint alone.
fn vertices_of_joint(skinning: &Skinning, joint: usize) -> Vec<u32> {
    (0..skinning.len() as u32).filter(|v| skinning.weight(*v as usize, joint) > 0.5).collect()
}

/// The groups of vertices of the file of masks, if there is one.
fn masks(model: &Path, vertices: usize) -> Result<BTreeMap<String, Vec<u32>>, HeadError> {
    let path = model.with_file_name(MASKS);
    if !path.exists() {
        return Ok(BTreeMap::new());
    }
    let file = PickledArrays::open(&path)?;
    let group = |name: String| {
        let mut group = indices(&path, &name, &file.array(&name)?.values, vertices)?;
        group.sort_unstable();
        group.dedup();
        Ok((name, group))
    };
    file.names().into_iter().map(group).collect()
}

/// The mesh beside the model that has texture coordinates, if there is one, and its path.
fn template_mesh(model: &Path, vertices: usize) -> Result<Option<(PathBuf, Obj)>, HeadError> {
    let path = model.with_file_name(TEMPLATE);
    if !path.exists() {
        return Ok(None);
    }
    let mesh = read_obj(&path)?;
    if mesh.positions.len() != vertices {
        let (expected, found) = (vertices, mesh.positions.len());
        return Err(HeadError::Topology { path, model: "the FLAME model beside it", expected, found });
    }
    Ok(Some((path, mesh)))
}

/// The texture coordinates of each triangle in the triangle of the mesh with the same corners; `None` if the mesh has none.
fn texture(path: &Path, mesh: &Obj, triangles: &[[u32; 3]]) -> Result<Option<TextureMap>, HeadError> {
    if mesh.texture_polygons.is_empty() {
        return Ok(None);
    }
    let polygons = mesh.polygons.iter().zip(&mesh.texture_polygons);
    let by_corners: HashMap<[u32; 3], [u32; 3]> = polygons
        .filter_map(|(corners, points)| {
            Some((corners.as_slice().try_into().ok()?, points.as_slice().try_into().ok()?))
        })
        .collect();
    let points_of = |&[a, b, c]: &[u32; 3]| {
        // A triangle may begin with any of its corners.
        let first = by_corners.get(&[a, b, c]).copied();
        let second = || by_corners.get(&[b, c, a]).map(|[b, c, a]| [*a, *b, *c]);
        let third = || by_corners.get(&[c, a, b]).map(|[c, a, b]| [*a, *b, *c]);
        first.or_else(second).or_else(third).ok_or_else(|| {
            let found = format!("none with the vertices {}, {} and {}", a + 1, b + 1, c + 1);
            FileProblem::field("f", "the triangles of the FLAME model beside it", found).in_file(path)
        })
    };
    let triangles = triangles.iter().map(points_of).collect::<Result<_, _>>()?;
    Ok(Some(TextureMap { points: mesh.texture.clone(), triangles }))
}

/// The full embedding of landmarks (`full_lmk_faces_idx`, `full_lmk_bary_coords`), if there is one.
fn landmarks(model: &Path, triangles: usize) -> Result<Vec<(u32, Vec3)>, HeadError> {
    let paths = LANDMARKS.map(|name| model.with_file_name(name));
    let Some(path) = paths.into_iter().find(|path| path.exists()) else { return Ok(Vec::new()) };
    let file = PickledArrays::open(&path)?;
    let (faces, weights) = (file.array("full_lmk_faces_idx")?, file.array("full_lmk_bary_coords")?);
    if weights.values.len() != 3 * faces.values.len() {
        let expected = format!("3 for each of the {} landmarks", faces.values.len());
        return Err(wrong_shape(&path, "full_lmk_bary_coords", &expected, &weights.shape).into());
    }
    let faces = indices(&path, "full_lmk_faces_idx", &faces.values, triangles)?;
    let weights = weights.values.as_chunks().0.iter().map(|weights| Vec3::from_array(*weights));
    Ok(faces.into_iter().zip(weights).collect())
}

/// The action units that the jaw's joint makes by itself.
fn jaw_units() -> Vec<ActionUnit> {
    let unit = |number, turn| ActionUnit {
        number,
        side: Side::Both,
        expressions: Vec::new(),
        joints: vec![(JointRole::Jaw as usize, Vec3::X * turn)],
    };
    vec![unit(26, JAW_DROP), unit(27, JAW_STRETCH)]
}

/// Sets the regions: by the masks, as far as there are any, and else by the landmarks.
fn set_regions(model: &mut HeadModel) {
    let parts = [
        (model.in_groups(&["teeth"]), Region::Teeth),
        (model.eyeballs.concat(), Region::Eyeball),
        (model.in_groups(&["left_eye_socket", "right_eye_socket"]), Region::InnerLid),
        (model.in_groups(&["lip_inside"]), Region::MouthInside),
        (model.in_groups(&["lips"]), Region::Lips),
        (model.in_groups(&["neck", "boundary"]), Region::Neck),
        (model.in_groups(&["scalp"]), Region::Scalp),
    ];
    mark_parts(model, &parts);
    let masked = model.vertex_groups.contains_key("scalp");
    divide_skin(model, if masked { &[Region::Lips, Region::Neck, Region::Scalp] } else { &[] });
}

#[cfg(test)]
mod tests;

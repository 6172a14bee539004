//! ICT-FaceKit (Li et al., *Learning Formation of Physically-Based Face Attributes*, CVPR 2020; MIT licence): the
//! light model's published `FaceXModel` folder.
//!
//! The published head is in centimetres with our axes. The meaning of each vertex is fixed by the topology of 26,719 vertices,
//! and documented in the README of ICT-FaceKit.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::{DMat4, DVec4, Quat, Vec3};
use rayon::prelude::*;
use serde::Deserialize;
use srflow_files::{FileKind, parse_error_in_words, read_text};

use crate::HeadError;
use crate::arkit::{ACTION_UNITS, action_units};
use crate::obj::{Obj, read_obj, read_obj_positions};
use crate::regions::RegionMap;
use crate::unit_table::{UNITS_NAME, read_units};
use crate::{HeadModel, Joint, JointRole, Offsets, Region, Shape, Skinning, TextureMap};

const VERTICES: usize = 26_719;
const METRES_PER_UNIT: f32 = 0.01;

// Vertex ranges of the published topology.
const HEAD_AND_NECK: Range<u32> = 9409..11248;
const MOUTH_SOCKET: Range<u32> = 11248..13294;
const EYE_SOCKETS: Range<u32> = 13294..14062;
const GUMS_AND_TONGUE: Range<u32> = 14062..17039;
const TEETH: Range<u32> = 17039..21451;
const LOWER_TEETH: Range<u32> = 19247..21451;
const EYEBALLS: [Range<u32>; 2] = [21451..23021, 23021..24591];
/// The outer shell of each eyeball. The iris below it is not dressed: it is painted on the shell.
const SCLERAS: [Range<u32>; 2] = [21451..22221, 23021..23791];

/// Shorter offsets, in metres, are rounding errors of the published files.
const NEGLIGIBLE_OFFSET: f32 = 2e-6;

#[derive(Deserialize)]
struct VertexIndices {
    expressions: Vec<String>,
    idx_to_landmark_verts: Vec<u32>,
}

/// Reads the neutral head, every expression that `vertex_indices.json` names and the folder contains, and every identity. The
/// eyeballs are rotated to look along +z at rest.
///
/// # Errors
/// Names the file that is missing, malformed, or does not have the published topology.
pub(crate) fn load(dir: &Path) -> Result<HeadModel, HeadError> {
    let indices = read_indices(&dir.join("vertex_indices.json"))?;
    let neutral_path = dir.join("generic_neutral_mesh.obj");
    let neutral = read_obj(&neutral_path).map_err(of_folder)?;
    if neutral.positions.len() != VERTICES {
        return Err(HeadError::Topology {
            path: neutral_path,
            model: "ICT-FaceKit's light model",
            expected: VERTICES,
            found: neutral.positions.len(),
        });
    }
    let template: Vec<Vec3> = neutral.positions.iter().map(|&p| p * METRES_PER_UNIT).collect();
    let expressions =
        shapes(dir, present(dir, expression_names(indices.expressions).into_iter()), &template)?;
    let identity_names = (0..1000).map(|i| format!("identity{i:03}"));
    let identities = shapes(dir, present(dir, identity_names), &template)?;

    let landmark_vertices = landmark_positions(&indices.idx_to_landmark_verts, &template);
    let Dressed { triangles, regions, texture } = dressed_triangles(neutral, &template, &landmark_vertices);
    let landmarks = landmark_triangles(&indices.idx_to_landmark_verts, &triangles);
    let positions = joints(&template, &landmark_vertices);
    let skinning = skinning(&template, &positions, &landmark_vertices, &expressions);
    let mut joints = Joint::of_roles(positions);
    for (joint, follows) in joints.iter_mut().zip(joint_regressor(&indices.idx_to_landmark_verts)) {
        joint.follows = follows;
    }
    let mut model = HeadModel {
        name: "ict".into(),
        action_units: action_units(expressions.iter().map(|shape| shape.name.as_str())),
        template,
        triangles,
        regions,
        identities,
        expressions,
        joints,
        joints_follow_expressions: false,
        expressions_are_components: false,
        skinning,
        pose_correctives: Vec::new(),
        landmarks,
        eyeballs: EYEBALLS.map(Iterator::collect),
        texture,
        colors: None,
        vertex_groups: BTreeMap::new(),
        carried: Vec::new(),
    };
    face_eyeballs_forward(&mut model);
    if let Some(units) = read_units(&dir.join(UNITS_NAME), &model)? {
        model.action_units = units;
    }
    Ok(model)
}

fn read_indices(path: &Path) -> Result<VertexIndices, HeadError> {
    let text = read_text(path, FileKind::Json).map_err(HeadError::IctFolder)?;
    let malformed = |problem: String, line| HeadError::Malformed { path: path.to_path_buf(), line, problem };
    let indices: VertexIndices =
        serde_json::from_str(&text).map_err(|error| malformed(parse_error_in_words(&error), error.line()))?;
    let landmarks = &indices.idx_to_landmark_verts;
    if landmarks.len() != 68 || landmarks.iter().any(|&v| v as usize >= VERTICES) {
        let problem = format!("expected 68 landmark vertices below {VERTICES}, found {}", landmarks.len());
        return Err(malformed(problem, 1));
    }
    Ok(indices)
}

/// The listed expressions, and those that only the action units use: the published folder has a `cheekRaiser` that its own
/// list lacks.
fn expression_names(mut names: Vec<String>) -> Vec<String> {
    for stem in ACTION_UNITS.iter().flat_map(|(_, parts)| parts.iter().map(|(stem, _)| stem)) {
        for suffix in ["", "_L", "_R"] {
            let name = format!("{stem}{suffix}");
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }
    names
}

/// A file that cannot be read, in a folder that may not be ICT-FaceKit's.
fn of_folder(error: HeadError) -> HeadError {
    match error {
        HeadError::Read(error) => HeadError::IctFolder(error),
        other => other,
    }
}

/// The existing files of these shapes. A name is the stem of a file in the folder, never a path.
fn present(dir: &Path, names: impl Iterator<Item = String>) -> Vec<(String, PathBuf)> {
    let plain = |name: &str| name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
    names
        .filter(|name| plain(name))
        .map(|name| (dir.join(format!("{name}.obj")), name))
        .filter(|(path, _)| path.is_file())
        .map(|(path, name)| (name, path))
        .collect()
}

fn shapes(dir: &Path, files: Vec<(String, PathBuf)>, template: &[Vec3]) -> Result<Vec<Shape>, HeadError> {
    files
        .into_par_iter()
        .map(|(name, path)| {
            let positions = read_obj_positions(&path).map_err(of_folder)?;
            if positions.len() != template.len() {
                return Err(HeadError::VertexCount {
                    reference: dir.join("generic_neutral_mesh.obj"),
                    expected: template.len(),
                    path,
                    found: positions.len(),
                });
            }
            let offsets = positions
                .iter()
                .zip(template)
                .enumerate()
                .map(|(v, (&moved, &rest))| (v as u32, moved * METRES_PER_UNIT - rest))
                .filter(|(_, offset)| offset.length() > NEGLIGIBLE_OFFSET)
                .collect();
            Ok(Shape::linear(name, Offsets::Sparse(offsets)))
        })
        .collect()
}

fn landmark_positions(vertices: &[u32], template: &[Vec3]) -> Vec<Vec3> {
    vertices.iter().map(|&v| template[v as usize]).collect()
}

/// Triangles with their regions and texture coordinates.
struct Dressed {
    triangles: Vec<[u32; 3]>,
    regions: Vec<Region>,
    texture: Option<TextureMap>,
}

/// Triangles of everything that is dressed. The tear film, the meshes that blend and shade the eyes, and the strips of lashes are
/// omitted: they are meant to be rendered transparent.
fn dressed_triangles(neutral: Obj, template: &[Vec3], landmarks: &[Vec3]) -> Dressed {
    let map = RegionMap::new(landmarks);
    let mut dressed = Dressed { triangles: Vec::new(), regions: Vec::new(), texture: None };
    let mut texture = Vec::new();
    for (number, polygon) in neutral.polygons.iter().enumerate() {
        for i in 2..polygon.len() {
            let triangle = [polygon[0], polygon[i - 1], polygon[i]];
            if let Some(region) = region(&map, triangle, template) {
                dressed.triangles.push(triangle);
                dressed.regions.push(region);
                let corners = neutral.texture_polygons.get(number);
                texture.extend(corners.map(|corners| [corners[0], corners[i - 1], corners[i]]));
            }
        }
    }
    if !neutral.texture_polygons.is_empty() {
        dressed.texture = Some(TextureMap { points: neutral.texture, triangles: texture });
    }
    dressed
}

/// The region of a triangle; `None` if it is not dressed.
fn region(map: &RegionMap, triangle: [u32; 3], template: &[Vec3]) -> Option<Region> {
    let in_range = |range: &Range<u32>| triangle.iter().all(|v| range.contains(v));
    if SCLERAS.iter().any(&in_range) {
        return Some(Region::Eyeball);
    }
    if in_range(&TEETH) {
        return Some(Region::Teeth);
    }
    if [GUMS_AND_TONGUE, MOUTH_SOCKET].iter().any(&in_range) {
        return Some(Region::MouthInside);
    }
    if in_range(&EYE_SOCKETS) {
        return Some(Region::InnerLid);
    }
    if !in_range(&(0..HEAD_AND_NECK.end)) {
        return None;
    }
    let [a, b, c] = triangle.map(|v| template[v as usize]);
    Some(map.skin_region((a + b + c) / 3.0))
}

/// Each landmark is a vertex: the first, second or third corner of a triangle that contains it.
fn landmark_triangles(vertices: &[u32], triangles: &[[u32; 3]]) -> Vec<(u32, Vec3)> {
    let corners = [Vec3::X, Vec3::Y, Vec3::Z];
    vertices
        .iter()
        .filter_map(|v| {
            triangles.iter().enumerate().find_map(|(t, triangle)| {
                triangle.iter().position(|corner| corner == v).map(|corner| (t as u32, corners[corner]))
            })
        })
        .collect()
}

fn joints(template: &[Vec3], landmarks: &[Vec3]) -> [Vec3; 5] {
    let ear_line = (landmarks[0] + landmarks[1] + landmarks[15] + landmarks[16]) * 0.25;
    let chin = landmarks[8];
    // The jaw rotates about the condyles, just in front of the ear canal; the head about the upper neck.
    let jaw = Vec3::new(0.0, ear_line.y, ear_line.z - 0.008);
    let neck = Vec3::new(0.0, chin.y - 0.015, ear_line.z - 0.045);
    let root = Vec3::new(0.0, chin.y - 0.10, ear_line.z - 0.06);
    [root, neck, jaw, eye_center(template, 0), eye_center(template, 1)]
}

/// Eyes follow their eyeball, jaw and neck the landmarks in front of the ears, the root the chin.
fn joint_regressor(landmarks: &[u32]) -> [Vec<(u32, f32)>; 5] {
    let mean = |vertices: Vec<u32>| {
        let weight = 1.0 / vertices.len() as f32;
        vertices.into_iter().map(|v| (v, weight)).collect::<Vec<_>>()
    };
    let ears = || mean([0, 1, 15, 16].map(|i| landmarks[i]).to_vec());
    [
        mean(vec![landmarks[8]]),
        ears(),
        ears(),
        mean(SCLERAS[0].clone().collect()),
        mean(SCLERAS[1].clone().collect()),
    ]
}

/// Centre of the sphere through the back of the sclera, by linear least squares. The cornea in front bulges out.
fn eye_center(template: &[Vec3], eye: usize) -> Vec3 {
    let vertices = &template[SCLERAS[eye].start as usize..SCLERAS[eye].end as usize];
    let mean = vertices.iter().sum::<Vec3>() / vertices.len() as f32;
    let mut normal = DMat4::ZERO;
    let mut right = DVec4::ZERO;
    for &v in vertices.iter().filter(|v| v.z < mean.z + 0.003) {
        let p = (v - mean).as_dvec3();
        let row = DVec4::new(2.0 * p.x, 2.0 * p.y, 2.0 * p.z, 1.0);
        normal += DMat4::from_cols(row * row.x, row * row.y, row * row.z, row * row.w);
        right += row * p.length_squared();
    }
    // Published eyeballs are round; test data may be flat, where the mean is used.
    let center = (normal.determinant().abs() > 1e-20).then(|| normal.inverse() * right);
    center
        .filter(|c| c.is_finite() && c.truncate().length() < 0.01)
        .map_or(mean, |c| mean + c.truncate().as_vec3())
}

fn skinning(template: &[Vec3], joints: &[Vec3; 5], landmarks: &[Vec3], expressions: &[Shape]) -> Skinning {
    let chin = landmarks[8];
    let jaw = jaw_weights(template, joints[JointRole::Jaw as usize], chin, expressions);
    template
        .iter()
        .enumerate()
        .map(|(v, p)| {
            for (eye, joint) in [(0, JointRole::LeftEye), (1, JointRole::RightEye)] {
                if EYEBALLS[eye].contains(&(v as u32)) {
                    let mut weights = [0.0; 5];
                    weights[joint as usize] = 1.0;
                    return weights;
                }
            }
            // The nape bends higher than the throat, which keeps the chin on the head.
            let behind = (chin.z - 0.03 - p.z).max(0.0) * 0.35;
            let head = smoothstep((p.y - (chin.y - 0.085 + behind)) / 0.085);
            [1.0 - head, head * (1.0 - jaw[v]), head * jaw[v], 0.0, 0.0]
        })
        .collect()
}

/// How much each vertex moves with the jaw: its displacement in `jawOpen` relative to that of a point fixed to the mandible.
/// Without that file only the lower teeth move.
fn jaw_weights(template: &[Vec3], jaw: Vec3, chin: Vec3, expressions: &[Shape]) -> Vec<f32> {
    let mut weights = vec![0.0_f32; template.len()];
    let lever = |p: Vec3| ((p.y - jaw.y).powi(2) + (p.z - jaw.z).powi(2)).sqrt().max(0.01);
    if let Some(shape) = expressions.iter().find(|s| s.name == "jawOpen") {
        let mandible = shape
            .offsets
            .iter()
            .map(|(v, offset)| offset.length() / lever(template[v as usize]))
            .fold(0.0, f32::max);
        for (v, offset) in shape.offsets.iter() {
            let p = template[v as usize];
            let downward = offset.y < 0.0 || p.y < chin.y + 0.06;
            let turn = offset.length() / lever(p) / mandible.max(1e-6);
            weights[v as usize] = if downward { smoothstep(turn * 1.15) } else { 0.0 };
        }
    }
    for v in LOWER_TEETH {
        weights[v as usize] = 1.0;
    }
    weights
}

fn smoothstep(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Corrects the published eyes, which diverge by some degrees, like optical axes at infinity seen through the cornea: a gaze
/// of zero must be +z. The cornea is also lowered to the space that the lids leave for a forward gaze.
fn face_eyeballs_forward(model: &mut HeadModel) {
    for eye in 0..2 {
        let center = model.joints[JointRole::LeftEye as usize + eye].position;
        let shell = SCLERAS[eye].start as usize..SCLERAS[eye].end as usize;
        let apex = model.template[shell]
            .iter()
            .map(|&p| p - center)
            .fold(Vec3::Z * 1e-6, |far, p| if p.length_squared() > far.length_squared() { p } else { far });
        let turn = Quat::from_rotation_arc(apex.normalize_or(Vec3::Z), Vec3::Z);
        for v in EYEBALLS[eye].clone() {
            let v = v as usize;
            model.template[v] = center + turn * (model.template[v] - center);
        }
    }
}

//! Avatars of LAM (aigc3d/LAM, He et al. 2025), which it makes of one photograph: a folder or zip file with `skin.glb`, FLAME's mesh
//! subdivided, on a skeleton and with 51 of ARKit's shapes, and `offset.ply`, one Gaussian for each vertex.
//!
//! A Gaussian's position is an offset from its vertex at rest, in the mesh's axes, and its colour (`f_dc`) is RGB from 0 to 1 instead of a
//! coefficient of spherical harmonics. Shapes move it as they move the vertex, then it follows the vertex's joints
//! (`lam/models/rendering/gs_renderer.py`, `animate_gs_model`). Here it turns with them too.

use std::path::{Path, PathBuf};

use glam::Vec3;
use srflow_files::{FileError, FileKind, FileProblem, open_zip, read_file, zip_entry, zip_entry_named};
use srflow_splat::gltf::Document;
use srflow_splat::{Gaussians, parse_ply};

use crate::landmark_file::on_triangle;
use crate::mesh::vertex_normals;
use crate::regions::divide_skin;
use crate::{HeadError, HeadModel, JointRole, Offsets, Region, Skinning, Splat, gltf};

/// The mesh with its shapes and its skeleton.
const SKIN: &str = "skin.glb";

/// The Gaussians.
const GAUSSIANS: &str = "offset.ply";

/// Largest file in a zip file, bytes. A `skin.glb` has 4 MB.
const MAX_ENTRY: u64 = 512 << 20;

/// Most vertices. LAM's meshes have 20,018.
const MAX_VERTICES: usize = 1 << 22;

/// Length of the two edges at the right angle of a triangle that carries a Gaussian, metres: small beside the Gaussians, so that it
/// is rigid where the skinning is not, and large beside what `f32` resolves.
const CARRIER: f32 = 1e-3;

/// How far the centre of an eyeball may be from the joint of the eye, metres.
const EYE_REACH: f32 = 0.04;

/// Vertices and triangles of LAM's mesh, to which [`LANDMARKS`] belong.
const LAM_MESH: (usize, usize) = (20_018, 39_904);

/// The vertices at dlib's 68 landmarks: those nearest to where MediaPipe's face mesh finds them in a frontal picture of an avatar, 1 mm on
/// average and 4 mm at the ears.
#[rustfmt::skip]
const LANDMARKS: [u32; 68] = [
    14989, 14978, 3484, 16088, 15858, 3479, 15862, 15883, 15898, 16302, 16280, 3740, 16258, 3582, 3754, 11813, 7796, // jaw line
    11735, 16499, 6370, 3153, 12294, 7561, 2134, 17, 3865, 12200, // brows
    10729, 16164, 16137, 16180, 14046, 14223, 3556, 10834, 1617, // nose
    13195, 13225, 2494, 13429, 12728, 12939, 16649, 9842, 8854, 9292, 955, 881, // eyes
    14495, 14289, 14146, 16202, 10766, 10909, 10445, 1801, 1866, 16153, 2949, 2904, 14502, 2937, 16143, 11384, 11154,
    11387, 16142, 14692, // lips
];

/// Reads an avatar.
///
/// # Errors
/// Names the file that is missing or malformed.
pub(crate) fn load(path: &Path) -> Result<HeadModel, HeadError> {
    let [(skin, skin_bytes), (ply, ply_bytes)] = files(path)?;
    let mut model = gltf::rigged(&Document::parse(&skin, skin_bytes, FileKind::Mesh)?, &skin)?;
    let gaussians = parse_ply(&ply, &ply_bytes)?;
    let count = model.template.len();
    if gaussians.len() != count || count > MAX_VERTICES {
        let expected =
            format!("one Gaussian for each of the {count} vertices of {SKIN}, at most {MAX_VERTICES}");
        return Err(FileProblem::field("vertices", expected, gaussians.len().to_string())
            .in_file(&ply)
            .into());
    }
    if gaussians.sh_degree != 0 {
        let found = format!("spherical harmonics of degree {}", gaussians.sh_degree);
        return Err(FileProblem::field("colours", "`f_dc_0` to `f_dc_2` alone", found).in_file(&ply).into());
    }
    model.validate()?;
    model.name = "lam".into();
    // The Gaussians have the colours.
    model.texture = None;
    model.colors = None;
    if (count, model.triangles.len()) == LAM_MESH {
        let place = |v: &u32| on_triangle(&([*v; 3], Vec3::X), &model.template, &model.triangles);
        model.landmarks = LANDMARKS.iter().map(place).collect();
    }
    free_eyes(&mut model);
    move_to_origin(&mut model);
    add_carriers(&mut model, &gaussians);
    model.validate()?;
    divide_skin(&mut model, &[]);
    Ok(model)
}

/// The two files of an avatar, with the names that errors give them.
fn files(path: &Path) -> Result<[(PathBuf, Vec<u8>); 2], FileError> {
    if path.is_dir() {
        let read = |name: &str, kind| {
            let file = path.join(name);
            read_file(&file, kind).map(|bytes| (file, bytes))
        };
        return Ok([read(SKIN, FileKind::Mesh)?, read(GAUSSIANS, FileKind::Splats)?]);
    }
    let in_file = |problem: FileProblem| problem.in_file(path);
    let mut archive = open_zip(read_file(path, FileKind::Mesh)?).map_err(in_file)?;
    let mut read = |name: &str| {
        // LAM packs the folder: the files are one level down.
        let entry = zip_entry_named(&archive, name).unwrap_or_else(|| name.to_owned());
        let bytes = zip_entry(&mut archive, &entry, "an avatar of LAM", MAX_ENTRY).map_err(in_file)?;
        Ok((path.join(name), bytes))
    };
    Ok([read(SKIN)?, read(GAUSSIANS)?])
}

/// Makes each eyeball, a part of the mesh of its own, follow the joint of its eye, which LAM's weights do not, and moves the joint into its
/// centre: it is on the way from the head to the eyeball either way.
fn free_eyes(model: &mut HeadModel) {
    let parts = connected_parts(model.template.len(), &model.triangles);
    let largest = parts.iter().map(Vec::len).max().unwrap_or(0);
    let balls: Vec<&Vec<u32>> = parts.iter().filter(|part| part.len() < largest).collect();
    let centre = |part: &[u32]| {
        let points = part.iter().map(|v| model.template[*v as usize]);
        let (low, high) =
            points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        (low + high) * 0.5
    };
    let mut follows: Vec<Option<u32>> = vec![None; model.template.len()];
    let mut moved = Vec::new();
    for (side, role) in [JointRole::LeftEye, JointRole::RightEye].into_iter().enumerate() {
        let Some(joint) = model.joint(role) else { continue };
        let away = |part: &[u32]| centre(part).distance(model.joints[joint].position);
        let Some(ball) = balls.iter().min_by(|a, b| away(a).total_cmp(&away(b))) else { continue };
        if away(ball) > EYE_REACH {
            continue;
        }
        ball.iter().for_each(|v| follows[*v as usize] = Some(joint as u32));
        moved.push((side, joint, centre(ball), (*ball).clone()));
    }
    for (side, joint, centre, ball) in moved {
        model.joints[joint].position = centre;
        model.eyeballs[side] = ball;
    }
    let mut skinning = Skinning::default();
    for (vertex, joint) in follows.iter().enumerate() {
        match joint {
            Some(joint) => skinning.push([(*joint, 1.0)]),
            None => skinning.push(model.skinning.of(vertex).iter().copied()),
        }
    }
    model.skinning = skinning;
    for (region, triangle) in model.regions.iter_mut().zip(&model.triangles) {
        if triangle.iter().all(|v| follows[*v as usize].is_some()) {
            *region = Region::Eyeball;
        }
    }
}

/// The vertices of each part of a mesh that no edge joins to the rest, in ascending order.
fn connected_parts(vertices: usize, triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    fn first(above: &mut [u32], mut vertex: u32) -> u32 {
        while above[vertex as usize] != vertex {
            above[vertex as usize] = above[above[vertex as usize] as usize];
            vertex = above[vertex as usize];
        }
        vertex
    }
    let mut above: Vec<u32> = (0..vertices as u32).collect();
    for &[a, b, c] in triangles {
        for other in [b, c] {
            let (one, other) = (first(&mut above, a), first(&mut above, other));
            above[one.max(other) as usize] = one.min(other);
        }
    }
    let mut parts: Vec<Vec<u32>> = Vec::new();
    let mut number = vec![usize::MAX; vertices];
    for vertex in 0..vertices as u32 {
        let root = first(&mut above, vertex) as usize;
        if number[root] == usize::MAX {
            number[root] = parts.len();
            parts.push(Vec::new());
        }
        parts[number[root]].push(vertex);
    }
    parts
}

/// Moves the middle between the eyes to the origin, where `f32` is finer: LAM's persons stand on the ground.
fn move_to_origin(model: &mut HeadModel) {
    let place = |role| model.joint(role).map(|joint| model.joints[joint].position);
    let eyes = place(JointRole::LeftEye).zip(place(JointRole::RightEye));
    let Some(middle) = eyes.map(|(left, right)| (left + right) * 0.5) else { return };
    model.template.iter_mut().for_each(|vertex| *vertex -= middle);
    model.joints.iter_mut().for_each(|joint| joint.position -= middle);
}

/// Adds, for each vertex, its Gaussian and a small triangle that carries it: at the Gaussian, with the normal, the joints, and the
/// displacements of the vertex.
fn add_carriers(model: &mut HeadModel, gaussians: &Gaussians) {
    let count = model.template.len();
    let normals = vertex_normals(&model.template, &model.triangles);
    let mut regions = vec![Region::Skin; count];
    for (triangle, region) in model.triangles.iter().zip(&model.regions) {
        triangle.iter().for_each(|v| regions[*v as usize] = *region);
    }
    for (vertex, normal) in normals.into_iter().enumerate() {
        let normal = normal.normalize_or(Vec3::Z);
        let position = model.template[vertex] + gaussians.positions[vertex];
        let along = normal.any_orthonormal_vector();
        let first = model.template.len() as u32;
        let corners = [Vec3::ZERO, along, normal.cross(along)];
        model.template.extend(corners.map(|corner| position + corner * CARRIER));
        for _ in corners {
            let weights: Vec<(u32, f32)> = model.skinning.of(vertex).to_vec();
            model.skinning.push(weights);
        }
        model.triangles.push([first, first + 1, first + 2]);
        model.regions.push(regions[vertex]);
        model.carried.push(Splat {
            position,
            scale: gaussians.scales[vertex],
            rotation: gaussians.rotations[vertex],
            opacity: gaussians.opacities[vertex],
            color: Vec3::from_array(gaussians.sh[vertex]),
        });
    }
    let carried = |vertex: u32| (0..3).map(move |corner| count as u32 + 3 * vertex + corner);
    for shape in &mut model.expressions {
        let mut offsets: Vec<(u32, Vec3)> = shape.offsets.iter().collect();
        let copies: Vec<(u32, Vec3)> = offsets
            .iter()
            .flat_map(|&(vertex, offset)| carried(vertex).map(move |copy| (copy, offset)))
            .collect();
        offsets.extend(copies);
        shape.offsets = Offsets::Sparse(offsets);
    }
}

#[cfg(test)]
mod tests;

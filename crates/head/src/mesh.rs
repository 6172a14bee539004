//! Meshes in files: OBJ, PLY and binary glTF.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::io::{self, Write};
use std::path::Path;

use glam::{Vec2, Vec3};
use serde_json::json;
use srflow_files::{FileError, FileProblem, write_atomically};
use srflow_splat::gltf::GltfBuilder;

use crate::TextureMap;

/// The formats of [`write_mesh`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeshFormat {
    /// Wavefront OBJ, as text.
    Obj,
    /// Binary little-endian PLY.
    Ply,
    /// Binary glTF 2.0 of one mesh.
    Glb,
}

impl MeshFormat {
    pub const ALL: [MeshFormat; 3] = [MeshFormat::Obj, MeshFormat::Ply, MeshFormat::Glb];

    pub const fn extension(self) -> &'static str {
        match self {
            MeshFormat::Obj => "obj",
            MeshFormat::Ply => "ply",
            MeshFormat::Glb => "glb",
        }
    }

    /// The format of a file's extension, in any case.
    pub fn of(path: &Path) -> Option<Self> {
        let extension = path.extension().and_then(OsStr::to_str)?;
        Self::ALL.into_iter().find(|format| format.extension().eq_ignore_ascii_case(extension))
    }
}

/// Writes a mesh in the format of the file's extension, whole or not at all: vertices in metres, triangles counter-clockwise seen
/// from outside, and texture coordinates if there are some. Coordinates keep every bit.
///
/// In PLY (`s`, `t`) and glTF (`TEXCOORD_0`) a vertex has one point of the texture. Vertices on a seam are repeated after all others, once
/// for each further point.
///
/// # Errors
/// When the extension is none of [`MeshFormat::ALL`], a triangle has a vertex or a point of the texture that does not exist, or the file
/// cannot be written.
pub fn write_mesh(
    path: &Path,
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    texture: Option<&TextureMap>,
) -> Result<(), FileError> {
    let problem = |problem: FileProblem| problem.in_file(path);
    let format = MeshFormat::of(path).ok_or_else(|| {
        let known = MeshFormat::ALL.map(|format| format!(".{}", format.extension())).join(", ");
        problem(FileProblem::field(
            "extension",
            known,
            path.extension().unwrap_or_default().to_string_lossy(),
        ))
    })?;
    check(vertices, triangles, texture).map_err(problem)?;
    if format == MeshFormat::Glb {
        let mut builder = GltfBuilder::new();
        add_checked(&mut builder, vertices, triangles, texture, None);
        return builder.write(path);
    }
    write_atomically(path, |writer| match (format, texture) {
        (MeshFormat::Ply, None) => write_ply(writer, vertices, triangles, None),
        (MeshFormat::Ply, Some(texture)) => {
            let Unfolded { vertices, triangles, texture, .. } = Unfolded::new(vertices, triangles, texture);
            write_ply(writer, &vertices, &triangles, Some(&texture))
        }
        (_, texture) => write_obj(writer, vertices, triangles, texture),
    })
}

/// Adds a node `head` with a mesh to a glTF scene; see [`write_mesh`]. With a motion the mesh moves: each further timestep is a morph target,
/// whose weight is 1 at its time and falls linearly to 0 at those of its neighbours.
///
/// # Errors
/// When a triangle has a vertex or a point of the texture that does not exist, or a timestep of the motion another number of vertices.
pub fn add_mesh(
    builder: &mut GltfBuilder,
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    texture: Option<&TextureMap>,
    motion: Option<&MeshMotion>,
) -> Result<(), FileProblem> {
    check(vertices, triangles, texture)?;
    if let Some(odd) = motion.and_then(|motion| motion.further.iter().find(|v| v.len() != vertices.len())) {
        let expected = format!("{} vertices at every timestep", vertices.len());
        return Err(FileProblem::field("motion", expected, odd.len().to_string()));
    }
    add_checked(builder, vertices, triangles, texture, motion);
    Ok(())
}

/// Where the vertices of a mesh go.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeshMotion {
    /// Vertices at the timesteps after the first, metres.
    pub further: Vec<Vec<Vec3>>,
    /// Timesteps per second.
    pub rate: f32,
}

fn check(vertices: &[Vec3], triangles: &[[u32; 3]], texture: Option<&TextureMap>) -> Result<(), FileProblem> {
    let within = |what: &'static str, triangles: &[[u32; 3]], count: usize| {
        let beyond = triangles.iter().flatten().find(|index| **index as usize >= count);
        beyond.map_or(Ok(()), |beyond| {
            Err(FileProblem::field("triangle", format!("{what} below {count}"), beyond.to_string()))
        })
    };
    within("vertices", triangles, vertices.len())?;
    let Some(texture) = texture else { return Ok(()) };
    within("points of the texture", &texture.triangles, texture.points.len())?;
    if texture.triangles.len() != triangles.len() {
        let expected = format!("{} triangles, as the mesh has", triangles.len());
        return Err(FileProblem::field("texture", expected, texture.triangles.len().to_string()));
    }
    Ok(())
}

/// A mesh with one point of the texture for each vertex.
struct Unfolded {
    vertices: Vec<Vec3>,
    /// The vertex that each one is or repeats.
    source: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    texture: Vec<Vec2>,
}

impl Unfolded {
    /// A vertex keeps its number with the first of its points, and is repeated for the others. Vertices of no triangle get (0, 0).
    fn new(vertices: &[Vec3], triangles: &[[u32; 3]], texture: &TextureMap) -> Self {
        let mut point_of: Vec<Option<u32>> = vec![None; vertices.len()];
        let mut repeated: HashMap<(u32, u32), u32> = HashMap::new();
        let mut unfolded = Self {
            vertices: vertices.to_vec(),
            source: (0..vertices.len() as u32).collect(),
            triangles: Vec::new(),
            texture: Vec::new(),
        };
        let mut further = Vec::new();
        for (triangle, points) in triangles.iter().zip(&texture.triangles) {
            unfolded.triangles.push(std::array::from_fn(|corner| {
                let (vertex, point) = (triangle[corner], points[corner]);
                if *point_of[vertex as usize].get_or_insert(point) == point {
                    return vertex;
                }
                *repeated.entry((vertex, point)).or_insert_with(|| {
                    unfolded.vertices.push(vertices[vertex as usize]);
                    unfolded.source.push(vertex);
                    further.push(point);
                    unfolded.vertices.len() as u32 - 1
                })
            }));
        }
        let at = |point: u32| texture.points[point as usize];
        unfolded.texture = point_of.iter().map(|point| point.map_or(Vec2::ZERO, at)).collect();
        unfolded.texture.extend(further.into_iter().map(at));
        unfolded
    }
}

fn write_obj(
    writer: &mut impl Write,
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    texture: Option<&TextureMap>,
) -> io::Result<()> {
    for v in vertices {
        writeln!(writer, "v {} {} {}", v.x, v.y, v.z)?;
    }
    let Some(texture) = texture else {
        return triangles.iter().try_for_each(|triangle| {
            let [a, b, c] = triangle.map(|v| v + 1);
            writeln!(writer, "f {a} {b} {c}")
        });
    };
    for point in &texture.points {
        writeln!(writer, "vt {} {}", point.x, point.y)?;
    }
    for (triangle, points) in triangles.iter().zip(&texture.triangles) {
        let ([a, b, c], [s, t, u]) = (triangle.map(|v| v + 1), points.map(|point| point + 1));
        writeln!(writer, "f {a}/{s} {b}/{t} {c}/{u}")?;
    }
    Ok(())
}

/// `texture` has one point for each vertex.
fn write_ply(
    writer: &mut impl Write,
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    texture: Option<&[Vec2]>,
) -> io::Result<()> {
    write!(
        writer,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\n{}element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        vertices.len(),
        if texture.is_some() { "property float s\nproperty float t\n" } else { "" },
        triangles.len()
    )?;
    match texture {
        None => write_floats(writer, vertices.iter().flat_map(|v| v.to_array()))?,
        Some(texture) => {
            let both = vertices.iter().zip(texture);
            write_floats(writer, both.flat_map(|(v, point)| [v.x, v.y, v.z, point.x, point.y]))?;
        }
    }
    for triangle in triangles {
        writer.write_all(&[3])?;
        write_indices(writer, &[*triangle])?;
    }
    Ok(())
}

fn add_checked(
    builder: &mut GltfBuilder,
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    texture: Option<&TextureMap>,
    motion: Option<&MeshMotion>,
) {
    let unfolded = texture.map(|texture| Unfolded::new(vertices, triangles, texture));
    let (vertices, triangles) = match &unfolded {
        Some(unfolded) => (&unfolded.vertices[..], &unfolded.triangles[..]),
        None => (vertices, triangles),
    };
    let mut attributes = json!({"POSITION": builder.floats(vertices.iter().map(Vec3::to_array))});
    let indices = builder.indices(triangles);
    if let Some(unfolded) = &unfolded {
        // glTF counts from the top.
        let points = unfolded.texture.iter().map(|point| [point.x, 1.0 - point.y]);
        attributes["TEXCOORD_0"] = builder.floats(points).into();
    }
    let mut primitive = json!({"attributes": attributes, "indices": indices});
    let Some(MeshMotion { further, rate }) = motion.filter(|motion| !motion.further.is_empty()) else {
        builder.add_mesh("head", &json!({"primitives": [primitive]}));
        return;
    };
    let mut targets = Vec::with_capacity(further.len());
    for moved in further {
        let source = |v: usize| unfolded.as_ref().map_or(v, |unfolded| unfolded.source[v] as usize);
        let offsets = vertices.iter().enumerate().map(|(v, rest)| (moved[source(v)] - rest).to_array());
        targets.push(json!({"POSITION": builder.floats(offsets)}));
    }
    primitive["targets"] = targets.into();
    let mesh = json!({"primitives": [primitive], "weights": vec![0.0; further.len()]});
    let node = builder.add_mesh("head", &mesh);
    let times = builder.keys((0..=further.len()).map(|timestep| timestep as f32 / rate));
    let weights = (0..=further.len()).flat_map(|timestep| {
        (1..=further.len()).map(move |target| if target == timestep { 1.0 } else { 0.0 })
    });
    let weights = builder.keys(weights);
    builder.add_animation(json!({
        "name": "motion",
        "samplers": [{"input": times, "output": weights, "interpolation": "LINEAR"}],
        "channels": [{"sampler": 0, "target": {"node": node, "path": "weights"}}],
    }));
}

fn write_floats(writer: &mut impl Write, mut values: impl Iterator<Item = f32>) -> io::Result<()> {
    values.try_for_each(|value| writer.write_all(&value.to_le_bytes()))
}

fn write_indices(writer: &mut impl Write, triangles: &[[u32; 3]]) -> io::Result<()> {
    triangles.iter().flatten().try_for_each(|index| writer.write_all(&index.to_le_bytes()))
}

/// A normal of each vertex: the sum of those of its triangles, each as long as twice the triangle's area.
pub fn vertex_normals(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; vertices.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
        let normal = (b - a).cross(c - a);
        triangle.iter().for_each(|vertex| normals[*vertex as usize] += normal);
    }
    normals
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obj::read_obj;

    const VERTICES: [Vec3; 3] =
        [Vec3::new(0.1, -0.2, 1e-8), Vec3::new(1.0 / 3.0, 0.0, 0.0), Vec3::new(0.0, 2.5, -7e-3)];
    const TRIANGLES: [[u32; 3]; 1] = [[2, 0, 1]];

    fn written(name: &str) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        write_mesh(&path, &VERTICES, &TRIANGLES, None).unwrap();
        std::fs::read(path).unwrap()
    }

    fn raw() -> (Vec<u8>, Vec<u8>) {
        let floats = VERTICES.iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect();
        (floats, TRIANGLES.as_flattened().iter().flat_map(|index| index.to_le_bytes()).collect())
    }

    #[test]
    fn obj_keeps_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.OBJ");
        write_mesh(&path, &VERTICES, &TRIANGLES, None).unwrap();
        let read = read_obj(&path).unwrap();
        assert_eq!((read.positions, read.polygons), (VERTICES.to_vec(), vec![vec![2, 0, 1]]));
    }

    #[test]
    fn ply_and_glb_have_their_formats() {
        let (floats, indices) = raw();
        let ply = written("a.ply");
        let header = ply.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let text = std::str::from_utf8(&ply[..header]).unwrap();
        assert!(text.contains("element vertex 3\n") && text.contains("element face 1\n"), "{text}");
        assert_eq!(ply[header..], [floats.clone(), vec![3], indices.clone()].concat());

        let glb = written("a.glb");
        let number = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&glb[..4], number(4), number(8)), (b"glTF".as_slice(), 2, glb.len()));
        let json = number(12);
        assert!(&glb[16..20] == b"JSON" && json % 4 == 0);
        let value: serde_json::Value = serde_json::from_slice(&glb[20..20 + json]).unwrap();
        assert_eq!(value["accessors"][0]["max"][1], 2.5);
        assert_eq!(value["buffers"][0]["byteLength"], 48);
        assert_eq!((number(20 + json), &glb[24 + json..28 + json]), (48, b"BIN\0".as_slice()));
        assert_eq!(glb[28 + json..], [floats, indices].concat());
    }

    /// Two triangles whose common edge is a seam at one end: vertex 1 has two points.
    fn seam() -> (Vec<Vec3>, Vec<[u32; 3]>, TextureMap) {
        let points = vec![Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::new(0.25, 0.75)];
        let vertices = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];
        (vertices, vec![[0, 1, 2], [2, 1, 3]], TextureMap { points, triangles: vec![[0, 1, 2], [2, 3, 1]] })
    }

    #[test]
    fn textures_are_read_again_from_obj() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.obj");
        let (vertices, triangles, texture) = seam();
        write_mesh(&path, &vertices, &triangles, Some(&texture)).unwrap();
        let read = read_obj(&path).unwrap();
        assert_eq!((read.positions, read.texture), (vertices, texture.points));
        assert_eq!(read.polygons, [[0, 1, 2], [2, 1, 3]]);
        assert_eq!(
            read.texture_polygons,
            texture.triangles.iter().map(|triangle| triangle.to_vec()).collect::<Vec<_>>()
        );
    }

    #[test]
    fn vertices_on_seams_are_repeated_in_ply_and_glb() {
        let folder = tempfile::tempdir().unwrap();
        let (vertices, triangles, texture) = seam();
        let floats = |numbers: &[f32]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
        let written = |name: &str| {
            let path = folder.path().join(name);
            write_mesh(&path, &vertices, &triangles, Some(&texture)).unwrap();
            (std::fs::read(&path).unwrap(), path)
        };
        let (ply, _) = written("a.ply");
        let header = ply.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let text = std::str::from_utf8(&ply[..header]).unwrap();
        assert!(
            text.contains("element vertex 5\n") && text.contains("z\nproperty float s\nproperty float t\n")
        );
        let second = floats(&[1.0, 0.0, 0.0, 1.0, 0.0]);
        let fifth = floats(&[1.0, 0.0, 0.0, 0.25, 0.75]);
        assert_eq!(
            (&ply[header + 20..header + 40], &ply[header + 80..header + 100]),
            (&second[..], &fifth[..])
        );
        let indices: Vec<u8> = [[0, 1, 2], [2, 4, 3_u32]]
            .iter()
            .flat_map(|triangle| [vec![3], triangle.iter().flat_map(|v| v.to_le_bytes()).collect()].concat())
            .collect();
        assert_eq!(ply[header + 100..], indices);

        // The reader of glTF heads reads the same back.
        let (_, path) = written("a.glb");
        let model = crate::gltf::load(&path, crate::Look::default()).unwrap();
        assert_eq!(model.triangles, [[0, 1, 2], [2, 4, 3]]);
        let read = model.texture.unwrap();
        assert_eq!(read.points, [0, 1, 2, 1, 3].map(|point| texture.points[point]));
        assert_eq!(read.triangles, model.triangles);
    }

    #[test]
    fn a_motion_is_one_morph_target_per_further_timestep() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        let (vertices, triangles, texture) = seam();
        let moved = |shift: f32| vertices.iter().map(|v| *v + shift * Vec3::Z).collect::<Vec<_>>();
        let motion = MeshMotion { further: vec![moved(0.5), moved(0.75)], rate: 25.0 };
        let mut builder = GltfBuilder::new();
        add_mesh(&mut builder, &vertices, &triangles, Some(&texture), Some(&motion)).unwrap();
        builder.write(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let json = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let value: serde_json::Value = serde_json::from_slice(&bytes[20..20 + json]).unwrap();
        assert_eq!(value["meshes"][0]["weights"], json!([0.0, 0.0]));
        let accessor = |number: &serde_json::Value| &value["accessors"][number.as_u64().unwrap() as usize];
        let sampler = &value["animations"][0]["samplers"][0];
        assert_eq!(
            (&accessor(&sampler["input"])["count"], &accessor(&sampler["output"])["count"]),
            (&3.into(), &6.into())
        );
        assert_eq!(accessor(&sampler["input"])["max"][0].as_f64().unwrap() as f32, 0.08);
        let model = crate::gltf::load(&path, crate::Look::default()).unwrap();
        assert_eq!(model.expressions.len(), 2);
        let offsets: Vec<_> = model.expressions[1].offsets.iter().collect();
        assert_eq!(offsets.len(), 5, "the repeated vertex moves too");
        assert!(offsets.iter().all(|(_, offset)| *offset == Vec3::new(0.0, 0.0, 0.75)), "{offsets:?}");

        let wrong = MeshMotion { further: vec![Vec::new()], rate: 25.0 };
        let error = add_mesh(&mut GltfBuilder::new(), &vertices, &triangles, None, Some(&wrong)).unwrap_err();
        assert!(error.to_string().contains("4 vertices at every timestep, found 0"), "{error}");
    }

    #[test]
    fn wrong_meshes_and_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = |name: &str, triangles: &[[u32; 3]]| {
            write_mesh(&folder.path().join(name), &VERTICES, triangles, None).unwrap_err().to_string()
        };
        assert!(error("a.stl", &TRIANGLES).contains("expected .obj, .ply, .glb, found stl"));
        assert!(error("a.obj", &[[0, 1, 3]]).contains("vertices below 3, found 3"));
        for (texture, expected) in [
            (
                TextureMap { points: vec![Vec2::X], triangles: vec![[0, 0, 1]] },
                "points of the texture below 1, found 1",
            ),
            (TextureMap::default(), "1 triangles, as the mesh has"),
        ] {
            let path = folder.path().join("a.ply");
            let error = write_mesh(&path, &VERTICES, &TRIANGLES, Some(&texture)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
    }
}

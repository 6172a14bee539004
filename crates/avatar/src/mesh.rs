//! Meshes in files: OBJ, PLY and binary glTF.

use std::ffi::OsStr;
use std::io::{self, Write};
use std::path::Path;

use glam::Vec3;
use srflow_field::{FileError, FileProblem, write_atomically};

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
/// from outside. Coordinates keep every bit.
///
/// # Errors
/// When the extension is none of [`MeshFormat::ALL`], a triangle has a vertex that does not exist, or the file cannot be written.
pub fn write_mesh(path: &Path, vertices: &[Vec3], triangles: &[[u32; 3]]) -> Result<(), FileError> {
    let problem = |problem: FileProblem| problem.in_file(path);
    let format = MeshFormat::of(path).ok_or_else(|| {
        let known = MeshFormat::ALL.map(|format| format!(".{}", format.extension())).join(", ");
        problem(FileProblem::field(
            "extension",
            known,
            path.extension().unwrap_or_default().to_string_lossy(),
        ))
    })?;
    if let Some(beyond) = triangles.iter().flatten().find(|v| **v as usize >= vertices.len()) {
        let expected = format!("vertices below {}", vertices.len());
        return Err(problem(FileProblem::field("triangle", expected, beyond.to_string())));
    }
    write_atomically(path, |writer| match format {
        MeshFormat::Obj => write_obj(writer, vertices, triangles),
        MeshFormat::Ply => write_ply(writer, vertices, triangles),
        MeshFormat::Glb => write_glb(writer, vertices, triangles),
    })
}

fn write_obj(writer: &mut impl Write, vertices: &[Vec3], triangles: &[[u32; 3]]) -> io::Result<()> {
    for v in vertices {
        writeln!(writer, "v {} {} {}", v.x, v.y, v.z)?;
    }
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| v + 1);
        writeln!(writer, "f {a} {b} {c}")?;
    }
    Ok(())
}

fn write_ply(writer: &mut impl Write, vertices: &[Vec3], triangles: &[[u32; 3]]) -> io::Result<()> {
    write!(
        writer,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nelement face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        vertices.len(),
        triangles.len()
    )?;
    write_floats(writer, vertices)?;
    for triangle in triangles {
        writer.write_all(&[3])?;
        write_indices(writer, &[*triangle])?;
    }
    Ok(())
}

/// The glTF 2.0 specification, section 4: a header, a chunk of JSON padded with spaces, and one of binary data.
fn write_glb(writer: &mut impl Write, vertices: &[Vec3], triangles: &[[u32; 3]]) -> io::Result<()> {
    let (points, indices) = (12 * vertices.len(), 12 * triangles.len());
    let low = vertices.iter().copied().fold(Vec3::INFINITY, Vec3::min).to_array();
    let high = vertices.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max).to_array();
    const FLOAT: u32 = 5126;
    const UNSIGNED_INT: u32 = 5125;
    const ARRAY_BUFFER: u32 = 34962;
    const ELEMENT_ARRAY_BUFFER: u32 = 34963;
    let json = serde_json::json!({
        "asset": {"version": "2.0", "generator": concat!("srflow ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "head"}],
        "meshes": [{"name": "head", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": vertices.len(), "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": UNSIGNED_INT, "count": 3 * triangles.len(), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points, "target": ARRAY_BUFFER},
            {"buffer": 0, "byteOffset": points, "byteLength": indices, "target": ELEMENT_ARRAY_BUFFER},
        ],
        "buffers": [{"byteLength": points + indices}],
    });
    let mut json = json.to_string();
    while !json.len().is_multiple_of(4) {
        json.push(' ');
    }
    let whole = 12 + 8 + json.len() + 8 + points + indices;
    let size =
        |bytes: usize| u32::try_from(bytes).map_err(|_| io::Error::other("a .glb file holds at most 4 GiB"));
    writer.write_all(b"glTF")?;
    for number in [2, size(whole)?, size(json.len())?] {
        writer.write_all(&number.to_le_bytes())?;
    }
    writer.write_all(b"JSON")?;
    writer.write_all(json.as_bytes())?;
    writer.write_all(&size(points + indices)?.to_le_bytes())?;
    writer.write_all(b"BIN\0")?;
    write_floats(writer, vertices)?;
    write_indices(writer, triangles)
}

fn write_floats(writer: &mut impl Write, vertices: &[Vec3]) -> io::Result<()> {
    let mut values = vertices.iter().flat_map(|v| v.to_array());
    values.try_for_each(|value| writer.write_all(&value.to_le_bytes()))
}

fn write_indices(writer: &mut impl Write, triangles: &[[u32; 3]]) -> io::Result<()> {
    triangles.iter().flatten().try_for_each(|index| writer.write_all(&index.to_le_bytes()))
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
        write_mesh(&path, &VERTICES, &TRIANGLES).unwrap();
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
        write_mesh(&path, &VERTICES, &TRIANGLES).unwrap();
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

    #[test]
    fn wrong_meshes_and_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = |name: &str, triangles: &[[u32; 3]]| {
            write_mesh(&folder.path().join(name), &VERTICES, triangles).unwrap_err().to_string()
        };
        assert!(error("a.stl", &TRIANGLES).contains("expected .obj, .ply, .glb, found stl"));
        assert!(error("a.obj", &[[0, 1, 3]]).contains("vertices below 3, found 3"));
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
    }
}

use std::path::Path;

use glam::Vec3;
use srflow_field::{FileKind, excerpt, read_file};

use crate::avatar::AvatarError;

/// The parts of a Wavefront OBJ file that are read: positions and polygons, vertex indices from 0.
#[derive(Debug, Default)]
pub(crate) struct Obj {
    pub positions: Vec<Vec3>,
    /// Vertex indices of each polygon, at least three, all below `positions.len()`.
    pub polygons: Vec<Vec<u32>>,
}

/// Larger coordinates are not a head in any unit, and would overflow later sums.
const LARGEST_COORDINATE: f32 = 1e6;

/// Reads positions and polygons; texture coordinates, normals, groups and materials are ignored.
pub(crate) fn read_obj(path: &Path) -> Result<Obj, AvatarError> {
    let bytes = read(path)?;
    let mut obj = Obj { positions: positions_in(path, &bytes)?, polygons: Vec::new() };
    for (number, line) in lines(&bytes) {
        if let Some(rest) = line.strip_prefix(b"f ") {
            obj.polygons.push(polygon(path, number, rest, obj.positions.len())?);
        }
    }
    Ok(obj)
}

/// Reads only the positions.
pub(crate) fn read_obj_positions(path: &Path) -> Result<Vec<Vec3>, AvatarError> {
    positions_in(path, &read(path)?)
}

fn read(path: &Path) -> Result<Vec<u8>, AvatarError> {
    read_file(path, FileKind::Mesh).map_err(AvatarError::IctFolder)
}

fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    bytes.split(|&b| b == b'\n').enumerate().map(|(i, line)| (i + 1, line.trim_ascii()))
}

fn positions_in(path: &Path, bytes: &[u8]) -> Result<Vec<Vec3>, AvatarError> {
    let mut positions = Vec::new();
    for (number, line) in lines(bytes) {
        if let Some(rest) = line.strip_prefix(b"v ") {
            positions.push(position(path, number, rest)?);
        }
    }
    Ok(positions)
}

fn position(path: &Path, line: usize, text: &[u8]) -> Result<Vec3, AvatarError> {
    let mut xyz = [0.0_f32; 3];
    let mut words = words(text);
    for value in &mut xyz {
        let word = words.next().unwrap_or("");
        *value = word.parse().ok().filter(|v: &f32| v.abs() <= LARGEST_COORDINATE).ok_or_else(|| {
            malformed(path, line, format!("expected three finite coordinates, found `{}`", excerpt(word)))
        })?;
    }
    Ok(Vec3::from_array(xyz))
}

fn polygon(path: &Path, line: usize, text: &[u8], vertices: usize) -> Result<Vec<u32>, AvatarError> {
    let mut polygon = Vec::with_capacity(4);
    for word in words(text) {
        let number = word.split('/').next().unwrap_or("");
        // OBJ counts from 1, and negative numbers count from the end.
        let index = match number.parse::<i64>() {
            Ok(n) if n > 0 => n - 1,
            Ok(n) if n < 0 => n.saturating_add(vertices as i64),
            _ => {
                return Err(malformed(
                    path,
                    line,
                    format!("expected a vertex number, found `{}`", excerpt(word)),
                ));
            }
        };
        if index < 0 || index >= vertices as i64 {
            return Err(malformed(path, line, format!("vertex {number} of {vertices} does not exist")));
        }
        polygon.push(index as u32);
    }
    if polygon.len() < 3 {
        let found = polygon.len();
        return Err(malformed(path, line, format!("a polygon needs at least 3 vertices, found {found}")));
    }
    Ok(polygon)
}

fn words(text: &[u8]) -> impl Iterator<Item = &str> {
    std::str::from_utf8(text).unwrap_or("").split_ascii_whitespace()
}

fn malformed(path: &Path, line: usize, problem: String) -> AvatarError {
    AvatarError::Malformed { path: path.to_path_buf(), line, problem }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<Obj, AvatarError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read_obj(file.path())
    }

    #[test]
    fn reads_positions_and_polygons_of_every_notation() {
        let obj = read_text(
            "# c\nmtllib x\nv 1 2 3\r\nv 0 0 1e-3 1.0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\nf 1//2 -1 2\n",
        )
        .unwrap();
        assert_eq!(obj.positions, [Vec3::new(1.0, 2.0, 3.0), Vec3::new(0.0, 0.0, 1e-3), Vec3::Y]);
        assert_eq!(obj.polygons, [[0, 1, 2], [0, 2, 1]]);
    }

    #[test]
    fn errors_name_the_line() {
        let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
        for (text, expected) in [
            ("v 0 0\n".to_string(), ":1: "),
            ("v 0 nan 0\n".to_string(), "`nan`"),
            ("v 0 inf 0\n".to_string(), "`inf`"),
            ("v 0 1e30 0\n".to_string(), "`1e30`"),
            (format!("{triangle}f 1 2 4\n"), "vertex 4 of 3"),
            (format!("{triangle}f 1 2 -4\n"), "vertex -4 of 3"),
            (format!("{triangle}f 0 1 2\n"), "`0`"),
            (format!("{triangle}f 1 2 99999999999999999999\n"), "vertex number"),
            (format!("{triangle}f 1 2 -9223372036854775808\n"), "of 3"),
            (format!("{triangle}f 1 2\n"), "found 2"),
            (format!("{triangle}f a b c\n"), "`a`"),
        ] {
            let message = read_text(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}

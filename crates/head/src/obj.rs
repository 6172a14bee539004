use std::path::Path;

use glam::{Vec2, Vec3};
use srflow_core::excerpt;
use srflow_files::{FileKind, read_file};

use crate::HeadError;

/// The parts of a Wavefront OBJ file that are read, indices from 0.
#[derive(Debug, Default)]
pub(crate) struct Obj {
    pub positions: Vec<Vec3>,
    /// sRGB colour of each vertex, behind its position as many scanners write it; empty unless every vertex has one.
    pub colors: Vec<Vec3>,
    /// Vertex indices of each polygon, at least three, all below `positions.len()`.
    pub polygons: Vec<Vec<u32>>,
    /// Texture coordinates.
    pub texture: Vec<Vec2>,
    /// Indices of the texture coordinates at the corners of each polygon, all below `texture.len()`; empty unless every polygon has
    /// them.
    pub texture_polygons: Vec<Vec<u32>>,
    /// Names of the materials, and the number of that of each polygon; the first is that of polygons without one, whose name is empty.
    pub materials: Vec<String>,
    pub material_of_polygons: Vec<u32>,
    /// Files that describe the materials.
    pub libraries: Vec<String>,
}

/// Larger coordinates are not a head in any unit, and would overflow later sums.
const LARGEST_COORDINATE: f32 = 1e6;

/// Reads a file, without normals.
pub(crate) fn read_obj(path: &Path) -> Result<Obj, HeadError> {
    let bytes = read_file(path, FileKind::Mesh)?;
    let mut obj = Obj {
        positions: positions_in(path, &bytes)?,
        colors: colors(&bytes),
        materials: vec![String::new()],
        ..Obj::default()
    };
    obj.texture = points(path, &bytes, b"vt ", "two")?.into_iter().map(Vec2::from_array).collect();
    let mut material = 0;
    for (number, line) in lines(&bytes) {
        if let Some(name) = name_after(line, b"usemtl ") {
            material = obj.materials.iter().position(|known| *known == name).unwrap_or_else(|| {
                obj.materials.push(name);
                obj.materials.len() - 1
            });
        } else if let Some(name) = name_after(line, b"mtllib ") {
            obj.libraries.push(name);
        } else if let Some(rest) = line.strip_prefix(b"f ") {
            obj.material_of_polygons.push(material as u32);
            let count = obj.positions.len();
            obj.polygons.push(polygon(path, number, "vertex", words(rest).map(|word| part(word, 0)), count)?);
            if words(rest).all(|word| !part(word, 1).is_empty()) {
                let corners = words(rest).map(|word| part(word, 1));
                obj.texture_polygons.push(polygon(path, number, "texture", corners, obj.texture.len())?);
            }
        }
    }
    if obj.texture_polygons.len() != obj.polygons.len() {
        obj.texture_polygons.clear();
    }
    Ok(obj)
}

/// A name that may have spaces.
fn name_after(line: &[u8], key: &[u8]) -> Option<String> {
    let name = line.strip_prefix(key)?.trim_ascii();
    std::str::from_utf8(name).ok().map(str::to_owned)
}

/// The colours behind the positions; none unless every position has one.
fn colors(bytes: &[u8]) -> Vec<Vec3> {
    let color = |line: &[u8]| {
        let mut numbers = words(line).map(|word| word.parse().ok().filter(|number: &f32| number.is_finite()));
        let [r, g, b] = [numbers.nth(3)??, numbers.next()??, numbers.next()??];
        Some(Vec3::new(r, g, b))
    };
    let positions = lines(bytes).filter_map(|(_, line)| line.strip_prefix(b"v "));
    let mut colors: Vec<Vec3> = positions.map(color).collect::<Option<_>>().unwrap_or_default();
    let most = if colors.iter().any(|color| color.max_element() > 1.0) { 255.0 } else { 1.0 };
    colors.iter_mut().for_each(|color| *color = (*color / most).clamp(Vec3::ZERO, Vec3::ONE));
    colors
}

/// The index number `at` of a corner, as in `12/7/3`; empty for none.
fn part(corner: &str, at: usize) -> &str {
    corner.split('/').nth(at).unwrap_or("")
}

/// Reads only the positions.
pub(crate) fn read_obj_positions(path: &Path) -> Result<Vec<Vec3>, HeadError> {
    positions_in(path, &read_file(path, FileKind::Mesh)?)
}

fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    bytes.split(|&b| b == b'\n').enumerate().map(|(i, line)| (i + 1, line.trim_ascii()))
}

fn positions_in(path: &Path, bytes: &[u8]) -> Result<Vec<Vec3>, HeadError> {
    Ok(points(path, bytes, b"v ", "three")?.into_iter().map(Vec3::from_array).collect())
}

/// The first N numbers of the lines that begin with `key`.
fn points<const N: usize>(
    path: &Path,
    bytes: &[u8],
    key: &[u8],
    in_words: &str,
) -> Result<Vec<[f32; N]>, HeadError> {
    let mut points = Vec::new();
    for (number, line) in lines(bytes) {
        let Some(rest) = line.strip_prefix(key) else { continue };
        let mut point = [0.0_f32; N];
        let mut words = words(rest);
        for value in &mut point {
            let word = words.next().unwrap_or("");
            let sane = word.parse().ok().filter(|v: &f32| v.abs() <= LARGEST_COORDINATE);
            *value = sane.ok_or_else(|| {
                let found = excerpt(word);
                malformed(path, number, format!("expected {in_words} finite coordinates, found `{found}`"))
            })?;
        }
        points.push(point);
    }
    Ok(points)
}

/// The indices in the corners of a polygon, which count `what`, of which there are `count`.
fn polygon<'a>(
    path: &Path,
    line: usize,
    what: &str,
    corners: impl Iterator<Item = &'a str>,
    count: usize,
) -> Result<Vec<u32>, HeadError> {
    let mut polygon = Vec::with_capacity(4);
    for number in corners {
        // OBJ counts from 1, and negative numbers count from the end.
        let index = match number.parse::<i64>() {
            Ok(n) if n > 0 => n - 1,
            Ok(n) if n < 0 => n.saturating_add(count as i64),
            _ => {
                let found = excerpt(number);
                return Err(malformed(path, line, format!("expected a {what} number, found `{found}`")));
            }
        };
        if index < 0 || index >= count as i64 {
            return Err(malformed(path, line, format!("{what} {number} of {count} does not exist")));
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

fn malformed(path: &Path, line: usize, problem: String) -> HeadError {
    HeadError::Malformed { path: path.to_path_buf(), line, problem }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<Obj, HeadError> {
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
        assert!(obj.texture_polygons.is_empty(), "one polygon has no texture coordinates");
    }

    #[test]
    fn reads_texture_coordinates() {
        let obj = read_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 1 0\nvt 0.25 0\nf 1/2/1 2/-2 3/1\n").unwrap();
        assert_eq!(obj.texture, [Vec2::new(0.5, 1.0), Vec2::new(0.25, 0.0)]);
        assert_eq!((obj.polygons, obj.texture_polygons), (vec![vec![0, 1, 2]], vec![vec![1, 0, 0]]));
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
            (format!("{triangle}vt 0\n"), "two finite coordinates"),
            (format!("{triangle}vt 0 0\nf 1/1 2/1 3/2\n"), "texture 2 of 1"),
        ] {
            let message = read_text(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}

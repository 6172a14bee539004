//! Landmarks as rows of three vertices and their weights: the format of GNM's `head_sparse_68.txt`.

use std::path::{Path, PathBuf};

use glam::Vec3;
use srflow_core::excerpt;
use srflow_files::{FileKind, FileProblem, read_text};

use crate::HeadError;
use crate::dress::nearest_weights;

/// Three vertices and their weights.
pub(crate) type Row = ([u32; 3], Vec3);

/// The rows of a file, at least 68, for a mesh of `vertices` vertices.
///
/// # Errors
/// Names the line that is malformed.
pub(crate) fn read_rows(path: &Path, vertices: usize) -> Result<Vec<Row>, HeadError> {
    let text = read_text(path, FileKind::Table)?;
    let mut rows = Vec::new();
    for (line, number) in text.lines().zip(1..).filter(|(line, _)| !line.trim().is_empty()) {
        let malformed = |problem| HeadError::Malformed { path: PathBuf::from(path), line: number, problem };
        let form =
            || malformed(format!("expected three vertices and their weights, found `{}`", excerpt(line)));
        let row = row(line).ok_or_else(form)?;
        if let Some(beyond) = row.0.into_iter().find(|vertex| *vertex as usize >= vertices) {
            let known = format!("the mesh has {vertices} vertices, counted from 0");
            return Err(malformed(format!("found the vertex {beyond}, but {known}")));
        }
        rows.push(row);
    }
    if rows.len() < 68 {
        let found = format!("{} rows", rows.len());
        return Err(FileProblem::field("landmarks", "68 rows", found).in_file(path).into());
    }
    Ok(rows)
}

fn row(line: &str) -> Option<Row> {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let [a, u, b, v, c, w] = words[..] else { return None };
    let mut corners = [0; 3];
    for (corner, word) in corners.iter_mut().zip([a, b, c]) {
        *corner = word.parse().ok()?;
    }
    let weights = Vec3::new(u.parse().ok()?, v.parse().ok()?, w.parse().ok()?);
    // Written with three digits.
    let sum = weights.element_sum();
    (weights.is_finite() && (sum - 1.0).abs() < 0.01).then_some((corners, weights))
}

/// Where a row is on the mesh.
pub(crate) fn place((corners, weights): &Row, template: &[Vec3]) -> Vec3 {
    let corners = corners.iter().map(|vertex| template[*vertex as usize]);
    corners.zip(weights.to_array()).map(|(corner, weight)| corner * weight).sum()
}

/// The triangle and barycentric coordinates of a row. Where its vertices are not the corners of a triangle, but of a quad that is cut
/// the other way, it is the nearest point of the surface.
pub(crate) fn on_triangle(row: &Row, template: &[Vec3], triangles: &[[u32; 3]]) -> (u32, Vec3) {
    let (corners, weights) = row;
    let weight = |vertex: u32| {
        let of = corners.iter().zip(weights.to_array()).filter(|(corner, _)| **corner == vertex);
        of.map(|(_, weight)| weight).sum::<f32>()
    };
    let holds = |triangle: &[u32; 3]| corners.iter().all(|corner| triangle.contains(corner));
    if let Some(number) = triangles.iter().position(holds) {
        return (number as u32, Vec3::from_array(triangles[number].map(weight)));
    }
    let point = place(row, template) / weights.element_sum();
    let nearest = triangles.iter().enumerate().map(|(number, triangle)| {
        let [a, b, c] = triangle.map(|vertex| template[vertex as usize]);
        let w = nearest_weights([a, b, c], point);
        (number as u32, w, (a * w.x + b * w.y + c * w.z).distance_squared(point))
    });
    nearest.min_by(|a, b| a.2.total_cmp(&b.2)).map_or((0, Vec3::X), |(number, weights, _)| (number, weights))
}

//! How far the mesh of a tracked head is from that of the true head.

use glam::{DVec3, Vec3};
use serde::Serialize;
use srflow_avatar::capture::Capture;
use srflow_data::region_map::HeadPart;
use srflow_head::{HeadModel, HeadPose, ShapedHead, TriangleFrame};

use crate::capture::TrueCapture;
use crate::parts::part_of;

/// Distances between corresponding points of two meshes, millimetres, over the surface of the true one: triangles count by their
/// areas.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PartDistance {
    pub part: HeadPart,
    pub mean_mm: f64,
    pub percentile_95_mm: f64,
    /// Mean along the normal of the true surface: what a mesh is off whose points slide along its surface.
    pub normal_mean_mm: f64,
    pub normal_percentile_95_mm: f64,
}

/// The distances of all parts that the head has, over the timesteps that both captures have.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshError {
    pub timesteps: usize,
    pub parts: Vec<PartDistance>,
}

/// Compares the mesh of `model`, with the shape of `shaped` and in `poses` (at the timesteps of `capture`), with that of the true head.
/// Both are compared in front of the same cameras: where those of `capture` are elsewhere by a translation, the head is too.
///
/// `None` when the true head has other triangles or the captures have no picture in common: then no points correspond.
pub fn mesh_error(
    truth: &TrueCapture,
    capture: &Capture,
    model: &HeadModel,
    shaped: &ShapedHead,
    poses: &[HeadPose],
) -> Option<MeshError> {
    let true_model = truth.avatar.model();
    if true_model.triangles != model.triangles {
        return None;
    }
    let offset = true_from_capture(truth, capture)?;
    let true_timesteps = truth.capture.timesteps();
    let pairs: Vec<(&HeadPose, &HeadPose)> = capture
        .timesteps()
        .iter()
        .zip(poses)
        .filter_map(|(timestep, pose)| {
            let place = true_timesteps.binary_search(timestep).ok()?;
            Some((truth.poses.get(place)?, pose))
        })
        .collect();
    let mut distances = [const { Vec::new() }; HeadPart::ALL.len()];
    let (mut true_vertices, mut vertices) = (Vec::new(), Vec::new());
    for (true_pose, pose) in &pairs {
        true_model.vertices(truth.avatar.shaped(), true_pose, &mut true_vertices);
        model.vertices(shaped, pose, &mut vertices);
        for (triangle, region) in model.triangles.iter().zip(&true_model.regions) {
            let frame = |vertices: &[Vec3]| {
                let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
                (TriangleFrame::of(a, b, c), (b - a).cross(c - a).length() / 2.0)
            };
            let ((true_frame, area), (found, _)) = (frame(&true_vertices), frame(&vertices));
            let off = found.origin + offset - true_frame.origin;
            let normal = true_frame.rotation * Vec3::Y;
            let distance = Distance { any: off.length(), normal: off.dot(normal).abs(), area };
            distances[part_of(*region) as usize].push(distance);
        }
    }
    let parts = HeadPart::ALL.iter().zip(distances);
    Some(MeshError {
        timesteps: pairs.len(),
        parts: parts.filter_map(|(&part, distances)| PartDistance::of(part, distances)).collect(),
    })
}

/// The mean offset of the true cameras from those of the same pictures, metres.
fn true_from_capture(truth: &TrueCapture, capture: &Capture) -> Option<Vec3> {
    let (mut sum, mut count) = (DVec3::ZERO, 0);
    for view in capture.views() {
        if let Some(true_view) = truth.capture.view_at(view.timestep, view.camera_index) {
            sum += true_view.camera.position() - view.camera.position();
            count += 1;
        }
    }
    (count > 0).then(|| (sum / f64::from(count)).as_vec3())
}

/// Between the centroids of corresponding triangles, metres and square metres.
#[derive(Clone, Copy)]
struct Distance {
    any: f32,
    normal: f32,
    area: f32,
}

impl PartDistance {
    fn of(part: HeadPart, mut distances: Vec<Distance>) -> Option<Self> {
        let area: f64 = distances.iter().map(|distance| f64::from(distance.area)).sum();
        if area.is_nan() || area <= 0.0 {
            return None;
        }
        let mut statistics = |of: fn(&Distance) -> f32| {
            distances.sort_unstable_by(|a, b| of(a).total_cmp(&of(b)));
            let sum: f64 = distances.iter().map(|distance| f64::from(of(distance) * distance.area)).sum();
            let mut below = 0.0;
            let at = distances.iter().find(|distance| {
                below += f64::from(distance.area);
                below >= 0.95 * area
            });
            [1000.0 * sum / area, 1000.0 * at.map_or(0.0, |distance| f64::from(of(distance)))]
        };
        let [mean_mm, percentile_95_mm] = statistics(|distance| distance.any);
        let [normal_mean_mm, normal_percentile_95_mm] = statistics(|distance| distance.normal);
        Some(Self { part, mean_mm, percentile_95_mm, normal_mean_mm, normal_percentile_95_mm })
    }
}

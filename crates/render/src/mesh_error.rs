//! How far the mesh of a tracked head is from that of the true head.

use glam::{DVec2, DVec3, Vec3};
use serde::Serialize;
use srflow_avatar::Similarity;
use srflow_avatar::capture::Capture;
use srflow_data::region_map::HeadPart;
use srflow_head::{HeadModel, HeadPose, ShapedHead, TriangleFrame};
use srflow_splat::Camera;

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
    /// The same two after the skin of each timestep was moved, turned and scaled onto the true one: what is left if place and size are
    /// unknown, as with one camera.
    pub aligned_mean_mm: f64,
    pub aligned_percentile_95_mm: f64,
    /// Mean error of the motion from one timestep to the next in the first camera's pictures, pixels, where the true surface faces it.
    pub motion_px: f64,
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
    let pairs: Vec<(u32, &HeadPose, &HeadPose)> = capture
        .timesteps()
        .into_iter()
        .zip(poses)
        .filter_map(|(timestep, pose)| {
            let place = true_timesteps.binary_search(&timestep).ok()?;
            Some((timestep, truth.poses.get(place)?, pose))
        })
        .collect();
    let first_camera = truth.capture.camera_indices().first().copied()?;
    let mut distances = [const { Vec::new() }; HeadPart::ALL.len()];
    let mut motion = Motion::default();
    let (mut true_vertices, mut vertices) = (Vec::new(), Vec::new());
    for (timestep, true_pose, pose) in &pairs {
        true_model.vertices(truth.avatar.shaped(), true_pose, &mut true_vertices);
        model.vertices(shaped, pose, &mut vertices);
        let triangles: Vec<Triangle> = model
            .triangles
            .iter()
            .zip(&true_model.regions)
            .map(|(triangle, region)| {
                let frame = |vertices: &[Vec3]| {
                    let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
                    (TriangleFrame::of(a, b, c), (b - a).cross(c - a).length() / 2.0)
                };
                let ((true_frame, area), (found, _)) = (frame(&true_vertices), frame(&vertices));
                let (truth, normal) = (true_frame.origin, true_frame.rotation * Vec3::Y);
                Triangle { part: part_of(*region), truth, normal, found: found.origin + offset, area }
            })
            .collect();
        let skin = triangles.iter().filter(|triangle| triangle.part == HeadPart::Skin);
        let pairs: Vec<_> =
            skin.map(|t| (t.found.as_dvec3(), t.truth.as_dvec3(), f64::from(t.area))).collect();
        let aligned = Similarity::between(&pairs);
        match truth.capture.view_at(*timestep, first_camera) {
            Some(view) => motion.add(&view.camera, &triangles),
            None => motion.before.clear(),
        }
        for Triangle { part, truth, normal, found, area } in triangles {
            let off = found - truth;
            let aligned = aligned.map_or(found, |aligned| aligned.apply(found.as_dvec3()).as_vec3()) - truth;
            let [normal, aligned] = [off, aligned].map(|off| off.dot(normal).abs());
            distances[part as usize].push(Distance { any: off.length(), normal, aligned, area });
        }
    }
    let parts = HeadPart::ALL.iter().zip(distances);
    Some(MeshError {
        timesteps: pairs.len(),
        parts: parts
            .filter_map(|(&part, distances)| PartDistance::of(part, distances, motion.mean(part)))
            .collect(),
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

/// A triangle of the true head and the centroid of the corresponding one; metres and square metres.
struct Triangle {
    part: HeadPart,
    truth: Vec3,
    normal: Vec3,
    found: Vec3,
    area: f32,
}

/// Between the centroids of corresponding triangles, metres and square metres.
#[derive(Clone, Copy)]
struct Distance {
    any: f32,
    normal: f32,
    aligned: f32,
    area: f32,
}

/// Errors of motion in pictures.
#[derive(Default)]
struct Motion {
    /// Of each triangle, how far the found one was from the true one in the last picture; `None` where it was not seen.
    before: Vec<Option<DVec2>>,
    /// Of each part: sums of errors, each times the area of its triangle in the head, and of areas.
    sums: [[f64; 2]; HeadPart::ALL.len()],
}

impl Motion {
    fn add(&mut self, camera: &Camera, triangles: &[Triangle]) {
        let eye = camera.position();
        let off = |t: &Triangle| {
            let facing = t.normal.as_dvec3().dot(eye - t.truth.as_dvec3()) > 0.0;
            let [truth, found] = [t.truth, t.found].map(|at| camera.project(at.as_dvec3()));
            facing.then(|| Some(found?.0 - truth?.0)).flatten()
        };
        let now: Vec<Option<DVec2>> = triangles.iter().map(off).collect();
        for ((triangle, before), now) in triangles.iter().zip(&self.before).zip(&now) {
            if let (Some(before), Some(now)) = (before, now) {
                let [sum, areas] = &mut self.sums[triangle.part as usize];
                *sum += f64::from(triangle.area) * before.distance(*now);
                *areas += f64::from(triangle.area);
            }
        }
        self.before = now;
    }

    /// NaN if it was never seen.
    fn mean(&self, part: HeadPart) -> f64 {
        let [sum, areas] = self.sums[part as usize];
        sum / areas
    }
}

impl PartDistance {
    fn of(part: HeadPart, mut distances: Vec<Distance>, motion_px: f64) -> Option<Self> {
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
        let [aligned_mean_mm, aligned_percentile_95_mm] = statistics(|distance| distance.aligned);
        Some(Self {
            part,
            mean_mm,
            percentile_95_mm,
            normal_mean_mm,
            normal_percentile_95_mm,
            aligned_mean_mm,
            aligned_percentile_95_mm,
            motion_px,
        })
    }
}

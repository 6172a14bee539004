//! The pose of a head before anything is known: from triangulated landmarks, or from one view under weak perspective.

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3, DVec4};
use srflow_core::median;
use srflow_splat::Camera;

use super::LandmarkView;
use super::robust::geman_mcclure;
use crate::Similarity;
use crate::capture::{Face, LANDMARK_COUNT};
use srflow_head::{HeadPoints, HeadState};

/// Landmarks that a pose needs.
pub(super) const LEAST: usize = 6;

/// World from head coordinates: `rotation * point + translation`.
#[derive(Debug, Clone, Copy)]
struct Rigid {
    rotation: DQuat,
    translation: DVec3,
}

/// Candidate states for the landmarks of one timestep: `state` with other rotations of the root and translations.
pub(super) fn candidates(points: &HeadPoints, views: &[&LandmarkView], state: &HeadState) -> Vec<HeadState> {
    let mut unposed = state.clone();
    *unposed.joint_mut(0) = DQuat::IDENTITY;
    unposed.translation = DVec3::ZERO;
    let head = points.positions(&unposed);

    let mut poses: Vec<Rigid> = Vec::new();
    let found: Vec<(DVec3, DVec3)> =
        (0..LANDMARK_COUNT).filter_map(|l| Some((head[l], triangulate(views, l)?))).collect();
    if found.len() >= LEAST {
        poses.extend(procrustes(&found));
    }
    let mut by_landmarks: Vec<&&LandmarkView> =
        views.iter().filter(|view| count(&view.landmarks) >= LEAST).collect();
    by_landmarks.sort_by_key(|view| std::cmp::Reverse(count(&view.landmarks)));
    poses.extend(by_landmarks.into_iter().take(2).filter_map(|view| weak_perspective(&head, view)));

    let placed = |pose: Rigid| {
        let mut placed = unposed.clone();
        *placed.joint_mut(0) = pose.rotation;
        // The root rotates about its own rest position, not about the origin.
        let about = points.positions(&placed)[0] - pose.rotation * head[0];
        placed.translation = pose.translation - about;
        placed
    };
    poses.into_iter().map(placed).collect()
}

fn count(face: &Face) -> usize {
    face.iter().flatten().count()
}

/// A line of sight in the world.
struct Ray<'a> {
    camera: &'a Camera,
    pixel: DVec2,
    origin: DVec3,
    direction: DVec3,
}

impl<'a> Ray<'a> {
    fn of(camera: &'a Camera, [x, y]: [f64; 2]) -> Self {
        let direction = DVec3::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0);
        let world_from_camera = DMat3::from_mat4(camera.camera_from_world).transpose();
        Self {
            camera,
            pixel: DVec2::new(x, y),
            origin: camera.position(),
            direction: (world_from_camera * direction).normalize(),
        }
    }

    /// Whether the point is seen at this pixel, to 1 % of the picture's side.
    fn sees(&self, point: DVec3) -> bool {
        let side = self.camera.width.max(self.camera.height) as f64;
        self.camera.project(point).is_some_and(|(pixel, _)| pixel.distance(self.pixel) < 0.01 * side)
    }
}

/// The point nearest to all rays; `None` when they are parallel.
fn nearest_point<'a>(rays: impl Iterator<Item = &'a Ray<'a>>) -> Option<DVec3> {
    let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for ray in rays {
        let d = ray.direction;
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        normal += across;
        right += across * ray.origin;
    }
    // The squared sine of the angle between two rays, roughly: about half a degree.
    (normal.determinant() > 1e-4).then(|| normal.inverse() * right)
}

/// Rays of which every pair is tried.
const MOST_PAIRED: usize = 16;

/// Where a landmark is in the world: the point that most views agree on, two at least.
fn triangulate(views: &[&LandmarkView], landmark: usize) -> Option<DVec3> {
    let rays: Vec<Ray> = views
        .iter()
        .filter_map(|view| Some(Ray::of(&view.camera, view.landmarks[landmark]?)))
        .filter(|ray| ray.direction.is_finite())
        .collect();
    let paired = &rays[..rays.len().min(MOST_PAIRED)];
    let mut best: Option<(usize, DVec3)> = None;
    for (i, a) in paired.iter().enumerate() {
        for b in &paired[..i] {
            let Some(point) = nearest_point([a, b].into_iter()) else { continue };
            let agreed = rays.iter().filter(|ray| ray.sees(point)).count();
            if agreed >= 2 && best.is_none_or(|(most, _)| agreed > most) {
                best = Some((agreed, point));
            }
        }
    }
    let (_, point) = best?;
    nearest_point(rays.iter().filter(|ray| ray.sees(point)))
}

const ROUNDS: usize = 12;

/// Weights by the loss of Geman and McClure, for residuals in units of twice their median.
fn robust_weights(residuals: &[f64], least: f64) -> Vec<f64> {
    let scale = 2.0 * median(residuals.iter().copied()).max(least);
    residuals.iter().map(|r| geman_mcclure((r / scale).powi(2), 1.0).1).collect()
}

/// The rigid transform of the first points onto the second ones (Horn 1987), reweighted against outliers.
fn procrustes(pairs: &[(DVec3, DVec3)]) -> Option<Rigid> {
    let mut weights = vec![1.0; pairs.len()];
    let mut pose = None;
    for _ in 0..ROUNDS {
        let weighted: Vec<(DVec3, DVec3, f64)> =
            pairs.iter().zip(&weights).map(|((from, to), weight)| (*from, *to, *weight)).collect();
        let Some(Similarity { rotation, translation, .. }) = Similarity::rigid(&weighted) else {
            return pose;
        };
        let residuals: Vec<f64> =
            pairs.iter().map(|(from, to)| (rotation * *from + translation).distance(*to)).collect();
        weights = robust_weights(&residuals, 1e-4);
        pose = Some(Rigid { rotation, translation });
    }
    pose
}

/// The pose from one view, if the depth of the face is small against its distance (scaled orthographic projection, the first
/// step of POSIT: DeMenthon and Davis 1995), reweighted against outliers.
fn weak_perspective(head: &[DVec3], view: &LandmarkView) -> Option<Rigid> {
    let camera = &view.camera;
    let seen: Vec<(DVec3, DVec2)> = head
        .iter()
        .zip(&view.landmarks)
        .filter_map(|(point, pixel)| {
            let [x, y] = (*pixel)?;
            Some((*point, DVec2::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy)))
        })
        .collect();
    let mean = seen.iter().map(|(point, _)| *point).sum::<DVec3>() / seen.len() as f64;
    let mut weights = vec![1.0; seen.len()];
    let mut rows = None;
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (DMat4::ZERO, [DVec4::ZERO; 2]);
        for ((point, pixel), weight) in seen.iter().zip(&weights) {
            // In decimetres, so that all columns are of one size.
            let row = ((*point - mean) * 10.0).extend(1.0);
            normal += DMat4::from_cols(row * row.x, row * row.y, row * row.z, row * row.w) * *weight;
            right[0] += row * (pixel.x * weight);
            right[1] += row * (pixel.y * weight);
        }
        // Landmarks in one plane, as of the brows alone, do not determine a pose.
        normal += DMat4::from_diagonal(DVec4::new(1e-9, 1e-9, 1e-9, 0.0));
        let inverse = normal.inverse();
        let solved = right.map(|right| inverse * right);
        if !solved.iter().all(|row| row.is_finite()) {
            break;
        }
        let residuals: Vec<f64> = seen
            .iter()
            .map(|(point, pixel)| {
                let row = ((*point - mean) * 10.0).extend(1.0);
                DVec2::new(row.dot(solved[0]), row.dot(solved[1])).distance(*pixel)
            })
            .collect();
        weights = robust_weights(&residuals, 1e-6);
        rows = Some(solved);
    }
    let [x, y] = rows?;
    let (across, down) = (x.truncate() * 10.0, y.truncate() * 10.0);
    let scale = (across.length() * down.length()).sqrt();
    let r1 = across.try_normalize()?;
    let r2 = (down - r1 * r1.dot(down)).try_normalize()?;
    if !(scale.is_finite() && scale > 0.0) {
        return None;
    }
    let camera_from_head = DMat3::from_cols(r1, r2, r1.cross(r2)).transpose();
    let centre = DVec3::new(x.w, y.w, 1.0) / scale;
    let world_from_camera = DMat3::from_mat4(camera.camera_from_world).transpose();
    let rotation = DQuat::from_mat3(&(world_from_camera * camera_from_head)).normalize();
    let centre = world_from_camera * (centre - camera.camera_from_world.w_axis.truncate());
    Some(Rigid { rotation, translation: centre - rotation * mean })
}

//! Default cameras: one that faces a set of Gaussians, and a circle around it.

use glam::{DMat3, DMat4, DVec3};
use srflow_core::Size;

use super::{Camera, NEAR};
use crate::Gaussians;

/// Share of the Gaussians within [`Surroundings::radius`]: outliers are ignored.
const INSIDE: f64 = 0.98;
/// Field of view of [`Camera::facing`] along the shorter side, in degrees.
const ANGLE: f64 = 30.0;

/// Position and extent of a set of Gaussians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surroundings {
    /// Medians of the coordinates.
    pub centre: DVec3,
    /// Radius of a ball around the centre that contains 98 % of the Gaussians up to two standard deviations, in world units.
    pub radius: f64,
}

impl Surroundings {
    /// `None` without Gaussians.
    pub fn of(gaussians: &Gaussians) -> Option<Self> {
        let positions = || gaussians.positions.iter().map(|position| position.as_dvec3());
        let centre = DVec3::new(
            quantile(positions().map(|p| p.x), 0.5)?,
            quantile(positions().map(|p| p.y), 0.5)?,
            quantile(positions().map(|p| p.z), 0.5)?,
        );
        let reach = positions().zip(&gaussians.scales);
        let reach = reach.map(|(p, scale)| p.distance(centre) + 2.0 * f64::from(scale.max_element()));
        let radius = quantile(reach, INSIDE)?;
        Some(Self { centre, radius })
    }
}

fn quantile(values: impl Iterator<Item = f64>, share: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let place = ((values.len() as f64 * share) as usize).min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(place, f64::total_cmp).1)
}

impl Camera {
    /// Shows the whole of `seen` from the front: from +z, where +y is up, as for heads of FLAME, glTF and this project.
    pub fn facing(seen: Surroundings, size: Size) -> Self {
        let half_angle = (ANGLE / 2.0).to_radians();
        let focal = size.width.min(size.height) as f64 / (2.0 * half_angle.tan());
        // No part of the ball is nearer than the near plane.
        let distance = (seen.radius / half_angle.sin()).max(seen.radius + 2.0 * NEAR);
        let world_from_camera = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        Self::centred(size, [focal; 2]).placed(world_from_camera, seen.centre + distance * DVec3::Z)
    }

    /// As [`Camera::facing`] from -z where -y is up, as for most scenes that were reconstructed from photographs.
    pub fn facing_down(seen: Surroundings, size: Size) -> Self {
        let turn = DVec3::new(1.0, -1.0, -1.0);
        let camera = Self::facing(Surroundings { centre: seen.centre * turn, ..seen }, size);
        Self { camera_from_world: camera.camera_from_world * DMat4::from_scale(turn), ..camera }
    }

    /// `count` cameras on a circle around `centre`, starting from this one, `degrees / count` apart: to the right where that is
    /// positive, with the circle's axis along the up direction of this camera's picture.
    pub fn orbit(&self, centre: DVec3, degrees: f64, count: usize) -> Vec<Self> {
        let camera_from_world = self.camera_from_world;
        let up = -camera_from_world.row(1).truncate().normalize();
        let camera = |number: usize| {
            let angle = (degrees * number as f64 / count as f64).to_radians();
            let back = DMat4::from_translation(centre)
                * DMat4::from_axis_angle(up, -angle)
                * DMat4::from_translation(-centre);
            Self { camera_from_world: camera_from_world * back, ..*self }
        };
        (0..count).map(camera).collect()
    }
}

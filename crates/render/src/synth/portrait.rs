//! How a camera sees one face, as in a laboratory.

use glam::{DVec3, EulerRot, Quat, Vec3};
use srflow_avatar::{Avatar, PosedHead};
use srflow_core::Size;
use srflow_core::random::Stream;
use srflow_head::HeadPose;
use srflow_splat::Camera;

use crate::generate::{Rig, SmoothPath, View};

/// The background of the heads: a laboratory's grey backdrop.
pub const BACKDROP: [f32; 3] = [0.55, 0.56, 0.57];

/// Width of the frame relative to the face's landmarks.
const MARGIN: f64 = 1.18;

/// Variation of the framing between recordings of one subject: degrees of azimuth, elevation and roll.
const VIEW_DEGREES: [f32; 3] = [6.0, 4.0, 2.0];

/// A camera at a distance of one metre whose square frame the face fills.
pub fn camera(avatar: &Avatar, side: usize, stream: &mut Stream) -> Camera {
    let at_rest: Vec<DVec3> = landmarks(avatar, &avatar.shaped().vertices).collect();
    let low = at_rest.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = at_rest.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let extent = (high - low).x.max((high - low).y) * MARGIN;
    // The landmarks end at the brows; the centre of the face is above theirs.
    let centre = (low + high) / 2.0 + DVec3::Y * 0.08 * extent;
    let [azimuth, elevation, roll] = VIEW_DEGREES.map(|reach| f64::from(stream.uniform(-reach, reach)));
    let shift = [0, 1].map(|_| f64::from(stream.uniform(-0.03, 0.03)) * side as f64);
    let mut camera = Rig::new(Size::new(side, side), centre).camera(View { azimuth, elevation, roll });
    camera.fx = side as f64 / extent;
    camera.fy = camera.fx;
    camera.cx += shift[0];
    camera.cy += shift[1];
    camera
}

/// Image positions of dlib's 68 landmarks on a posed head, in pixels.
pub fn landmarks_in_image(avatar: &Avatar, head: &PosedHead, camera: &Camera) -> Vec<[f64; 2]> {
    let seen = landmarks(avatar, head.vertices()).map(|point| camera.project(point));
    // The face is in front of the camera, so every landmark has an image position.
    seen.map(|seen| seen.map_or([0.0; 2], |(pixel, _)| pixel.to_array())).collect()
}

fn landmarks<'a>(avatar: &'a Avatar, vertices: &'a [Vec3]) -> impl Iterator<Item = DVec3> + 'a {
    avatar.model().landmarks_on(vertices).take(68).map(|place| place.as_dvec3())
}

/// A random motion of a head through so many points: yaw, pitch and roll of up to `degrees`, and places of up to `metres`, to either side.
pub fn drift(
    stream: &mut Stream,
    points: usize,
    degrees: [f32; 3],
    metres: f32,
    strength: f32,
) -> SmoothPath<6> {
    let reach = |axis: usize| if axis < 3 { degrees[axis] } else { metres };
    let point = |_| std::array::from_fn(|axis| f64::from(strength * reach(axis) * stream.uniform(-1.0, 1.0)));
    SmoothPath::through((0..points).map(point).collect())
}

/// Turns and moves a head by a place of its [`drift`].
pub fn move_head(pose: &mut HeadPose, drift: [f64; 6]) {
    let [yaw, pitch, roll, x, y, z] = drift.map(|value| value as f32);
    let turn = Quat::from_euler(EulerRot::YXZ, yaw.to_radians(), -pitch.to_radians(), roll.to_radians());
    let root = pose.joint_mut(0);
    *root = (turn * *root).normalize();
    pose.translation += Vec3::new(x, y, z);
}

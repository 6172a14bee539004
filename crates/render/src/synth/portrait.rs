//! How a camera sees one face, as in a laboratory.

use glam::{DVec3, Vec3};
use srflow_avatar::{Avatar, PosedHead};
use srflow_core::random::Stream;
use srflow_splat::Camera;

use crate::generate::{Rig, View};

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
    let mut camera = Rig::new(side, side, centre).camera(View { azimuth, elevation, roll });
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

//! Difficult scenes, and random ones.

use glam::{DMat3, DMat4, DVec3, EulerRot, Quat, Vec3};
use srflow_core::random::{Key, Stream};

use crate::{Camera, Device, FrameGradients, Gaussians};

/// The device that `SRFLOW_TEST_DEVICE` names, which the tests run on besides the CPU.
pub(crate) fn test_device() -> Option<Device> {
    let name = std::env::var("SRFLOW_TEST_DEVICE").ok()?;
    Some(Device::named(&name).unwrap_or_else(|error| panic!("SRFLOW_TEST_DEVICE: {error}")))
}

/// A camera at the origin, looking along z; the image size is not a multiple of a tile, the principal point is off-centre.
pub(crate) fn camera() -> Camera {
    Camera {
        width: 83,
        height: 57,
        fx: 90.0,
        fy: 80.0,
        cx: 37.3,
        cy: 30.8,
        camera_from_world: DMat4::IDENTITY,
    }
}

/// The camera rotated by small angles (radians) and moved.
pub(crate) fn moved(camera: Camera, yaw: f64, pitch: f64, translation: DVec3) -> Camera {
    let rotation = DMat3::from_euler(EulerRot::YXZ, yaw, pitch, 0.1 * yaw);
    let motion = DMat4::from_mat3_translation(rotation, translation);
    Camera { camera_from_world: motion * camera.camera_from_world, ..camera }
}

/// One Gaussian, round, red.
pub(crate) fn single(position: Vec3, scale: f32, opacity: f32) -> Gaussians {
    let mut gaussians = Gaussians::default();
    push(&mut gaussians, position, Vec3::splat(scale), Quat::IDENTITY, opacity, [1.0, 0.2, 0.1]);
    gaussians
}

/// Appends a Gaussian whose colour does not depend on direction.
pub(crate) fn push(
    gaussians: &mut Gaussians,
    position: Vec3,
    scale: Vec3,
    rotation: Quat,
    opacity: f32,
    color: [f32; 3],
) {
    const C0: f32 = 0.282_094_8;
    gaussians.positions.push(position);
    gaussians.scales.push(scale);
    gaussians.rotations.push(rotation);
    gaussians.opacities.push(opacity);
    gaussians.sh.push(color.map(|c| (c - 0.5) / C0));
    gaussians.sh.extend(std::iter::repeat_n([0.0; 3], gaussians.sh_len() - 1));
}

/// Appends Gaussians that have `a` and `b` as parameters of each kind in turn.
pub(crate) fn push_each(gaussians: &mut Gaussians, a: f32, b: f32) {
    push(gaussians, Vec3::new(a, b, 1.0), Vec3::splat(0.1), Quat::IDENTITY, 0.5, [0.5; 3]);
    push(gaussians, Vec3::new(0.0, a, b), Vec3::new(b, a, 0.1), Quat::IDENTITY, 0.5, [0.5; 3]);
    push(gaussians, Vec3::Z, Vec3::new(a, b, 0.1), Quat::IDENTITY, 0.5, [0.5; 3]);
    push(gaussians, Vec3::Z, Vec3::splat(0.2), Quat::from_xyzw(a, b, a, b), 0.5, [0.5; 3]);
    push(gaussians, Vec3::Z, Vec3::splat(0.2), Quat::IDENTITY, a, [b, 0.5, 0.5]);
}

/// `count` Gaussians in front of, beside and behind [`camera`]. Footprints range from under a pixel to the whole image,
/// shapes from round to needles of 1:300; some opacities are 0, 1, or under 1/255.
pub(crate) fn random(seed: u64, count: usize, sh_degree: usize) -> Gaussians {
    let mut stream = Key::new(seed).stream("scene");
    let mut gaussians = Gaussians { sh_degree, ..Gaussians::default() };
    for i in 0..count {
        let depth = stream.uniform(-0.5, 4.0);
        let position = Vec3::new(stream.uniform(-0.8, 0.8) * depth, stream.uniform(-0.6, 0.6) * depth, depth);
        let size = 0.003 * libm::powf(60.0, stream.unit());
        let mut scale =
            Vec3::splat(size) * Vec3::new(1.0, stream.uniform(0.3, 1.0), stream.uniform(0.3, 1.0));
        if i % 7 == 0 {
            scale = Vec3::new(0.6, 0.002, 0.002); // needle
        }
        if i % 41 == 0 {
            scale = Vec3::splat(stream.uniform(1.0, 20.0)); // huge
        }
        let opacity = match i % 11 {
            0 => 1.0,
            1 => 0.002,
            2 => 0.0,
            _ => stream.uniform(0.02, 1.0),
        };
        let color = std::array::from_fn(|_| stream.uniform(-0.1, 1.1));
        push(&mut gaussians, position, scale, rotation(&mut stream), opacity, color);
        let degrees = gaussians.sh.len() - gaussians.sh_len() + 1;
        for coefficient in &mut gaussians.sh[degrees..] {
            *coefficient = std::array::from_fn(|_| 0.2 * stream.normal());
        }
    }
    gaussians
}

fn rotation(stream: &mut Stream) -> Quat {
    Quat::from_xyzw(stream.normal(), stream.normal(), stream.normal(), stream.normal()).normalize()
}

/// The same Gaussians, each centre displaced by a normal amount of `deviation` along each axis.
pub(crate) fn jittered(gaussians: &Gaussians, seed: u64, deviation: f32) -> Gaussians {
    let mut stream = Key::new(seed).stream("motion");
    let mut next = gaussians.clone();
    for position in &mut next.positions {
        *position += deviation * Vec3::new(stream.normal(), stream.normal(), stream.normal());
    }
    next
}

/// Random gradients of every output of an image of `pixels` pixels.
pub(crate) fn gradients(pixels: usize, seed: u64) -> FrameGradients {
    let mut stream = Key::new(seed).stream("gradients");
    let mut numbers = |scale: f32| (0..pixels).map(|_| scale * stream.normal()).collect::<Vec<f32>>();
    let (red, green, blue) = (numbers(1.0), numbers(1.0), numbers(1.0));
    let (u, v) = (numbers(0.1), numbers(0.1));
    FrameGradients {
        color: (0..pixels).map(|i| [red[i], green[i], blue[i]]).collect(),
        flow: u.into_iter().zip(v).map(|(u, v)| [u, v]).collect(),
        alpha: numbers(1.0),
        depth: numbers(0.3),
        depth_next: numbers(0.3),
    }
}

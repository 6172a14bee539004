//! sRGB (IEC 61966-2-1), for colours from 0 to 1.

use glam::Vec3;

/// Linear light from sRGB.
pub(crate) fn linear_from_srgb(srgb: Vec3) -> Vec3 {
    let channel = |x: f32| if x <= 0.040_45 { x / 12.92 } else { libm::powf((x + 0.055) / 1.055, 2.4) };
    Vec3::new(channel(srgb.x), channel(srgb.y), channel(srgb.z))
}

/// sRGB from linear light, which is not negative.
pub(crate) fn srgb_from_linear(linear: Vec3) -> Vec3 {
    let channel =
        |x: f32| if x <= 0.003_130_8 { x * 12.92 } else { 1.055 * libm::powf(x, 1.0 / 2.4) - 0.055 };
    Vec3::new(channel(linear.x), channel(linear.y), channel(linear.z))
}

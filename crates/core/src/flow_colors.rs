use rayon::prelude::*;

use crate::{FlowField, Image};

/// A flow as a picture: hue is direction, saturation is length, white is zero flow. `max` is the length in pixels with full
/// saturation, and longer flow is darker; by default (or if not positive) it is the longest flow of the picture. Unknown
/// pixels are black.
///
/// The colours are those of Middlebury (Baker et al., IJCV 2011; `colorcode.cpp`), as the Python package `flow_vis` 0.1
/// computes them.
pub fn flow_colors(flow: &FlowField, max: Option<f32>) -> Image {
    let max = max.filter(|max| *max > 0.0).unwrap_or_else(|| longest_flow(flow));
    let scale = max + 1e-5; // keeps the longest flow from rounding above the maximum
    let wheel = wheel();
    let mut image = Image::new(flow.width(), flow.height());
    image.pixels_mut().par_iter_mut().zip(flow.pixels()).with_min_len(4096).for_each(|(color, [u, v])| {
        if u.is_finite() && v.is_finite() {
            *color = color_of(&wheel, [u / scale, v / scale]);
        }
    });
    image
}

/// Length of the longest known flow in pixels; 0 if none is known.
pub fn longest_flow(flow: &FlowField) -> f32 {
    flow.pixels().iter().map(length).filter(|length| length.is_finite()).fold(0.0, f32::max)
}

fn length([u, v]: &[f32; 2]) -> f32 {
    (u * u + v * v).sqrt()
}

/// Steps from red to yellow, green, cyan, blue, magenta and back to red, perceptually spaced.
const STEPS: [usize; 6] = [15, 6, 4, 11, 13, 6];
const WHEEL_LEN: usize = 55;

/// The fully saturated colours, `0..=1`.
fn wheel() -> [[f64; 3]; WHEEL_LEN] {
    const CORNERS: [[f64; 3]; 6] = [
        [255., 0., 0.],
        [255., 255., 0.],
        [0., 255., 0.],
        [0., 255., 255.],
        [0., 0., 255.],
        [255., 0., 255.],
    ];
    let mut wheel = [[0.0; 3]; WHEEL_LEN];
    let mut next = 0;
    for (corner, steps) in STEPS.into_iter().enumerate() {
        let (from, to) = (CORNERS[corner], CORNERS[(corner + 1) % 6]);
        for step in 0..steps {
            let change = (255.0 * step as f64 / steps as f64).floor();
            wheel[next] = std::array::from_fn(|c| (from[c] + change * (to[c] - from[c]) / 255.0) / 255.0);
            next += 1;
        }
    }
    wheel
}

fn color_of(wheel: &[[f64; 3]; WHEEL_LEN], [u, v]: [f32; 2]) -> [u8; 3] {
    let radius = f64::from(length(&[u, v]));
    if radius == 0.0 {
        return [255; 3]; // the same result without the arctangent: many pixels are static
    }
    let turn = libm::atan2f(-v, -u) / std::f32::consts::PI;
    let place = (turn + 1.0) / 2.0 * (WHEEL_LEN - 1) as f32;
    let before = (place as usize).min(WHEEL_LEN - 1);
    let after = (before + 1) % WHEEL_LEN;
    let part = f64::from(place - before as f32);
    std::array::from_fn(|channel| {
        let hue = (1.0 - part) * wheel[before][channel] + part * wheel[after][channel];
        let color = if radius <= 1.0 { 1.0 - radius * (1.0 - hue) } else { 0.75 * hue };
        (255.0 * color) as u8
    })
}

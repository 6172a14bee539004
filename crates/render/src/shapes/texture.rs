//! What layers look like.

use glam::{DMat2, DVec2, Vec3};
use srflow_core::random::Stream;
use srflow_core::{Image, Size};

/// Texels along a side of a texture made by code.
const SIZE: usize = 256;

/// A picture that covers the plane: made by code and periodic, or a photograph that is mirrored at its borders.
#[derive(Debug, Clone)]
pub struct Texture {
    width: usize,
    height: usize,
    texels: Vec<[f32; 3]>,
    is_mirrored: bool,
    /// Texels from pixels of frame 1.
    texel_from_pixel: DMat2,
    offset: DVec2,
    /// Channels are scaled by `gain` about the middle grey, and `shift` is added, 0..1.
    gain: f32,
    shift: Vec3,
}

impl Texture {
    /// A random texture made by code.
    pub fn made(stream: &mut Stream) -> Self {
        let palette = Palette::random(stream);
        let values = match stream.below(6) {
            0..3 => clouds(stream),
            3 => cells(stream),
            4 => stripes(stream),
            _ => {
                let (a, b) = (clouds(stream), stripes(stream));
                a.iter().zip(&b).map(|(a, b)| 0.7 * a + 0.3 * b).collect()
            }
        };
        let texels = values.iter().map(|&value| palette.at(value).to_array()).collect();
        // Skin and walls have little contrast.
        let gain = if stream.unit() < 0.3 { stream.uniform(0.05, 0.4) } else { 1.0 };
        let zoom = f64::from(libm::expf(stream.uniform(-0.9, 0.3)));
        Self::placed(Size::new(SIZE, SIZE), texels, false, zoom, gain, stream)
    }

    /// A photograph, turned and zoomed such that a pixel of a frame shows up to one of its pixels, and a little changed in colour.
    pub fn photograph(image: &Image, stream: &mut Stream) -> Self {
        let texels = image.pixels().iter().map(|pixel| pixel.map(|byte| f32::from(byte) / 255.0)).collect();
        let zoom = f64::from(libm::expf(stream.uniform(-0.9, 0.0)));
        let gain = stream.uniform(0.7, 1.2);
        Self::placed(image.size(), texels, true, zoom, gain, stream)
    }

    fn placed(
        Size { width, height }: Size,
        texels: Vec<[f32; 3]>,
        is_mirrored: bool,
        zoom: f64,
        gain: f32,
        stream: &mut Stream,
    ) -> Self {
        // Photographs keep their up, roughly.
        let turn =
            if is_mirrored { 0.2 * stream.normal() } else { stream.uniform(0.0, std::f32::consts::TAU) };
        let (sin, cos) = libm::sincos(f64::from(turn));
        let offset =
            DVec2::new((stream.unit() * width as f32).into(), (stream.unit() * height as f32).into());
        let shift = Vec3::from([0; 3].map(|_| 0.04 * stream.normal()));
        let texel_from_pixel = DMat2::from_cols(DVec2::new(cos, sin), DVec2::new(-sin, cos)) * zoom;
        Self { width, height, texels, is_mirrored, texel_from_pixel, offset, gain, shift }
    }

    /// The colour at a point of frame 1, about 0..1 (any for one that is not finite): interpolated between texels by cubic convolution (Keys 1981), so that frames sample
    /// it equally, wherever between the texels their pixels lie.
    pub fn color(&self, point: DVec2) -> Vec3 {
        let place = self.texel_from_pixel * point + self.offset;
        let first = place.floor();
        let [x, y] = (place - first).to_array().map(|t| keys(t as f32));
        let [columns, rows] = [(first.x, self.width), (first.y, self.height)].map(|(first, size)| {
            [-1, 0, 1, 2].map(|step| self.texel((first as i32).saturating_add(step), size))
        });
        let mut color = Vec3::ZERO;
        for (row, weight_y) in rows.into_iter().zip(y) {
            let row = &self.texels[row * self.width..][..self.width];
            let mut sum = Vec3::ZERO;
            for (column, weight_x) in columns.into_iter().zip(x) {
                sum += Vec3::from(row[column]) * weight_x;
            }
            color += sum * weight_y;
        }
        (color - 0.5) * self.gain + 0.5 + self.shift
    }

    /// The texel at a place along an axis.
    fn texel(&self, place: i32, size: usize) -> usize {
        let period = if self.is_mirrored { 2 * size } else { size };
        let place = place.rem_euclid(period as i32) as usize;
        if place < size { place } else { period - 1 - place }
    }
}

/// The weights of four texels for a place between the middle two.
fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (t3 - t2),
    ]
}

/// A few colours, each of which stands for a part of 0..1.
struct Palette([Vec3; 5]);

impl Palette {
    fn random(stream: &mut Stream) -> Self {
        let base = Vec3::from([0; 3].map(|_| stream.unit()));
        let spread = stream.uniform(0.1, 0.8);
        Self([(); 5].map(|()| {
            // Brightness differs more than hue.
            let brightness = spread * (stream.unit() - 0.5);
            let hue = Vec3::from([0; 3].map(|_| 0.5 * spread * (stream.unit() - 0.5)));
            (base + brightness + hue).clamp(Vec3::ZERO, Vec3::ONE)
        }))
    }

    fn at(&self, value: f32) -> Vec3 {
        let place = value.clamp(0.0, 1.0) * (self.0.len() - 1) as f32;
        let part = (place as usize).min(self.0.len() - 2);
        self.0[part].lerp(self.0[part + 1], place - part as f32)
    }
}

/// Fractal noise (value noise of several octaves), spread over 0..1.
fn clouds(stream: &mut Stream) -> Vec<f32> {
    let persistence = stream.uniform(0.4, 0.95);
    let coarsest = 4 << stream.below(3);
    let mut values = vec![0.0_f32; SIZE * SIZE];
    let (mut points, mut weight) = (coarsest, 1.0);
    while points <= SIZE / 2 {
        let lattice: Vec<f32> = (0..points * points).map(|_| stream.uniform(-1.0, 1.0)).collect();
        let cell = SIZE / points;
        let smooth: Vec<f32> =
            (0..cell).map(|i| i as f32 / cell as f32).map(|t| t * t * (3.0 - 2.0 * t)).collect();
        for (y, row) in values.chunks_exact_mut(SIZE).enumerate() {
            let (top, t) = (y / cell, smooth[y % cell]);
            let [above, below] = [top, (top + 1) % points].map(|line| &lattice[line * points..][..points]);
            for left in 0..points {
                let right = (left + 1) % points;
                let a = above[left] + (below[left] - above[left]) * t;
                let b = above[right] + (below[right] - above[right]) * t;
                for (value, s) in row[left * cell..][..cell].iter_mut().zip(&smooth) {
                    *value += weight * (a + (b - a) * s);
                }
            }
        }
        points *= 2;
        weight *= persistence;
    }
    let [low, high] = values.iter().fold([f32::MAX, f32::MIN], |[low, high], &v| [low.min(v), high.max(v)]);
    values.iter_mut().for_each(|value| *value = (*value - low) / (high - low).max(1e-6));
    values
}

/// Stones: each texel has the value of the nearest of some random points, darker towards the borders.
fn cells(stream: &mut Stream) -> Vec<f32> {
    let side = 4 + stream.below(12) as usize;
    let size = SIZE as f32 / side as f32;
    let points: Vec<(f32, f32, f32)> =
        (0..side * side).map(|_| (stream.unit(), stream.unit(), stream.unit())).collect();
    let mut values = Vec::with_capacity(SIZE * SIZE);
    for y in 0..SIZE {
        for x in 0..SIZE {
            let (u, v) = (x as f32 / size, y as f32 / size);
            let (column, row) = (u as usize, v as usize);
            let (mut nearest, mut second, mut value) = (f32::MAX, f32::MAX, 0.0);
            for j in 0..3 {
                for i in 0..3 {
                    let (cx, cy) = ((column + side + i - 1) % side, (row + side + j - 1) % side);
                    let (px, py, shade) = points[cy * side + cx];
                    let du = column as f32 + i as f32 - 1.0 + px - u;
                    let dv = row as f32 + j as f32 - 1.0 + py - v;
                    let squared = du * du + dv * dv;
                    if squared < nearest {
                        (second, nearest, value) = (nearest, squared, shade);
                    } else {
                        second = second.min(squared);
                    }
                }
            }
            let border = ((second.sqrt() - nearest.sqrt()) * 8.0).min(1.0);
            values.push(value * (0.4 + 0.6 * border));
        }
    }
    values
}

/// Soft stripes or checks.
fn stripes(stream: &mut Stream) -> Vec<f32> {
    // Whole numbers of waves: the texture stays periodic.
    let waves = [0; 2].map(|_| [(); 2].map(|()| stream.below(25) as f32 - 12.0));
    let [phase, sharpness] = [stream.uniform(0.0, 1.0), stream.uniform(1.0, 6.0)];
    let is_check = stream.unit() < 0.5;
    let turn = std::f32::consts::TAU / SIZE as f32;
    let wave = |[across, down]: [f32; 2], x: usize, y: usize| {
        libm::sinf(turn * (across * x as f32 + down * y as f32) + phase)
    };
    let mut values = Vec::with_capacity(SIZE * SIZE);
    for y in 0..SIZE {
        for x in 0..SIZE {
            let height = wave(waves[0], x, y) * if is_check { wave(waves[1], x, y) } else { 1.0 };
            values.push(0.5 + 0.5 * (sharpness * height).clamp(-1.0, 1.0));
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_core::random::Key;

    #[test]
    fn textures_vary_are_continuous_and_cover_the_plane() {
        let image = Image::from_fn(40, 30, |x, y| [(6 * x) as u8, (8 * y) as u8, 90]);
        for number in 0..60 {
            let mut stream = Key::new(9).scene(number).stream("texture");
            let texture = match number % 4 {
                0 => Texture::photograph(&image, &mut stream),
                _ => Texture::made(&mut stream),
            };
            let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            for step in 0..2000 {
                let point =
                    DVec2::new(f64::from(step % 50) * 7.3 - 200.0, f64::from(step / 50) * 9.1 - 150.0);
                let color = texture.color(point);
                let beside = texture.color(point + DVec2::new(1e-4, 1e-4));
                assert!((color - beside).abs().max_element() < 2e-3, "{color} {beside}");
                assert!(color.min_element() > -0.6 && color.max_element() < 1.6, "{color}");
                (low, high) = (low.min(color), high.max(color));
            }
            assert!((high - low).max_element() > 0.004, "texture {number}: {low} {high}");
        }
    }
}

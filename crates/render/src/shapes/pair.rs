//! One pair of frames: layers of texture that move over each other, and what a camera does to their picture.

use glam::{DVec2, Vec3};
use rayon::prelude::*;
use srflow_core::random::{Key, Stream};
use srflow_core::{FlowField, Image, Mask, Plane, Size};
use srflow_data::flow::Sample;

use super::motion::Motion;
use super::outline::Outline;
use super::texture::Texture;
use crate::recording::add_noise;

/// Two frames and the exact motion between them.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapePair {
    pub frame1: Image,
    pub frame2: Image,
    /// From frame 1 to frame 2, in pixels: of the layer that covers more than half of the pixel, at its centre.
    pub flow: FlowField,
    /// `true` where another layer covers the point in frame 2, or it is outside of the picture.
    pub occlusion: Mask,
}

impl From<ShapePair> for Sample {
    fn from(ShapePair { frame1, frame2, flow, occlusion }: ShapePair) -> Self {
        Self { frame1, frame2, flow: Some(flow), mask: None, occlusion: Some(occlusion) }
    }
}

/// Layers in front of the background.
const LAYERS: std::ops::RangeInclusive<u32> = 4..=16;

/// Less than this share of a pixel is not visible.
const LEAST_SHARE: f32 = 1e-3;

struct Layer {
    outline: Outline,
    texture: Texture,
    motion: Motion,
    /// Rectangles in frame 1 and in frame 2 that contain it, with its soft border.
    bounds: [Option<[DVec2; 2]>; 2],
    /// Width of the border in pixels.
    softness: f64,
}

impl Layer {
    fn new(outline: Outline, texture: Texture, motion: Motion, softness: f64) -> Self {
        let whole = outline.bounds().map(|[low, high]| [low - softness, high + softness]);
        let bounds = [whole, whole.map(|bounds| motion.bounds(bounds))];
        Self { outline, texture, motion, bounds, softness }
    }

    /// The point of frame 1 that is at a point of frame 1 (0) or 2 (1); `None` where the layer certainly is not.
    fn source(&self, frame: usize, point: DVec2) -> Option<DVec2> {
        if let Some([low, high]) = self.bounds[frame]
            && !(point.cmpge(low).all() && point.cmple(high).all())
        {
            return None;
        }
        Some(if frame == 0 { point } else { self.motion.inverse(point) })
    }

    /// Whether it covers more than half of a pixel.
    fn covers(&self, frame: usize, point: DVec2) -> bool {
        self.source(frame, point).is_some_and(|source| self.outline.distance(source) < 0.0)
    }
}

impl ShapePair {
    /// Pair number `number` of a seed. `length` is the shortest and the longest motion in pixels; the pair's own is between them, each
    /// octave equally likely. `photograph` gives some layers their texture, if it has one.
    pub fn random(
        size: Size,
        key: Key,
        length: [f32; 2],
        photograph: &mut dyn FnMut(&mut Stream) -> Option<Texture>,
    ) -> Self {
        let Size { width, height } = size;
        let layers = random_layers(size, key, length, photograph);
        let (colors1, labels) = draw(&layers, size, 0);
        let (colors2, _) = draw(&layers, size, 1);

        let center = |x: usize, y: usize| DVec2::new(x as f64, y as f64);
        let target = |x: usize, y: usize| layers[labels[y * width + x] as usize].motion.forward(center(x, y));
        let flow =
            FlowField::from_fn(width, height, |x, y| (target(x, y) - center(x, y)).as_vec2().to_array());
        let [low, high] = [DVec2::splat(-0.5), DVec2::new(width as f64, height as f64) - 0.5];
        let occlusion = Mask::from_fn(width, height, |x, y| {
            let target = target(x, y);
            let above = &layers[..labels[y * width + x] as usize];
            let is_inside = target.cmpge(low).all() && target.cmple(high).all();
            !is_inside || above.iter().any(|layer| layer.covers(1, target))
        });
        let camera = Camera::random(size, key);
        let [frame1, frame2] =
            [(0, colors1), (1, colors2)].map(|(frame, colors)| camera.record(frame, colors));
        Self { frame1, frame2, flow, occlusion }
    }
}

/// From front to back; the last is the background.
fn random_layers(
    Size { width, height }: Size,
    key: Key,
    [shortest, longest]: [f32; 2],
    photograph: &mut dyn FnMut(&mut Stream) -> Option<Texture>,
) -> Vec<Layer> {
    let mut stream = key.stream("layers");
    let side = width.min(height) as f64;
    let typical = shortest * libm::powf(longest / shortest, stream.unit());
    let typical = f64::from(typical);
    let count = LAYERS.start() + stream.below(LAYERS.end() - LAYERS.start() + 1);

    let middle = DVec2::new(width as f64, height as f64) / 2.0;
    let behind = typical * f64::from(stream.unit());
    let background = Motion::random(middle, middle.length(), behind, &mut stream);
    let mut texture = |stream: &mut Stream| photograph(stream).unwrap_or_else(|| Texture::made(stream));
    let mut layers = Vec::new();
    for _ in 0..count {
        let center =
            DVec2::new(stream.uniform(0.0, width as f32).into(), stream.uniform(0.0, height as f32).into());
        let radius = side * 0.03 * libm::exp(f64::from(stream.uniform(0.0, 2.6)));
        let outline = Outline::random(center, radius, &mut stream);
        let length = typical * libm::exp(0.5 * f64::from(stream.normal()));
        let own = Motion::random(center, radius, length.min(f64::from(longest)), &mut stream);
        // Some are painted onto the background.
        let motion = if stream.unit() < 0.15 { background.clone() } else { own };
        let softness = f64::from(stream.uniform(1.0, 1.8));
        layers.push(Layer::new(outline, texture(&mut stream), motion, softness));
    }
    layers.push(Layer::new(Outline::Everywhere, texture(&mut stream), background, 1.0));
    layers
}

/// The colours of a frame, and the layer that covers each pixel's centre.
fn draw(layers: &[Layer], Size { width, height }: Size, frame: usize) -> (Vec<Vec3>, Vec<u32>) {
    let mut pixels = vec![(Vec3::ZERO, 0); width * height];
    pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let point = DVec2::new(x as f64, y as f64);
            let (mut color, mut left, mut label) = (Vec3::ZERO, 1.0, None);
            for (number, layer) in (0..).zip(layers) {
                let Some(source) = layer.source(frame, point) else { continue };
                let distance = layer.outline.distance(source);
                let alpha = (0.5 - distance / layer.softness).clamp(0.0, 1.0) as f32;
                if alpha > 0.0 {
                    color += layer.texture.color(source) * (left * alpha);
                    left *= 1.0 - alpha;
                }
                if distance < 0.0 {
                    label.get_or_insert(number);
                }
                if left < LEAST_SHARE && label.is_some() {
                    break;
                }
            }
            *pixel = (color, label.unwrap_or_default());
        }
    });
    pixels.into_iter().unzip()
}

/// What happens to both pictures between the scene and the file.
struct Camera {
    key: Key,
    size: Size,
    /// Colour and greatest share of fog, if there is any.
    fog: Option<(Vec3, f32)>,
    /// For each frame: factor, power, and factors of the gradients to the right and downwards, for each channel.
    light: [[Vec3; 4]; 2],
    /// Standard deviation of the blur in pixels.
    blur: f32,
    /// Strength of the sensor noise; 1 is about two levels.
    noise: f32,
}

impl Camera {
    fn random(size: Size, key: Key) -> Self {
        let mut stream = key.stream("camera");
        let fog = (stream.unit() < 0.2).then(|| {
            let color = Vec3::splat(stream.uniform(0.3, 1.0)) + 0.1 * (stream.unit() - 0.5);
            (color, stream.uniform(0.1, 0.6))
        });
        // About the same for the three channels.
        let near = |center: f32, spread: f32, stream: &mut Stream| {
            let common = stream.normal();
            Vec3::from([0; 3].map(|_| center + spread * (common + 0.3 * stream.normal())))
        };
        const CENTERS: [f32; 4] = [1.0, 1.0, 0.0, 0.0];
        const SPREADS: [f32; 4] = [0.08, 0.1, 0.06, 0.06];
        let first: [Vec3; 4] = std::array::from_fn(|i| near(CENTERS[i], SPREADS[i], &mut stream));
        // In most pairs it hardly changes.
        let change = if stream.unit() < 0.25 { stream.uniform(0.2, 1.0) } else { 0.02 };
        let second = std::array::from_fn(|i| first[i] + near(0.0, change * SPREADS[i], &mut stream));
        let blur = if stream.unit() < 0.4 { stream.uniform(0.3, 1.5) } else { 0.0 };
        let noise = if stream.unit() < 0.7 { stream.uniform(0.1, 3.0) } else { 0.0 };
        Self { key, size, fog, light: [first, second], blur, noise }
    }

    fn record(&self, frame: u32, mut colors: Vec<Vec3>) -> Image {
        let Size { width, height } = self.size;
        let key = self.key.frame(frame);
        if let Some((color, most)) = self.fog {
            let share = smooth_field(self.size, &mut key.stream("fog"));
            for (pixel, share) in colors.iter_mut().zip(share) {
                *pixel = pixel.lerp(color, most * share);
            }
        }
        let [factor, power, right, down] = self.light[frame as usize];
        let across = |at: usize, len: usize| 2.0 * (at as f32 + 0.5) / len as f32 - 1.0;
        let curves = power.to_array().map(|power| Curve::new(power.clamp(0.6, 1.6)));
        for (y, row) in colors.chunks_exact_mut(width).enumerate() {
            for (x, pixel) in row.iter_mut().enumerate() {
                let lit = factor + right * across(x, width) + down * across(y, height);
                let value = (*pixel * lit).clamp(Vec3::ZERO, Vec3::ONE).to_array();
                *pixel = Vec3::from(std::array::from_fn(|i| curves[i].at(value[i])));
            }
        }
        if self.blur > 0.0 {
            blur(&mut colors, self.size, self.blur);
        }
        let byte = |value: f32| (255.0 * value.clamp(0.0, 1.0) + 0.5) as u8;
        let mut image = Image::from_fn(width, height, |x, y| colors[y * width + x].to_array().map(byte));
        if self.noise > 0.0 {
            add_noise(&mut image, &Plane::filled(width, height, 1.0), self.noise, key);
        }
        image
    }
}

/// A power of 0..1, linear between many places.
struct Curve([f32; Self::PARTS + 1]);

impl Curve {
    const PARTS: usize = 1024;

    fn new(power: f32) -> Self {
        Self(std::array::from_fn(|i| libm::powf(i as f32 / Self::PARTS as f32, power)))
    }

    fn at(&self, value: f32) -> f32 {
        let place = value * Self::PARTS as f32;
        let part = (place as usize).min(Self::PARTS - 1);
        self.0[part] + (self.0[part + 1] - self.0[part]) * (place - part as f32)
    }
}

/// Values of 0..1 that change over about a quarter of the picture.
fn smooth_field(Size { width, height }: Size, stream: &mut Stream) -> Vec<f32> {
    const POINTS: usize = 5;
    let points: [[f32; POINTS]; POINTS] = [(); POINTS].map(|()| [(); POINTS].map(|()| stream.unit()));
    let place = |at: usize, len: usize| {
        let place = (POINTS - 1) as f32 * at as f32 / len as f32;
        let t = place - place.floor();
        (place as usize, t * t * (3.0 - 2.0 * t))
    };
    let mut values = Vec::with_capacity(width * height);
    for y in 0..height {
        let (row, t) = place(y, height);
        for x in 0..width {
            let (column, s) = place(x, width);
            let line = |row: usize| points[row][column] + (points[row][column + 1] - points[row][column]) * s;
            values.push(line(row) + (line(row + 1) - line(row)) * t);
        }
    }
    values
}

/// Convolves with a Gaussian, cut off at three standard deviations; the border is continued.
fn blur(colors: &mut [Vec3], Size { width, height }: Size, deviation: f32) {
    let reach = (3.0 * deviation).ceil() as usize;
    let weights: Vec<f32> =
        (0..=reach).map(|i| libm::expf(-0.5 * (i * i) as f32 / (deviation * deviation))).collect();
    let total = weights[0] + 2.0 * weights[1..].iter().sum::<f32>();
    let pass = |from: &[Vec3], to: &mut [Vec3], (length, step): (usize, usize), start: usize| {
        for at in 0..length {
            let read = |at: usize| from[start + at.min(length - 1) * step];
            let mut sum = read(at) * weights[0];
            for (i, &weight) in weights.iter().enumerate().skip(1) {
                sum += (read(at.saturating_sub(i)) + read(at + i)) * weight;
            }
            to[start + at * step] = sum / total;
        }
    };
    let mut between = vec![Vec3::ZERO; colors.len()];
    for y in 0..height {
        pass(colors, &mut between, (width, 1), y * width);
    }
    for x in 0..width {
        pass(&between, colors, (height, width), x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(number: u32, length: [f32; 2]) -> ShapePair {
        ShapePair::random(Size::new(160, 120), Key::new(5).scene(number), length, &mut |_| None)
    }

    #[test]
    fn frame_2_at_the_flow_looks_like_frame_1_except_where_it_is_occluded() {
        let (mut visible, mut hidden) = (Vec::new(), Vec::new());
        for number in 0..12 {
            let size = Size::new(160, 120);
            let layers = random_layers(size, Key::new(5).scene(number), [0.3, 12.0], &mut |_| None);
            let pair = pair(number, [0.3, 12.0]);
            let (first, labels) = draw(&layers, size, 0);
            // Exact colours of frame 2 between its pixels.
            for y in 0..120 {
                for x in 0..160 {
                    let [u, v] = pair.flow.get(x, y);
                    let target = DVec2::new(x as f64 + f64::from(u), y as f64 + f64::from(v));
                    let on_top = layers.iter().position(|layer| layer.covers(1, target)).unwrap();
                    let label = labels[y * 160 + x] as usize;
                    let outside = target.cmplt(DVec2::splat(-0.5)).any()
                        || target.cmpgt(DVec2::new(159.5, 119.5)).any();
                    assert_eq!(*pair.occlusion.row(y).get(x).unwrap(), outside || on_top != label);
                    let source = layers[on_top].motion.inverse(target);
                    let seen = layers[on_top].texture.color(source);
                    let difference = (seen - first[y * 160 + x]).abs().element_sum() / 3.0;
                    if outside {
                        continue;
                    }
                    if on_top == label { visible.push(difference) } else { hidden.push(difference) }
                }
            }
        }
        visible.sort_unstable_by(f32::total_cmp);
        let mean = |list: &[f32]| list.iter().sum::<f32>() / list.len() as f32;
        // Except for soft borders, visible points have the same colour, to the accuracy of the flow's 32 bits.
        assert!(visible[visible.len() * 8 / 10] < 1e-3, "{}", visible[visible.len() * 8 / 10]);
        assert!(
            hidden.len() > 500 && mean(&hidden) > 5.0 * mean(&visible),
            "{} {}",
            mean(&hidden),
            mean(&visible)
        );
    }

    #[test]
    fn lengths_of_motion_are_as_asked_for() {
        for length in [[0.05, 0.3], [2.0, 8.0]] {
            let mut lengths: Vec<f32> = (0..20)
                .flat_map(|number| pair(number, length).flow.into_pixels())
                .map(|[u, v]| (u * u + v * v).sqrt())
                .collect();
            lengths.sort_unstable_by(f32::total_cmp);
            let at = |share: f64| lengths[(share * (lengths.len() - 1) as f64) as usize];
            assert!(at(0.99) < 4.0 * length[1] && at(0.9) > 0.5 * length[0], "{} {}", at(0.99), at(0.9));
        }
    }

    #[test]
    fn a_blur_keeps_what_is_flat_and_the_sum_of_the_rest() {
        let mut flat = vec![Vec3::splat(0.3); 20 * 10];
        blur(&mut flat, Size::new(20, 10), 1.4);
        assert!(flat.iter().all(|pixel| (*pixel - 0.3).abs().max_element() < 1e-6));
        let mut point = vec![Vec3::ZERO; 21 * 21];
        point[10 * 21 + 10] = Vec3::ONE;
        blur(&mut point, Size::new(21, 21), 1.2);
        assert!((point.iter().map(|pixel| pixel.x).sum::<f32>() - 1.0).abs() < 1e-5);
        assert!((point[10 * 21 + 11].x / point[10 * 21 + 10].x - libm::expf(-0.5 / 1.44)).abs() < 1e-5);
    }
}

//! Backgrounds made by code: rooms, textures, gradients and lights, out of focus by a random amount.
//!
//! Places are in heights of the picture from its centre, to the right and down. Colours are coded values from 0 to 1.

use std::f32::consts::FRAC_PI_2;

use glam::{DVec2, Vec3};
use rayon::prelude::*;
use srflow_core::random::{Key, Stream};
use srflow_core::{Image, LUMA};
use srflow_head::Look;

use crate::recording::defocus;
use crate::shapes::Texture;

/// Greatest radius of the defocus, in heights of the picture.
const GREATEST_DEFOCUS: f32 = 0.012;

/// Least radius in the second look, as a part of the greatest: what is behind a head is never as sharp as the head.
const LEAST_DEFOCUS: f32 = 0.3;

/// Part of the colourfulness that is left in the second look: few rooms are as colourful as random numbers.
const COLOURFULNESS: f32 = 0.55;

type Colour = [f32; 3];

/// The background of the scene of `key`. It does not move.
pub(super) fn procedural(width: usize, height: usize, key: Key, look: Look) -> Image {
    let mut stream = key.stream("procedural background");
    let mut canvas = Canvas::new(width, height, look);
    let kind = stream.below(20);
    match kind {
        0..11 => room(&mut canvas, &mut stream),
        11..14 => texture(&mut canvas, &mut stream),
        14..17 => gradient(&mut canvas, &mut stream),
        _ => lights(&mut canvas, &mut stream),
    }
    // A wall of cloth or foliage is out of focus as far as a room is deep.
    let least = if (11..14).contains(&kind) { 0.6 } else { LEAST_DEFOCUS };
    grain(&mut canvas, &mut stream);
    if look >= Look::Second {
        canvas.each(|colour, _| mixed([luma(colour); 3], colour, COLOURFULNESS));
    }
    let mut image = canvas.image();
    // Squared: most backgrounds are nearly in focus.
    let softness = stream.unit();
    let softness = softness * softness;
    let softness = if look == Look::First { softness } else { softness.max(least) };
    defocus(&mut image, GREATEST_DEFOCUS * softness * height as f32);
    image
}

/// A wall, or two that meet, lit from one side, with things in front of it.
fn room(canvas: &mut Canvas, stream: &mut Stream) {
    let wall = colour(stream, 0.3..0.85, 0.3);
    let darker = scaled(wall, stream.uniform(0.5, 0.9));
    gradient_between(canvas, stream, wall, darker);
    let half_width = canvas.half_width();
    if stream.unit() < 0.5 {
        let corner = stream.uniform(-half_width, half_width);
        let far = if stream.unit() < 0.5 { half_width + 0.2 } else { -half_width - 0.2 };
        let side = Shape::rectangle([0.5 * (corner + far), 0.0], [0.5 * (far - corner).abs(), 0.6]);
        canvas.paint(&side.coloured([0.0; 3], [0.0; 3]).opaque(stream.uniform(0.08, 0.35)));
    }
    if stream.unit() < 0.3 {
        let ceiling = Shape::rectangle([0.0, -0.5], [half_width, stream.uniform(0.02, 0.12)]);
        let white = scaled([1.0, 0.99, 0.96], stream.uniform(0.6, 0.95));
        canvas.paint(&ceiling.coloured(scaled(white, 0.9), white));
    }
    for _ in 0..2 + stream.below(5) {
        let centre = [stream.uniform(-half_width, half_width), stream.uniform(-0.45, 0.45)];
        match stream.below(6) {
            0 => window(canvas, stream, centre),
            1 => picture(canvas, stream, centre),
            2 => shelf(canvas, stream, centre),
            3 => door(canvas, stream, centre),
            4 => plant(canvas, stream, centre),
            _ => lamp(canvas, stream, centre),
        }
    }
}

fn window(canvas: &mut Canvas, stream: &mut Stream, centre: [f32; 2]) {
    let half = [stream.uniform(0.1, 0.22), stream.uniform(0.14, 0.3)];
    let frame = colour(stream, 0.5..0.95, 0.1);
    shadowed(canvas, &Shape::rectangle(centre, half).coloured(frame, scaled(frame, 0.85)));
    let (columns, rows) = (1 + stream.below(2), 1 + stream.below(3));
    let sky = scaled([0.85, 0.93, 1.0], stream.uniform(0.75, 1.1));
    let ground = colour(stream, 0.3..0.9, 0.3);
    let gap = 0.008;
    for row in 0..rows {
        for column in 0..columns {
            let within =
                |index: u32, count: u32, half: f32| half * ((2 * index + 1) as f32 / count as f32 - 1.0);
            let place = [
                centre[0] + within(column, columns, half[0] - gap),
                centre[1] + within(row, rows, half[1] - gap),
            ];
            let size = [(half[0] - gap) / columns as f32 - gap, (half[1] - gap) / rows as f32 - gap];
            let lower = if row + 1 == rows { ground } else { sky };
            canvas.paint(&Shape::rectangle(place, size).coloured(sky, lower));
        }
    }
}

fn picture(canvas: &mut Canvas, stream: &mut Stream, centre: [f32; 2]) {
    let half = [stream.uniform(0.04, 0.16), stream.uniform(0.04, 0.16)];
    let frame = colour(stream, 0.1..0.8, 0.4);
    shadowed(canvas, &Shape::rectangle(centre, half).coloured(frame, scaled(frame, 0.8)));
    let inner = half.map(|half| 0.86 * half);
    let (top, bottom) = (colour(stream, 0.2..1.0, 0.7), colour(stream, 0.1..0.8, 0.7));
    canvas.paint(&Shape::rectangle(centre, inner).coloured(top, bottom));
    for _ in 0..stream.below(8) {
        let place = [0, 1].map(|axis| centre[axis] + inner[axis] * stream.uniform(-0.7, 0.7));
        let size = [0, 1].map(|axis| inner[axis] * stream.uniform(0.05, 0.3));
        let paint = colour(stream, 0.1..1.0, 0.8);
        canvas.paint(&Shape::ellipse(place, size).coloured(paint, scaled(paint, 0.7)));
    }
}

fn shelf(canvas: &mut Canvas, stream: &mut Stream, centre: [f32; 2]) {
    let half = [stream.uniform(0.15, 0.4), stream.uniform(0.1, 0.4)];
    let wood = colour(stream, 0.2..0.8, 0.5);
    shadowed(canvas, &Shape::rectangle(centre, half).coloured(scaled(wood, 0.55), scaled(wood, 0.45)));
    let rows = 1 + stream.below(5);
    let pitch = 2.0 * half[1] / rows as f32;
    for row in 0..rows {
        let floor = centre[1] - half[1] + pitch * (row + 1) as f32;
        let (mut x, right) = (centre[0] - half[0] + 0.01, centre[0] + half[0] - 0.01);
        while x < right {
            let thick = stream.uniform(0.006, 0.022).min(0.5 * (right - x).max(0.004));
            let tall = pitch * stream.uniform(0.25, 0.42);
            if stream.unit() < 0.88 {
                let book = colour(stream, 0.1..0.9, 0.8);
                let spine = Shape::rectangle([x + thick, floor - tall], [0.92 * thick, tall]);
                canvas.paint(&spine.coloured(book, scaled(book, 0.75)));
            }
            x += 2.0 * thick;
        }
        canvas
            .paint(&Shape::rectangle([centre[0], floor], [half[0], 0.006]).coloured(wood, scaled(wood, 0.7)));
    }
}

fn door(canvas: &mut Canvas, stream: &mut Stream, [x, _]: [f32; 2]) {
    let leaf = colour(stream, 0.3..0.95, 0.4);
    let (centre, half) = ([x, 0.15], [stream.uniform(0.15, 0.22), 0.55]);
    shadowed(canvas, &Shape::rectangle(centre, half).coloured(scaled(leaf, 0.8), scaled(leaf, 0.8)));
    let inner = half.map(|half| half - 0.015);
    canvas.paint(&Shape::rectangle(centre, inner).coloured(leaf, scaled(leaf, 0.92)));
    for panel in [-0.25, 0.2] {
        let place = [x, centre[1] + panel];
        let size = [0.7 * half[0], 0.18];
        canvas.paint(&Shape::rectangle(place, size).coloured(scaled(leaf, 0.78), scaled(leaf, 1.08)));
        let size = size.map(|half| half - 0.006);
        canvas.paint(&Shape::rectangle(place, size).coloured(leaf, scaled(leaf, 0.95)));
    }
    let handle = Shape::ellipse([x + 0.85 * half[0], 0.2], [0.012, 0.012]);
    canvas.paint(&handle.coloured([0.9, 0.85, 0.7], [0.3, 0.28, 0.25]));
}

fn plant(canvas: &mut Canvas, stream: &mut Stream, centre: [f32; 2]) {
    let (green, size) =
        ([stream.uniform(0.1, 0.4), stream.uniform(0.3, 0.6), stream.uniform(0.05, 0.3)], 0.14);
    if canvas.look == Look::First {
        for _ in 0..40 {
            let place = centre.map(|middle| middle + size * stream.normal().clamp(-2.0, 2.0) * 0.5);
            let leaf = [stream.uniform(0.008, 0.035), stream.uniform(0.008, 0.035)];
            let shade = scaled(green, stream.uniform(0.4, 1.4));
            canvas.paint(&Shape::ellipse(place, leaf).coloured(scaled(shade, 1.2), scaled(shade, 0.8)));
        }
    } else {
        let olive = mixed(green, [0.2, 0.24, 0.15], 0.55);
        leaves(canvas, stream, [centre[0], centre[1] + 0.1], olive);
    }
    let pot = colour(stream, 0.3..0.9, 0.5);
    canvas.paint(
        &Shape::rectangle([centre[0], centre[1] + 0.16], [0.06, 0.06]).coloured(pot, scaled(pot, 0.6)),
    );
}

/// Pointed leaves that rise from a place to all sides; the later ones are in front, in more light.
fn leaves(canvas: &mut Canvas, stream: &mut Stream, root: [f32; 2], green: Colour) {
    let (slender, count) = (stream.uniform(0.16, 0.42), 14 + stream.below(16));
    for number in 0..count {
        let lean = stream.uniform(-1.35, 1.35);
        let reach = stream.uniform(0.05, 0.2) * (1.0 - 0.25 * lean.abs());
        let (across, down) = (libm::sinf(lean), -libm::cosf(lean));
        let shade = scaled(green, 0.45 + 0.7 * number as f32 / count as f32 + stream.uniform(-0.1, 0.1));
        let at = |share: f32| [root[0] + across * reach * share, root[1] + down * reach * share];
        let stem = Shape::leaf(at(0.5), [0.5 * reach, 0.0025], lean - FRAC_PI_2);
        canvas.paint(&stem.coloured(scaled(shade, 0.7), scaled(shade, 0.5)));
        let half = stream.uniform(0.026, 0.055);
        let droop = lean - FRAC_PI_2 + stream.uniform(-0.4, 0.6) * lean.signum();
        let blade = Shape::leaf(at(1.0), [half, slender * half], droop);
        canvas.paint(&blade.coloured(scaled(shade, 1.25), scaled(shade, 0.8)));
        // The vein.
        let vein = Shape::leaf(at(1.0), [0.9 * half, 0.06 * half], droop);
        canvas.paint(&vein.coloured(scaled(shade, 1.45), scaled(shade, 1.3)).opaque(0.7));
    }
}

fn lamp(canvas: &mut Canvas, stream: &mut Stream, centre: [f32; 2]) {
    let glow = [1.0, stream.uniform(0.85, 0.97), stream.uniform(0.6, 0.92)];
    let reach = stream.uniform(0.2, 0.5);
    let halo = Shape::ellipse(centre, [0.5 * reach; 2]).coloured(glow, glow);
    canvas.paint(&halo.opaque(stream.uniform(0.2, 0.5)).soft(reach));
    canvas.paint(&Shape::rectangle(centre, [0.05, 0.04]).coloured(glow, scaled(glow, 0.9)));
    canvas
        .paint(&Shape::rectangle([centre[0], centre[1] + 0.15], [0.004, 0.11]).coloured([0.2; 3], [0.1; 3]));
}

/// Cloth, plaster, stone or foliage.
fn texture(canvas: &mut Canvas, stream: &mut Stream) {
    let texture = Texture::made(stream);
    let texels = texels(stream);
    canvas.each(|_, place| {
        texture.color(texels * DVec2::from(place.map(f64::from))).clamp(Vec3::ZERO, Vec3::ONE).to_array()
    });
}

/// A studio's backdrop.
fn gradient(canvas: &mut Canvas, stream: &mut Stream) {
    let (from, to) = (colour(stream, 0.15..0.95, 0.4), colour(stream, 0.05..0.8, 0.4));
    gradient_between(canvas, stream, from, to);
}

/// Lamps far out of focus, in front of a dark gradient.
fn lights(canvas: &mut Canvas, stream: &mut Stream) {
    let (from, to) = (colour(stream, 0.05..0.35, 0.5), colour(stream, 0.02..0.2, 0.5));
    gradient_between(canvas, stream, from, to);
    let size = stream.uniform(0.015, 0.06);
    let edge = if canvas.look == Look::First { 0.15 } else { 0.8 };
    for _ in 0..10 + stream.below(50) {
        let centre = [stream.uniform(-canvas.half_width(), canvas.half_width()), stream.uniform(-0.5, 0.5)];
        let glow = colour(stream, 0.7..1.0, 0.6);
        let disc = Shape::ellipse(centre, [size * stream.uniform(0.7, 1.2); 2]).coloured(glow, glow);
        canvas.paint(&disc.opaque(stream.uniform(0.15, 0.8)).soft(edge * size));
    }
}

fn gradient_between(canvas: &mut Canvas, stream: &mut Stream, from: Colour, to: Colour) {
    let angle = stream.uniform(0.0, std::f32::consts::TAU);
    let (across, down) = (libm::cosf(angle), libm::sinf(angle));
    let vignette = stream.uniform(0.0, 0.5);
    canvas.each(|_, [x, y]| {
        let share = 0.5 + 0.8 * (x * across + y * down);
        scaled(mixed(from, to, share.clamp(0.0, 1.0)), 1.0 - vignette * (x * x + y * y))
    });
}

/// The unevenness of surfaces.
fn grain(canvas: &mut Canvas, stream: &mut Stream) {
    let texture = Texture::made(stream);
    let (strength, texels) = (stream.uniform(0.0, 0.2), texels(stream));
    canvas.each(|colour, place| {
        let bump = texture.color(texels * DVec2::from(place.map(f64::from))).y - 0.5;
        scaled(colour, 1.0 + strength * bump.clamp(-0.5, 0.5))
    });
}

/// Pixels of a texture in a height of the picture.
fn texels(stream: &mut Stream) -> f64 {
    f64::from(stream.uniform(100.0, 800.0))
}

/// A shape with its soft shadow on the wall, below it.
fn shadowed(canvas: &mut Canvas, shape: &Shape) {
    let centre = [shape.centre[0], shape.centre[1] + 0.012];
    canvas.paint(&Shape { centre, ..shape.coloured([0.0; 3], [0.0; 3]).opaque(0.35).soft(0.03) });
    canvas.paint(shape);
}

/// A random colour whose strongest channel is in `brightness`, up to `saturation` away from grey.
fn colour(stream: &mut Stream, brightness: std::ops::Range<f32>, saturation: f32) -> Colour {
    let brightness = stream.uniform(brightness.start, brightness.end);
    let saturation = saturation * stream.unit();
    let tint = [0; 3].map(|_| stream.unit());
    let most = tint.into_iter().fold(1e-3, f32::max);
    tint.map(|share| brightness * (1.0 - saturation * (1.0 - share / most)))
}

fn scaled(colour: Colour, factor: f32) -> Colour {
    colour.map(|value| (value * factor).clamp(0.0, 1.0))
}

fn mixed(from: Colour, to: Colour, share: f32) -> Colour {
    std::array::from_fn(|channel| from[channel] + (to[channel] - from[channel]) * share)
}

/// Brightness by Rec. 601.
fn luma([red, green, blue]: Colour) -> f32 {
    LUMA[0] * red + LUMA[1] * green + LUMA[2] * blue
}

/// A rectangle or an ellipse along the axes, or a leaf.
#[derive(Debug, Clone)]
struct Shape {
    centre: [f32; 2],
    half: [f32; 2],
    outline: Outline,
    top: Colour,
    bottom: Colour,
    opacity: f32,
    /// Width of its border, half of it outside.
    softness: f32,
}

#[derive(Debug, Clone, Copy)]
enum Outline {
    Rectangle,
    Ellipse,
    /// Pointed at both ends, its length turned clockwise by these radians.
    Leaf(f32),
}

impl Shape {
    fn rectangle(centre: [f32; 2], half: [f32; 2]) -> Self {
        let (top, bottom) = ([0.0; 3], [0.0; 3]);
        Self { centre, half, outline: Outline::Rectangle, top, bottom, opacity: 1.0, softness: 0.0 }
    }

    fn ellipse(centre: [f32; 2], half: [f32; 2]) -> Self {
        Self { outline: Outline::Ellipse, ..Self::rectangle(centre, half) }
    }

    fn leaf(centre: [f32; 2], half: [f32; 2], turn: f32) -> Self {
        Self { outline: Outline::Leaf(turn), ..Self::rectangle(centre, half) }
    }

    fn coloured(&self, top: Colour, bottom: Colour) -> Self {
        Self { top, bottom, ..self.clone() }
    }

    fn opaque(self, opacity: f32) -> Self {
        Self { opacity, ..self }
    }

    fn soft(self, softness: f32) -> Self {
        Self { softness, ..self }
    }

    /// Distance of a place outside of the border, about; negative inside.
    fn distance(&self, offset: [f32; 2]) -> f32 {
        let [x, y] = [0, 1].map(|axis| offset[axis].abs());
        let [a, b] = self.half;
        match self.outline {
            Outline::Rectangle => (x - a).max(y - b),
            Outline::Ellipse => ((x * x / (a * a) + y * y / (b * b)).sqrt() - 1.0) * a.min(b),
            Outline::Leaf(turn) => {
                let (sine, cosine) = (libm::sinf(turn), libm::cosf(turn));
                let along = (offset[0] * cosine + offset[1] * sine) / a;
                (offset[1] * cosine - offset[0] * sine).abs() - b * (1.0 - along * along)
            }
        }
    }

    /// How far it reaches from its centre along an axis.
    fn reach(&self, axis: usize) -> f32 {
        match self.outline {
            Outline::Leaf(_) => self.half[0].max(self.half[1]),
            _ => self.half[axis],
        }
    }
}

struct Canvas {
    width: usize,
    height: usize,
    look: Look,
    pixels: Vec<Colour>,
}

impl Canvas {
    fn new(width: usize, height: usize, look: Look) -> Self {
        Self { width, height, look, pixels: vec![[0.0; 3]; width * height] }
    }

    /// Half of the width, in heights.
    fn half_width(&self) -> f32 {
        0.5 * self.width as f32 / self.height as f32
    }

    /// Changes every pixel by its colour and place.
    fn each(&mut self, change: impl Fn(Colour, [f32; 2]) -> Colour + Sync) {
        let (scale, half_width) = (1.0 / self.height as f32, self.half_width());
        self.pixels.par_chunks_mut(self.width).enumerate().for_each(|(y, row)| {
            let down = (y as f32 + 0.5) * scale - 0.5;
            for (x, pixel) in row.iter_mut().enumerate() {
                *pixel = change(*pixel, [(x as f32 + 0.5) * scale - half_width, down]);
            }
        });
    }

    fn paint(&mut self, shape: &Shape) {
        let pitch = 1.0 / self.height as f32;
        let half_width = self.half_width();
        let softness = shape.softness.max(pitch);
        // The pixels from and to which a shape reaches along one axis.
        let span = |axis: usize, half: f32, len: usize| {
            let reach = shape.reach(axis) + 0.5 * softness;
            let place = |at: f32| ((at + half) / pitch).clamp(0.0, len as f32) as usize;
            place(shape.centre[axis] - reach)..(place(shape.centre[axis] + reach) + 1).min(len)
        };
        let columns = span(0, half_width, self.width);
        for y in span(1, 0.5, self.height) {
            let down = (y as f32 + 0.5) * pitch - 0.5 - shape.centre[1];
            let colour = mixed(shape.top, shape.bottom, (0.5 + 0.5 * down / shape.reach(1)).clamp(0.0, 1.0));
            for x in columns.clone() {
                let across = (x as f32 + 0.5) * pitch - half_width - shape.centre[0];
                let covered = (0.5 - shape.distance([across, down]) / softness).clamp(0.0, 1.0);
                if let Some(pixel) = self.pixels.get_mut(y * self.width + x) {
                    *pixel = mixed(*pixel, colour, covered * shape.opacity);
                }
            }
        }
    }

    fn image(&self) -> Image {
        Image::from_fn(self.width, self.height, |x, y| {
            self.pixels[y * self.width + x].map(|value| (value * 255.0 + 0.5).clamp(0.0, 255.0) as u8)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_are_filled_and_differ_by_scene() {
        let key = Key::new(7);
        let all: Vec<Image> =
            (0..40).map(|scene| procedural(60, 80, key.scene(scene), Look::Second)).collect();
        for (number, image) in all.iter().enumerate() {
            let values = image.pixels().as_flattened();
            let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
            assert!((5.0..250.0).contains(&mean), "{number}: {mean}");
            assert!(image.pixels().iter().any(|pixel| *pixel != image.get(0, 0)), "{number}");
            assert!(!all[..number].contains(image), "{number}");
        }
        assert_eq!(procedural(60, 80, key.scene(3), Look::Second), all[3]);
    }

    #[test]
    fn the_bits_do_not_depend_on_threads() {
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                (0..8)
                    .map(|scene| procedural(90, 130, Key::new(1).scene(scene), Look::Second))
                    .collect::<Vec<_>>()
            })
        };
        assert!(with(1) == with(3));
    }

    #[test]
    fn a_size_shows_the_same_scene() {
        for scene in 0..20 {
            let key = Key::new(2).scene(scene);
            let (small, large) =
                (procedural(60, 80, key, Look::First), procedural(240, 320, key, Look::First));
            let mean = |image: &Image| {
                image.pixels().iter().map(|pixel| f64::from(pixel[1])).sum::<f64>()
                    / image.pixels().len() as f64
            };
            assert!((mean(&small) - mean(&large)).abs() < 4.0, "{scene}");
        }
    }
}

//! The losses of JPEG compression, without a file: chroma of half the resolution, and 8x8 blocks of cosine coefficients, rounded to
//! multiples of the tables in ITU-T T.81, annex K, which are scaled by a quality as in libjpeg. Coding the coefficients is
//! lossless and left out. The arithmetic of a codec may differ between processors; this one's does not.

use rayon::prelude::*;
use srflow_core::{Image, LUMA, Size};

/// Side of a block.
const SIDE: usize = 8;

/// Steps of the coefficients at quality 50, by rows of growing vertical frequency: table K.1.
const LUMA_STEPS: [u16; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, //
    12, 12, 14, 19, 26, 58, 60, 55, //
    14, 13, 16, 24, 40, 57, 69, 56, //
    14, 17, 22, 29, 51, 87, 80, 62, //
    18, 22, 37, 56, 68, 109, 103, 77, //
    24, 35, 55, 64, 81, 104, 113, 92, //
    49, 64, 78, 87, 103, 121, 120, 101, //
    72, 92, 95, 98, 112, 100, 103, 99,
];

/// Table K.2.
const CHROMA_STEPS: [u16; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, //
    18, 21, 26, 66, 99, 99, 99, 99, //
    24, 26, 56, 99, 99, 99, 99, 99, //
    47, 66, 99, 99, 99, 99, 99, 99, //
    99, 99, 99, 99, 99, 99, 99, 99, //
    99, 99, 99, 99, 99, 99, 99, 99, //
    99, 99, 99, 99, 99, 99, 99, 99, //
    99, 99, 99, 99, 99, 99, 99, 99,
];

/// Replaces a picture by what JPEG of `quality` 1 to 100 leaves of it.
pub fn compress(image: &mut Image, quality: u8) {
    let Size { width, height } = image.size();
    if width == 0 || height == 0 {
        return;
    }
    let mut luma = Channel::new(width, height, |x, y| ycc(image.get(x, y))[0]);
    let mut chroma = [1, 2].map(|channel| halved(image, channel));
    luma.quantize(&scaled(&LUMA_STEPS, quality));
    for chroma in &mut chroma {
        chroma.quantize(&scaled(&CHROMA_STEPS, quality));
    }
    let [blue, red] = &chroma;
    image.pixels_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            *pixel = rgb([luma.get(x, y), blue.doubled(x, y), red.doubled(x, y)]);
        }
    });
}

/// Steps at a quality.
fn scaled(steps: &[u16; 64], quality: u8) -> [f32; 64] {
    let quality = u32::from(quality.clamp(1, 100));
    let percent = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    steps.map(|step| ((u32::from(step) * percent + 50) / 100).clamp(1, 255) as f32)
}

/// One channel, filled up to whole blocks by its last row and column.
struct Channel {
    width: usize,
    height: usize,
    /// Width of the filled rows.
    stride: usize,
    values: Vec<u8>,
}

impl Channel {
    fn new(width: usize, height: usize, value: impl Fn(usize, usize) -> u8 + Sync) -> Self {
        let (stride, rows) = (width.next_multiple_of(SIDE), height.next_multiple_of(SIDE));
        let mut values = vec![0; stride * rows];
        values.par_chunks_mut(stride).enumerate().for_each(|(y, row)| {
            for (x, place) in row.iter_mut().enumerate() {
                *place = value(x.min(width - 1), y.min(height - 1));
            }
        });
        Self { width, height, stride, values }
    }

    fn get(&self, x: usize, y: usize) -> u8 {
        self.values[y * self.stride + x]
    }

    /// The value at a pixel of twice the resolution: bilinear between the centres of the four values around it, as in libjpeg.
    fn doubled(&self, x: usize, y: usize) -> u8 {
        let (near_x, far_x) = neighbours(x, self.width);
        let (near_y, far_y) = neighbours(y, self.height);
        let value = |x, y| u32::from(self.get(x, y));
        let sum = 9 * value(near_x, near_y) + 3 * (value(far_x, near_y) + value(near_x, far_y));
        ((sum + value(far_x, far_y) + 8) / 16) as u8
    }

    /// Rounds the cosine coefficients of every block to multiples of `steps`.
    fn quantize(&mut self, steps: &[f32; 64]) {
        let cosines = cosines();
        let stride = self.stride;
        self.values.par_chunks_mut(SIDE * stride).for_each(|rows| {
            for left in (0..stride).step_by(SIDE) {
                let mut block = [[0.0; SIDE]; SIDE];
                for (line, row) in block.iter_mut().zip(rows.chunks(stride)) {
                    for (value, &level) in line.iter_mut().zip(&row[left..]) {
                        *value = f32::from(level) - 128.0;
                    }
                }
                let mut coefficients = product(&product(&cosines, &block), &transposed(&cosines));
                for (value, step) in coefficients.as_flattened_mut().iter_mut().zip(steps) {
                    *value = (*value / step).round() * step;
                }
                let block = product(&product(&transposed(&cosines), &coefficients), &cosines);
                for (line, row) in block.iter().zip(rows.chunks_mut(stride)) {
                    for (value, level) in line.iter().zip(&mut row[left..]) {
                        *level = (value + 128.5).clamp(0.0, 255.0) as u8;
                    }
                }
            }
        });
    }
}

/// The halved value that a pixel lies in, and the other one that it is closest to.
fn neighbours(place: usize, len: usize) -> (usize, usize) {
    let near = place / 2;
    let far = if place.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(len - 1) };
    (near, far)
}

/// Blue or red chroma, averaged over squares of 2x2 pixels.
fn halved(image: &Image, channel: usize) -> Channel {
    let Size { width, height } = image.size();
    Channel::new(width.div_ceil(2), height.div_ceil(2), |x, y| {
        let of = |dx: usize, dy: usize| {
            let pixel = image.get((2 * x + dx).min(width - 1), (2 * y + dy).min(height - 1));
            u32::from(ycc(pixel)[channel])
        };
        ((of(0, 0) + of(1, 0) + of(0, 1) + of(1, 1) + 2) / 4) as u8
    })
}

type Block = [[f32; SIDE]; SIDE];

/// The orthonormal cosine transform: coefficients from values, by rows of growing frequency.
fn cosines() -> Block {
    std::array::from_fn(|frequency| {
        let scale = if frequency == 0 { 0.125_f64.sqrt() } else { 0.5 };
        std::array::from_fn(|place| {
            let angle = (2 * place + 1) as f64 * frequency as f64 * std::f64::consts::PI / 16.0;
            (scale * libm::cos(angle)) as f32
        })
    })
}

fn transposed(block: &Block) -> Block {
    std::array::from_fn(|row| std::array::from_fn(|column| block[column][row]))
}

fn product(a: &Block, b: &Block) -> Block {
    let mut product = [[0.0; SIDE]; SIDE];
    for (line, a) in product.iter_mut().zip(a) {
        for (factor, b) in a.iter().zip(b) {
            for (value, b) in line.iter_mut().zip(b) {
                *value += factor * b;
            }
        }
    }
    product
}

/// Luma, blue and red chroma of sRGB, as in JFIF.
fn ycc([red, green, blue]: [u8; 3]) -> [u8; 3] {
    let [red, green, blue] = [red, green, blue].map(f32::from);
    [
        LUMA[0] * red + LUMA[1] * green + LUMA[2] * blue,
        -0.168_735_9 * red - 0.331_264_1 * green + 0.5 * blue + 128.0,
        0.5 * red - 0.418_687_6 * green - 0.081_312_4 * blue + 128.0,
    ]
    .map(|value| (value + 0.5).clamp(0.0, 255.0) as u8)
}

fn rgb([luma, blue, red]: [u8; 3]) -> [u8; 3] {
    let (luma, blue, red) = (f32::from(luma), f32::from(blue) - 128.0, f32::from(red) - 128.0);
    [luma + 1.402 * red, luma - 0.344_136_3 * blue - 0.714_136_3 * red, luma + 1.772 * blue]
        .map(|value| (value + 0.5).clamp(0.0, 255.0) as u8)
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;

    use super::*;

    fn compressed(image: &Image, quality: u8) -> Image {
        let mut image = image.clone();
        compress(&mut image, quality);
        image
    }

    /// Root mean square over all values, in levels.
    fn difference(a: &Image, b: &Image) -> f64 {
        let values = a.pixels().as_flattened().iter().zip(b.pixels().as_flattened());
        let sum: f64 = values.clone().map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
        (sum / values.len() as f64).sqrt()
    }

    /// Shapes with noise, of a size that is no multiple of the blocks.
    fn sample() -> Image {
        let mut stream = Key::new(2).stream("test");
        Image::from_fn(45, 37, |x, y| {
            let inside = (x as i32 - 20).pow(2) + (y as i32 - 15).pow(2) < 120;
            let base = if inside { [210.0, 150.0, 120.0] } else { [40.0 + x as f32, 70.0, 90.0 + y as f32] };
            base.map(|value| (value + 4.0 * stream.normal()).clamp(0.0, 255.0) as u8)
        })
    }

    #[test]
    fn the_error_grows_as_the_quality_falls() {
        let image = sample();
        let errors = [95, 80, 60, 40, 20, 5].map(|quality| difference(&image, &compressed(&image, quality)));
        assert!(errors.is_sorted() && errors[0] > 0.5 && errors[5] > 8.0, "{errors:?}");
    }

    #[test]
    fn a_flat_picture_stays_flat() {
        for quality in [1, 10, 50, 90] {
            for color in [[128; 3], [255; 3], [0; 3], [200, 30, 90]] {
                let after = compressed(&Image::filled(30, 21, color), quality);
                assert!(after.pixels().iter().all(|pixel| *pixel == after.get(0, 0)), "{quality} {color:?}");
            }
        }
        // The mean of a block is the lowest coefficient over 8, whose step at this quality is 16.
        let grey = compressed(&Image::filled(16, 16, [77; 3]), 50).get(3, 3);
        assert!(grey.iter().all(|value| value.abs_diff(77) <= 1), "{grey:?}");
    }

    #[test]
    fn compressing_again_changes_little() {
        let once = compressed(&sample(), 30);
        let twice = compressed(&once, 30);
        assert!(difference(&once, &twice) < 0.25 * difference(&sample(), &once));
    }

    #[test]
    fn blocks_show_at_their_borders_alone() {
        // A slope: at low quality each block keeps its mean and the first frequency at most.
        let slope = Image::from_fn(64, 8, |x, _| [(20 + x) as u8; 3]);
        let after = compressed(&slope, 3);
        let step = |x: usize| i32::from(after.get(x, 4)[0]) - i32::from(after.get(x - 1, 4)[0]);
        let steps: Vec<i32> = (1..64).map(step).collect();
        let (borders, inside): (Vec<_>, Vec<_>) = (1..64).zip(steps).partition(|(x, _)| *x % SIDE == 0);
        let sum = |steps: Vec<(usize, i32)>| steps.iter().map(|(_, step)| step.abs()).sum::<i32>();
        assert!(sum(borders) > sum(inside));
    }
}

//! Blur by a lens out of focus, and by motion while the shutter is open.
//!
//! Light adds up, coded values do not: pictures are averaged as the squares of their values, which is the light of a display
//! with gamma 2. Squares and their sums are integers, and the square root is exact, so the bits are the same everywhere.

use rayon::prelude::*;
use srflow_core::{Image, Size};

/// Rows that a thread blurs at a time.
const BAND: usize = 64;

/// Discs of a smaller radius, in pixels, do not reach the next pixel.
const LEAST_RADIUS: f32 = 0.5;

/// Spreads every pixel over a disc of `radius` pixels. Pixels at the disc's edge count by the share of them, to first order,
/// that it covers. Outside of the picture its border goes on.
pub fn defocus(image: &mut Image, radius: f32) {
    let Size { width, height } = image.size();
    if radius <= LEAST_RADIUS || width == 0 || height == 0 {
        return;
    }
    let disc = Disc::new(radius);
    let sharp = image.clone();
    image.pixels_mut().par_chunks_mut(BAND * width).enumerate().for_each(|(band, pixels)| {
        let top = (band * BAND) as isize;
        let rows = pixels.len() / width;
        let sums: Vec<Vec<[u32; 3]>> = (top - disc.reach..top + rows as isize + disc.reach)
            .map(|y| running_sums(sharp.row(y.clamp(0, height as isize - 1) as usize), disc.reach))
            .collect();
        for (row, line) in pixels.chunks_mut(width).enumerate() {
            for (x, pixel) in line.iter_mut().enumerate() {
                let light = disc.mean(&sums[row..], x);
                *pixel = light.map(|light| (light.sqrt() + 0.5) as u8);
            }
        }
    });
}

/// The mean light of pictures of one size.
#[derive(Debug, Clone, Default)]
pub struct Exposure {
    /// Sums of squares; at most 2^16 pictures.
    light: Vec<[u32; 3]>,
    pictures: u32,
}

impl Exposure {
    pub fn add(&mut self, image: &Image) {
        self.light.resize(image.pixels().len(), [0; 3]);
        for (light, pixel) in self.light.iter_mut().zip(image.pixels()) {
            for (light, &value) in light.iter_mut().zip(pixel) {
                *light += u32::from(value) * u32::from(value);
            }
        }
        self.pictures += 1;
    }

    /// Replaces a picture of the same size by the mean of those added, and starts again.
    pub fn develop(&mut self, image: &mut Image) {
        let pictures = self.pictures.max(1) as f32;
        for (light, pixel) in self.light.iter().zip(image.pixels_mut()) {
            *pixel = light.map(|light| ((light as f32 / pictures).sqrt() + 0.5) as u8);
        }
        self.light.clear();
        self.pictures = 0;
    }
}

/// The weights of a disc, by row: ones in the middle, fractions at its edge.
struct Disc {
    /// Rows and columns from the centre to the farthest pixel.
    reach: isize,
    rows: Vec<DiscRow>,
    total: f32,
}

struct DiscRow {
    /// Columns from the centre to the farthest pixel of weight 1; negative if there is none.
    whole: isize,
    /// Columns of smaller weights, to both sides of the centre.
    edge: Vec<(isize, f32)>,
}

impl Disc {
    fn new(radius: f32) -> Self {
        let reach = (radius + 0.5).ceil() as isize - 1;
        let rows = (-reach..=reach).map(|y| {
            let weights = (0..=reach).map(|x| weight(radius, x, y));
            let whole = weights.clone().take_while(|&weight| weight >= 1.0).count() as isize - 1;
            let edge = (0..).zip(weights).filter(|&(x, weight)| x > whole && weight > 0.0);
            let both =
                |(x, weight): (isize, f32)| [(-x, weight), (x, weight)].into_iter().skip(usize::from(x == 0));
            DiscRow { whole, edge: edge.flat_map(both).collect() }
        });
        let rows: Vec<DiscRow> = rows.collect();
        let of_row = |row: &DiscRow| {
            (2 * row.whole + 1).max(0) as f32 + row.edge.iter().map(|(_, weight)| weight).sum::<f32>()
        };
        let total = rows.iter().map(of_row).sum();
        Self { reach, rows, total }
    }

    /// The mean light around column `x`, from the running sums of the rows that the disc covers.
    fn mean(&self, sums: &[Vec<[u32; 3]>], x: usize) -> [f32; 3] {
        let mut light = [0.0_f32; 3];
        for (row, sums) in self.rows.iter().zip(sums) {
            // `sums[i]` is of the columns before `i - reach`.
            let column = |offset: isize| (x as isize + self.reach + offset) as usize;
            if row.whole >= 0 {
                let (before, after) = (sums[column(-row.whole)], sums[column(row.whole + 1)]);
                for channel in 0..3 {
                    light[channel] += (after[channel] - before[channel]) as f32;
                }
            }
            for &(offset, weight) in &row.edge {
                let (before, after) = (sums[column(offset)], sums[column(offset + 1)]);
                for channel in 0..3 {
                    light[channel] += weight * (after[channel] - before[channel]) as f32;
                }
            }
        }
        light.map(|light| light / self.total)
    }
}

/// Weight of the pixel `x` columns and `y` rows from the centre.
fn weight(radius: f32, x: isize, y: isize) -> f32 {
    let distance = ((x * x + y * y) as f32).sqrt();
    (radius + 0.5 - distance).clamp(0.0, 1.0)
}

/// Sums of the squares of all pixels before each, with `reach` more pixels at both ends.
fn running_sums(row: &[[u8; 3]], reach: isize) -> Vec<[u32; 3]> {
    let last = row.len() as isize - 1;
    let mut sum = [0_u32; 3];
    let mut sums = vec![sum];
    for x in -reach..=last + reach {
        let pixel = row[x.clamp(0, last) as usize];
        for channel in 0..3 {
            sum[channel] += u32::from(pixel[channel]) * u32::from(pixel[channel]);
        }
        sums.push(sum);
    }
    sums
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;

    use super::*;

    fn blurred(mut image: Image, radius: f32) -> Image {
        defocus(&mut image, radius);
        image
    }

    fn random(width: usize, height: usize) -> Image {
        let mut stream = Key::new(5).stream("test");
        Image::from_fn(width, height, |_, _| [0; 3].map(|_| stream.below(256) as u8))
    }

    /// The definition: a weighted mean over the neighbourhood.
    fn slowly_blurred(image: &Image, radius: f32) -> Image {
        let reach = radius.ceil() as isize + 1;
        let at = |place: isize, len: usize| place.clamp(0, len as isize - 1) as usize;
        Image::from_fn(image.width(), image.height(), |x, y| {
            let (mut light, mut total) = ([0.0_f64; 3], 0.0);
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let weight = f64::from(weight(radius, dx, dy));
                    let pixel =
                        image.get(at(x as isize + dx, image.width()), at(y as isize + dy, image.height()));
                    total += weight;
                    for channel in 0..3 {
                        light[channel] += weight * f64::from(pixel[channel]).powi(2);
                    }
                }
            }
            light.map(|light| ((light / total).sqrt() + 0.5) as u8)
        })
    }

    #[test]
    fn the_fast_blur_is_the_weighted_mean() {
        for (width, height, radius) in [(40, 30, 0.7), (33, 90, 1.5), (70, 9, 2.9), (20, 140, 7.3)] {
            let image = random(width, height);
            let (fast, slow) = (blurred(image.clone(), radius), slowly_blurred(&image, radius));
            let pairs = fast.pixels().as_flattened().iter().zip(slow.pixels().as_flattened());
            let differing = pairs.clone().filter(|(a, b)| a != b).count();
            assert!(pairs.clone().all(|(a, b)| a.abs_diff(*b) <= 1), "{radius}");
            assert!(differing * 1000 <= 3 * width * height, "{radius}: {differing}");
        }
    }

    #[test]
    fn an_exposure_is_the_mean_light() {
        let mut exposure = Exposure::default();
        for _ in 0..2 {
            for value in [10, 90, 90, 200] {
                exposure.add(&Image::filled(3, 2, [value, 77, 255]));
            }
            let mut mean = Image::new(3, 2);
            exposure.develop(&mut mean);
            // The root of (100 + 2 * 8100 + 40000) / 4.
            assert_eq!(mean, Image::filled(3, 2, [119, 77, 255]));
        }
    }

    #[test]
    fn blur_keeps_flat_pictures_and_the_mean_light() {
        let flat = Image::filled(50, 40, [200, 3, 77]);
        assert_eq!(blurred(flat.clone(), 4.0), flat);
        let image = random(50, 40);
        assert_eq!(blurred(image.clone(), 0.4), image);

        let dot = Image::from_fn(64, 64, |x, y| if (x, y) == (30, 33) { [255; 3] } else { [90; 3] });
        let light = |image: &Image| -> f64 {
            image.pixels().iter().map(|pixel| f64::from(pixel[1]).powi(2)).sum::<f64>() / 4096.0
        };
        for radius in [1.0, 2.5] {
            let spread = blurred(dot.clone(), radius);
            assert!((light(&spread) - light(&dot)).abs() < 0.3, "{} {}", light(&spread), light(&dot));
            assert!(spread.get(30, 33)[0] < 200 && spread.get(30, 34)[0] > 95);
            assert_eq!(spread.get(30 + radius as usize + 2, 33), [90; 3]);
        }
    }
}

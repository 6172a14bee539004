//! `.sog` files of PlayCanvas (playcanvas/splat-transform, `src/lib/readers/read-sog.ts` and `read-sog-v1.ts`): a zip file of `meta.json`
//! and lossless WebP pictures with a pixel for each Gaussian, row by row.
//!
//! | entry | its pixels are |
//! |---|---|
//! | `means` | lower and upper byte of each position, between limits, as `sign(x) ln(1 + abs(x))` |
//! | `quats` | three parts of the quaternion w, x, y, z in -1..=1 times `sqrt(2)`, and 252 and the number of the largest |
//! | `scales` | numbers in a list of logarithms of scales; in version 1, `u8` between limits |
//! | `sh0` | numbers in a list of coefficients, and the opacity; in version 1, `u8` between limits, of opacity its logit |
//! | `shN` | numbers in a list of `centroids`, 64 in a row, and each Gaussian's centroid (`labels`, two bytes) |

use std::path::Path;

use glam::Vec3;
use serde::Deserialize;
use srflow_core::Size;
use srflow_files::{
    FileError, FileKind, FileProblem, open_zip, parse_error_in_words, read_file, rgba_of_image, zip_entry,
};

use super::{check, problem, room_for, unit_rotation};
use crate::Gaussians;

/// The format in errors.
const SOG: &str = "a .sog file";

/// Largest entry, of which `meta.json` takes 20 kB and a picture a few bytes a pixel.
const MAX_ENTRY: u64 = 1 << 30;
/// Most Gaussians in any file, and per byte: real ones take ten bytes each.
const COUNT_IN_ANY_FILE: u64 = 1 << 16;
/// The first number of a quaternion's picture.
const LARGEST_IS_W: u8 = 252;
/// Coefficients of degree 1 and above by degree.
const HIGHER: [usize; 4] = [0, 3, 8, 15];
/// Centroids in a row of their picture.
const CENTROIDS: usize = 64;

#[derive(Deserialize)]
struct Meta {
    /// None in version 1.
    version: Option<u32>,
    count: Option<u64>,
    means: Means,
    scales: Levels,
    quats: Rotations,
    sh0: Levels,
    #[serde(rename = "shN")]
    sh_n: Option<Higher>,
}

#[derive(Deserialize)]
struct Rotations {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Means {
    /// In version 1: number of Gaussians, and 3.
    shape: Option<[u64; 2]>,
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Deserialize)]
struct Levels {
    codebook: Option<Vec<Option<f64>>>,
    mins: Option<Vec<f64>>,
    maxs: Option<Vec<f64>>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct Higher {
    bands: Option<usize>,
    codebook: Option<Vec<Option<f64>>>,
    mins: Option<f64>,
    maxs: Option<f64>,
    files: [String; 2],
}

/// Reads versions 1 and 2.
pub(super) fn read(path: &Path) -> Result<Gaussians, FileError> {
    decode(read_file(path, FileKind::Splats)?).map_err(|problem| problem.in_file(path))
}

fn decode(bytes: Vec<u8>) -> Result<Gaussians, FileProblem> {
    let most = COUNT_IN_ANY_FILE.max(bytes.len() as u64);
    let mut archive = open_zip(bytes)?;
    let meta = zip_entry(&mut archive, "meta.json", SOG, MAX_ENTRY)?;
    let meta: Meta = serde_json::from_slice(&meta)
        .map_err(|error| problem("meta.json", "that of a .sog file", parse_error_in_words(&error)))?;
    if let Some(version) = meta.version.filter(|version| *version != 2) {
        return Err(problem("version", "1 or 2", version));
    }
    let count = meta.count.or(meta.means.shape.map(|[count, _]| count));
    let count = count.ok_or_else(|| problem("count", "the number of Gaussians", "none"))?;
    if count > most {
        return Err(problem("count", format!("at most {most}, by the size of the file"), count));
    }
    let mut pixels = |name: &str| -> Result<Picture, FileProblem> {
        let (Size { width, height }, pixels) =
            rgba_of_image(&zip_entry(&mut archive, name, SOG, MAX_ENTRY)?)?;
        Ok(Picture { width, height, pixels })
    };
    let mut of_all = |name: &str| {
        let picture = pixels(name)?;
        if (picture.pixels.len() as u64) < count {
            let found = format!("{} pixels in {name}", picture.pixels.len());
            return Err(problem("picture", format!("one pixel for each of {count} Gaussians"), found));
        }
        Ok(picture.pixels)
    };
    let [low, high] = [of_all(&meta.means.files[0])?, of_all(&meta.means.files[1])?];
    let quats = of_all(&meta.quats.files[0])?;
    let scales = of_all(&meta.scales.files[0])?;
    let colors = of_all(&meta.sh0.files[0])?;
    let of_scales = Decoder::of("scales", &meta.scales, 3)?;
    let of_colors = Decoder::of("sh0", &meta.sh0, 4)?;
    let higher = match &meta.sh_n {
        Some(sh_n) => {
            let labels = of_all(&sh_n.files[1])?;
            Some(Palette::new(sh_n, pixels(&sh_n.files[0])?, labels)?)
        }
        None => None,
    };

    let degree = higher.as_ref().map_or(0, |higher| higher.degree);
    let mut gaussians = room_for(count, degree)?;
    for at in 0..count as usize {
        let position = std::array::from_fn(|axis| {
            let part = f64::from(u16::from_le_bytes([low[at][axis], high[at][axis]])) / 65535.0;
            let (min, max) = (meta.means.mins[axis], meta.means.maxs[axis]);
            let folded = min + part * (max - min);
            (folded.abs().exp_m1() * folded.signum()) as f32
        });
        gaussians.positions.push(Vec3::from_array(position));
        let scale = std::array::from_fn(|axis| of_scales.value(axis, scales[at][axis]).exp() as f32);
        gaussians.scales.push(Vec3::from_array(scale));
        gaussians.rotations.push(unit_rotation(rotation(quats[at], at)?, at)?);
        let [.., opacity] = colors[at];
        let opacity = match &of_colors {
            Decoder::Codebook(_) => f64::from(opacity) / 255.0,
            Decoder::Range(_) => 1.0 / (1.0 + (-of_colors.value(3, opacity)).exp()),
        };
        gaussians.opacities.push(opacity as f32);
        gaussians
            .sh
            .push(std::array::from_fn(|channel| of_colors.value(channel, colors[at][channel]) as f32));
        if let Some(higher) = &higher {
            higher.push(&mut gaussians.sh, at)?;
        }
    }
    check(&gaussians)?;
    Ok(gaussians)
}

struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 4]>,
}

/// x, y, z, w.
fn rotation([a, b, c, largest]: [u8; 4], index: usize) -> Result<[f64; 4], FileProblem> {
    let which = largest.checked_sub(LARGEST_IS_W).ok_or_else(|| {
        problem("quats", "252 to 255 in the alpha of each pixel", format!("{largest} of Gaussian {index}"))
    })?;
    let others = [a, b, c].map(|byte| (f64::from(byte) / 255.0 * 2.0 - 1.0) / std::f64::consts::SQRT_2);
    let rest = (1.0 - others.iter().map(|part| part * part).sum::<f64>()).max(0.0).sqrt();
    let mut others = others.into_iter();
    let [w, x, y, z] =
        std::array::from_fn(
            |at| {
                if at == usize::from(which) { rest } else { others.next().unwrap_or_default() }
            },
        );
    Ok([x, y, z, w])
}

/// The numbers that bytes stand for.
enum Decoder {
    Codebook(Vec<f64>),
    /// Version 1: the numbers of 0 and 255 in each channel.
    Range(Vec<[f64; 2]>),
}

impl Decoder {
    fn of(field: &'static str, levels: &Levels, channels: usize) -> Result<Self, FileProblem> {
        let range = match (&levels.mins, &levels.maxs) {
            (Some(mins), Some(maxs)) if mins.len() >= channels && maxs.len() >= channels => {
                Some(mins.iter().zip(maxs).map(|(min, max)| [*min, *max]).collect())
            }
            _ => None,
        };
        Self::new(field, levels.codebook.as_deref(), range)
    }

    fn new(
        field: &'static str,
        codebook: Option<&[Option<f64>]>,
        range: Option<Vec<[f64; 2]>>,
    ) -> Result<Self, FileProblem> {
        let Some(codebook) = codebook else {
            return range
                .map(Self::Range)
                .ok_or_else(|| problem(field, "a codebook, or mins and maxs", "neither"));
        };
        let mut numbers = codebook.to_vec();
        // As playcanvas/engine reads files of a writer that left out the first (`gsplat-sog-data.js`).
        if let [first @ None, Some(second), .., Some(last)] = &mut numbers[..] {
            *first = Some(*second + (*second - *last) / 255.0);
        }
        let numbers: Option<Vec<f64>> = numbers.into_iter().collect();
        numbers
            .filter(|numbers| numbers.len() == 256)
            .map(Self::Codebook)
            .ok_or_else(|| problem(field, "a codebook of 256 numbers", format!("{} entries", codebook.len())))
    }

    fn value(&self, channel: usize, byte: u8) -> f64 {
        match self {
            Self::Codebook(numbers) => numbers[usize::from(byte)],
            Self::Range(ranges) => {
                let [min, max] = ranges[channel];
                min + (max - min) * f64::from(byte) / 255.0
            }
        }
    }
}

/// Coefficients of degree 1 and above.
struct Palette {
    degree: usize,
    centroids: Picture,
    labels: Vec<[u8; 4]>,
    decoder: Decoder,
}

impl Palette {
    fn new(meta: &Higher, centroids: Picture, labels: Vec<[u8; 4]>) -> Result<Self, FileProblem> {
        let degree = HIGHER.iter().position(|coefficients| CENTROIDS * coefficients == centroids.width);
        let degree =
            degree.filter(|degree| meta.bands.is_none_or(|bands| bands == *degree)).ok_or_else(|| {
                let found = format!("{} columns, {:?} bands", centroids.width, meta.bands);
                problem("shN", "a picture of 64 centroids in each row, of 1 to 3 bands", found)
            })?;
        let range = meta.mins.zip(meta.maxs).map(|(min, max)| vec![[min, max]; 3]);
        let decoder = Decoder::new("shN", meta.codebook.as_deref(), range)?;
        Ok(Self { degree, centroids, labels, decoder })
    }

    /// Appends those of a Gaussian.
    fn push(&self, sh: &mut Vec<[f32; 3]>, at: usize) -> Result<(), FileProblem> {
        let [low, high, ..] = self.labels[at];
        let centroid = usize::from(u16::from_le_bytes([low, high]));
        let coefficients = HIGHER[self.degree];
        let start = centroid / CENTROIDS * self.centroids.width + centroid % CENTROIDS * coefficients;
        let pixels = self.centroids.pixels.get(start..start + coefficients).ok_or_else(|| {
            let most = CENTROIDS * self.centroids.height;
            problem("labels", format!("centroids below {most}"), format!("{centroid} of Gaussian {at}"))
        })?;
        sh.extend(pixels.iter().map(|pixel| {
            std::array::from_fn::<_, 3, _>(|channel| self.decoder.value(channel, pixel[channel]) as f32)
        }));
        Ok(())
    }
}

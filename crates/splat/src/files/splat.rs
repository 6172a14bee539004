//! `.splat` files, as written and read by antimatter15/splat (`main.js`, `processPlyBuffer`): 32 bytes per Gaussian and nothing else,
//! little-endian.
//!
//! | bytes | are |
//! |---|---|
//! | 12 | position, `f32` |
//! | 12 | standard deviations, `f32` |
//! | 4 | red, green and blue as sRGB, and the opacity, `u8` |
//! | 4 | the quaternion `w x y z` of length 1, as `128 + 128 q` |
//!
//! The Gaussians come in the order of their volume times opacity, the largest first: viewers show a file while it loads.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

use glam::Vec3;
use srflow_files::{FileError, FileKind, FileProblem, open_file, write_atomically};

use super::{Invisible, check, problem, room_for, unit_rotation};
use crate::{Gaussians, SH_0};

const BYTES: usize = 32;

/// Reads a `.splat` file.
pub(super) fn read(path: &Path) -> Result<Gaussians, FileError> {
    let (file, len) = open_file(path, FileKind::Splats)?;
    let mut invisible = Invisible::default();
    let gaussians = decode(&mut BufReader::with_capacity(1 << 18, file), len, &mut invisible);
    let gaussians = gaussians.map_err(|problem| problem.in_file(path))?;
    invisible.note(path, &gaussians);
    Ok(gaussians)
}

/// Writes a `.splat` file.
pub(super) fn write(path: &Path, gaussians: &Gaussians) -> Result<(), FileError> {
    check(gaussians).map_err(|problem| problem.in_file(path))?;
    write_atomically(path, |writer| encode(gaussians, writer))
}

pub(super) fn decode(
    reader: &mut impl Read,
    len: u64,
    invisible: &mut Invisible,
) -> Result<Gaussians, FileProblem> {
    if len == 0 || !len.is_multiple_of(BYTES as u64) {
        let expected = "a multiple of 32 bytes, one Gaussian each (.splat of antimatter15)";
        return Err(problem("file size", expected, format!("{len} bytes")));
    }
    let count = len / BYTES as u64;
    let mut gaussians = room_for(count, 0)?;
    let mut bytes = [0; BYTES];
    for _ in 0..count {
        reader.read_exact(&mut bytes).map_err(FileProblem::reading)?;
        push(&mut gaussians, &bytes, invisible)?;
    }
    Ok(gaussians)
}

fn push(
    gaussians: &mut Gaussians,
    bytes: &[u8; BYTES],
    invisible: &mut Invisible,
) -> Result<(), FileProblem> {
    let index = gaussians.len();
    let number = |at: usize| f32::from_le_bytes(std::array::from_fn(|byte| bytes[4 * at + byte]));
    let position = Vec3::new(number(0), number(1), number(2));
    let scale = Vec3::new(number(3), number(4), number(5));
    if !position.is_finite() || !scale.is_finite() {
        invisible.push(gaussians);
        return Ok(());
    }
    if !scale.cmpge(Vec3::ZERO).all() {
        let expected = "lengths, not negative (is it a .splat of antimatter15?)";
        return Err(problem("scale", expected, format!("{scale} of Gaussian {index}")));
    }
    let color = [24, 25, 26].map(|at| ((f64::from(bytes[at]) / 255.0 - 0.5) / SH_0) as f32);
    let [w, x, y, z] = [28, 29, 30, 31].map(|at| (f64::from(bytes[at]) - 128.0) / 128.0);
    gaussians.rotations.push(unit_rotation([x, y, z, w], index)?);
    gaussians.positions.push(position);
    gaussians.scales.push(scale);
    gaussians.opacities.push(f32::from(bytes[27]) / 255.0);
    gaussians.sh.push(color);
    Ok(())
}

pub(super) fn encode(gaussians: &Gaussians, writer: &mut BufWriter<File>) -> io::Result<()> {
    let importance: Vec<f32> = gaussians
        .scales
        .iter()
        .zip(&gaussians.opacities)
        .map(|(scale, opacity)| {
            let [a, b, c] = scale.to_array().map(f64::from);
            (a * b * c * f64::from(*opacity)) as f32
        })
        .collect();
    let mut order: Vec<usize> = (0..gaussians.len()).collect();
    order.sort_by(|a, b| importance[*b].total_cmp(&importance[*a]));
    // As JavaScript's Uint8ClampedArray: halves go to the even number.
    let byte = |value: f64| value.round_ties_even() as u8;
    for index in order {
        let (position, scale) = (gaussians.positions[index], gaussians.scales[index]);
        for number in position.to_array().into_iter().chain(scale.to_array()) {
            writer.write_all(&number.to_le_bytes())?;
        }
        let color = gaussians.sh[index * gaussians.sh_len()];
        let [r, g, b] = color.map(|channel| byte((0.5 + SH_0 * f64::from(channel)) * 255.0));
        let rotation = gaussians.rotations[index].as_dquat().normalize();
        let [x, y, z, w] = rotation.to_array().map(|part| byte(part * 128.0 + 128.0));
        writer.write_all(&[r, g, b, byte(f64::from(gaussians.opacities[index]) * 255.0), w, x, y, z])?;
    }
    Ok(())
}

//! Middlebury `.flo`: `PIEH`, width and height as little-endian `i32`, then `u v` of every pixel, row-major, as
//! little-endian `f32`. A pixel with a component beyond 1e9 is unknown. (Baker et al., *A Database and Evaluation
//! Methodology for Optical Flow*, IJCV 2011; `flowIO.cpp` of the Middlebury flow code.)

use std::io::{self, Read, Write};

use super::checks::{check_pixels, quote};
use super::claim::{blank, check_end, check_size};
use super::samples::{Endian, Sample, read_samples, write_f32_little_endian};
use crate::FileProblem;
use srflow_core::{FlowField, Size};

/// The little-endian `f32` 202021.25.
pub(super) const MAGIC: &[u8] = b"PIEH";

const HEADER_BYTES: u64 = 12;

/// Larger components mark unknown flow.
const UNKNOWN_BEYOND: f32 = 1e9;

/// Value written for unknown components.
const UNKNOWN: f32 = 1e10;

/// Also returns how many bytes follow the flow.
pub(super) fn decode(reader: &mut dyn Read, len: u64) -> Result<(FlowField, u64), FileProblem> {
    if len < HEADER_BYTES {
        return Err(FileProblem::field("header", "12 bytes", format!("a file of {len} bytes")));
    }
    let mut magic = [0; 4];
    reader.read_exact(&mut magic).map_err(FileProblem::reading)?;
    if magic != MAGIC {
        return Err(FileProblem::field("magic", "\"PIEH\", the start of a .flo file", quote(&magic)));
    }
    let mut size = [0; 8];
    reader.read_exact(&mut size).map_err(FileProblem::reading)?;
    let [w0, w1, w2, w3, h0, h1, h2, h3] = size;
    let width = i32::from_le_bytes([w0, w1, w2, w3]);
    let height = i32::from_le_bytes([h0, h1, h2, h3]);
    let Size { width, height } = check_size(width.into(), height.into())?;
    let more = check_end(HEADER_BYTES + 8 * (width as u64 * height as u64), len, 8 * width as u64)?;

    let mut flow = FlowField::from_buffer(width, height, blank(width * height)?);
    read_samples(reader, Sample::F32(Endian::Little), flow.pixels_mut().as_flattened_mut())?;
    check_pixels(&flow, "finite numbers (beyond 1e9 where the flow is unknown)", |[u, v]| {
        u.is_finite() && v.is_finite()
    })?;
    for pixel in flow.pixels_mut() {
        if pixel[0].abs() > UNKNOWN_BEYOND || pixel[1].abs() > UNKNOWN_BEYOND {
            *pixel = [f32::NAN; 2];
        }
    }
    Ok((flow, more))
}

/// # Errors
/// When a known pixel has a value that marks unknown flow.
pub(super) fn check_range(flow: &FlowField) -> Result<(), FileProblem> {
    check_pixels(flow, "at most 1e9 pixels, beyond which .flo means unknown", |[u, v]| {
        u.is_nan() || (u.abs() <= UNKNOWN_BEYOND && v.abs() <= UNKNOWN_BEYOND)
    })
}

pub(super) fn encode(flow: &FlowField, writer: &mut impl Write) -> io::Result<()> {
    writer.write_all(MAGIC)?;
    for side in [flow.width(), flow.height()] {
        writer.write_all(&(side as i32).to_le_bytes())?; // at most MAX_PIXELS
    }
    let mut row = vec![0.0; 2 * flow.width()];
    for y in 0..flow.height() {
        for (out, value) in row.iter_mut().zip(flow.row(y).as_flattened()) {
            *out = if value.is_nan() { UNKNOWN } else { *value };
        }
        write_f32_little_endian(writer, &row)?;
    }
    Ok(())
}

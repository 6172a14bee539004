//! `.npz16`: flow on a grid of 1/256 px in a NumPy archive, about twenty times smaller than `.flo`.
//!
//! The archive (NumPy reads it by content, whatever its name) has three arrays: `step`, a scalar `f4`, and the `i1` arrays
//! `low` and `high` of shape (2, H, W), `u` first. `256 * high + low` modulo 2^16 are the components in steps, with first each
//! row replaced by its difference to the row above, and then each column by its difference to the one on its left. So, in
//! NumPy:
//!
//! ```text
//! z = np.load("00000.npz16")
//! q = (z["high"] * np.int16(256) + z["low"]).cumsum(1, dtype=np.int16).cumsum(2, dtype=np.int16)
//! flow = q.transpose(1, 2, 0) * z["step"]
//! ```
//!
//! The step is 1/256 px (an error of at most 1/512 px) up to 127.99 px, and the next sufficient power of two for larger flow.
//! A pixel with unknown flow has -32768 in both components.

use std::io::{self, Cursor, Read, Write};

use zip::ZipArchive;

use super::checks::{broken, check_pixels};
use super::claim::{blank, check_deflated, check_size};
use crate::FileProblem;
use srflow_core::{FlowField, Size};

/// The arrays, in file order.
const STEP: &str = "step.npy";
const LOW: &str = "low.npy";
const HIGH: &str = "high.npy";

/// Whether an archive has the arrays of this format.
pub(super) fn is_this(names: &[String]) -> bool {
    [STEP, LOW, HIGH].iter().all(|wanted| names.iter().any(|name| name == wanted))
}

/// The finest step, and the number of steps on either side of zero; the next negative number means unknown.
const FINEST_STEP: f32 = 1.0 / 256.0;
const REACH: f32 = 32_767.0;
const UNKNOWN: i16 = i16::MIN;

/// # Errors
/// Names the first pixel that no step can represent.
pub(super) fn check_range(flow: &FlowField) -> Result<(), FileProblem> {
    check_pixels(flow, "components of at most 1e30 px", |pixel| {
        pixel.iter().all(|x| x.is_nan() || x.abs() <= 1e30)
    })
}

pub(super) fn encode(flow: &FlowField, writer: &mut impl Write) -> io::Result<()> {
    let Size { width, height } = flow.size();
    let step = step_for(flow);
    let (low, high) = residuals(flow, step);
    let mut archive = Archive::new(writer);
    archive.add(STEP, &header("<f4", &[]), &step.to_le_bytes())?;
    archive.add(LOW, &header("|i1", &[2, height, width]), &low)?;
    archive.add(HIGH, &header("|i1", &[2, height, width]), &high)?;
    archive.finish()
}

fn step_for(flow: &FlowField) -> f32 {
    let known = flow.pixels().as_flattened().iter().filter(|component| component.is_finite());
    let greatest = known.fold(0.0_f32, |greatest, component| greatest.max(component.abs()));
    let mut step = FINEST_STEP;
    while greatest > step * REACH {
        step *= 2.0;
    }
    step
}

/// Low and high bytes of the differences, `u` before `v`.
fn residuals(flow: &FlowField, step: f32) -> (Vec<u8>, Vec<u8>) {
    let Size { width, height } = flow.size();
    let (mut low, mut high) = (vec![0; 2 * width * height], vec![0; 2 * width * height]);
    let mut above = vec![[0_i16; 2]; width];
    let mut row = vec![[0_i16; 2]; width];
    for y in 0..height {
        for (steps, pixel) in row.iter_mut().zip(flow.row(y)) {
            *steps = pixel.map(|component| quantize(component, step));
        }
        for component in 0..2 {
            let start = (component * height + y) * width;
            let bytes = low[start..start + width].iter_mut().zip(&mut high[start..start + width]);
            let mut left = 0_i16;
            for ((low, high), (steps, above)) in bytes.zip(row.iter().zip(&above)) {
                let down = steps[component].wrapping_sub(above[component]);
                let residual = down.wrapping_sub(left);
                left = down;
                *low = residual as u8;
                // The low byte is signed, so that small differences leave the high byte at zero.
                *high = (residual.wrapping_add(128) >> 8) as u8;
            }
        }
        std::mem::swap(&mut row, &mut above);
    }
    (low, high)
}

/// Rounds to the nearest step, ties to even.
fn quantize(component: f32, step: f32) -> i16 {
    // Adding and subtracting 1.5 * 2^23 rounds to an integer; the step is a power of two, so its inverse is exact.
    const ROUND: f32 = 12_582_912.0;
    if component.is_finite() { (component * (1.0 / step) + ROUND - ROUND) as i16 } else { UNKNOWN }
}

pub(super) fn decode(archive: &mut ZipArchive<Cursor<Vec<u8>>>) -> Result<FlowField, FileProblem> {
    let step = read_array(archive, STEP, "<f4")?;
    let low = read_array(archive, LOW, "|i1")?;
    let high = read_array(archive, HIGH, "|i1")?;
    let step = match <[u8; 4]>::try_from(&step.bytes[..]).map(f32::from_le_bytes) {
        Ok(step) if step.is_finite() && step > 0.0 && (step * REACH).is_finite() => step,
        Ok(step) => return Err(FileProblem::field("step", "one positive number", step.to_string())),
        Err(_) => {
            let found = format!("{} bytes", step.bytes.len());
            return Err(FileProblem::field("step", "one number of 4 bytes", found));
        }
    };
    let (width, height) = match (&low.shape[..], &high.shape[..]) {
        (&[2, height, width], same) if low.shape == same => (width, height),
        (low, high) => {
            let found = format!("low {low:?}, high {high:?}");
            return Err(FileProblem::field("shape", "(2, H, W) of both low and high", found));
        }
    };
    let mut pixels = blank::<[f32; 2]>(width * height)?;
    let mut above = vec![0_i16; width];
    for component in 0..2 {
        above.fill(0);
        for y in 0..height {
            let start = (component * height + y) * width;
            let bytes = low.bytes[start..start + width].iter().zip(&high.bytes[start..start + width]);
            let row = &mut pixels[y * width..(y + 1) * width];
            let mut left = 0_i16;
            for ((low, high), (pixel, above)) in bytes.zip(row.iter_mut().zip(&mut above)) {
                let residual = i16::from(*high as i8).wrapping_mul(256).wrapping_add(i16::from(*low as i8));
                left = left.wrapping_add(residual);
                *above = above.wrapping_add(left);
                pixel[component] = if *above == UNKNOWN { f32::NAN } else { f32::from(*above) * step };
            }
        }
    }
    // One unknown component makes both unknown.
    for pixel in pixels.iter_mut().filter(|[u, v]| u.is_nan() != v.is_nan()) {
        *pixel = [f32::NAN; 2];
    }
    FlowField::from_pixels(width, height, pixels)
        .map_err(|error| FileProblem::field("shape", "(2, H, W)", error.to_string()))
}

struct RawArray {
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

/// Reads an array of type `descr`, with its shape checked against the array's size in the archive.
fn read_array(
    archive: &mut ZipArchive<Cursor<Vec<u8>>>,
    name: &'static str,
    descr: &str,
) -> Result<RawArray, FileProblem> {
    let mut entry = archive.by_name(name).map_err(broken)?;
    let size = entry.size();
    check_deflated(size, entry.compressed_size())?;
    let mut start = [0; 10];
    entry.read_exact(&mut start).map_err(FileProblem::reading)?;
    let length = u16::from_le_bytes([start[8], start[9]]);
    let mut header = vec![0; usize::from(length)];
    entry.read_exact(&mut header).map_err(FileProblem::reading)?;
    let shape = parse_header(&start, &header, descr).ok_or_else(|| {
        let found = header.escape_ascii().to_string();
        FileProblem::field(name, format!("a version 1 header of a C-ordered array of {descr}"), found)
    })?;
    let pixels = match shape[..] {
        [2, height, width] => {
            let side = |side| i64::try_from(side).unwrap_or(i64::MAX);
            2 * check_size(side(width), side(height))?.pixels()
        }
        _ => 4,
    };
    let promised = pixels as u64 + 10 + u64::from(length);
    if promised != size {
        let expected = format!("{promised} bytes according to its shape {shape:?}");
        return Err(FileProblem::field(name, expected, format!("{size} bytes")));
    }
    let mut bytes = blank::<u8>(pixels)?;
    entry.read_exact(&mut bytes).map_err(FileProblem::reading)?;
    // The archive's checksum is verified at the end of the data.
    match entry.read(&mut [0]).map_err(FileProblem::reading)? {
        0 => Ok(RawArray { shape, bytes }),
        _ => Err(FileProblem::field(name, format!("{size} bytes according to the archive"), "more")),
    }
}

fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    let shape: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut text =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}), }}", shape.trim_end());
    while !(10 + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat()
}

/// The shape, if the header is one that [`header`] could have written, except for its spaces.
fn parse_header(start: &[u8; 10], text: &[u8], descr: &str) -> Option<Vec<usize>> {
    let text: String = std::str::from_utf8(text).ok()?.split_whitespace().collect();
    let before = format!("{{'descr':'{descr}','fortran_order':False,'shape':(");
    let shape = text.strip_prefix(&before)?.strip_suffix("),}")?;
    let sides = shape.split(',').filter(|side| !side.is_empty()).map(|side| side.parse().ok());
    let shape: Vec<usize> = sides.collect::<Option<_>>()?;
    (start.starts_with(b"\x93NUMPY\x01\x00") && matches!(shape[..], [] | [2, _, _])).then_some(shape)
}

/// A zip archive of deflated entries, written here because `fdeflate` compresses them, which is designed for differences of
/// neighbouring pixels: half the time and two thirds of the bytes of zlib's level 1 on flow.
struct Archive<'a, W> {
    writer: &'a mut W,
    offset: u32,
    directory: Vec<u8>,
    entries: u16,
}

impl<'a, W: Write> Archive<'a, W> {
    fn new(writer: &'a mut W) -> Self {
        Self { writer, offset: 0, directory: Vec::new(), entries: 0 }
    }

    fn add(&mut self, name: &str, header: &[u8], data: &[u8]) -> io::Result<()> {
        let mut compressor = fdeflate::Compressor::new(Vec::with_capacity(data.len() / 8))?;
        compressor.write_data(header)?;
        compressor.write_data(data)?;
        let stream = compressor.finish()?;
        // Two bytes of zlib's header precede the deflate stream, and four of its checksum follow.
        let deflated = &stream[2..stream.len() - 4];
        let mut sum = crc32fast::Hasher::new();
        sum.update(header);
        sum.update(data);
        let too_large = |_| io::Error::other("an array is too large for a plain zip archive");
        let size = u32::try_from(header.len() + data.len()).map_err(too_large)?;
        let deflated_size = u32::try_from(deflated.len()).map_err(too_large)?;

        // Version 2.0, no flags, method 8, the first day of the format's calendar: the same bytes at any time.
        let mut fields = vec![20, 0, 0, 0, 8, 0, 0, 0, 0x21, 0];
        for value in [sum.finalize(), deflated_size, size] {
            fields.extend(value.to_le_bytes());
        }
        fields.extend((name.len() as u16).to_le_bytes());
        fields.extend([0, 0]);
        let local = [b"PK\x03\x04", &fields[..], name.as_bytes()].concat();
        self.writer.write_all(&local)?;
        self.writer.write_all(deflated)?;

        self.directory.extend(b"PK\x01\x02\x14\x00");
        self.directory.extend(&fields);
        self.directory.extend([0; 10]);
        self.directory.extend(self.offset.to_le_bytes());
        self.directory.extend(name.as_bytes());
        self.entries += 1;
        let grown = u64::from(self.offset) + local.len() as u64 + deflated.len() as u64;
        self.offset = u32::try_from(grown).map_err(too_large)?;
        Ok(())
    }

    fn finish(self) -> io::Result<()> {
        self.writer.write_all(&self.directory)?;
        let mut end = b"PK\x05\x06\0\0\0\0".to_vec();
        end.extend(self.entries.to_le_bytes());
        end.extend(self.entries.to_le_bytes());
        end.extend((self.directory.len() as u32).to_le_bytes());
        end.extend(self.offset.to_le_bytes());
        end.extend([0, 0]);
        self.writer.write_all(&end)
    }
}

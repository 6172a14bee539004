//! Portable float map as used for flow by FlyingThings3D: `PF`, width and height, a scale whose sign is the byte order
//! (negative: little-endian), then three `f32` a pixel, bottom row first. The first two are `u v`; the flow is unknown
//! where the third is over 0.5 (`read_pfm` of ptlflow, `ptlflow/utils/external/raft.py`).

use std::io::{self, Read, Write};

use super::checks::quote;
use super::claim::{blank, check_file_size, check_size};
use super::samples::{Endian, Sample, read_samples, write_f32_little_endian};
use crate::FileProblem;
use srflow_core::FlowField;

pub(super) const MAGIC: &[u8] = b"PF";

pub(super) fn decode(reader: &mut dyn Read, len: u64) -> Result<FlowField, FileProblem> {
    let header = Header::read(reader)?;
    let (width, height) = (header.width, header.height);
    check_file_size(header.bytes + 12 * (width as u64 * height as u64), len)?;

    let mut flow = FlowField::from_buffer(width, height, blank(width * height)?);
    let mut row = vec![[0.0; 3]; width];
    for (y, pixels) in flow.pixels_mut().chunks_exact_mut(width).enumerate().rev() {
        read_samples(reader, Sample::F32(header.endian), row.as_flattened_mut())?;
        for (x, (pixel, channels)) in pixels.iter_mut().zip(&row).enumerate() {
            let [u, v, unknown] = *channels;
            *pixel = if unknown > 0.5 { [f32::NAN; 2] } else { [u, v] };
            let known_finite = u.is_finite() && v.is_finite() && !unknown.is_nan();
            if !(known_finite || unknown > 0.5) {
                let expected = "finite numbers (the third over 0.5 where the flow is unknown)";
                return Err(FileProblem::Pixel { x, y, expected, found: format!("({u}, {v}, {unknown})") });
            }
        }
    }
    Ok(flow)
}

pub(super) fn encode(flow: &FlowField, writer: &mut impl Write) -> io::Result<()> {
    write!(writer, "PF\n{} {}\n-1.0\n", flow.width(), flow.height())?;
    let mut row = vec![[0.0; 3]; flow.width()];
    for y in (0..flow.height()).rev() {
        for (channels, [u, v]) in row.iter_mut().zip(flow.row(y)) {
            *channels = if u.is_nan() { [0.0, 0.0, 1.0] } else { [*u, *v, 0.0] };
        }
        write_f32_little_endian(writer, row.as_flattened())?;
    }
    Ok(())
}

struct Header {
    /// Length of the header in the file.
    bytes: u64,
    width: usize,
    height: usize,
    endian: Endian,
}

impl Header {
    fn read(reader: &mut dyn Read) -> Result<Self, FileProblem> {
        let mut bytes = 0;
        let mut word = |field| {
            let word = next_word(reader, field)?;
            bytes += word.len() as u64 + 1;
            Ok::<_, FileProblem>(word)
        };
        let magic = word("magic")?;
        if magic != "PF" {
            let expected = "\"PF\", the start of a .pfm file of three channels";
            return Err(FileProblem::field("magic", expected, quote(magic.as_bytes())));
        }
        let width = word("width")?;
        let height = word("height")?;
        let side = |field, word: &str| {
            word.parse::<i64>().map_err(|_| FileProblem::field(field, "a whole number", format!("{word:?}")))
        };
        let (width, height) = check_size(side("width", &width)?, side("height", &height)?)?;
        let scale = word("scale")?;
        let endian = match scale.parse::<f64>() {
            Ok(scale) if scale < 0.0 && scale.is_finite() => Endian::Little,
            Ok(scale) if scale > 0.0 && scale.is_finite() => Endian::Big,
            _ => {
                let expected = "a number whose sign is the byte order, such as -1.0";
                return Err(FileProblem::field("scale", expected, format!("{scale:?}")));
            }
        };
        Ok(Self { bytes, width, height, endian })
    }
}

/// The bytes up to the next white space, which is consumed.
fn next_word(reader: &mut dyn Read, field: &'static str) -> Result<String, FileProblem> {
    const LONGEST: usize = 40;
    let mut word = Vec::new();
    let mut byte = [0];
    while word.len() <= LONGEST && reader.read(&mut byte).map_err(FileProblem::reading)? == 1 {
        if byte[0].is_ascii_whitespace() {
            return Ok(String::from_utf8_lossy(&word).into_owned());
        }
        word.extend(byte);
    }
    Err(FileProblem::field(field, "a word followed by white space", quote(&word)))
}

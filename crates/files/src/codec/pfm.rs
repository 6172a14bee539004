//! Portable float map as used for flow by FlyingThings3D: `PF`, width and height, a scale whose sign is the byte order
//! (negative: little-endian), with white space and comments between them, then three `f32` a pixel, bottom row first. The first two are `u v`; the flow is unknown
//! where the third is over 0.5 (`read_pfm` of ptlflow, `ptlflow/utils/external/raft.py`).

use std::io::{self, Cursor, Read, Write};

use super::checks::quote;
use super::claim::{blank, check_end, check_size};
use super::samples::{Endian, Sample, read_samples, write_f32_little_endian};
use crate::FileProblem;
use srflow_core::{FlowField, Size};

pub(super) const MAGIC: &[u8] = b"PF";

/// Most bytes of white space after the header's last word.
const MOST_SPACE: u64 = 16;

/// Also returns how many bytes follow the flow.
pub(super) fn decode(reader: &mut dyn Read, len: u64) -> Result<(FlowField, u64), FileProblem> {
    let header = Header::read(reader)?;
    let (width, height) = (header.width, header.height);
    let row = 12 * width as u64;
    let mut more = check_end(header.bytes + row * height as u64, len, row.max(MOST_SPACE + 1))?;
    let mut start = vec![0; if more <= MOST_SPACE { more as usize } else { 0 }];
    reader.read_exact(&mut start).map_err(FileProblem::reading)?;
    // The length of the file tells white space from data: the line may end in \r\n.
    if !header.ends_its_line && start.ends_with(b"\n") && start.iter().all(u8::is_ascii_whitespace) {
        (start, more) = (Vec::new(), 0);
    } else if more >= row {
        check_end(header.bytes + row * height as u64, len, row)?;
    }
    let reader: &mut dyn Read = &mut Cursor::new(start).chain(reader);

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
    Ok((flow, more))
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
    /// Whether the last byte is a line feed.
    ends_its_line: bool,
}

impl Header {
    fn read(reader: &mut dyn Read) -> Result<Self, FileProblem> {
        let (mut bytes, mut last) = (0, 0);
        let mut word = |field| {
            let (word, space) = next_word(reader, field, &mut bytes)?;
            last = space;
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
        let Size { width, height } = check_size(side("width", &width)?, side("height", &height)?)?;
        let scale = word("scale")?;
        let endian = match scale.parse::<f64>() {
            Ok(scale) if scale < 0.0 && scale.is_finite() => Endian::Little,
            Ok(scale) if scale > 0.0 && scale.is_finite() => Endian::Big,
            _ => {
                let expected = "a number whose sign is the byte order, such as -1.0";
                return Err(FileProblem::field("scale", expected, format!("{scale:?}")));
            }
        };
        Ok(Self { bytes, width, height, endian, ends_its_line: last == b'\n' })
    }
}

/// The next word, without white space and comments before it, and the byte of white space after it. Adds to the bytes read.
fn next_word(
    reader: &mut dyn Read,
    field: &'static str,
    bytes: &mut u64,
) -> Result<(String, u8), FileProblem> {
    const LONGEST: usize = 40;
    const LONGEST_HEADER: u64 = 4096;
    let mut word = Vec::new();
    let mut in_comment = false;
    let mut byte = [0];
    while word.len() <= LONGEST
        && *bytes < LONGEST_HEADER
        && reader.read(&mut byte).map_err(FileProblem::reading)? == 1
    {
        *bytes += 1;
        match byte[0] {
            b'\n' | b'\r' if in_comment => in_comment = false,
            _ if in_comment => {}
            b'#' if word.is_empty() => in_comment = true,
            space if space.is_ascii_whitespace() && word.is_empty() => {}
            space if space.is_ascii_whitespace() => {
                return Ok((String::from_utf8_lossy(&word).into_owned(), space));
            }
            other => word.push(other),
        }
    }
    Err(FileProblem::field(field, "a word followed by white space", quote(&word)))
}

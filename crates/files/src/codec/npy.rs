//! NumPy's `.npy`: `\x93NUMPY`, a version, the length of a Python dictionary with `descr`, `fortran_order` and `shape`,
//! and the values (`numpy/lib/format.py`). Versions 1 to 3 are read, with real numbers, integers (either byte order) and
//! booleans; version 1 is written, with little-endian `f32` or float16.

use std::io::{self, Read, Write};
use std::path::Path;

use half::f16;
use half::slice::HalfFloatSliceExt as _;

use super::checks::{check_finite_or_unknown, check_pixels, quote, read_with};
use super::claim::{MAX_PIXELS, blank, check_file_size, check_size, read_all};
use super::samples::{Endian, Sample, read_samples, write_f32_little_endian};
use crate::{FileError, FileKind, FileProblem, write_atomically};
use srflow_core::{FlowField, Plane, Size};

pub(super) const MAGIC: &[u8] = b"\x93NUMPY";

/// An array of `f32` of any shape, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length of each dimension, outermost first: (H, W) or (H, W, 3) for images.
    pub shape: Vec<usize>,
    /// The values, row-major.
    pub values: Vec<f32>,
}

impl Array {
    /// The array that NumPy stores as `bytes`: `descr` is the type, e.g. `<f8`, and `fortran_order` the order of the values.
    ///
    /// # Errors
    /// When the type is not a number, or `shape` does not match the number of bytes.
    pub fn from_numpy(
        descr: &str,
        shape: Vec<usize>,
        fortran_order: bool,
        bytes: &[u8],
    ) -> Result<Self, FileProblem> {
        let sample = sample_of(descr)
            .ok_or_else(|| FileProblem::field("descr", "a real number, integer or boolean", descr))?;
        let count = shape.iter().try_fold(1_usize, |count, side| count.checked_mul(*side));
        if count.and_then(|count| count.checked_mul(sample.bytes())) != Some(bytes.len()) {
            let expected = format!("{} bytes of values", bytes.len());
            return Err(FileProblem::field("shape", expected, format!("{shape:?} of {descr}")));
        }
        let mut values = blank(bytes.len() / sample.bytes())?;
        read_samples(&mut &*bytes, sample, &mut values)?;
        if fortran_order {
            values = row_major_from_fortran(&shape, &values);
        }
        Ok(Self { shape, values })
    }
}

/// Reads a `.npy` file of numbers, converted to `f32`; Fortran order becomes row-major. Values may be NaN or infinite.
///
/// # Errors
/// When the file cannot be read, contains another type of array, or does not match its header.
pub fn read_npy(path: &Path) -> Result<Array, FileError> {
    read_with(path, FileKind::Array, |reader, len| decode(reader, len))
}

/// The array of a file of `len` bytes.
pub(crate) fn decode(reader: &mut dyn Read, len: u64) -> Result<Array, FileProblem> {
    let header = Header::read(reader, len)?;
    let count = header.shape.iter().try_fold(1_u64, |count, side| count.checked_mul(*side));
    let count = count.filter(|count| *count <= 4 * MAX_PIXELS).ok_or_else(|| {
        FileProblem::field(
            "shape",
            format!("at most {} values", 4 * MAX_PIXELS),
            format!("{:?}", header.shape),
        )
    })?;
    let sample = header.sample()?;
    check_file_size(header.bytes + count * sample.bytes() as u64, len)?;
    let mut values = blank(count as usize)?;
    read_samples(reader, sample, &mut values)?;
    let shape: Vec<usize> = header.shape.iter().map(|side| *side as usize).collect();
    if header.fortran_order {
        values = row_major_from_fortran(&shape, &values);
    }
    Ok(Array { shape, values })
}

/// The texts of a `.npy` file of `len` bytes of Unicode text (`<U`), row-major.
pub(super) fn decode_texts(reader: &mut dyn Read, len: u64) -> Result<Vec<String>, FileProblem> {
    let header = Header::read(reader, len)?;
    let width = header.descr.as_deref().and_then(|descr| descr.strip_prefix("<U")?.parse::<u64>().ok());
    let count = header.shape.iter().try_fold(1_u64, |count, side| count.checked_mul(*side));
    let (Some(width), false) = (width, header.fortran_order && header.shape.len() > 1) else {
        return Err(FileProblem::field("descr", "row-major Unicode text (<U)", header.shown_type()));
    };
    let bytes = count.and_then(|count| count.checked_mul(width)?.checked_mul(4));
    let bytes = bytes.filter(|_| count.is_some_and(|count| count <= MAX_PIXELS));
    let bytes = bytes.ok_or_else(|| {
        FileProblem::field("shape", format!("at most {MAX_PIXELS} texts"), format!("{:?}", header.shape))
    })?;
    check_file_size(header.bytes.saturating_add(bytes), len)?;
    let values = read_all(reader, bytes)?;
    let text = |letters: &[u8]| -> String {
        let letters = letters.as_chunks::<4>().0.iter().map(|letter| u32::from_le_bytes(*letter));
        letters.take_while(|letter| *letter != 0).map(|c| char::from_u32(c).unwrap_or('\u{fffd}')).collect()
    };
    match width {
        0 => Ok(Vec::new()),
        width => Ok(values.chunks_exact(4 * width as usize).map(text).collect()),
    }
}

/// The pickle in a `.npy` file of Python objects (`|O`), which NumPy loads with `allow_pickle`; `None` for other bytes.
///
/// # Errors
/// When it is a `.npy` file with a broken header, or of another type.
pub fn npy_pickle(bytes: &[u8]) -> Result<Option<&[u8]>, FileProblem> {
    if !bytes.starts_with(MAGIC) {
        return Ok(None);
    }
    let header = Header::read(&mut &*bytes, bytes.len() as u64)?;
    match header.descr.as_deref() {
        Some("|O" | "O") => Ok(bytes.get(header.bytes as usize..)),
        _ => Err(FileProblem::field("descr", "pickled objects (|O)", header.shown_type())),
    }
}

/// Writes a `.npy` file of little-endian `f32`, whole or not at all (see [`write_atomically`]). For an image of three
/// channels: `write_npy(path, &[height, width, 3], pixels.as_flattened())`.
///
/// # Errors
/// When `shape` does not match the number of values, or the file cannot be written.
pub fn write_npy(path: &Path, shape: &[usize], values: &[f32]) -> Result<(), FileError> {
    let count = shape.iter().try_fold(1_usize, |count, side| count.checked_mul(*side));
    if count != Some(values.len()) {
        let found = format!("{} values", values.len());
        return Err(FileProblem::field("shape", format!("values for {shape:?}"), found).in_file(path));
    }
    write_atomically(path, |writer| encode(shape, values, writer))
}

/// Reads a `.npy` file of shape (H, W).
///
/// # Errors
/// As [`read_npy`], and when the array has another number of dimensions or is empty.
pub fn read_npy_plane(path: &Path) -> Result<Plane, FileError> {
    let Array { shape, values } = read_npy(path)?;
    match shape[..] {
        [height, width] if width > 0 && height > 0 => Ok(Plane::from_buffer(width, height, values)),
        _ => {
            Err(FileProblem::field("shape", "(H, W) of at least one pixel", format!("{shape:?}"))
                .in_file(path))
        }
    }
}

/// Reads a flow from a `.npy` file of shape (2, H, W) or (1, 2, H, W), `u` first, as tensors of PyTorch are.
///
/// # Errors
/// As [`read_npy`], and when the array has another shape or a value is infinite.
pub fn read_npy_channels_first(path: &Path) -> Result<FlowField, FileError> {
    let Array { shape, values } = read_npy(path)?;
    let ([2, height, width] | [1, 2, height, width]) = shape[..] else {
        let found = format!("{shape:?}");
        return Err(FileProblem::field("shape", "(2, H, W) for a flow, channels first", found).in_file(path));
    };
    let (u, v) = values.split_at(values.len() / 2);
    flow_of(width, height, u, v).map_err(|problem| problem.in_file(path))
}

/// The flow of two arrays of shape (H, W).
pub(super) fn flow_of_components(u: Array, v: Array) -> Result<FlowField, FileProblem> {
    match (&u.shape[..], &v.shape[..]) {
        (&[height, width], &[rows, columns]) if (rows, columns) == (height, width) => {
            flow_of(width, height, &u.values, &v.values)
        }
        (u, v) => Err(FileProblem::field("shape", "(H, W) of both u and v", format!("{u:?} and {v:?}"))),
    }
}

fn flow_of(width: usize, height: usize, u: &[f32], v: &[f32]) -> Result<FlowField, FileProblem> {
    let Size { width, height } = check_size(width as i64, height as i64)?;
    let flow = FlowField::from_fn(width, height, |x, y| [u[y * width + x], v[y * width + x]]);
    check_finite_or_unknown(&flow)?;
    Ok(flow)
}

/// Writes a plane as a `.npy` file of shape (H, W); see [`write_npy`].
///
/// # Errors
/// When the file cannot be written.
pub fn write_npy_plane(path: &Path, plane: &Plane) -> Result<(), FileError> {
    write_npy(path, &[plane.height(), plane.width()], plane.pixels())
}

pub(super) fn decode_flow(reader: &mut dyn Read, len: u64) -> Result<FlowField, FileProblem> {
    let header = Header::read(reader, len)?;
    let [height, width, 2] = header.shape[..] else {
        let expected = match header.shape[..] {
            [2, _, _] | [1, 2, _, _] => "(H, W, 2) for a flow; `convert` has a setting for channels first",
            _ => "(H, W, 2) for a flow",
        };
        return Err(FileProblem::field("shape", expected, format!("{:?}", header.shape)));
    };
    let Size { width, height } =
        check_size(i64::try_from(width).unwrap_or(i64::MAX), i64::try_from(height).unwrap_or(i64::MAX))?;
    let count = 2 * width as u64 * height as u64;
    let sample = header.sample()?;
    check_file_size(header.bytes + count * sample.bytes() as u64, len)?;

    let mut flow = FlowField::from_buffer(width, height, blank(width * height)?);
    read_samples(reader, sample, flow.pixels_mut().as_flattened_mut())?;
    if header.fortran_order {
        let columns = flow.pixels().as_flattened();
        let (u, v) = columns.split_at(width * height);
        flow = FlowField::from_fn(width, height, |x, y| [u[x * height + y], v[x * height + y]]);
    }
    check_finite_or_unknown(&flow)?;
    Ok(flow)
}

pub(super) fn encode_flow(flow: &FlowField, writer: &mut impl Write) -> io::Result<()> {
    encode(&[flow.height(), flow.width(), 2], flow.pixels().as_flattened(), writer)
}

/// # Errors
/// When a component reaches 512 px, from where float16 has an error of more than 1/8 px.
pub(super) fn check_half_range(flow: &FlowField) -> Result<(), FileProblem> {
    check_pixels(
        flow,
        "components below 512 pixels, where float16 is within 1/8 pixel (take float32)",
        |[u, v]| u.is_nan() || (u.abs() < 512.0 && v.abs() < 512.0),
    )
}

/// A `.npy` file of little-endian float16.
pub(super) fn encode_flow_half(flow: &FlowField) -> Vec<u8> {
    let values = flow.pixels().as_flattened();
    let mut bytes = header_bytes("<f2", &[flow.height(), flow.width(), 2]);
    bytes.reserve_exact(2 * values.len());
    let mut block = [f16::ZERO; 1 << 12];
    for values in values.chunks(block.len()) {
        let block = &mut block[..values.len()];
        block.convert_from_f32_slice(values);
        // One NaN everywhere: processors keep different bits of it.
        bytes.extend(
            block.iter().flat_map(|&value| if value.is_nan() { f16::NAN } else { value }.to_le_bytes()),
        );
    }
    bytes
}

pub(super) fn encode(shape: &[usize], values: &[f32], writer: &mut impl Write) -> io::Result<()> {
    writer.write_all(&header_bytes("<f4", shape))?;
    write_f32_little_endian(writer, values)
}

/// The sample type for a NumPy type such as `<f4`.
fn sample_of(descr: &str) -> Option<Sample> {
    let endian = match descr.get(..1)? {
        ">" => Endian::Big,
        _ => Endian::Little,
    };
    let integer = |bytes, signed| Some(Sample::Integer { bytes, signed, endian });
    match descr.get(1..)? {
        "f2" => Some(Sample::F16(endian)),
        "f4" => Some(Sample::F32(endian)),
        "f8" => Some(Sample::F64(endian)),
        "u1" | "b1" => Some(Sample::U8),
        "i1" => integer(1, true),
        "i2" => integer(2, true),
        "i4" => integer(4, true),
        "i8" => integer(8, true),
        "u2" => integer(2, false),
        "u4" => integer(4, false),
        "u8" => integer(8, false),
        _ => None,
    }
}

/// The header of version 1 as NumPy writes it, padded so that the values start at a multiple of 64 bytes.
pub(super) fn header_bytes(descr: &str, shape: &[usize]) -> Vec<u8> {
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let mut dictionary =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}{comma}), }}", sides.join(", "));
    let unpadded = MAGIC.len() + 4 + dictionary.len() + 1;
    dictionary.extend(std::iter::repeat_n(' ', unpadded.next_multiple_of(64) - unpadded));
    dictionary.push('\n');
    let mut header = MAGIC.to_vec();
    header.extend([1, 0]);
    header.extend((dictionary.len() as u16).to_le_bytes());
    header.extend(dictionary.as_bytes());
    header
}

struct Header {
    /// Length of the header in the file.
    bytes: u64,
    /// The type of the values, e.g. `<f4`; `None` for a structured type.
    descr: Option<String>,
    fortran_order: bool,
    shape: Vec<u64>,
}

impl Header {
    /// Maximum length of the dictionary. NumPy's own limit is 10000.
    const MAX_BYTES: u32 = 65_535;

    fn read(reader: &mut dyn Read, len: u64) -> Result<Self, FileProblem> {
        if len < 10 {
            return Err(FileProblem::field("header", "at least 10 bytes", format!("a file of {len} bytes")));
        }
        let mut start = [0; 8];
        reader.read_exact(&mut start).map_err(FileProblem::reading)?;
        let [magic @ .., version, _minor] = start;
        if magic != MAGIC {
            return Err(FileProblem::field(
                "magic",
                "\"\\x93NUMPY\", the start of a .npy file",
                quote(&magic),
            ));
        }
        let mut length = [0; 4];
        let length_bytes = match version {
            1 => 2,
            2 | 3 => 4,
            _ => return Err(FileProblem::field("version", "1, 2 or 3", version.to_string())),
        };
        reader.read_exact(&mut length[..length_bytes]).map_err(FileProblem::reading)?;
        let length = u32::from_le_bytes(length);
        let bytes = (start.len() + length_bytes) as u64 + u64::from(length);
        if length > Self::MAX_BYTES || bytes > len {
            let expected = format!("at most {} bytes, inside the file", Self::MAX_BYTES);
            return Err(FileProblem::field("header length", expected, length.to_string()));
        }
        let mut dictionary = vec![0; length as usize];
        reader.read_exact(&mut dictionary).map_err(FileProblem::reading)?;
        Self::parse(&String::from_utf8_lossy(&dictionary), bytes)
    }

    fn parse(dictionary: &str, bytes: u64) -> Result<Self, FileProblem> {
        let entry = |key: &'static str| {
            let quoted = [format!("'{key}':"), format!("\"{key}\":")];
            let found = quoted.iter().find_map(|quoted| dictionary.split_once(quoted.as_str()));
            found.map(|(_, value)| value.trim_start()).ok_or_else(|| {
                FileProblem::field(
                    key,
                    "an entry of the header's dictionary",
                    format!("{:?}", dictionary.trim_end()),
                )
            })
        };
        let descr = entry("descr")?;
        let name = descr.strip_prefix(['\'', '"']).and_then(|rest| rest.split(['\'', '"']).next());
        let descr = name.map(str::to_owned);
        let order = entry("fortran_order")?;
        let fortran_order = order.starts_with("True");
        if !fortran_order && !order.starts_with("False") {
            return Err(FileProblem::field("fortran_order", "True or False", first_line(order)));
        }
        let shape = entry("shape")?;
        let wrong_shape = || FileProblem::field("shape", "a tuple of lengths", first_line(shape));
        let (inside, _) = shape.strip_prefix('(').and_then(|s| s.split_once(')')).ok_or_else(wrong_shape)?;
        let sides = inside.split(',').map(str::trim).filter(|side| !side.is_empty());
        let shape = sides.map(|side| side.parse().map_err(|_| wrong_shape())).collect::<Result<_, _>>()?;
        Ok(Self { bytes, descr, fortran_order, shape })
    }

    fn sample(&self) -> Result<Sample, FileProblem> {
        self.descr.as_deref().and_then(sample_of).ok_or_else(|| {
            let expected = "real numbers, integers or booleans (save with dtype float32)";
            FileProblem::field("descr", expected, self.shown_type())
        })
    }

    fn shown_type(&self) -> String {
        self.descr.as_ref().map_or("a structured type".to_owned(), |name| format!("'{name}'"))
    }
}

fn first_line(text: &str) -> String {
    let line: String = text.chars().take(40).collect();
    format!("{line:?}")
}

/// Column-major to row-major order.
fn row_major_from_fortran(shape: &[usize], values: &[f32]) -> Vec<f32> {
    let mut row_major = Vec::with_capacity(values.len());
    let mut position = vec![0; shape.len()];
    let mut strides = Vec::with_capacity(shape.len());
    let mut stride = 1;
    for side in shape {
        strides.push(stride);
        stride *= side;
    }
    for _ in 0..values.len() {
        row_major.push(values[position.iter().zip(&strides).map(|(p, s)| p * s).sum::<usize>()]);
        for axis in (0..shape.len()).rev() {
            position[axis] += 1;
            if position[axis] < shape[axis] {
                break;
            }
            position[axis] = 0;
        }
    }
    row_major
}

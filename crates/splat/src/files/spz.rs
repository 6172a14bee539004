//! `.spz` files of Niantic (nianticlabs/spz, `src/cc/load-spz.cc`): a gzip stream of a header of 16 bytes and one list per attribute.
//!
//! | bytes | are |
//! |---|---|
//! | 16 | `NGSP`, version, number of Gaussians (`u32` each), degree of the spherical harmonics, fractional bits, flags, 0 (`u8` each) |
//! | 9 N | positions: 24-bit fixed point with that many fractional bits |
//! | N | opacities: `255 a` |
//! | 3 N | colours: `255 (0.15 c + 0.5)` of the coefficient of degree 0 |
//! | 3 N | scales: `16 (ln s + 10)` |
//! | 4 N | rotations: number of the largest part, then the others in 10 bits each; in version 2 (3 N) x, y and z in 8 bits |
//! | 3 K N | spherical harmonics of degree 1 and above: `128 c + 128`, rounded to 5 bits in degree 1 and to 4 above |
//!
//! Written is version 3, the last in gzip, which viewers read since 2025: the rotations of version 2 are off by up to 12 degrees. Not
//! read are version 1, whose format was never released, and version 4 in Zstandard.

use std::io::{BufReader, Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::Vec3;
use srflow_files::{FileError, FileKind, FileProblem, open_file, write_atomically};

use super::{check, problem, room_for, unit_rotation};
use crate::{Gaussians, sh};

const MAGIC: [u8; 4] = *b"NGSP";
const HEADER: usize = 16;
const VERSION: u32 = 3;

/// Largest number of Gaussians, that of the reference's readers of these versions.
const MAX_COUNT: u64 = 10_000_000;

/// Most bytes that a file may unpack to, in any case and per byte of the file. Gaussians without colours of higher degrees, which are
/// zeros, pack ten times as well as others; gzip can hold a thousand bytes in one.
const MIN_UNPACKED: u64 = 16 << 20;
const MAX_EXPANSION: u64 = 64;

/// The first bit of the flags: the Gaussians are antialiased. The second: records of extensions follow the lists.
const ANTIALIASED: u8 = 1;
const HAS_EXTENSIONS: u8 = 2;

/// Fractional bits of positions within 8 units: steps of a thousandth of a millimetre for a head in metres. The reference always takes 12,
/// a quarter of a millimetre, which is more than the width of a hair.
const MOST_BITS: u32 = 20;
/// Magnitude of a 24-bit number with a sign.
const MOST_FIXED: f64 = 8_388_607.0;

/// Factor between coefficients of degree 0 and colours; smaller than the basis function, so that colours may leave 0..=1.
const COLOR_SCALE: f32 = 0.15;

/// Reads versions 2 and 3.
pub(super) fn read(path: &Path) -> Result<Gaussians, FileError> {
    let (file, len) = open_file(path, FileKind::Splats)?;
    decode(BufReader::with_capacity(1 << 18, file), len).map_err(|problem| problem.in_file(path))
}

/// Writes version 3.
pub(super) fn write(path: &Path, gaussians: &Gaussians) -> Result<(), FileError> {
    let packed = check(gaussians).and_then(|()| pack(gaussians)).map_err(|problem| problem.in_file(path))?;
    write_atomically(path, |writer| {
        let mut encoder = GzEncoder::new(writer, Compression::default());
        encoder.write_all(&packed)?;
        encoder.finish()?;
        Ok(())
    })
}

struct Header {
    version: u32,
    count: usize,
    sh_degree: usize,
    fractional_bits: u32,
    flags: u8,
}

impl Header {
    /// Checks every claim; `len` is the size of the file.
    fn parse(bytes: [u8; HEADER], len: u64) -> Result<Self, FileProblem> {
        let [m0, m1, m2, m3, v0, v1, v2, v3, n0, n1, n2, n3, degree, bits, flags, _] = bytes;
        if [m0, m1, m2, m3] != MAGIC {
            let found = bytes[..4].escape_ascii();
            return Err(problem("magic", "NGSP, as .spz files start when unpacked", found));
        }
        let (version, count) = (u32::from_le_bytes([v0, v1, v2, v3]), u32::from_le_bytes([n0, n1, n2, n3]));
        if !(2..=3).contains(&version) {
            return Err(problem("version", "2 or 3 (export the file again in version 3)", version));
        }
        if degree > 3 {
            return Err(problem("degree of the spherical harmonics", "0 to 3", degree));
        }
        if bits > 24 {
            return Err(problem("fractional bits", "0 to 24", bits));
        }
        let header = Self {
            version,
            count: count as usize,
            sh_degree: degree.into(),
            fractional_bits: bits.into(),
            flags,
        };
        if u64::from(count) > MAX_COUNT {
            return Err(problem("number of Gaussians", format!("at most {MAX_COUNT}"), count));
        }
        if header.packed_bytes() as u64 > len.saturating_mul(MAX_EXPANSION).max(MIN_UNPACKED) {
            let expected = format!("at most what a file of {len} bytes can be expected to hold");
            return Err(problem("number of Gaussians", expected, count));
        }
        Ok(header)
    }

    fn rotation_bytes(&self) -> usize {
        if self.version == 2 { 3 } else { 4 }
    }

    /// Coefficients of degree 1 and above.
    fn rest(&self) -> usize {
        sh::coefficients(self.sh_degree) - 1
    }

    /// Size of all lists.
    fn packed_bytes(&self) -> usize {
        self.count * (9 + 1 + 3 + 3 + self.rotation_bytes() + 3 * self.rest())
    }
}

pub(super) fn decode(reader: impl Read, len: u64) -> Result<Gaussians, FileProblem> {
    let mut reader = GzDecoder::new(reader);
    let mut header = [0; HEADER];
    reader.read_exact(&mut header).map_err(not_gzip)?;
    let header = Header::parse(header, len)?;
    // Memory grows with what arrives, not with what the header claims. One byte more tells whether the lists end.
    let expected = header.packed_bytes();
    let mut packed = Vec::new();
    reader.by_ref().take(expected as u64 + 1).read_to_end(&mut packed).map_err(not_gzip)?;
    let has_extensions = header.flags & HAS_EXTENSIONS != 0;
    if packed.len() < expected || (packed.len() > expected && !has_extensions) {
        let comparison = if packed.len() < expected { "fewer" } else { "more" };
        let expected = format!("{expected} bytes for {} Gaussians", header.count);
        return Err(problem("lists", expected, comparison));
    }
    unpack(&header, &packed)
}

fn not_gzip(error: std::io::Error) -> FileProblem {
    use std::io::ErrorKind::{InvalidData, InvalidInput, UnexpectedEof};
    match error.kind() {
        InvalidData | InvalidInput | UnexpectedEof => problem(
            "gzip",
            "a whole gzip stream, as .spz files of version 2 and 3 are (export version 4 again in version 3)",
            error,
        ),
        _ => FileProblem::reading(error),
    }
}

fn unpack(header: &Header, packed: &[u8]) -> Result<Gaussians, FileProblem> {
    let count = header.count;
    let mut gaussians = room_for(count as u64, header.sh_degree)?;
    gaussians.antialiased = header.flags & ANTIALIASED != 0;
    let mut left = packed;
    let mut list = |bytes: usize| {
        let (list, rest) = left.split_at_checked(count * bytes).unwrap_or((&[], &[]));
        left = rest;
        list
    };
    let [positions, opacities, colors, scales] = [9, 1, 3, 3].map(&mut list);
    let rotations = list(header.rotation_bytes());
    let rest = list(3 * header.rest());

    let step = 1.0 / f64::from(1_u32 << header.fractional_bits);
    let fixed = |&[a, b, c]: &[u8; 3]| ((i32::from_le_bytes([0, a, b, c]) >> 8) as f64 * step) as f32;
    let positions = positions.as_chunks::<3>().0.as_chunks::<3>().0;
    gaussians.positions.extend(positions.iter().map(|axes| Vec3::from_array(axes.each_ref().map(fixed))));
    gaussians.opacities.extend(opacities.iter().map(|byte| f32::from(*byte) / 255.0));
    let scale = |byte: u8| libm::exp(f64::from(byte) / 16.0 - 10.0) as f32;
    gaussians.scales.extend(scales.as_chunks::<3>().0.iter().map(|bytes| Vec3::from_array(bytes.map(scale))));
    for (index, bytes) in rotations.chunks_exact(header.rotation_bytes()).enumerate() {
        let rotation = match *bytes {
            [x, y, z] => first_three([x, y, z]),
            [a, b, c, d] => smallest_three(u32::from_le_bytes([a, b, c, d])),
            _ => [0.0; 4],
        };
        gaussians.rotations.push(unit_rotation(rotation, index)?);
    }
    let color = |byte: u8| (f32::from(byte) / 255.0 - 0.5) / COLOR_SCALE;
    let harmonic = |byte: u8| (f32::from(byte) - 128.0) / 128.0;
    let mut rest = rest.as_chunks::<3>().0.iter();
    for bytes in colors.as_chunks::<3>().0 {
        gaussians.sh.push(bytes.map(color));
        gaussians.sh.extend(rest.by_ref().take(header.rest()).map(|bytes| bytes.map(harmonic)));
    }
    Ok(gaussians)
}

/// x, y, z, w from the first three of version 2.
fn first_three(bytes: [u8; 3]) -> [f64; 4] {
    let [x, y, z] = bytes.map(|byte| f64::from(byte) / 127.5 - 1.0);
    [x, y, z, (1.0 - x * x - y * y - z * z).max(0.0).sqrt()]
}

/// x, y, z, w from the number of the largest part in the highest two bits, and sign and magnitude of the others in ten bits each.
fn smallest_three(mut bits: u32) -> [f64; 4] {
    let largest = (bits >> 30) as usize;
    let mut rotation = [0.0; 4];
    let mut squares = 0.0;
    for (part, value) in rotation.iter_mut().enumerate().rev() {
        if part != largest {
            let magnitude = std::f64::consts::FRAC_1_SQRT_2 * f64::from(bits & 511) / 511.0;
            *value = if bits & 512 == 0 { magnitude } else { -magnitude };
            squares += magnitude * magnitude;
            bits >>= 10;
        }
    }
    rotation[largest] = f64::max(1.0 - squares, 0.0).sqrt();
    rotation
}

/// The header and the lists.
pub(super) fn pack(gaussians: &Gaussians) -> Result<Vec<u8>, FileProblem> {
    let count = u32::try_from(gaussians.len()).ok().filter(|count| u64::from(*count) <= MAX_COUNT);
    let count = count.ok_or_else(|| {
        problem("number of Gaussians", format!("at most {MAX_COUNT} in an .spz file"), gaussians.len())
    })?;
    let bits = fractional_bits(gaussians)?;
    let flags = if gaussians.antialiased { ANTIALIASED } else { 0 };
    let mut packed = Vec::from(MAGIC);
    packed.extend(VERSION.to_le_bytes());
    packed.extend(count.to_le_bytes());
    packed.extend([gaussians.sh_degree as u8, bits as u8, flags, 0]);

    let steps = f64::from(1_u32 << bits);
    for coordinate in gaussians.positions.iter().flat_map(|position| position.to_array()) {
        let [a, b, c, _] = ((f64::from(coordinate) * steps).round() as i32).to_le_bytes();
        packed.extend([a, b, c]);
    }
    packed.extend(gaussians.opacities.iter().map(|opacity| rounded(opacity * 255.0)));
    let coefficients = || gaussians.sh.chunks_exact(gaussians.sh_len());
    let color = |channel: f32| rounded(channel * (COLOR_SCALE * 255.0) + 0.5 * 255.0);
    packed.extend(coefficients().flat_map(|sh| sh[0].map(color)));
    let scales = gaussians.scales.iter().flat_map(|scale| scale.to_array());
    packed.extend(scales.map(|scale| rounded(((libm::log(f64::from(scale)) + 10.0) * 16.0) as f32)));
    for rotation in &gaussians.rotations {
        packed.extend(packed_rotation(rotation.normalize().to_array()).to_le_bytes());
    }
    for sh in coefficients() {
        for (number, coefficient) in sh.iter().enumerate().skip(1) {
            let bucket = if number < sh::coefficients(1) { 1 << 3 } else { 1 << 4 };
            packed.extend(coefficient.map(|channel| quantized(channel, bucket)));
        }
    }
    Ok(packed)
}

/// As many as the largest coordinate leaves, up to [`MOST_BITS`].
fn fractional_bits(gaussians: &Gaussians) -> Result<u32, FileProblem> {
    let largest =
        gaussians.positions.iter().fold(0.0_f32, |most, position| most.max(position.abs().max_element()));
    let fits = |bits: &u32| (f64::from(largest) * f64::from(1_u32 << bits)).round() <= MOST_FIXED;
    (0..=MOST_BITS).rev().find(fits).ok_or_else(|| {
        problem("position", format!("coordinates up to {MOST_FIXED} in an .spz file"), largest)
    })
}

fn rounded(value: f32) -> u8 {
    value.round() as u8
}

/// Rounds to the middle of a bucket; 0 is one.
fn quantized(value: f32, bucket: i32) -> u8 {
    let whole = (value * 128.0).round().clamp(-1024.0, 1024.0) as i32 + 128;
    ((whole + bucket / 2) / bucket * bucket).clamp(0, 255) as u8
}

fn packed_rotation(rotation: [f32; 4]) -> u32 {
    let mut largest = 0;
    for part in 1..4 {
        if rotation[part].abs() > rotation[largest].abs() {
            largest = part;
        }
    }
    let negative = rotation[largest] < 0.0;
    let mut bits = largest as u32;
    for (part, value) in rotation.into_iter().enumerate() {
        if part != largest {
            let magnitude = (511.0 * (value.abs() / std::f32::consts::FRAC_1_SQRT_2) + 0.5) as u32;
            bits = bits << 10 | u32::from((value < 0.0) != negative) << 9 | magnitude.min(511);
        }
    }
    bits
}

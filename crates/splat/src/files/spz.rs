//! `.spz` files of Niantic (nianticlabs/spz, `src/cc/load-spz.cc`): a header of 16 bytes, one list per attribute, and records of
//! extensions. Versions 2 and 3 are one gzip stream of them.
//!
//! | bytes | are |
//! |---|---|
//! | 16 | `NGSP`, version, number of Gaussians (`u32` each), degree of the spherical harmonics, fractional bits, flags, streams (`u8` each) |
//! | 9 N | positions: 24-bit fixed point with that many fractional bits |
//! | N | opacities: `255 a` |
//! | 3 N | colours: `255 (0.15 c + 0.5)` of the coefficient of degree 0 |
//! | 3 N | scales: `16 (ln s + 10)` |
//! | 4 N | rotations: number of the largest part, then the others in 10 bits each; in version 2 (3 N) x, y and z in 8 bits |
//! | 3 K N | spherical harmonics of degree 1 and above: `128 c + 128`, rounded to 5 bits in degree 1 and to 4 above |
//!
//! Version 4 begins with 32 bytes: those above, the place of a table (`u32`) and zeros. The records come next, then the table: for each list
//! that is not empty, its size when packed and when not (`u64` each). The lists follow, each a stream of Zstandard.
//!
//! A record is its type and the size of what follows (`u32` each).
//!
//! Written is version 3, the last in gzip, which viewers read since 2025: the rotations of version 2 are off by up to 12 degrees. Not
//! read is version 1, whose format was never released.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::{DMat3, DMat4, Vec3};
use ruzstd::decoding::StreamingDecoder;
use srflow_files::{FileError, FileKind, FileProblem, open_file, write_atomically};

use super::{check, place, problem, room_for, unit_rotation};
use crate::{Gaussians, sh};

const MAGIC: [u8; 4] = *b"NGSP";
const HEADER: usize = 16;
const VERSION: u32 = 3;

/// Bytes before the records of version 4.
const STREAMS_HEADER: usize = 32;

/// Largest number of Gaussians in a gzip stream, that of the reference's readers.
const MAX_COUNT: u64 = 10_000_000;

/// Most bytes that a file may unpack to, in any case and per byte of the file. Gaussians without colours of higher degrees, which are
/// zeros, pack ten times as well as others; gzip can hold a thousand bytes in one, Zstandard more.
const MIN_UNPACKED: u64 = 16 << 20;
const MAX_EXPANSION: u64 = 64;

/// The first bit of the flags: the Gaussians are antialiased. The second: records of extensions follow the lists.
const ANTIALIASED: u8 = 1;
const HAS_EXTENSIONS: u8 = 2;

/// Records of Adobe: limits of a viewer's camera, and the directions of the axes.
const CAMERA: u32 = 0xadbe_0002;
const COORDINATE_SYSTEM: u32 = 0xadbe_0003;

/// Most bytes of the records of a gzip stream.
const MAX_RECORDS: u64 = 1 << 20;

/// Bytes that a decoder of Zstandard should be able to look back (RFC 8878, 3.1.1.1.2).
const MIN_WINDOW: u64 = 8 << 20;

/// Fractional bits of positions within 8 units: steps of a thousandth of a millimetre for a head in metres. The reference always takes 12,
/// a quarter of a millimetre, which is more than the width of a hair.
const MOST_BITS: u32 = 20;
/// Magnitude of a 24-bit number with a sign.
const MOST_FIXED: f64 = 8_388_607.0;

/// Factor between coefficients of degree 0 and colours; smaller than the basis function, so that colours may leave 0..=1.
const COLOR_SCALE: f32 = 0.15;

/// Reads versions 2 to 4.
pub(super) fn read(path: &Path) -> Result<Gaussians, FileError> {
    let (file, len) = open_file(path, FileKind::Splats)?;
    let mut unknown = Vec::new();
    let gaussians = decode(BufReader::with_capacity(1 << 18, file), len, &mut unknown)
        .map_err(|problem| problem.in_file(path))?;
    if !unknown.is_empty() {
        let (path, types) = (path.display(), unknown.join(", "));
        log::warn!("{path}: extensions of types {types} are not known; what they say is left out");
    }
    Ok(gaussians)
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
        if version < 4 && u64::from(count) > MAX_COUNT {
            return Err(problem("number of Gaussians", format!("at most {MAX_COUNT}"), count));
        }
        if header.packed_bytes() > len.saturating_mul(MAX_EXPANSION).max(MIN_UNPACKED) {
            let expected = format!("at most what a file of {len} bytes can be expected to hold");
            return Err(problem("number of Gaussians", expected, count));
        }
        Ok(header)
    }

    /// Bytes of each list for one Gaussian.
    fn lists(&self) -> [usize; 6] {
        let rotation = if self.version == 2 { 3 } else { 4 };
        [9, 1, 3, 3, rotation, 3 * self.rest()]
    }

    /// Coefficients of degree 1 and above.
    fn rest(&self) -> usize {
        sh::coefficients(self.sh_degree) - 1
    }

    /// Size of all lists.
    fn packed_bytes(&self) -> u64 {
        self.count as u64 * self.lists().iter().sum::<usize>() as u64
    }
}

/// `len` is the size of the file. Appends the types of records that are not known to `unknown`.
pub(super) fn decode(
    mut reader: impl BufRead,
    len: u64,
    unknown: &mut Vec<String>,
) -> Result<Gaussians, FileProblem> {
    let is_plain = reader.fill_buf().map_err(FileProblem::reading)?.starts_with(&MAGIC);
    let (header, lists, records) =
        if is_plain { read_streams(reader, len)? } else { read_gzip(GzDecoder::new(reader), len)? };
    let mut gaussians = unpack(&header, &lists)?;
    if header.flags & HAS_EXTENSIONS != 0 {
        apply(&records, &mut gaussians, unknown)?;
    }
    Ok(gaussians)
}

/// Header, lists and records of version 2 or 3.
fn read_gzip(mut reader: impl Read, len: u64) -> Result<(Header, Vec<u8>, Vec<u8>), FileProblem> {
    let mut header = [0; HEADER];
    reader.read_exact(&mut header).map_err(not_gzip)?;
    let header = Header::parse(header, len)?;
    if !(2..=3).contains(&header.version) {
        return Err(problem("version", "2 or 3 in a gzip stream (export the file again)", header.version));
    }
    // Memory grows with what arrives, not with what the header claims. One byte more tells whether the lists end.
    let mut lists = Vec::new();
    let expected = header.packed_bytes();
    reader.by_ref().take(expected).read_to_end(&mut lists).map_err(not_gzip)?;
    let mut records = Vec::new();
    reader.take(MAX_RECORDS + 1).read_to_end(&mut records).map_err(not_gzip)?;
    let has_records = header.flags & HAS_EXTENSIONS != 0;
    let most = if has_records { MAX_RECORDS } else { 0 };
    let comparison = match lists.len() as u64 {
        size if size < expected => "fewer",
        _ if records.len() as u64 > most => "more",
        _ => return Ok((header, lists, records)),
    };
    Err(problem("lists", format!("{expected} bytes for {} Gaussians", header.count), comparison))
}

fn not_gzip(error: std::io::Error) -> FileProblem {
    use std::io::ErrorKind::{InvalidData, InvalidInput, UnexpectedEof};
    match error.kind() {
        InvalidData | InvalidInput | UnexpectedEof => {
            problem("gzip", "a whole gzip stream, or NGSP at the start of the file", error)
        }
        _ => FileProblem::reading(error),
    }
}

/// Header, lists and records of version 4.
fn read_streams(mut reader: impl Read, len: u64) -> Result<(Header, Vec<u8>, Vec<u8>), FileProblem> {
    let mut bytes = Vec::new();
    reader.read_to_end(&mut bytes).map_err(FileProblem::reading)?;
    let truncated = || {
        problem("file size", "as many bytes as its header and table claim", format!("{} bytes", bytes.len()))
    };
    let (header, _) = bytes.split_first_chunk::<HEADER>().ok_or_else(truncated)?;
    let streams = usize::from(header[HEADER - 1]);
    let header = Header::parse(*header, len)?;
    if header.version != 4 {
        let expected = "4 in a file that is not a gzip stream (export the file again in version 4)";
        return Err(problem("version", expected, header.version));
    }
    let (_, from_table) = bytes.split_at_checked(HEADER).ok_or_else(truncated)?;
    let (place, _) = from_table.split_first_chunk().ok_or_else(truncated)?;
    let place = u32::from_le_bytes(*place) as usize;
    let records = bytes.get(STREAMS_HEADER..place).ok_or_else(truncated)?.to_vec();
    let (table, mut packed) = bytes[place..].split_at_checked(16 * streams).ok_or_else(truncated)?;
    let sizes = header.lists().map(|bytes| bytes as u64 * header.count as u64);
    let sizes: Vec<u64> = sizes.into_iter().filter(|size| *size > 0).collect();
    if sizes.len() != streams {
        return Err(problem("streams", format!("one for each of {} lists", sizes.len()), streams));
    }
    let mut lists = Vec::new();
    for (size, claim) in sizes.into_iter().zip(table.as_chunks::<8>().0.as_chunks::<2>().0) {
        let [stored, unpacked] = claim.map(u64::from_le_bytes);
        if unpacked != size {
            return Err(problem(
                "size of a list",
                format!("{size} for {} Gaussians", header.count),
                unpacked,
            ));
        }
        let stored = usize::try_from(stored).ok();
        let (stream, rest) =
            stored.and_then(|stored| packed.split_at_checked(stored)).ok_or_else(truncated)?;
        packed = rest;
        unpack_stream(stream, size, &mut lists)?;
    }
    if !packed.is_empty() {
        return Err(truncated());
    }
    Ok((header, lists, records))
}

/// Appends what a stream of Zstandard holds, which must be `size` bytes.
fn unpack_stream(stream: &[u8], size: u64, to: &mut Vec<u8>) -> Result<(), FileProblem> {
    let not_whole = |found: String| problem("Zstandard", format!("a stream of {size} bytes"), found);
    let decoder = StreamingDecoder::new_with_max_window_size(stream, size.max(MIN_WINDOW))
        .map_err(|error| not_whole(error.to_string()))?;
    let before = to.len();
    decoder.take(size + 1).read_to_end(to).map_err(|error| not_whole(error.to_string()))?;
    match (to.len() - before) as u64 {
        found if found == size => Ok(()),
        found if found < size => Err(not_whole(format!("{found} bytes"))),
        _ => Err(not_whole("more".to_owned())),
    }
}

/// Does what the records of extensions say.
fn apply(
    mut records: &[u8],
    gaussians: &mut Gaussians,
    unknown: &mut Vec<String>,
) -> Result<(), FileProblem> {
    let truncated = || problem("extensions", "whole records", "the end within one");
    let word =
        |bytes: &[u8]| bytes.first_chunk().map(|bytes| u32::from_le_bytes(*bytes)).ok_or_else(truncated);
    while !records.is_empty() {
        let (header, rest) = records.split_at_checked(8).ok_or_else(truncated)?;
        let size = word(&header[4..])? as usize;
        let (content, rest) = rest.split_at_checked(size).ok_or_else(truncated)?;
        records = rest;
        match word(header)? {
            CAMERA => {}
            COORDINATE_SYSTEM => turn(gaussians, word(content)?)?,
            other if unknown.len() < 8 => unknown.push(format!("{other:#010x}")),
            _ => {}
        }
    }
    Ok(())
}

/// From axes that a record names to right, up and back, as in files without a record. The number less one is four bits: 1 is right, not left;
/// 2 is up, not down; 4 is front, not back; and with 8, which names the second and the third axis in the other order, back, not front.
pub(super) fn turn(gaussians: &mut Gaussians, system: u32) -> Result<(), FileProblem> {
    let Some(bits) = system.checked_sub(1) else { return Ok(()) };
    let sign = |holds: bool| if holds { 1.0 } else { -1.0 };
    let signs = [sign(bits & 1 != 0), sign(bits & 2 != 0), sign(bits & 4 == 0)];
    let exchanged = bits & 8 != 0;
    // The reference turns these by 180 degrees away from their names.
    if bits > 15 || exchanged && signs[1] != signs[2] {
        let expected = "0 to 8 or 11 to 14, whose names and the format's library agree";
        return Err(problem("coordinate system", expected, system));
    }
    let mut axes = DMat3::from_diagonal(signs.into());
    if exchanged {
        axes = DMat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0]) * axes;
    }
    place(gaussians, DMat4::from_mat3(axes))
}

fn unpack(header: &Header, lists: &[u8]) -> Result<Gaussians, FileProblem> {
    let count = header.count;
    let mut gaussians = room_for(count as u64, header.sh_degree)?;
    gaussians.antialiased = header.flags & ANTIALIASED != 0;
    let mut left = lists;
    let [positions, opacities, colors, scales, rotations, rest] = header.lists().map(|bytes| {
        let (list, rest) = left.split_at_checked(count * bytes).unwrap_or((&[], &[]));
        left = rest;
        list
    });

    let step = 1.0 / f64::from(1_u32 << header.fractional_bits);
    let fixed = |&[a, b, c]: &[u8; 3]| ((i32::from_le_bytes([0, a, b, c]) >> 8) as f64 * step) as f32;
    let positions = positions.as_chunks::<3>().0.as_chunks::<3>().0;
    gaussians.positions.extend(positions.iter().map(|axes| Vec3::from_array(axes.each_ref().map(fixed))));
    gaussians.opacities.extend(opacities.iter().map(|byte| f32::from(*byte) / 255.0));
    let scale = |byte: u8| libm::exp(f64::from(byte) / 16.0 - 10.0) as f32;
    gaussians.scales.extend(scales.as_chunks::<3>().0.iter().map(|bytes| Vec3::from_array(bytes.map(scale))));
    for (index, bytes) in rotations.chunks_exact(header.lists()[4]).enumerate() {
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

//! Blocks of numbers in files.

use std::io::{self, Read, Write};

use half::f16;

use crate::FileProblem;

/// Byte order of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Endian {
    Little,
    Big,
}

/// The storage format of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sample {
    F16(Endian),
    F32(Endian),
    F64(Endian),
    U8,
    /// An integer of 1, 2, 4 or 8 bytes.
    Integer {
        bytes: usize,
        signed: bool,
        endian: Endian,
    },
}

impl Sample {
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::F16(_) => 2,
            Self::F32(_) => 4,
            Self::F64(_) => 8,
            Self::U8 => 1,
            Self::Integer { bytes, .. } => bytes,
        }
    }
}

const NATIVE: Endian = if cfg!(target_endian = "little") { Endian::Little } else { Endian::Big };

/// Bytes converted at a time: fits in the second-level cache.
const BLOCK: usize = 1 << 16;

/// Fills `values` with the next numbers of the file, converted to `f32`.
pub(crate) fn read_samples(
    reader: &mut dyn Read,
    sample: Sample,
    values: &mut [f32],
) -> Result<(), FileProblem> {
    if sample == Sample::F32(NATIVE) {
        return reader.read_exact(bytemuck::cast_slice_mut(values)).map_err(FileProblem::reading);
    }
    let mut block = vec![0; BLOCK];
    for values in values.chunks_mut(BLOCK / sample.bytes()) {
        let bytes = &mut block[..values.len() * sample.bytes()];
        reader.read_exact(bytes).map_err(FileProblem::reading)?;
        convert_samples(sample, bytes, values);
    }
    Ok(())
}

/// Fills `values` with converted numbers.
pub(crate) fn convert_samples(sample: Sample, bytes: &[u8], values: &mut [f32]) {
    fn each<const N: usize>(bytes: &[u8], values: &mut [f32], to_f32: impl Fn([u8; N]) -> f32) {
        for (value, bytes) in values.iter_mut().zip(bytes.as_chunks::<N>().0) {
            *value = to_f32(*bytes);
        }
    }
    match sample {
        Sample::F16(Endian::Little) => each::<2>(bytes, values, |b| f16::from_le_bytes(b).to_f32()),
        Sample::F16(Endian::Big) => each::<2>(bytes, values, |b| f16::from_be_bytes(b).to_f32()),
        Sample::F32(Endian::Little) => each::<4>(bytes, values, f32::from_le_bytes),
        Sample::F32(Endian::Big) => each::<4>(bytes, values, f32::from_be_bytes),
        Sample::F64(Endian::Little) => each::<8>(bytes, values, |b| f64::from_le_bytes(b) as f32),
        Sample::F64(Endian::Big) => each::<8>(bytes, values, |b| f64::from_be_bytes(b) as f32),
        Sample::U8 => each::<1>(bytes, values, |b| f32::from(b[0])),
        Sample::Integer { bytes: size, signed, endian } => {
            for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(size)) {
                *value = f32_from_integer(bytes, signed, endian);
            }
        }
    }
}

/// Writes `values` as little-endian `f32`.
pub(crate) fn write_f32_little_endian(writer: &mut dyn Write, values: &[f32]) -> io::Result<()> {
    if NATIVE == Endian::Little {
        return writer.write_all(bytemuck::cast_slice(values));
    }
    let mut block = Vec::with_capacity(BLOCK);
    for values in values.chunks(BLOCK / 4) {
        block.clear();
        block.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        writer.write_all(&block)?;
    }
    Ok(())
}

/// An integer of at most 8 bytes, to the nearest `f32`.
fn f32_from_integer(bytes: &[u8], signed: bool, endian: Endian) -> f32 {
    let push = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
    let number = match endian {
        Endian::Little => bytes.iter().rev().fold(0, push),
        Endian::Big => bytes.iter().fold(0, push),
    };
    let unused = 64 - 8 * bytes.len() as u32;
    if signed { ((number << unused) as i64 >> unused) as f32 } else { number as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_of_every_size_are_read() {
        fn read(bytes: &[u8], signed: bool, endian: Endian) -> f32 {
            let mut values = [0.0];
            let sample = Sample::Integer { bytes: bytes.len(), signed, endian };
            read_samples(&mut &bytes[..], sample, &mut values).unwrap();
            values[0]
        }
        for value in [-128_i8, -1, 0, 1, 127] {
            assert_eq!(read(&value.to_le_bytes(), true, Endian::Little), f32::from(value));
            assert_eq!(read(&i16::from(value).to_be_bytes(), true, Endian::Big), f32::from(value));
            assert_eq!(read(&i32::from(value).to_le_bytes(), true, Endian::Little), f32::from(value));
            assert_eq!(read(&i64::from(value).to_le_bytes(), true, Endian::Little), f32::from(value));
        }
        assert_eq!(read(&u16::MAX.to_be_bytes(), false, Endian::Big), 65535.0);
        assert_eq!(read(&u32::MAX.to_le_bytes(), false, Endian::Little), 4_294_967_296.0);
        assert_eq!(read(&i64::MIN.to_be_bytes(), true, Endian::Big), -9_223_372_036_854_775_808.0);
    }

    #[test]
    fn numbers_of_every_layout_are_read() {
        let value = -1.5_f32;
        let layouts: [(Sample, Vec<u8>); 6] = [
            (Sample::F16(Endian::Little), vec![0x00, 0xbe]),
            (Sample::F16(Endian::Big), vec![0xbe, 0x00]),
            (Sample::F32(Endian::Little), value.to_le_bytes().to_vec()),
            (Sample::F32(Endian::Big), value.to_be_bytes().to_vec()),
            (Sample::F64(Endian::Little), f64::from(value).to_le_bytes().to_vec()),
            (Sample::F64(Endian::Big), f64::from(value).to_be_bytes().to_vec()),
        ];
        for (sample, bytes) in layouts {
            let many = bytes.repeat(20_000); // more than one block
            let mut values = vec![0.0; 20_000];
            read_samples(&mut many.as_slice(), sample, &mut values).unwrap();
            assert!(values.iter().all(|v| *v == value), "{sample:?}");
        }
    }
}

use rayon::prelude::*;

use super::chunks::{Chunk, Filter, chunks_of_layout};
use super::fields::Fields;
use super::header::{find_in_root, message, messages};
use super::{UNDEFINED, chunks};
use crate::FileProblem;
use crate::codec::claim::{MAX_PIXELS, check_file_size};
use crate::codec::samples::{Endian, Sample, convert_samples};

/// A three-dimensional dataset, located in a file but not read yet.
pub(in crate::codec) struct Dataset<'a> {
    /// Length of each dimension, as claimed by the file.
    pub(in crate::codec) shape: [u64; 3],
    sample: Sample,
    storage: Storage<'a>,
}

enum Storage<'a> {
    Contiguous(&'a [u8]),
    Chunked { shape: [u64; 3], filters: Vec<Filter>, chunks: Vec<Chunk<'a>> },
}

impl<'a> Dataset<'a> {
    /// Looks up a dataset of the root group, and checks that the file is large enough for its shape.
    pub(in crate::codec) fn find(file: &'a [u8], name: &str) -> Result<Self, FileProblem> {
        let (mut shape, mut sample, mut layout, mut filters) = (None, None, None, Vec::new());
        for (kind, data) in messages(file, find_in_root(file, name)?)? {
            match kind {
                message::DATASPACE => shape = Some(parse_image_shape(data)?),
                message::DATATYPE => sample = Some(parse_sample(data)?),
                message::FILTERS => filters = chunks::parse_filters(data)?,
                message::LAYOUT => layout = Some(data),
                _ => {}
            }
        }
        let (Some(shape), Some(sample), Some(layout)) = (shape, sample, layout) else {
            let expected = "a dataset: dataspace, datatype and data layout";
            return Err(FileProblem::field("object header", expected, "a group, or a dataset without them"));
        };
        let storage = Storage::parse(file, layout, shape, sample, filters)?;
        let dataset = Self { shape, sample, storage };
        dataset.check_claim()?;
        Ok(dataset)
    }

    fn check_claim(&self) -> Result<(), FileProblem> {
        match &self.storage {
            Storage::Contiguous(bytes) => {
                let values = self.shape.iter().try_fold(1_u64, |values, side| values.checked_mul(*side));
                let promised = values.and_then(|values| values.checked_mul(self.sample.bytes() as u64));
                check_file_size(promised.unwrap_or(u64::MAX), bytes.len() as u64)
            }
            Storage::Chunked { shape, filters, chunks } => {
                let chunk_bytes = self.chunk_bytes(*shape)? as u64;
                chunks::check_complete(chunks, self.shape, *shape)?;
                chunks.iter().try_for_each(|chunk| chunk.check_claim(filters, chunk_bytes))
            }
        }
    }

    /// Reads all values, row-major, into a slice of matching length.
    pub(in crate::codec) fn read(&self, values: &mut [f32]) -> Result<(), FileProblem> {
        match &self.storage {
            Storage::Contiguous(bytes) => {
                convert_samples(self.sample, bytes, values);
                Ok(())
            }
            Storage::Chunked { shape, filters, chunks } => self.read_chunks(*shape, filters, chunks, values),
        }
    }

    fn read_chunks(
        &self,
        chunk_shape: [u64; 3],
        filters: &[Filter],
        chunks: &[Chunk],
        values: &mut [f32],
    ) -> Result<(), FileProblem> {
        let chunk_bytes = self.chunk_bytes(chunk_shape)?;
        const DECOMPRESSED_AT_A_TIME: usize = 1 << 26;
        let batch = (DECOMPRESSED_AT_A_TIME / chunk_bytes).clamp(1, 4 * rayon::current_num_threads());
        for batch in chunks.chunks(batch) {
            let decoded = batch.par_iter().map(|chunk| {
                let bytes = chunk.decode(filters, chunk_bytes, self.sample.bytes())?;
                let mut values = vec![0.0; bytes.len() / self.sample.bytes()];
                convert_samples(self.sample, &bytes, &mut values);
                Ok(values)
            });
            let decoded: Vec<Vec<f32>> = decoded.collect::<Result<_, FileProblem>>()?;
            for (chunk, decoded) in batch.iter().zip(&decoded) {
                place(chunk.offset, decoded, chunk_shape, values, self.shape);
            }
        }
        Ok(())
    }

    fn chunk_bytes(&self, shape: [u64; 3]) -> Result<usize, FileProblem> {
        let values = shape.iter().try_fold(1_u64, |values, side| values.checked_mul(*side));
        let bytes = values.and_then(|values| values.checked_mul(self.sample.bytes() as u64));
        bytes.filter(|bytes| (1..=16 * MAX_PIXELS).contains(bytes)).map(|bytes| bytes as usize).ok_or_else(
            || {
                FileProblem::field(
                    "chunk size",
                    format!("1 to {} bytes", 16 * MAX_PIXELS),
                    format!("{shape:?} values"),
                )
            },
        )
    }
}

impl<'a> Storage<'a> {
    fn parse(
        file: &'a [u8],
        data: &'a [u8],
        shape: [u64; 3],
        sample: Sample,
        filters: Vec<Filter>,
    ) -> Result<Self, FileProblem> {
        match Layout::parse(file, data)? {
            Layout::Contiguous(bytes) => Ok(Self::Contiguous(bytes)),
            Layout::Chunked { version, fields } => {
                let (chunk_shape, chunks) = chunks_of_layout(file, fields, version, shape, sample, &filters)?;
                Ok(Self::Chunked { shape: chunk_shape, filters, chunks })
            }
        }
    }
}

/// Where the values of a dataset are.
pub(super) enum Layout<'a> {
    Contiguous(&'a [u8]),
    /// In chunks, which the rest of the message describes.
    Chunked {
        version: u8,
        fields: Fields<'a>,
    },
}

impl<'a> Layout<'a> {
    /// The data layout message (section IV.A.2.i).
    pub(super) fn parse(file: &'a [u8], data: &'a [u8]) -> Result<Self, FileProblem> {
        let mut fields = Fields::new(data, "data layout");
        let version = fields.one_of("data layout version", &[3, 4, 5])?;
        match fields.one_of("data layout class", &[0, 1, 2])? {
            0 => {
                let size = fields.u16()?;
                Ok(Self::Contiguous(fields.bytes(size.into())?))
            }
            1 => {
                let (address, size) = (fields.u64()?, fields.u64()?);
                if address == UNDEFINED {
                    return Err(FileProblem::field(
                        "data address",
                        "an address inside the file",
                        "none: nothing was written",
                    ));
                }
                let size = usize::try_from(size).unwrap_or(usize::MAX);
                Ok(Self::Contiguous(Fields::at(file, address, "contiguous data")?.bytes(size)?))
            }
            _ => Ok(Self::Chunked { version, fields }),
        }
    }
}

/// Copies a chunk to its position; values outside the dataset are dropped.
fn place(offset: [u64; 3], chunk: &[f32], chunk_shape: [u64; 3], values: &mut [f32], shape: [u64; 3]) {
    let offset = offset.map(|start| start as usize);
    let [_, chunk_columns, chunk_channels] = chunk_shape.map(|side| side as usize);
    let [_, columns, channels] = shape.map(|side| side as usize);
    let inside: [usize; 3] =
        std::array::from_fn(|axis| (chunk_shape[axis] as usize).min(shape[axis] as usize - offset[axis]));
    for row in 0..inside[0] {
        let from = &chunk[row * chunk_columns * chunk_channels..];
        let to = &mut values[((offset[0] + row) * columns + offset[1]) * channels..];
        if chunk_channels == channels {
            to[..inside[1] * channels].copy_from_slice(&from[..inside[1] * channels]);
            continue;
        }
        for column in 0..inside[1] {
            let to = &mut to[column * channels + offset[2]..][..inside[2]];
            to.copy_from_slice(&from[column * chunk_channels..][..inside[2]]);
        }
    }
}

/// The shape of a dataset of three dimensions.
fn parse_image_shape(data: &[u8]) -> Result<[u64; 3], FileProblem> {
    let shape = parse_shape(data)?;
    let found = format!("{} of them: {shape:?}", shape.len());
    shape.try_into().map_err(|_| FileProblem::field("dataspace", "3 dimensions", found))
}

/// The dataspace message (section IV.A.2.b).
pub(super) fn parse_shape(data: &[u8]) -> Result<Vec<u64>, FileProblem> {
    let mut fields = Fields::new(data, "dataspace");
    let version = fields.one_of("dataspace version", &[1, 2])?;
    let dimensions = fields.u8()?;
    fields.bytes(if version == 1 { 6 } else { 2 })?; // flags, reserved or type
    (0..dimensions).map(|_| fields.u64()).collect()
}

/// The datatype message (section IV.A.2.d): an IEEE floating-point number.
pub(super) fn parse_sample(data: &[u8]) -> Result<Sample, FileProblem> {
    let mut fields = Fields::new(data, "datatype");
    let class = fields.u8()? & 0x0f;
    let bits = fields.number(3)?;
    let size = fields.u32()?;
    let endian = match bits & 0x41 {
        0x00 => Some(Endian::Little),
        0x01 => Some(Endian::Big),
        _ => None,
    };
    // Offset, precision; position and size of the exponent and of the mantissa; exponent bias.
    let sample = match (class, size, endian) {
        (1, 2, Some(endian)) => Some((Sample::F16(endian), [0, 16, 10, 5, 0, 10, 15])),
        (1, 4, Some(endian)) => Some((Sample::F32(endian), [0, 32, 23, 8, 0, 23, 127])),
        (1, 8, Some(endian)) => Some((Sample::F64(endian), [0, 64, 52, 11, 0, 52, 1023])),
        _ => None,
    };
    let mut number = |bytes| fields.number(bytes);
    match sample {
        Some((sample, standard))
            if [number(2)?, number(2)?, number(1)?, number(1)?, number(1)?, number(1)?, number(4)?]
                == standard =>
        {
            Ok(sample)
        }
        _ => {
            let found = format!("class {class} of {size} bytes");
            Err(FileProblem::field("datatype", "an IEEE floating-point number of 2, 4 or 8 bytes", found))
        }
    }
}

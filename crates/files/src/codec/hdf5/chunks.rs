use std::collections::HashSet;
use std::io::Read;

use flate2::read::ZlibDecoder;

use super::UNDEFINED;
use super::fields::Fields;
use crate::FileProblem;
use crate::codec::claim::{blank, check_deflated, check_file_size};
use crate::codec::samples::Sample;

/// Filters applied to a chunk's bytes before storage (section IV.A.2.l).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Filter {
    Deflate,
    Shuffle,
    Fletcher32,
}

/// A stored piece of a dataset.
pub(super) struct Chunk<'a> {
    /// Index of its first value in the dataset.
    pub(super) offset: [u64; 3],
    stored: &'a [u8],
    /// Bit `i` is set if filter `i` was skipped.
    skipped_filters: u32,
}

impl Chunk<'_> {
    /// # Errors
    /// When the stored bytes cannot expand to `bytes` bytes of values.
    pub(super) fn check_claim(&self, filters: &[Filter], bytes: u64) -> Result<(), FileProblem> {
        let applied = |filter| self.applied(filters).any(|applied| applied == filter);
        if applied(Filter::Deflate) {
            return check_deflated(bytes, self.stored.len() as u64);
        }
        let check_sum = if applied(Filter::Fletcher32) { 4 } else { 0 };
        check_file_size(bytes + check_sum, self.stored.len() as u64)
    }

    fn applied<'f>(&self, filters: &'f [Filter]) -> impl DoubleEndedIterator<Item = Filter> + use<'f> {
        let skipped = self.skipped_filters;
        filters.iter().enumerate().filter(move |(i, _)| skipped >> i & 1 == 0).map(|(_, filter)| *filter)
    }

    /// The bytes of the values: reverses the filters from last to first.
    pub(super) fn decode(
        &self,
        filters: &[Filter],
        bytes: usize,
        sample_bytes: usize,
    ) -> Result<Vec<u8>, FileProblem> {
        let mut data = self.stored.to_vec();
        for filter in self.applied(filters).rev() {
            data = match filter {
                Filter::Deflate => inflate(&data, bytes)?,
                Filter::Shuffle => unshuffle(&data, sample_bytes),
                Filter::Fletcher32 => checked_fletcher32(data)?,
            };
        }
        check_file_size(bytes as u64, data.len() as u64)?;
        Ok(data)
    }
}

fn inflate(data: &[u8], bytes: usize) -> Result<Vec<u8>, FileProblem> {
    let wrong = |found: String| FileProblem::field("chunk", format!("{bytes} bytes of deflated data"), found);
    let mut inflated = blank(bytes)?;
    let mut decoder = ZlibDecoder::new(data);
    decoder.read_exact(&mut inflated).map_err(|error| wrong(error.to_string()))?;
    match decoder.read(&mut [0]) {
        Ok(0) => Ok(inflated),
        Ok(_) => Err(wrong("more".to_owned())),
        Err(error) => Err(wrong(error.to_string())),
    }
}

/// Reverses the shuffle filter: first bytes of all values, second bytes of all, and so on.
fn unshuffle(data: &[u8], sample_bytes: usize) -> Vec<u8> {
    let mut values = data.to_vec(); // remaining bytes at the end stay in place
    let count = data.len() / sample_bytes;
    for (place, plane) in data.chunks_exact(count.max(1)).take(sample_bytes).enumerate() {
        for (value, byte) in values.chunks_exact_mut(sample_bytes).zip(plane) {
            value[place] = *byte;
        }
    }
    values
}

fn checked_fletcher32(mut data: Vec<u8>) -> Result<Vec<u8>, FileProblem> {
    let wrong =
        || FileProblem::field("chunk", "data that matches its Fletcher-32 checksum", "a corrupt chunk");
    let at = data.len().checked_sub(4).ok_or_else(wrong)?;
    let stored = data.split_off(at);
    if stored == fletcher32(&data).to_le_bytes() { Ok(data) } else { Err(wrong()) }
}

/// Over big-endian 16-bit words; a last single byte is the high byte of a word.
fn fletcher32(data: &[u8]) -> u32 {
    let (mut low, mut high) = (0_u64, 0_u64);
    for block in data.chunks(720) {
        for word in block.chunks(2) {
            low += u64::from(word[0]) << 8 | u64::from(word.get(1).copied().unwrap_or(0));
            high += low;
        }
        low %= 65535;
        high %= 65535;
    }
    // The reference folds sums and never reduces them to zero.
    let fold = |sum: u64, any: bool| if sum == 0 && any { 65535 } else { sum };
    let any = data.iter().any(|byte| *byte != 0);
    (fold(high, any) << 16 | fold(low, any)) as u32
}

/// The filter pipeline message.
pub(super) fn parse_filters(data: &[u8]) -> Result<Vec<Filter>, FileProblem> {
    let mut fields = Fields::new(data, "filter pipeline");
    let version = fields.one_of("filter pipeline version", &[1, 2])?;
    let count = fields.u8()?;
    fields.bytes(if version == 1 { 6 } else { 0 })?;
    let mut filters = Vec::new();
    for _ in 0..count {
        let id = fields.u16()?;
        let name_bytes = if version == 1 || id >= 256 { fields.u16()? } else { 0 };
        fields.bytes(2)?; // flags
        let values = usize::from(fields.u16()?);
        fields.bytes(name_bytes.into())?;
        fields.bytes(4 * values)?;
        fields.bytes(if version == 1 && values % 2 == 1 { 4 } else { 0 })?;
        filters.push(match id {
            1 => Filter::Deflate,
            2 => Filter::Shuffle,
            3 => Filter::Fletcher32,
            _ => {
                let expected = "gzip, shuffle or fletcher32 (rewrite it with compression=\"gzip\")";
                return Err(FileProblem::field("filter", expected, format!("filter number {id}")));
            }
        });
    }
    Ok(filters)
}

/// Shape and location of the chunks: the rest of a data layout message of class 2.
pub(super) fn chunks_of_layout<'a>(
    file: &'a [u8],
    mut fields: Fields<'a>,
    version: u8,
    shape: [u64; 3],
    sample: Sample,
    filters: &[Filter],
) -> Result<([u64; 3], Vec<Chunk<'a>>), FileProblem> {
    if version == 3 {
        fields.one_of("dimensions of chunks", &[4])?;
        let tree = fields.u64()?;
        let chunk_shape = chunk_shape(&mut fields, 4, sample, shape)?;
        return Ok((chunk_shape, chunks_of_tree(file, tree)?));
    }
    let flags = fields.one_of("chunk flags", &[0, 2])?;
    fields.one_of("dimensions of chunks", &[4])?;
    let side_bytes = fields.one_of("bytes of a chunk's side", &[1, 2, 3, 4, 5, 6, 7, 8])?;
    let chunk_shape = chunk_shape(&mut fields, side_bytes.into(), sample, shape)?;
    let unfiltered =
        chunk_shape.iter().fold(sample.bytes() as u64, |bytes, side| bytes.saturating_mul(*side));
    const SINGLE: u8 = 1;
    let chunks = match fields.one_of("chunk index", &[SINGLE, 3])? {
        SINGLE => {
            let (size, skipped_filters) =
                if flags == 2 { (fields.u64()?, fields.u32()?) } else { (unfiltered, 0) };
            let stored = stored_at(file, fields.u64()?, size)?;
            vec![Chunk { offset: [0; 3], stored, skipped_filters }]
        }
        _ => {
            fields.bytes(1)?; // page bits, repeated in the array's header
            let unfiltered = filters.is_empty().then_some(unfiltered);
            chunks_of_fixed_array(file, fields.u64()?, shape, chunk_shape, unfiltered)?
        }
    };
    Ok((chunk_shape, chunks))
}

/// Checks that a chunk is no larger than the dataset, since the excess would only waste memory.
fn chunk_shape(
    fields: &mut Fields,
    side_bytes: usize,
    sample: Sample,
    shape: [u64; 3],
) -> Result<[u64; 3], FileProblem> {
    let chunk = [fields.number(side_bytes)?, fields.number(side_bytes)?, fields.number(side_bytes)?];
    let element = fields.number(side_bytes)?;
    let fits = chunk.iter().zip(shape).all(|(chunk, side)| (1..=side).contains(chunk));
    if fits && element == sample.bytes() as u64 {
        return Ok(chunk);
    }
    let expected = format!("at least 1 and at most {shape:?} values of {} bytes", sample.bytes());
    Err(FileProblem::field("chunk shape", expected, format!("{chunk:?} of {element} bytes")))
}

fn stored_at(file: &[u8], address: u64, size: u64) -> Result<&[u8], FileProblem> {
    Fields::at(file, address, "chunk")?.bytes(usize::try_from(size).unwrap_or(usize::MAX))
}

/// The chunks listed by a B-tree of version 1 (section III.A.1).
fn chunks_of_tree(file: &[u8], tree: u64) -> Result<Vec<Chunk<'_>>, FileProblem> {
    const NAME: &str = "chunk B-tree";
    if tree == UNDEFINED {
        return Ok(Vec::new());
    }
    let mut chunks = Vec::new();
    // Each node has its own place in the file: more visits than nodes can fit means a loop.
    let mut nodes_left = file.len() / 24;
    let mut waiting = vec![tree];
    while let Some(address) = waiting.pop() {
        let mut node = Fields::at(file, address, NAME)?;
        node.signature(b"TREE")?;
        node.one_of("B-tree type", &[1])?;
        let level = node.u8()?;
        let entries = node.u16()?;
        node.bytes(16)?; // siblings
        let room = nodes_left.checked_sub(1 + usize::from(entries));
        nodes_left = room.ok_or_else(|| FileProblem::field(NAME, "a tree", "a cycle of nodes"))?;
        for _ in 0..entries {
            let size = node.u32()?;
            let skipped_filters = node.u32()?;
            let offset = [node.u64()?, node.u64()?, node.u64()?];
            node.u64()?; // offset inside an element
            let address = node.u64()?;
            if level > 0 {
                waiting.push(address);
            } else {
                let stored = stored_at(file, address, size.into())?;
                chunks.push(Chunk { offset, stored, skipped_filters });
            }
        }
    }
    Ok(chunks)
}

/// The chunks listed by a fixed array, row-major (sections VII.B and VII.C); `bytes` is their size if they are not filtered.
fn chunks_of_fixed_array<'a>(
    file: &'a [u8],
    address: u64,
    shape: [u64; 3],
    chunk_shape: [u64; 3],
    bytes: Option<u64>,
) -> Result<Vec<Chunk<'a>>, FileProblem> {
    const NAME: &str = "fixed array of chunks";
    let mut header = Fields::at(file, address, NAME)?;
    header.signature(b"FAHD")?;
    header.one_of("fixed array version", &[0])?;
    header.one_of("fixed array client", &[u8::from(bytes.is_none())])?;
    let entry_bytes = usize::from(header.u8()?);
    let page_bits = header.u8()?;
    let count = header.u64()?;
    let grid: [u64; 3] = std::array::from_fn(|axis| shape[axis].div_ceil(chunk_shape[axis]));
    let expected = grid.iter().try_fold(1_u64, |count, side| count.checked_mul(*side));
    if expected != Some(count) || page_bits > 32 || count > 1 << page_bits {
        let expected = "as many entries as chunks, on one page (files written with h5py's default settings are supported)";
        return Err(FileProblem::field(NAME, expected, format!("{count} entries")));
    }
    let mut block = Fields::at(file, header.u64()?, NAME)?;
    block.signature(b"FADB")?;
    block.bytes(1 + 1 + 8)?; // version, client, address of the header
    let size_bytes =
        entry_bytes.checked_sub(if bytes.is_some() { 8 } else { 8 + 4 }).filter(|size| *size <= 8);
    let size_bytes = size_bytes
        .ok_or_else(|| FileProblem::field(NAME, "entries of 8 to 20 bytes", entry_bytes.to_string()))?;
    let mut chunks = Vec::new();
    for index in 0..count {
        let address = block.u64()?;
        let stored_bytes = block.number(size_bytes)?;
        let skipped_filters = if bytes.is_some() { 0 } else { block.u32()? };
        let place = [index / grid[2] / grid[1], index / grid[2] % grid[1], index % grid[2]];
        let offset = std::array::from_fn(|axis| place[axis] * chunk_shape[axis]);
        let stored = stored_at(file, address, bytes.unwrap_or(stored_bytes))?;
        chunks.push(Chunk { offset, stored, skipped_filters });
    }
    Ok(chunks)
}

/// # Errors
/// When the chunks do not tile the dataset exactly.
pub(super) fn check_complete(
    chunks: &[Chunk],
    shape: [u64; 3],
    chunk_shape: [u64; 3],
) -> Result<(), FileProblem> {
    let tiles = shape
        .iter()
        .zip(chunk_shape)
        .try_fold(1_u64, |tiles, (side, chunk)| tiles.checked_mul(side.div_ceil(chunk)));
    let in_place = |chunk: &Chunk| {
        (0..3).all(|axis| {
            chunk.offset[axis] < shape[axis] && chunk.offset[axis].is_multiple_of(chunk_shape[axis])
        })
    };
    let places: HashSet<[u64; 3]> =
        chunks.iter().filter(|chunk| in_place(chunk)).map(|chunk| chunk.offset).collect();
    if tiles == Some(places.len() as u64) && places.len() == chunks.len() {
        return Ok(());
    }
    let expected = format!("chunks of {chunk_shape:?} that tile {shape:?}");
    Err(FileProblem::field(
        "chunks",
        expected,
        format!("{} chunks, {} of them at expected positions", chunks.len(), places.len()),
    ))
}

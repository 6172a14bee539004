use std::io::{self, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;

use super::{MAGIC, UNDEFINED};

/// Children of a node of a chunk B-tree: twice the rank that superblock version 0 implies.
const TREE_CHILDREN: usize = 64;

/// Raw bytes of a chunk, unless the image is too large for one B-tree node.
const CHUNK_BYTES: usize = 1 << 20;

/// Fast, and after the shuffle as small as gzip's highest levels without it.
const LEVEL: u32 = 2;

/// Writes a file with one dataset of `f32` of shape (H, W, channels) in the root group, in chunks of whole rows, shuffled and
/// deflated. The bytes do not depend on the number of threads. Every side must be under 2^32.
///
/// # Errors
/// When the writer fails, or the shape does not match the number of values.
pub(in crate::codec) fn write_image(
    name: &str,
    shape: [usize; 3],
    values: &[f32],
    writer: &mut impl Write,
) -> io::Result<()> {
    let [height, width, channels] = shape;
    let row = width * channels;
    if row == 0 || height * row != values.len() {
        return Err(io::Error::other(format!("{} values do not make an image {shape:?}", values.len())));
    }
    let chunk_rows = (CHUNK_BYTES / (4 * row)).clamp(1, height).max(height.div_ceil(TREE_CHILDREN));
    let chunks: Vec<Vec<u8>> = values
        .par_chunks(chunk_rows * row)
        .map(|chunk| compress(chunk, chunk_rows * row))
        .collect::<io::Result<_>>()?;
    let file = Layout::new(name, shape, chunk_rows);
    writer.write_all(&file.metadata(&chunks)?)?;
    chunks.iter().try_for_each(|chunk| writer.write_all(chunk))
}

/// Shuffles and deflates a chunk of `count` values; those beyond the image are zero.
fn compress(values: &[f32], count: usize) -> io::Result<Vec<u8>> {
    let mut planes = vec![0; 4 * count];
    for (place, plane) in planes.chunks_exact_mut(count).enumerate() {
        for (byte, value) in plane.iter_mut().zip(values) {
            *byte = value.to_le_bytes()[place];
        }
    }
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(LEVEL));
    encoder.write_all(&planes)?;
    encoder.finish()
}

/// Addresses of all structures: superblock, root group (object header, B-tree, heap, symbol node), dataset (object header,
/// B-tree), chunks.
struct Layout<'a> {
    name: &'a str,
    shape: [usize; 3],
    chunk_rows: usize,
}

const ROOT_HEADER: usize = 96;
const GROUP_TREE: usize = ROOT_HEADER + 16 + 24;
const HEAP: usize = GROUP_TREE + 24 + 33 * 8 + 32 * 8;
const HEAP_DATA: usize = HEAP + 32;
const HEAP_DATA_BYTES: usize = 64;
const SYMBOLS: usize = HEAP_DATA + HEAP_DATA_BYTES;
const DATASET_HEADER: usize = SYMBOLS + 8 + 8 * 40;
const DATASET_MESSAGES_BYTES: usize = 5 * 8 + 32 + 24 + 8 + 32 + 56;
const CHUNK_TREE: usize = DATASET_HEADER + 16 + DATASET_MESSAGES_BYTES;
const CHUNK_KEY_BYTES: usize = 4 + 4 + 4 * 8;
const CHUNKS: usize = CHUNK_TREE + 24 + (TREE_CHILDREN + 1) * CHUNK_KEY_BYTES + TREE_CHILDREN * 8;

impl<'a> Layout<'a> {
    fn new(name: &'a str, shape: [usize; 3], chunk_rows: usize) -> Self {
        Self { name, shape, chunk_rows }
    }

    /// Everything before the chunks.
    fn metadata(&self, chunks: &[Vec<u8>]) -> io::Result<Vec<u8>> {
        let mut file = Bytes(Vec::with_capacity(CHUNKS));
        let end = CHUNKS + chunks.iter().map(Vec::len).sum::<usize>();
        self.superblock(&mut file, end);
        self.root_group(&mut file);
        self.dataset_header(&mut file);
        self.chunk_tree(&mut file, chunks)?;
        Ok(file.0)
    }

    /// Section II.A, version 0.
    fn superblock(&self, file: &mut Bytes, end: usize) {
        file.bytes(MAGIC);
        file.bytes(&[0, 0, 0, 0, 0, 8, 8, 0]); // versions; sizes of offsets and lengths
        file.u16(4); // half the entries of a symbol node
        file.u16(16); // half the children of a group's B-tree node
        file.u32(0);
        file.u64(0); // base address
        file.u64(UNDEFINED); // free space
        file.u64(end as u64);
        file.u64(UNDEFINED); // driver information
        file.u64(0); // name of the root group
        file.u64(ROOT_HEADER as u64);
        file.u32(1); // the next two are cached
        file.u32(0);
        file.u64(GROUP_TREE as u64);
        file.u64(HEAP as u64);
    }

    /// Sections IV.A.1, III.A.1, III.D and III.B, for a group of one entry.
    fn root_group(&self, file: &mut Bytes) {
        file.pad_to(ROOT_HEADER);
        file.object_header(1, 24);
        file.message(0x11, 16);
        file.u64(GROUP_TREE as u64);
        file.u64(HEAP as u64);

        file.pad_to(GROUP_TREE);
        file.bytes(b"TREE\0\0");
        file.u16(1); // entries
        file.u64(UNDEFINED); // siblings
        file.u64(UNDEFINED);
        file.u64(0); // before the first name: the empty one
        file.u64(SYMBOLS as u64);
        file.u64(8); // the last name

        file.pad_to(HEAP);
        file.bytes(b"HEAP\0\0\0\0");
        file.u64(HEAP_DATA_BYTES as u64);
        file.u64(1); // no free list
        file.u64(HEAP_DATA as u64);
        file.pad_to(HEAP_DATA + 8); // the empty name
        file.bytes(self.name.as_bytes());

        file.pad_to(SYMBOLS);
        file.bytes(b"SNOD\x01\0");
        file.u16(1); // entries
        file.u64(8); // name in the heap
        file.u64(DATASET_HEADER as u64);
    }

    fn dataset_header(&self, file: &mut Bytes) {
        file.pad_to(DATASET_HEADER);
        file.object_header(5, DATASET_MESSAGES_BYTES);

        file.message(0x01, 32); // dataspace
        file.bytes(&[1, 3, 0, 0, 0, 0, 0, 0]);
        self.shape.iter().for_each(|side| file.u64(*side as u64));

        file.message(0x03, 24); // datatype: IEEE binary32, little-endian
        file.bytes(&[0x11, 0x20, 0x1f, 0]);
        file.u32(4);
        file.bytes(&[0, 0, 32, 0, 23, 8, 0, 23, 127, 0, 0, 0, 0, 0, 0, 0]);

        file.message(0x05, 8); // fill value: zero
        file.bytes(&[2, 3, 2, 1, 0, 0, 0, 0]);

        file.message(0x08, 32); // data layout: chunked
        file.bytes(&[3, 2, 4]);
        file.u64(CHUNK_TREE as u64);
        for side in [self.chunk_rows, self.shape[1], self.shape[2], 4] {
            file.u32(side as u32);
        }
        file.bytes(&[0; 5]);

        file.message(0x0b, 56); // filters
        file.bytes(&[1, 2, 0, 0, 0, 0, 0, 0]);
        for (id, name, parameter) in [(2, b"shuffle\0", 4), (1, b"deflate\0", LEVEL)] {
            file.u16(id);
            file.u16(8); // length of the name
            file.u16(1); // may be absent when reading
            file.u16(1); // parameters
            file.bytes(name);
            file.u32(parameter);
            file.u32(0);
        }
    }

    /// One node of section III.A.1: sizes, offsets and addresses of the chunks.
    fn chunk_tree(&self, file: &mut Bytes, chunks: &[Vec<u8>]) -> io::Result<()> {
        file.pad_to(CHUNK_TREE);
        file.bytes(b"TREE\x01\0");
        file.u16(chunks.len() as u16);
        file.u64(UNDEFINED); // siblings
        file.u64(UNDEFINED);
        let mut address = CHUNKS;
        for (index, chunk) in chunks.iter().enumerate() {
            let size = u32::try_from(chunk.len());
            file.u32(size.map_err(|_| io::Error::other("a chunk is beyond 2^32 bytes"))?);
            self.chunk_offset(file, index);
            file.u64(address as u64);
            address += chunk.len();
        }
        file.u32(0);
        self.chunk_offset(file, chunks.len());
        file.pad_to(CHUNKS);
        Ok(())
    }

    fn chunk_offset(&self, file: &mut Bytes, index: usize) {
        file.u32(0); // every filter is applied
        file.u64((index * self.chunk_rows) as u64);
        file.bytes(&[0; 3 * 8]);
    }
}

/// A file under construction; numbers are little-endian.
struct Bytes(Vec<u8>);

impl Bytes {
    fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    fn u16(&mut self, number: u16) {
        self.bytes(&number.to_le_bytes());
    }

    fn u32(&mut self, number: u32) {
        self.bytes(&number.to_le_bytes());
    }

    fn u64(&mut self, number: u64) {
        self.bytes(&number.to_le_bytes());
    }

    fn pad_to(&mut self, address: usize) {
        debug_assert!(self.0.len() <= address, "a structure is longer than the room for it");
        self.0.resize(address, 0);
    }

    /// Version 1, with this number of messages and bytes.
    fn object_header(&mut self, messages: u16, bytes: usize) {
        self.bytes(&[1, 0]);
        self.u16(messages);
        self.u32(1); // references
        self.u32(bytes as u32);
        self.u32(0);
    }

    fn message(&mut self, kind: u16, bytes: u16) {
        self.u16(kind);
        self.u16(bytes);
        self.u32(0); // flags
    }
}

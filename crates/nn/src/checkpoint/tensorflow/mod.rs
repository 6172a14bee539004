//! TensorFlow checkpoints (`tf.train.Saver`, "bundles"): a table of the tensors (`NAME.index`), and one or more files with their
//! bytes in the same folder (`NAME.data-00000-of-00001`).
//!
//! The messages are defined in `tensorflow/core/protobuf/tensor_bundle.proto`; the table is LevelDB's.

pub(super) mod layout;
mod proto;
mod table;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::rc::Rc;

use burn::tensor::DType;
use srflow_core::excerpt;
use srflow_files::{FileKind, open_file};

use super::{Contents, StoredBytes, StoredTensor};
use proto::Fields;

pub use proto::push_varint;
pub(super) use table::is_table;
pub use table::masked_crc32c;

/// Largest table of tensors. For a network with a thousand tensors it has less than 100 kB.
const MAX_TABLE_BYTES: u64 = 64 << 20;
/// Most files of tensors. Programs on a single machine write one.
const MAX_SHARDS: u64 = 1024;

/// The table entry of a tensor.
struct Entry {
    /// `None` for types other than floating point.
    dtype: Option<DType>,
    /// In TensorFlow's order.
    shape: Vec<usize>,
    shard: u64,
    start: u64,
    len: u64,
    crc32c: u32,
}

/// The files of tensors that belong to a table.
struct Shards<'a> {
    table: &'a Path,
    count: u64,
    opened: BTreeMap<u64, (Rc<File>, u64)>,
}

pub(super) fn contents(path: &Path, mut file: File, len: u64) -> Result<Contents, String> {
    if len > MAX_TABLE_BYTES {
        return Err(format!("its table of tensors has {len} bytes, more than {MAX_TABLE_BYTES}"));
    }
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0)).map_err(|error| error.to_string())?;
    file.take(len).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    let mut entries = table::entries(&bytes)?.into_iter();
    let header = match entries.next() {
        Some((name, header)) if name.is_empty() => header,
        _ => return Err("its table does not start with a header".into()),
    };
    let mut shards = Shards { table: path, count: shard_count(&header)?, opened: BTreeMap::new() };
    let mut tensors = BTreeMap::new();
    for (name, entry) in entries {
        // Keys of parts of partitioned variables are not UTF-8.
        let Ok(name) = String::from_utf8(name) else { continue };
        let Some(reference_name) = layout::reference_name(&name) else { continue };
        let in_entry = |problem: String| format!("{}: {problem}", excerpt(&name));
        let entry = Entry::parse(&entry).map_err(in_entry)?;
        let Some(dtype) = entry.dtype else { continue };
        let bytes = shards.bytes_of(&entry, dtype).map_err(in_entry)?;
        let shape = layout::reference_shape(&entry.shape);
        tensors.insert(reference_name, StoredTensor { dtype, shape, bytes });
    }
    let shard_bytes =
        shards.opened.values().map(|(_, len)| len).fold(0, |sum: u64, len| sum.saturating_add(*len));
    Ok(Contents { shard_bytes, ..Contents::from(tensors) })
}

/// The name of the table of a file of tensors; `None` if the file is not named like one.
pub(super) fn table_of(path: &Path) -> Option<String> {
    let (stem, parts) = path.file_name()?.to_str()?.rsplit_once(".data-")?;
    let (shard, count) = parts.split_once("-of-")?;
    let digits = |text: &str| text.len() == 5 && text.bytes().all(|byte| byte.is_ascii_digit());
    (digits(shard) && digits(count)).then(|| format!("{stem}.index"))
}

/// Number of shards in a `BundleHeaderProto`.
fn shard_count(header: &[u8]) -> Result<u64, String> {
    let mut count = 0;
    for field in Fields::new(header) {
        match field? {
            (1, value) => count = value.number()?,
            (2, value) if value.number()? != 0 => {
                return Err("its values are big-endian; save it on a little-endian machine".into());
            }
            _ => {}
        }
    }
    if count > MAX_SHARDS {
        return Err(format!("its header claims {count} files of tensors, more than {MAX_SHARDS}"));
    }
    Ok(count)
}

impl Entry {
    /// Parses a `BundleEntryProto`.
    fn parse(entry: &[u8]) -> Result<Self, String> {
        let mut found = Self { dtype: None, shape: Vec::new(), shard: 0, start: 0, len: 0, crc32c: 0 };
        for field in Fields::new(entry) {
            match field? {
                (1, value) => {
                    found.dtype = match value.number()? {
                        1 => Some(DType::F32),
                        2 => Some(DType::F64),
                        14 => Some(DType::BF16),
                        19 => Some(DType::F16),
                        _ => None,
                    }
                }
                (2, value) => found.shape = shape(value.message()?)?,
                (3, value) => found.shard = value.number()?,
                (4, value) => found.start = value.number()?,
                (5, value) => found.len = value.number()?,
                (6, value) => found.crc32c = value.fixed32()?,
                (7, _) => {
                    let advice = "save it without a partitioner";
                    return Err(format!("partitioned variables are not supported; {advice}"));
                }
                _ => {}
            }
        }
        Ok(found)
    }
}

/// Parses a `TensorShapeProto`.
fn shape(message: Fields) -> Result<Vec<usize>, String> {
    let mut shape = Vec::new();
    for field in message {
        if let (2, dimension) = field? {
            let mut size = 0;
            for field in dimension.message()? {
                if let (1, value) = field? {
                    size = value.number()?;
                }
            }
            // Negative sizes, such as -1 for unknown ones, are above `isize::MAX` as unsigned numbers.
            let size = usize::try_from(size).ok().filter(|size| *size <= isize::MAX as usize);
            shape.push(size.ok_or("its shape has a negative size")?);
        }
    }
    Ok(shape)
}

impl Shards<'_> {
    /// Checks the range of an entry against its file, and its length against its shape.
    fn bytes_of(&mut self, entry: &Entry, dtype: DType) -> Result<StoredBytes, String> {
        let Entry { shard, start, len, crc32c, .. } = *entry;
        let (file, file_len) = self.open(shard)?;
        if start.checked_add(len).is_none_or(|end| end > file_len) {
            let claim = format!("{len} bytes at {start} in file {shard} of {}", self.count);
            return Err(format!("it claims {claim}, which has {file_len}"));
        }
        let numbers = entry.shape.iter().map(|&size| size as u64).fold(1, u64::saturating_mul);
        let expected = numbers.saturating_mul(dtype.size() as u64);
        let in_memory = usize::try_from(len).ok().filter(|_| len == expected && len > 0);
        let Some(len) = in_memory else {
            return Err(format!("expected {expected} bytes for its shape {:?}, found {len}", entry.shape));
        };
        Ok(StoredBytes::Tensorflow { file, start, len, crc32c, shape: entry.shape.clone() })
    }

    fn open(&mut self, shard: u64) -> Result<(Rc<File>, u64), String> {
        if shard >= self.count {
            return Err(format!("it claims to be in file {shard} of {}", self.count));
        }
        if let Some((file, len)) = self.opened.get(&shard) {
            return Ok((file.clone(), *len));
        }
        let name = self.table.file_name().and_then(|name| name.to_str());
        let Some(stem) = name.and_then(|name| name.strip_suffix(".index")) else {
            let expected = format!("NAME.data-00000-of-{:05}", self.count);
            return Err(format!(
                "its tensors are in {expected}, so its name must be NAME.index; rename it to match that file"
            ));
        };
        let path = self.table.with_file_name(format!("{stem}.data-{shard:05}-of-{:05}", self.count));
        let (file, len) = open_file(&path, FileKind::Checkpoint)
            .map_err(|error| format!("opening the file of its tensors: {error}"))?;
        let file = Rc::new(file);
        self.opened.insert(shard, (file.clone(), len));
        Ok((file, len))
    }
}

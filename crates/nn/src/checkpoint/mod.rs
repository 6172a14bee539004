//! Checkpoint files of other programs, recognized by their content.
//!
//! PyTorch files are pickles: they are parsed, never executed. Opening a file reads names, types and shapes of its tensors; every
//! size in it is checked against the length of the file before memory is allocated.

mod burnpack;
mod keras;
mod naming;
mod pytorch;
mod pytorch_writer;
mod safetensors;
mod searchable_text;
mod sharded;
mod tensorflow;

pub use pytorch_writer::save_pytorch;
pub use safetensors::{StoredAs, parameters_of_safetensors, read_safetensors, safetensors_bytes};
pub use searchable_text::searchable_text;
pub use tensorflow::{masked_crc32c, push_varint};

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use burn::tensor::{DType, TensorData};
use serde::{Deserialize, Serialize};
use srflow_core::excerpt;
use srflow_files::{FileKind, open_file};

use crate::parameters::{ParameterInfo, Parameters};
use crate::weights::WeightsError;

/// Most bytes of tensors per byte of the file. Valid checkpoints may share storages or be compressed, but reach less.
const MAX_CLAIM_RATIO: u64 = 8;
/// Bytes needed to recognize a format, at the start and at the end of a file.
const MAGIC_BYTES: u64 = 262;
const END_BYTES: u64 = 8;

/// Format of a checkpoint file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// From `torch.save` since PyTorch 1.6, and from Lightning (`.ckpt`).
    PytorchZip,
    /// From `torch.save` before PyTorch 1.6, or with `_use_new_zipfile_serialization=False`.
    PytorchLegacy,
    /// From Hugging Face's library, and from [`save_parameters`](crate::save_parameters).
    Safetensors,
    /// From Burn.
    Burnpack,
    /// From TensorFlow (`tf.train.Saver`): the `.index` file; the tensors are in other files of the same folder.
    Tensorflow,
    /// From Keras, in HDF5.
    Keras,
    /// An index of several files (`.index.json`) from Hugging Face's libraries.
    Sharded,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PytorchZip => "PyTorch (zip)",
            Self::PytorchLegacy => "PyTorch (legacy)",
            Self::Safetensors => "safetensors",
            Self::Burnpack => "burnpack",
            Self::Tensorflow => "TensorFlow checkpoint (.index)",
            Self::Keras => "Keras (HDF5)",
            Self::Sharded => "index of several files (.index.json)",
        })
    }
}

/// An open checkpoint file: its floating-point tensors under the names of the reference implementation, their values not read
/// yet. Containers and prefixes of names are removed, and so are duplicates.
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    format: Format,
    container: Option<&'static str>,
    prefix: String,
    tensors: BTreeMap<String, StoredTensor>,
    hyper_parameters: BTreeMap<String, f64>,
}

/// The contents of a file, under the names in the file.
struct Contents {
    tensors: BTreeMap<String, StoredTensor>,
    hyper_parameters: BTreeMap<String, f64>,
    /// Names and kinds of arrays that are no tensors of floating-point numbers.
    others: BTreeMap<String, String>,
    /// Bytes of the other files of a checkpoint with several files.
    shard_bytes: u64,
}

/// Metadata in files written by srflow.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct About {
    /// Name of the network.
    pub network: String,
    /// Settings of the network that are not parameters, by name.
    pub settings: BTreeMap<String, usize>,
    /// The settings that the reference implementation reads, under its names.
    pub hyper_parameters: BTreeMap<String, usize>,
}

#[derive(Debug)]
struct StoredTensor {
    dtype: DType,
    shape: Vec<usize>,
    bytes: StoredBytes,
}

#[derive(Debug)]
enum StoredBytes {
    Range {
        file: Rc<File>,
        start: u64,
        len: usize,
    },
    Pytorch(pytorch::StridedTensor),
    Tensorflow {
        file: Rc<File>,
        start: u64,
        len: usize,
        /// Masked.
        crc32c: u32,
        /// In TensorFlow's order.
        shape: Vec<usize>,
    },
    Memory(Vec<u8>),
}

impl Checkpoint {
    /// Opens a file and reads everything but the values.
    ///
    /// # Errors
    /// When the file cannot be read, is not a checkpoint or a broken one, or contains no floating-point tensors.
    pub fn open(path: &Path) -> Result<Self, WeightsError> {
        let (file, len, format) = recognized(path)?;
        let broken = |problem: String| WeightsError::broken(path, format, &problem);
        let Contents { tensors, hyper_parameters, others, shard_bytes } =
            contents_of(path, file, len, format)?;
        let named = naming::reference_names(tensors);
        if named.tensors.is_empty() {
            let mut kinds = BTreeMap::<String, usize>::new();
            others.into_values().for_each(|kind| *kinds.entry(kind).or_default() += 1);
            let kinds: Vec<String> = kinds.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
            let found = if kinds.is_empty() { "none".to_owned() } else { kinds.join(", ") };
            return Err(WeightsError::Empty { path: path.to_owned(), found });
        }
        let claimed = named.tensors.values().map(StoredTensor::claim).fold(0, u64::saturating_add);
        let stored = len.saturating_add(shard_bytes);
        if claimed > stored.saturating_mul(MAX_CLAIM_RATIO) {
            return Err(broken(format!("its tensors claim {claimed} bytes, the file has {stored}")));
        }
        Ok(Self {
            path: path.to_owned(),
            format,
            container: named.container,
            prefix: named.prefix,
            tensors: named.tensors,
            hyper_parameters,
        })
    }

    pub fn format(&self) -> Format {
        self.format
    }

    /// The dictionary with the parameters, such as `state_dict`; `None` if they are at the root of the file.
    pub fn container(&self) -> Option<&str> {
        self.container
    }

    /// The prefix that was removed from every name, such as `module.`; may be empty.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Element types of the stored tensors, such as `F32`.
    pub fn types(&self) -> Vec<String> {
        let types: BTreeSet<String> =
            self.tensors.values().map(|tensor| format!("{:?}", tensor.dtype)).collect();
        types.into_iter().collect()
    }

    /// Numbers in the `hyper_parameters` of a PyTorch file, where Lightning stores the arguments of the network, by name, and the
    /// settings in a file written by srflow ([`About`]). Booleans are not included.
    pub fn hyper_parameters(&self) -> &BTreeMap<String, f64> {
        &self.hyper_parameters
    }

    /// Names and shapes, sorted by name.
    pub fn parameters(&self) -> Vec<ParameterInfo> {
        let info = |(name, tensor): (&String, &StoredTensor)| ParameterInfo {
            name: name.clone(),
            shape: tensor.shape.clone(),
        };
        self.tensors.iter().map(info).collect()
    }

    /// Renames every tensor; those for which `name` returns `None` are dropped.
    #[must_use]
    pub fn renamed(mut self, name: impl Fn(&str) -> Option<String>) -> Self {
        let tensors = std::mem::take(&mut self.tensors);
        self.tensors = tensors.into_iter().filter_map(|(old, tensor)| Some((name(&old)?, tensor))).collect();
        self
    }

    /// Reads the values, as `f32`.
    ///
    /// # Errors
    /// When the file is truncated or cannot be read.
    pub fn read(self) -> Result<Parameters, WeightsError> {
        let parameters = read_all(&self.path, self.format, self.tensors)?;
        Ok(parameters.into_iter().map(|(name, data)| (name, data.convert::<f32>())).collect())
    }
}

/// Opens a file and recognizes its format. Returns its length too.
fn recognized(path: &Path) -> Result<(File, u64, Format), WeightsError> {
    let read_error = |error| WeightsError::Read { path: path.to_owned(), error };
    let (mut file, len) = open_file(path, FileKind::Checkpoint)?;
    let mut start = Vec::new();
    (&mut file).take(MAGIC_BYTES).read_to_end(&mut start).map_err(read_error)?;
    let mut end = Vec::new();
    file.seek(SeekFrom::Start(len.saturating_sub(END_BYTES))).map_err(read_error)?;
    (&mut file).take(END_BYTES).read_to_end(&mut end).map_err(read_error)?;
    match format_of(path, &start, &end) {
        Some(format) => Ok((file, len, format)),
        None => {
            let found = describe_file(path, &start);
            Err(WeightsError::Unrecognized { path: path.to_owned(), found })
        }
    }
}

/// The contents of a recognized file.
fn contents_of(path: &Path, file: File, len: u64, format: Format) -> Result<Contents, WeightsError> {
    let found = match format {
        Format::PytorchZip => pytorch::zip_contents(file, len),
        Format::PytorchLegacy => pytorch::legacy_contents(file, len),
        Format::Safetensors => safetensors::contents(file, len),
        Format::Burnpack => burnpack::tensors(file, len).map(Contents::from),
        Format::Tensorflow => tensorflow::contents(path, file, len),
        Format::Keras => keras::contents(file, len),
        Format::Sharded => return sharded::contents(path, file),
    };
    found.map_err(|problem| WeightsError::broken(path, format, &problem))
}

impl From<BTreeMap<String, StoredTensor>> for Contents {
    fn from(tensors: BTreeMap<String, StoredTensor>) -> Self {
        Self { tensors, hyper_parameters: BTreeMap::new(), others: BTreeMap::new(), shard_bytes: 0 }
    }
}

/// Reads the values of all tensors, in their stored types.
fn read_all(
    path: &Path,
    format: Format,
    tensors: BTreeMap<String, StoredTensor>,
) -> Result<Parameters, WeightsError> {
    let read = |(name, tensor): (String, StoredTensor)| {
        let data = tensor.read().map_err(|error| match error.kind() {
            io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof => {
                WeightsError::broken(path, format, &format!("{name}: {error}"))
            }
            _ => WeightsError::Read { path: path.to_owned(), error },
        })?;
        Ok((name, data))
    };
    tensors.into_iter().map(read).collect()
}

impl WeightsError {
    fn broken(path: &Path, format: Format, problem: &str) -> Self {
        Self::Broken { path: path.to_owned(), format, problem: excerpt(problem) }
    }
}

impl StoredTensor {
    fn byte_len(&self) -> u64 {
        let numbers = self.shape.iter().map(|&size| size as u64).fold(1, u64::saturating_mul);
        numbers.saturating_mul(self.dtype.size() as u64)
    }

    /// Bytes that reading it may take.
    fn claim(&self) -> u64 {
        match &self.bytes {
            StoredBytes::Pytorch(tensor) => self.byte_len().max(tensor.read_bytes()),
            _ => self.byte_len(),
        }
    }

    fn read(self) -> io::Result<TensorData> {
        let expected = self.byte_len();
        let invalid = |problem: String| io::Error::new(io::ErrorKind::InvalidData, problem);
        let bytes = match self.bytes {
            StoredBytes::Range { file, start, len } => read_range(&file, start, len)?,
            StoredBytes::Tensorflow { file, start, len, crc32c, shape } => {
                let bytes = read_range(&file, start, len)?;
                if masked_crc32c(&bytes) != crc32c {
                    return Err(invalid("the checksum of its bytes is wrong".into()));
                }
                tensorflow::layout::reference_order(bytes, &shape, self.dtype.size())
            }
            StoredBytes::Pytorch(tensor) => tensor.read()?,
            StoredBytes::Memory(bytes) => bytes,
        };
        if bytes.len() as u64 != expected {
            return Err(invalid(format!("expected {expected} bytes, found {}", bytes.len())));
        }
        Ok(TensorData::from_bytes_vec(bytes, self.shape, self.dtype))
    }
}

fn read_range(mut file: &File, start: u64, len: usize) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; len];
    file.seek(SeekFrom::Start(start))?;
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Recognizes a format by the first and last bytes of a file. That of an index is plain JSON, known by its name.
fn format_of(path: &Path, start: &[u8], end: &[u8]) -> Option<Format> {
    if start.starts_with(b"PK\x03\x04") || start.starts_with(b"PK\x05\x06") {
        Some(Format::PytorchZip)
    } else if start.starts_with(&burn_pack::MAGIC_NUMBER.to_le_bytes()) {
        Some(Format::Burnpack)
    } else if start.starts_with(srflow_files::HDF5_MAGIC) {
        Some(Format::Keras)
    } else if path.as_os_str().as_encoded_bytes().ends_with(b".index.json") {
        Some(Format::Sharded)
    } else if start.get(8) == Some(&b'{') {
        // Eight bytes of length, then JSON. No pickle has a brace at this position.
        Some(Format::Safetensors)
    } else if start.get(257..) == Some(b"ustar") {
        None
    } else if start.first() == Some(&0x80) {
        Some(Format::PytorchLegacy) // the opcode PROTO, the first of every pickle of torch.save
    } else if tensorflow::is_table(end) {
        Some(Format::Tensorflow)
    } else {
        None
    }
}

/// Describes a file by its name and first bytes, for errors.
fn describe_file(path: &Path, start: &[u8]) -> String {
    if let Some(table) = tensorflow::table_of(path) {
        return format!(
            "a file of tensors of a TensorFlow checkpoint; pass its table instead, {}",
            excerpt(&table)
        );
    }
    if start.is_empty() {
        return "an empty file".into();
    }
    if start.get(257..) == Some(b"ustar") {
        return "a tar file, as PyTorch before 0.1.10 wrote".into();
    }
    let text = String::from_utf8_lossy(&start[..start.len().min(24)]);
    format!("a file that starts with `{}`", excerpt(&text))
}

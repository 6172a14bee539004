//! Checkpoint files of other programs, recognized by their content.
//!
//! PyTorch files are pickles: they are parsed, never executed. Opening a file reads the names, types and shapes of its
//! tensors; every size it claims is checked against the length of the file before memory is taken.

mod burnpack;
mod hyper_parameters;
mod naming;
mod pytorch;
mod pytorch_writer;
mod safetensors;
mod words;

pub use pytorch_writer::save_pytorch;
pub use safetensors::{read_safetensors, safetensors_bytes};
pub use words::words;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use burn::tensor::{DType, TensorData};
use srflow_field::{FileKind, excerpt, open_file};

use crate::parameters::{ParameterInfo, Parameters};
use crate::weights::WeightsError;

/// Tensors of an honest checkpoint may share bytes, or be deflated, but not claim so many times the length of the file.
const MOST_CLAIMED: u64 = 8;
/// Bytes of a file that tell what it is.
const START: u64 = 262;

/// What kind of file a checkpoint is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Of `torch.save` since PyTorch 1.6, and of Lightning (`.ckpt`).
    PytorchZip,
    /// Of `torch.save` before PyTorch 1.6, or with `_use_new_zipfile_serialization=False`.
    PytorchLegacy,
    /// Of Hugging Face, and of [`save_parameters`](crate::save_parameters).
    Safetensors,
    /// Of Burn.
    Burnpack,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PytorchZip => "PyTorch (zip)",
            Self::PytorchLegacy => "PyTorch (legacy)",
            Self::Safetensors => "safetensors",
            Self::Burnpack => "burnpack",
        })
    }
}

/// A checkpoint file, opened: its parameters under the names that the reference implementations give them, none of
/// them read yet. Containers and prefixes are taken off, counters and index tables left out, what is stored twice is
/// there once.
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    format: Format,
    container: Option<&'static str>,
    prefix: String,
    tensors: BTreeMap<String, StoredTensor>,
    hyper_parameters: BTreeMap<String, f64>,
}

/// What a file holds, its tensors under the names that they have there.
struct Contents {
    tensors: BTreeMap<String, StoredTensor>,
    hyper_parameters: BTreeMap<String, f64>,
}

/// A tensor in a file.
#[derive(Debug)]
struct StoredTensor {
    dtype: DType,
    shape: Vec<usize>,
    bytes: StoredBytes,
}

/// Where the bytes of a tensor are.
#[derive(Debug)]
enum StoredBytes {
    /// So many, from there on.
    Range {
        file: Rc<File>,
        start: u64,
        len: usize,
    },
    Pytorch(pytorch_reader::Tensor),
    Memory(Vec<u8>),
}

impl Checkpoint {
    /// Opens a file and reads what it holds, but no values.
    ///
    /// # Errors
    /// When the file cannot be read, is no checkpoint or a broken one, or holds no tensor of floating-point numbers.
    pub fn open(path: &Path) -> Result<Self, WeightsError> {
        let read_error = |error| WeightsError::Read { path: path.to_owned(), error };
        let (mut file, len) = open_file(path, FileKind::Checkpoint)?;
        let mut start = Vec::new();
        (&mut file).take(START).read_to_end(&mut start).map_err(read_error)?;
        let Some(format) = format_of(&start) else {
            return Err(WeightsError::Unrecognized { path: path.to_owned(), found: described(&start) });
        };
        let broken = |problem: String| WeightsError::broken(path, format, &problem);
        let found = match format {
            Format::PytorchZip | Format::PytorchLegacy => pytorch::contents(path, format, len),
            Format::Safetensors => safetensors::tensors(file, len).map(Contents::from),
            Format::Burnpack => burnpack::tensors(file, len).map(Contents::from),
        };
        let Contents { tensors, hyper_parameters } = found.map_err(broken)?;
        let named = naming::reference_names(tensors);
        if named.tensors.is_empty() {
            return Err(WeightsError::Empty { path: path.to_owned() });
        }
        let claimed = named.tensors.values().map(StoredTensor::byte_len).fold(0, u64::saturating_add);
        if claimed > len.saturating_mul(MOST_CLAIMED) {
            return Err(broken(format!("its tensors claim {claimed} bytes, the file has {len}")));
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

    /// What kind of file it is.
    pub fn format(&self) -> Format {
        self.format
    }

    /// The dictionary of the file that holds the parameters, such as `state_dict`, where they are not at its root.
    pub fn container(&self) -> Option<&str> {
        self.container
    }

    /// What stood before every name and is taken off, such as `module.`; empty when nothing did.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Types of the stored numbers, such as `F32`.
    pub fn types(&self) -> Vec<String> {
        let types: BTreeSet<String> =
            self.tensors.values().map(|tensor| format!("{:?}", tensor.dtype)).collect();
        types.into_iter().collect()
    }

    /// The numbers among the `hyper_parameters` of a PyTorch file, where Lightning puts what a network was made with, by name;
    /// true and false are none.
    pub fn hyper_parameters(&self) -> &BTreeMap<String, f64> {
        &self.hyper_parameters
    }

    /// Names and shapes, by name.
    pub fn parameters(&self) -> Vec<ParameterInfo> {
        let info = |(name, tensor): (&String, &StoredTensor)| ParameterInfo {
            name: name.clone(),
            shape: tensor.shape.clone(),
        };
        self.tensors.iter().map(info).collect()
    }

    /// The same under other names; a tensor without a new name is left out.
    #[must_use]
    pub fn renamed(mut self, name: impl Fn(&str) -> Option<String>) -> Self {
        let tensors = std::mem::take(&mut self.tensors);
        self.tensors = tensors.into_iter().filter_map(|(old, tensor)| Some((name(&old)?, tensor))).collect();
        self
    }

    /// Reads the values, as `f32`.
    ///
    /// # Errors
    /// When the file ends before them or cannot be read.
    pub fn read(self) -> Result<Parameters, WeightsError> {
        let parameters = read_all(&self.path, self.format, self.tensors)?;
        Ok(parameters.into_iter().map(|(name, data)| (name, data.convert::<f32>())).collect())
    }
}

impl From<BTreeMap<String, StoredTensor>> for Contents {
    fn from(tensors: BTreeMap<String, StoredTensor>) -> Self {
        Self { tensors, hyper_parameters: BTreeMap::new() }
    }
}

/// The values of all tensors, in the types that they are stored in.
fn read_all(
    path: &Path,
    format: Format,
    tensors: BTreeMap<String, StoredTensor>,
) -> Result<Parameters, WeightsError> {
    let read = |(name, tensor): (String, StoredTensor)| {
        let data = tensor.read().map_err(|error| match error.kind() {
            io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof => match format {
                // PyTorch's names the tensor.
                Format::PytorchZip | Format::PytorchLegacy => {
                    WeightsError::broken(path, format, &error.to_string())
                }
                Format::Safetensors | Format::Burnpack => {
                    WeightsError::broken(path, format, &format!("{name}: {error}"))
                }
            },
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

    fn read(self) -> io::Result<TensorData> {
        let expected = self.byte_len();
        let bytes = match self.bytes {
            StoredBytes::Range { file, start, len } => {
                let mut bytes = vec![0; len];
                (&*file).seek(SeekFrom::Start(start))?;
                (&*file).read_exact(&mut bytes)?;
                bytes
            }
            StoredBytes::Pytorch(tensor) => tensor.read()?,
            StoredBytes::Memory(bytes) => bytes,
        };
        if bytes.len() as u64 != expected {
            let problem = format!("expected {expected} bytes, found {}", bytes.len());
            return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
        }
        Ok(TensorData::from_bytes_vec(bytes, self.shape, self.dtype))
    }
}

/// What a file is, by its first bytes. A broken one is what it seems to be.
fn format_of(start: &[u8]) -> Option<Format> {
    if start.starts_with(b"PK\x03\x04") || start.starts_with(b"PK\x05\x06") {
        Some(Format::PytorchZip)
    } else if start.starts_with(&burn_pack::MAGIC_NUMBER.to_le_bytes()) {
        Some(Format::Burnpack)
    } else if start.get(8) == Some(&b'{') {
        // Eight bytes of length, then JSON. No pickle has a brace there.
        Some(Format::Safetensors)
    } else if start.get(257..) == Some(b"ustar") {
        None
    } else if start.first() == Some(&0x80) {
        Some(Format::PytorchLegacy) // the opcode PROTO, with which every pickle of torch.save starts
    } else {
        None
    }
}

/// The start of a file for people to recognize.
fn described(start: &[u8]) -> String {
    if start.is_empty() {
        return "an empty file".into();
    }
    if start.get(257..) == Some(b"ustar") {
        return "a tar file, as PyTorch before 0.1.10 wrote".into();
    }
    let text = String::from_utf8_lossy(&start[..start.len().min(24)]);
    format!("a file that starts with `{}`", excerpt(&text))
}

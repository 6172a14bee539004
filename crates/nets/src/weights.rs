//! Checkpoint files of other programs, told apart by their content.
//!
//! PyTorch files (zip, legacy, and the `.ckpt` of Lightning, which is one with the weights under `state_dict`) are pickles:
//! they are parsed, never executed. Safetensors files are read as they are.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use burn::module::Module;
use burn::tensor::{DType, Device, TensorData};
use pytorch_reader::{PytorchError, PytorchReader};
use safetensors::{Dtype, SafeTensorError, SafeTensors};

use crate::architecture::Architecture;
use crate::network::Network;
use crate::parameters::{Parameters, ParametersError, with_parameters};

/// Dictionaries that training programs put the weights in, beside other things.
const CONTAINERS: [&str; 3] = ["state_dict.", "model_state_dict.", "model."];
/// What wrappers of a network put before every name.
const PREFIXES: [&str; 3] = ["module.", "network.", "model."];

/// Why a checkpoint was not loaded.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file could not be read.
    #[error("{}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file starts as a safetensors file and is none.
    #[error("{}: not a whole safetensors file ({source}); fetch or save it again", .path.display())]
    Safetensors {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: SafeTensorError,
    },
    /// The file is neither safetensors nor a PyTorch checkpoint, or a broken one.
    #[error(
        "{}: expected weights as PyTorch (.pth, .pt, .ckpt) or safetensors file, but {source}",
        .path.display()
    )]
    Pytorch {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: PytorchError,
    },
    /// A checkpoint without a single tensor of numbers.
    #[error("{}: holds no weights", .path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The weights are those of another network.
    #[error("{}: {source}", .path.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// The names.
        source: ParametersError,
    },
}

/// `network` with the weights of a checkpoint.
pub fn load<M: Module>(network: M, path: &Path) -> Result<M, WeightsError> {
    let parameters = read_parameters(path)?;
    with_parameters(network, parameters)
        .map_err(|source| WeightsError::Mismatch { path: path.to_owned(), source })
}

/// A network of the given architecture with the weights of a checkpoint.
pub fn load_network(
    architecture: Architecture,
    path: &Path,
    device: &Device,
) -> Result<Network, WeightsError> {
    load(architecture.init(device), path)
}

/// The parameters in a checkpoint, as `f32`, under the names that the reference implementations give them: containers
/// and prefixes taken off, counters and index tables left out, what is stored twice taken once.
pub fn read_parameters(path: &Path) -> Result<Parameters, WeightsError> {
    let read_error = |source| WeightsError::Read { path: path.to_owned(), source };
    let mut start = Vec::new();
    let file = File::open(path).map_err(read_error)?;
    file.take(9).read_to_end(&mut start).map_err(read_error)?;
    // Eight bytes of length, then JSON. No PyTorch file has a brace there.
    let found = if start.get(8) == Some(&b'{') { read_safetensors(path)? } else { read_pytorch(path)? };
    let parameters = once(without_prefix(without_container(found)));
    if parameters.is_empty() {
        return Err(WeightsError::Empty { path: path.to_owned() });
    }
    Ok(parameters)
}

fn read_safetensors(path: &Path) -> Result<Parameters, WeightsError> {
    let bytes = std::fs::read(path).map_err(|source| WeightsError::Read { path: path.to_owned(), source })?;
    let file = SafeTensors::deserialize(&bytes)
        .map_err(|source| WeightsError::Safetensors { path: path.to_owned(), source })?;
    let tensors = file.iter().filter_map(|(name, tensor)| {
        let dtype = match tensor.dtype() {
            Dtype::F64 => DType::F64,
            Dtype::F32 => DType::F32,
            Dtype::F16 => DType::F16,
            Dtype::BF16 => DType::BF16,
            _ => return None,
        };
        Some((name.to_owned(), numbers(tensor.data().to_vec(), tensor.shape(), dtype)))
    });
    Ok(tensors.collect())
}

fn read_pytorch(path: &Path) -> Result<Parameters, WeightsError> {
    let reader =
        PytorchReader::new(path).map_err(|source| WeightsError::Pytorch { path: path.to_owned(), source })?;
    let mut found = Parameters::new();
    for (name, tensor) in reader.into_tensors() {
        let dtype = match tensor.dtype() {
            pytorch_reader::DType::F64 => DType::F64,
            pytorch_reader::DType::F32 => DType::F32,
            pytorch_reader::DType::F16 => DType::F16,
            pytorch_reader::DType::BF16 => DType::BF16,
            _ => continue,
        };
        let bytes = tensor.read().map_err(|source| WeightsError::Read { path: path.to_owned(), source })?;
        found.insert(name, numbers(bytes, tensor.shape(), dtype));
    }
    Ok(found)
}

fn numbers(bytes: Vec<u8>, shape: &[usize], dtype: DType) -> TensorData {
    TensorData::from_bytes_vec(bytes, shape.to_vec(), dtype).convert::<f32>()
}

/// Only what the first container that is there holds.
fn without_container(found: Parameters) -> Parameters {
    for container in CONTAINERS {
        let inside = found.keys().any(|name| name.starts_with(container));
        let outside = found.keys().any(|name| !name.starts_with(container));
        if inside && (outside || container != "model.") {
            let kept = found
                .into_iter()
                .filter_map(|(name, data)| Some((name.strip_prefix(container)?.to_owned(), data)));
            return kept.collect();
        }
    }
    found
}

/// Takes off prefixes that every name has.
fn without_prefix(mut found: Parameters) -> Parameters {
    while let Some(prefix) = PREFIXES
        .iter()
        .find(|prefix| !found.is_empty() && found.keys().all(|name| name.starts_with(**prefix)))
    {
        found = found.into_iter().map(|(name, data)| (name[prefix.len()..].to_owned(), data)).collect();
    }
    found
}

/// Leaves out the second copy of a shortcut's norm: `downsample.1`, and as the last numbered norm of the block.
fn once(mut found: Parameters) -> Parameters {
    let shortcuts: Vec<(String, String)> = found
        .keys()
        .filter_map(|name| name.split_once("downsample.1."))
        .map(|(block, rest)| (block.to_owned(), rest.to_owned()))
        .collect();
    for (block, rest) in shortcuts {
        if found.remove(&format!("{block}norm4.{rest}")).is_none() {
            found.remove(&format!("{block}norm3.{rest}"));
        }
    }
    found
}

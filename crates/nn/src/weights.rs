//! Networks with the parameters of a checkpoint, and checkpoints of networks.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use burn::module::Module;
use srflow_field::{FileError, write_atomically};

use crate::checkpoint::{Checkpoint, Format, safetensors_bytes};
use crate::parameters::{Parameters, ParametersError, compare, parameter_infos, parameters, with_parameters};

/// Why a checkpoint was not loaded.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file could not be opened.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file could not be read.
    #[error("{}: {error}", .path.display())]
    Read { path: PathBuf, error: io::Error },
    /// The file is no checkpoint.
    #[error(
        "{}: expected weights as PyTorch (.pth, .pt, .ckpt), safetensors or burnpack file, found {found}",
        .path.display()
    )]
    Unrecognized {
        path: PathBuf,
        /// What it seems to be.
        found: String,
    },
    /// The file starts as a checkpoint and cannot be read as one.
    #[error(
        "{}: expected a whole {format} file, but {problem}; download it again, or save the network's state_dict again",
        .path.display()
    )]
    Broken {
        path: PathBuf,
        /// What it starts as.
        format: Format,
        /// What is wrong with it.
        problem: String,
    },
    /// A checkpoint without a single tensor of floating-point numbers.
    #[error("{}: holds no floating-point tensors, which weights are (counters and indices are whole numbers); give the file that the network was saved to", .path.display())]
    Empty { path: PathBuf },
    /// The weights are those of another network.
    #[error("{}: {difference}{hint}", .path.display())]
    Mismatch {
        path: PathBuf,
        difference: ParametersError,
        /// More for the user, such as which network they fit; on a line of its own.
        hint: String,
    },
    /// The parameters fit, but the file says that they are another network's.
    #[error(
        "{}: its name or hyper-parameters say that these are weights of {other}, whose parameters have the names and shapes of \
         {network}'s but are computed with otherwise; use weights of {network}, or rename the file if it holds them",
        .path.display()
    )]
    OtherNetwork {
        path: PathBuf,
        /// The network that was asked for.
        network: &'static str,
        /// The network that the file names.
        other: &'static str,
    },
}

/// `network` with the weights of a checkpoint: PyTorch (zip, legacy, Lightning), safetensors or burnpack, recognized
/// by content.
///
/// # Errors
/// When the file cannot be read, or its parameters are not those of the network, each and no other.
pub fn load<M: Module>(network: M, path: &Path) -> Result<M, WeightsError> {
    load_from(network, Checkpoint::open(path)?, path)
}

/// `network` with the weights of a checkpoint that is open, such as one whose tensors were
/// [renamed](Checkpoint::renamed).
///
/// # Errors
/// As [`load`].
pub fn load_from<M: Module>(network: M, checkpoint: Checkpoint, path: &Path) -> Result<M, WeightsError> {
    let infos = checkpoint.parameters();
    let mismatch =
        |difference| WeightsError::Mismatch { path: path.to_owned(), difference, hint: String::new() };
    compare(&parameter_infos(&network), &infos).map_err(mismatch)?;
    with_parameters(network, checkpoint.read()?).map_err(mismatch)
}

/// The parameters in a checkpoint, as `f32`; see [`Checkpoint`].
///
/// # Errors
/// When the file cannot be read or is no checkpoint.
pub fn read_parameters(path: &Path) -> Result<Parameters, WeightsError> {
    Checkpoint::open(path)?.read()
}

/// Writes the parameters of a network as a safetensors file, under the reference's names, as `f32`: whole or not at all.
///
/// # Errors
/// When the file cannot be written.
pub fn save_parameters(network: &impl Module, path: &Path) -> Result<(), FileError> {
    let parameters = parameters(network);
    let tensors = parameters.iter().map(|(name, data)| {
        let values = data.as_slice::<f32>().expect("parameters are f32");
        (name.clone(), data.shape().as_slice(), values)
    });
    let bytes = safetensors_bytes(tensors);
    write_atomically(path, |writer| writer.write_all(&bytes))
}

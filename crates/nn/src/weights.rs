//! Loads the parameters of networks from checkpoints, and saves them.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use burn::module::Module;
use srflow_files::{FileError, write_atomically};

use crate::checkpoint::{About, Checkpoint, Format, StoredAs, safetensors_bytes};
use crate::parameters::{Parameters, ParametersError, compare, parameter_infos, parameters, with_parameters};

/// Errors of loading a checkpoint.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: {error}", .path.display())]
    Read {
        path: PathBuf,
        #[source]
        error: io::Error,
    },
    /// The file is not a checkpoint.
    #[error(
        "{}: expected weights in a PyTorch (.pth, .pt, .ckpt), safetensors, burnpack, TensorFlow (.index) or Keras (.h5) file, \
         or an index of several (.index.json), found {found}",
        .path.display()
    )]
    Unrecognized {
        path: PathBuf,
        /// Description of the file.
        found: String,
    },
    /// The file starts like a checkpoint but is corrupt or truncated.
    #[error(
        "{}: expected a whole {format} file, but {problem}; download it again, or save the network's state_dict again",
        .path.display()
    )]
    Broken { path: PathBuf, format: Format, problem: String },
    #[error(
        "{}: expected tensors of floating-point numbers (16 to 64 bits), found {found}; pass the file that the network's \
         state_dict was saved to",
        .path.display()
    )]
    Empty {
        path: PathBuf,
        /// Counts of what it holds instead.
        found: String,
    },
    /// Names or shapes of the parameters differ from those of the network.
    #[error("{}: {difference}{hint}", .path.display())]
    Mismatch {
        path: PathBuf,
        difference: ParametersError,
        /// Advice on its own line, such as which network the weights fit; may be empty.
        hint: String,
    },
    /// The parameters fit, but the name or hyper-parameters of the file identify another network.
    #[error(
        "{}: its name or hyper-parameters identify these weights as those of {other}, which uses parameters of the same names \
         and shapes as {network} in a different way; use weights of {network}, or rename the file if it contains them",
        .path.display()
    )]
    OtherNetwork {
        path: PathBuf,
        /// The requested network.
        network: &'static str,
        /// The network that the file identifies.
        other: &'static str,
    },
}

/// Loads a checkpoint into `network`: PyTorch (zip, legacy, Lightning), safetensors, burnpack, TensorFlow or Keras, recognized by
/// content.
///
/// # Errors
/// When the file cannot be read, or the names and shapes of its parameters are not exactly those of the network.
pub fn load<M: Module>(network: M, path: &Path) -> Result<M, WeightsError> {
    load_from(network, Checkpoint::open(path)?, path)
}

/// Loads an open checkpoint into `network`, such as one with [renamed](Checkpoint::renamed) tensors. `path` is for errors.
///
/// # Errors
/// See [`load`].
pub fn load_from<M: Module>(network: M, checkpoint: Checkpoint, path: &Path) -> Result<M, WeightsError> {
    let infos = checkpoint.parameters();
    let mismatch =
        |difference| WeightsError::Mismatch { path: path.to_owned(), difference, hint: String::new() };
    compare(&parameter_infos(&network), &infos).map_err(mismatch)?;
    with_parameters(network, checkpoint.read()?).map_err(mismatch)
}

/// Reads the parameters in a checkpoint, as `f32`; see [`Checkpoint`].
///
/// # Errors
/// When the file cannot be read or is not a checkpoint.
pub fn read_parameters(path: &Path) -> Result<Parameters, WeightsError> {
    Checkpoint::open(path)?.read()
}

/// Writes the parameters of a network to a safetensors file, under the reference's names. The write is atomic.
///
/// # Errors
/// When the file cannot be written.
pub fn save_parameters(
    network: &impl Module,
    stored_as: StoredAs,
    about: Option<&About>,
    path: &Path,
) -> Result<(), FileError> {
    write_parameters(&parameters(network), stored_as, about, path)
}

/// Writes parameters, which must be `f32`, to a safetensors file. The write is atomic.
///
/// # Errors
/// When the file cannot be written.
pub fn write_parameters(
    parameters: &Parameters,
    stored_as: StoredAs,
    about: Option<&About>,
    path: &Path,
) -> Result<(), FileError> {
    let tensors = parameters.iter().map(|(name, data)| {
        let values = data.as_slice::<f32>().expect("parameters are f32");
        (name.clone(), data.shape().as_slice(), values)
    });
    let bytes = safetensors_bytes(tensors, stored_as, about);
    write_atomically(path, |writer| writer.write_all(&bytes))
}

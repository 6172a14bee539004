//! Weights that come with srflow.

use burn::tensor::Device;
use sha2::{Digest, Sha256};
use srflow_files::hexadecimal;
use srflow_nn::{parameters_of_safetensors, with_parameters};

use crate::table::{Architecture, Network};

/// The network with the weights that come with srflow; `None` if there are none.
pub fn load_included(architecture: Architecture, device: &Device) -> Option<Network> {
    let bytes = architecture.facts().included?;
    let parameters = parameters_of_safetensors(bytes).expect("the file in the repository is whole");
    Some(with_parameters(architecture.init(device), parameters).expect("weights of this network"))
}

/// The SHA-256 of the file of weights that comes with srflow, in lower-case hexadecimal.
pub fn included_sha256(architecture: Architecture) -> Option<String> {
    architecture.facts().included.map(|bytes| hexadecimal(Sha256::digest(bytes)))
}

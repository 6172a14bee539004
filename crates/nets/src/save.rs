//! Writes networks to files of weights.

use std::collections::BTreeMap;
use std::path::Path;

use srflow_files::FileError;
use srflow_nn::{About, StoredAs, save_parameters, save_pytorch};

use crate::settings::Setting;
use crate::table::Network;

/// Prefix of settings in files, which keeps them apart from the hyper-parameters of other programs.
pub(crate) const OWN: &str = "srflow.";

/// Metadata for a file of the network's weights: its name and its settings, which [`load_network`](crate::load_network) applies.
pub fn about(network: &Network) -> About {
    let mut about = About {
        network: network.architecture().name().to_owned(),
        settings: BTreeMap::new(),
        hyper_parameters: BTreeMap::new(),
    };
    for Setting { name, in_files, value, .. } in network.clone().settings() {
        about.settings.insert(format!("{OWN}{name}"), *value);
        about.hyper_parameters.extend(in_files.map(|name| (name.to_owned(), *value)));
    }
    about
}

/// Writes the weights and settings of a network in the safetensors format. The write is atomic.
///
/// # Errors
/// When the file cannot be written.
pub fn save_network(network: &Network, stored_as: StoredAs, path: &Path) -> Result<(), FileError> {
    save_parameters(network, stored_as, Some(&about(network)), path)
}

/// Writes the weights and settings of a network to a Lightning checkpoint; see [`save_pytorch`]. The write is atomic.
///
/// # Errors
/// When the file cannot be written.
pub fn save_network_pytorch(network: &Network, path: &Path) -> Result<(), FileError> {
    save_pytorch(network, network.architecture().facts().ptlflow_prefix, &about(network), path)
}

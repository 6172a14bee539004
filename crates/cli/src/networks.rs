//! Networks on the command line: weights, iterations, device.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use srflow_nets::{Architecture, Claim, NetworkEstimator, claim, find_weights, load_network, weights_folder};
use srflow_ops::{device, device_kinds};

use crate::usage::wrong_usage;

/// Where networks are computed when nothing is said.
const CPU: &str = "cpu";

/// Parameters of networks.
#[derive(Args, Debug, Clone)]
#[command(next_help_heading = "Parameters of networks")]
pub struct NetworkArgs {
    /// Checkpoint of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as
    /// things; `srflow models` lists them
    #[arg(long, value_name = "FILE|NAME")]
    pub weights: Option<String>,
    /// Refinements of the flow [default: the network's own, see `srflow models`]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000))]
    iters: Option<u16>,
    /// Pairs of frames that are estimated at once, where a command can.
    #[arg(skip = 1_usize)]
    pub batch: usize,
    /// Where to compute
    #[arg(long, value_name = "DEVICE", default_value = CPU, help = device_help())]
    pub device: String,
}

fn device_help() -> String {
    format!("Where to compute; in this build {}", device_kinds().join(", "))
}

impl Default for NetworkArgs {
    fn default() -> Self {
        Self { weights: None, iters: None, batch: 1, device: CPU.to_owned() }
    }
}

impl NetworkArgs {
    /// The first option that was given.
    pub fn given(&self) -> Option<&'static str> {
        [
            ("--weights", self.weights.is_some()),
            ("--iters", self.iters.is_some()),
            ("--batch", self.batch > 1),
            ("--device", !self.on_cpu()),
        ]
        .into_iter()
        .find_map(|(option, given)| given.then_some(option))
    }

    pub fn on_cpu(&self) -> bool {
        self.device == CPU
    }

    /// Refinements of a network.
    pub fn iterations(&self, architecture: Architecture) -> usize {
        self.iters.map_or(architecture.facts().iterations.default, usize::from)
    }

    /// The file of a network's weights: its own, or those of `--weights`.
    ///
    /// # Errors
    /// When there are none, or they cannot be found.
    pub fn weights_of(&self, architecture: Architecture, own: Option<&str>) -> anyhow::Result<PathBuf> {
        let name = architecture.name();
        match own.or(self.weights.as_deref()) {
            Some(weights) => weights_file(Some(architecture), weights),
            None => wrong_usage!(
                "{name} needs weights: give --weights FILE, or --method {name}=FILE; `srflow models` says where \
                 people get them"
            ),
        }
    }

    /// The network with its weights: its own, or those of `--weights`.
    ///
    /// # Errors
    /// When there are none, or they do not fit it; when there is no such device.
    pub fn estimator(
        &self,
        architecture: Architecture,
        weights: Option<&str>,
        label: String,
    ) -> anyhow::Result<NetworkEstimator> {
        let device = match device(&self.device) {
            Ok(device) => device,
            Err(error) => wrong_usage!("--device: {error}"),
        };
        let path = self.weights_of(architecture, weights)?;
        let network = load_network(architecture, &path, &device)?;
        note_if_ambiguous(architecture, &path)?;
        let iterations = NonZeroUsize::new(self.iterations(architecture)).context("no iterations")?;
        Ok(NetworkEstimator::new(label, network, iterations, device))
    }
}

/// Says so where the weights of a file could as well be another network's.
///
/// # Errors
/// When the file cannot be read.
pub fn note_if_ambiguous(architecture: Architecture, path: &Path) -> anyhow::Result<()> {
    if let Claim::Silent(others) = claim(architecture, path)? {
        note!(
            "note: {}: nothing in it says whether it is of {} or of {}, whose parameters have the same names and shapes",
            path.display(),
            architecture.facts().title,
            others.join(", ")
        );
    }
    Ok(())
}

/// The file that `--weights` means, fetched when it is a name that was not used before.
///
/// # Errors
/// When it is neither a file nor a name, or cannot be fetched.
pub fn weights_file(architecture: Option<Architecture>, weights: &str) -> anyhow::Result<PathBuf> {
    let folder = weights_folder();
    let bar = ProgressBar::no_length().with_style(ProgressStyle::with_template(
        "{spinner} weights {bytes} of {total_bytes}  {bytes_per_sec}  ETA {eta}",
    )?);
    let found = find_weights(weights.as_ref(), architecture, folder.as_deref(), &mut |done, len| {
        if let Some(len) = len {
            bar.set_length(len);
        }
        bar.set_position(done);
    });
    bar.finish_and_clear();
    found.with_context(|| {
        let of = architecture.map_or(String::new(), |architecture| format!(" of {}", architecture.name()));
        format!("weights{of} (`srflow models` lists what there is)")
    })
}

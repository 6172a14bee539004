//! The parameters of networks: weights, iterations, device.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use crate::clap::{Args, ValueEnum};
use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_nets::{
    Architecture, Claim, Iterations, Network, NetworkEstimator, SettingError, claim, find_weights,
    load_included, load_network, weights_folder,
};
use srflow_ops::{Device, Precision, check_precision, device, device_kinds, fastest_precision};

use crate::Watch;
use crate::error::wrong_settings;

/// The default device.
pub(crate) const CPU: &str = "cpu";

/// Where the weights of a network are.
pub enum Weights {
    File(PathBuf),
    /// They come with srflow.
    Included,
}

/// Parameters of networks.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(next_help_heading = "Parameters of networks")]
pub struct NetworkArgs {
    /// Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things;
    /// `srflow models` lists them
    #[arg(long, value_name = "FILE|NAME")]
    pub weights: Option<String>,
    #[arg(long, value_name = "N|auto[:PX]", help = iterations_help())]
    iters: Option<Iterations>,
    /// Network setting that the weights do not store; `srflow models` lists them
    #[arg(long, value_name = "NAME=VALUE", value_parser = setting)]
    #[serde(with = "pairs")]
    set: Vec<(String, usize)>,
    /// Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units
    /// for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums,
    /// softmax, norms and flow are always f32
    #[arg(long, value_name = "PRECISION", default_value_t)]
    precision: PrecisionArg,
    /// Pairs estimated at once, where a command supports it.
    #[arg(skip = 1_usize)]
    #[serde(skip, default = "one")]
    pub batch: usize,
    /// Device to compute on
    #[arg(long, value_name = "DEVICE", default_value = CPU, help = device_help())]
    pub device: String,
}

/// What networks multiply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PrecisionArg {
    #[default]
    F32,
    F16,
    Bf16,
    Auto,
}

impl fmt::Display for PrecisionArg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
            Self::Auto => "auto",
        })
    }
}

impl PrecisionArg {
    /// On the named device.
    ///
    /// # Errors
    /// When the device does not exist, or does not multiply at this precision.
    pub fn on(self, name: &str) -> anyhow::Result<Precision> {
        let wanted = match self {
            Self::F32 => return Ok(Precision::F32),
            Self::Auto => return Ok(fastest_precision(&opened(name)?)),
            Self::F16 => Precision::F16,
            Self::Bf16 => Precision::Bf16,
        };
        if let Err(error) = check_precision(&opened(name)?, wanted) {
            wrong_settings!("`precision` with `device` {name}: {error}");
        }
        Ok(wanted)
    }
}

/// The device of this name.
///
/// # Errors
/// When it does not exist.
fn opened(name: &str) -> anyhow::Result<Device> {
    match device(name) {
        Ok(device) => Ok(device),
        Err(error) => wrong_settings!("`device`: {error}"),
    }
}

fn setting(text: &str) -> Result<(String, usize), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    let value = value.parse().map_err(|_| format!("{name}: expected a whole number, found `{value}`"))?;
    Ok((name.to_owned(), value))
}

fn iterations_help() -> String {
    format!(
        "Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than {} px, auto:PX \
         less than PX [default: the network's own, see `srflow models`]",
        Iterations::STILL_PX
    )
}

/// The help of `--device`.
pub fn device_help() -> String {
    format!("Device to compute on; this build has {}", device_kinds().join(", "))
}

fn one() -> usize {
    1
}

/// Pairs of a name and a value as a map.
mod pairs {
    use std::collections::BTreeMap;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(pairs: &[(String, usize)], serializer: S) -> Result<S::Ok, S::Error> {
        pairs.iter().cloned().collect::<BTreeMap<_, _>>().serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(String, usize)>, D::Error> {
        Ok(BTreeMap::deserialize(deserializer)?.into_iter().collect())
    }
}

impl Default for NetworkArgs {
    fn default() -> Self {
        Self {
            weights: None,
            iters: None,
            set: Vec::new(),
            precision: PrecisionArg::F32,
            batch: 1,
            device: CPU.to_owned(),
        }
    }
}

impl NetworkArgs {
    /// The first setting that was given.
    pub fn given(&self) -> Option<&'static str> {
        [
            ("weights", self.weights.is_some()),
            ("iters", self.iters.is_some()),
            ("set", !self.set.is_empty()),
            ("precision", self.precision != PrecisionArg::F32),
            ("batch", self.batch > 1),
            ("device", !self.on_cpu()),
        ]
        .into_iter()
        .find_map(|(setting, given)| given.then_some(setting))
    }

    /// The same for a method with iterations and settings of its own.
    pub fn of(&self, iterations: Option<Iterations>, settings: &[(String, usize)]) -> Self {
        let set = self.set.iter().chain(settings).cloned().collect();
        Self { iters: iterations.or(self.iters), set, ..self.clone() }
    }

    pub fn on_cpu(&self) -> bool {
        self.device == CPU
    }

    /// What is multiplied.
    ///
    /// # Errors
    /// When the device does not exist, or does not multiply it.
    pub fn precision(&self) -> anyhow::Result<Precision> {
        self.precision.on(&self.device)
    }

    /// Refinement iterations of a network, at most; 1 for one that does not refine.
    pub fn iterations(&self, architecture: Architecture) -> usize {
        self.refinement(architecture).most(architecture.facts()).get()
    }

    /// The movement of the flow in pixels of the frames, below which a network does no more iterations; `None` if it does all.
    pub fn still_px(&self, architecture: Architecture) -> Option<f32> {
        self.refinement(architecture).still_px(architecture.facts())
    }

    /// Whether a network that refines its flow is to stop by itself.
    pub fn is_auto(&self, architecture: Architecture) -> bool {
        let auto = matches!(self.refinement(architecture), Iterations::UntilStill { .. });
        auto && architecture.facts().refines()
    }

    fn refinement(&self, architecture: Architecture) -> Iterations {
        self.iters.unwrap_or_else(|| Iterations::default_of(architecture.facts()))
    }

    /// The settings of a network, with the given values or the defaults.
    ///
    /// # Errors
    /// When a value is out of range.
    pub fn settings(&self, architecture: Architecture) -> anyhow::Result<BTreeMap<&'static str, usize>> {
        let mut network = self.init(architecture)?;
        Ok(network.settings().into_iter().map(|setting| (setting.name, *setting.value)).collect())
    }

    /// A network with random parameters and the given settings.
    ///
    /// # Errors
    /// When a value is out of range.
    pub fn init(&self, architecture: Architecture) -> anyhow::Result<Network> {
        let mut network = architecture.init(&Default::default());
        self.set(&mut network)?;
        Ok(network)
    }

    /// Applies the settings that the network has; the rest is for other networks.
    fn set(&self, network: &mut Network) -> anyhow::Result<()> {
        for (name, value) in &self.set {
            match network.set(name, *value) {
                Ok(()) | Err(SettingError::Unknown { .. }) => {}
                Err(error) => wrong_settings!("`set` {name}={value}: {error}"),
            }
        }
        Ok(())
    }

    /// Checks that every given option applies to one of `networks`.
    ///
    /// # Errors
    /// Names the first that does not.
    pub fn check(&self, networks: &[Architecture]) -> anyhow::Result<()> {
        let names = || networks.iter().map(|network| network.name()).collect::<Vec<_>>().join(", ");
        if self.iters.is_some() && !networks.iter().any(|network| network.facts().refines()) {
            wrong_settings!(
                "`iters` is for networks that refine their flow, and not for {}: leave it out",
                names()
            );
        }
        let own: Vec<_> = networks.iter().map(|network| self.settings(*network)).collect::<Result<_, _>>()?;
        for (name, _) in &self.set {
            if !own.iter().any(|own| own.contains_key(name.as_str())) {
                let all = Architecture::ALL.map(|network| (network.name(), self.settings(network)));
                let having = all
                    .iter()
                    .filter(|(_, own)| own.as_ref().is_ok_and(|own| own.contains_key(name.as_str())));
                let having: Vec<&str> = having.map(|(name, _)| *name).collect();
                match having.as_slice() {
                    [] => {
                        wrong_settings!(
                            "`set` {name}: no network has this setting; `srflow models` lists them"
                        )
                    }
                    having => {
                        wrong_settings!(
                            "`set` {name}: a setting of {}, not of {}",
                            having.join(", "),
                            names()
                        )
                    }
                }
            }
        }
        Ok(())
    }

    /// Where a network's weights are: its own, those of `weights`, or the ones that come with srflow.
    ///
    /// # Errors
    /// When no weights are given and none come with srflow, or they cannot be found.
    pub fn weights_of(
        &self,
        architecture: Architecture,
        own: Option<&str>,
        watch: &Watch,
    ) -> anyhow::Result<Weights> {
        let name = architecture.name();
        match own.or(self.weights.as_deref()) {
            Some(weights) => weights_file(Some(architecture), weights, watch).map(Weights::File),
            None if architecture.facts().included.is_some() => Ok(Weights::Included),
            None => wrong_settings!(
                "{name} needs weights: give `weights` FILE, or `method` {name}=FILE; `srflow models` lists where to get \
                them"
            ),
        }
    }

    /// The network with its weights: its own, or those of `weights`; for frames that are scaled by `scale` first.
    ///
    /// # Errors
    /// When there are no weights, they do not fit, or the device does not exist.
    pub fn estimator(
        &self,
        architecture: Architecture,
        weights: Option<&str>,
        label: String,
        scale: f64,
        watch: &Watch,
    ) -> anyhow::Result<NetworkEstimator> {
        let (device, precision) = (opened(&self.device)?, self.precision()?);
        let mut network = match self.weights_of(architecture, weights, watch)? {
            Weights::Included => load_included(architecture, &device).context("no weights")?,
            Weights::File(path) => {
                let network = load_network(architecture, &path, &device)?;
                note_if_ambiguous(architecture, &path)?;
                network
            }
        };
        self.set(&mut network)?;
        let iterations = self.refinement(architecture).scaled(scale);
        Ok(NetworkEstimator::new(label, network, iterations, device).with_precision(precision))
    }
}

/// Prints a note if the weights could also be another network's, or are those of a network with the same parameters.
///
/// # Errors
/// When the file cannot be read.
pub fn note_if_ambiguous(architecture: Architecture, path: &Path) -> anyhow::Result<()> {
    let (file, facts) = (path.display(), architecture.facts());
    match claim(architecture, path)? {
        Claim::Ambiguous(others) => log::warn!(
            "{file}: these may be weights of {} or of {}, whose parameters have the same names and shapes",
            facts.title,
            others.join(", ")
        ),
        Claim::Other(other) if facts.lookalikes.contains(&other) => {
            log::warn!("{file}: these are weights of {other}, from which {} starts", facts.title);
        }
        _ => {}
    }
    Ok(())
}

/// The file of these weights, fetched if it is a published name that is not cached.
///
/// # Errors
/// When it is neither a file nor a published name, or cannot be fetched.
pub fn weights_file(
    architecture: Option<Architecture>,
    weights: &str,
    watch: &Watch,
) -> anyhow::Result<PathBuf> {
    let folder = weights_folder();
    let fetched = watch.count("bytes of weights", None);
    let found = find_weights(weights.as_ref(), architecture, folder.as_deref(), &mut |done, len| {
        if let Some(len) = len {
            fetched.set_total(len);
        }
        fetched.set(done);
    });
    found.with_context(|| {
        let of = architecture.map_or(String::new(), |architecture| format!(" of {}", architecture.name()));
        format!("weights{of} (`srflow models` lists the published ones)")
    })
}

//! The networks, and files of their weights.

use std::fmt;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::ensure;
use serde::{Deserialize, Serialize};
use srflow_core::{SettingError, Size};
use srflow_nets::{
    Allowed, Architecture, Fit, OnnxError, OnnxOptions, Setting, fits_of_file, load_included, load_network,
    save_network, save_network_onnx, save_network_pytorch, weights_folder,
};
use srflow_nn::{Checkpoint, ParameterInfo, ParametersError, StoredAs};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::networks::weights_file;
use crate::{Job, Report, Watch};

/// List the networks
///
/// Lists every network with its parameters, the multiple that frames are padded to, the iterations, the
/// licence of the authors' code, and the published weights.
#[derive(Args, Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelsJob {}

/// Inspect a file of weights
///
/// Prints the kind of file and the network that its parameters fit, or the nearest network and what is
/// missing.
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[command(after_help = "Example:
  srflow models inspect skflow-things.ckpt")]
pub struct InspectJob {
    /// Weights: PyTorch (.pth, .pt, .ckpt), safetensors, burnpack, TensorFlow (.index), Keras (.h5) or an index of
    /// several files (.index.json)
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
}

/// Export weights for PyTorch or as safetensors, or a network as ONNX
///
/// A .ckpt, .pt or .pth file is a Lightning checkpoint that torch.load reads, even with weights_only=True,
/// and that ptlflow loads into the network of the same name: get_model("raft", ckpt_path="raft.ckpt"). The
/// parameters have the names of the reference implementations.
///
/// A .onnx file holds a whole network with its weights, for onnxruntime and other programs: srflow, raft,
/// raft-small or skflow. Its inputs are `frame1` and `frame2`, f32 [1, 3, height, width], RGB in 0..255; its
/// output is `flow`, f32 [1, 2, height, width], in pixels, to the right and down. It takes frames of any
/// size, or with --size of one, and pads and crops itself. srflow also takes `start`, a flow to start from,
/// and gives `uncertainty`: docs/reference/networks.md.
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow models export runs/first/best.safetensors -o raft.ckpt
  srflow models export raft-things -o raft.onnx --iters 12
  srflow models export srflow -o srflow.onnx --size 640x480")]
pub struct ExportJob {
    /// Weights: a file, the name of published weights, such as skflow-things, or the name of a built-in
    /// network
    #[arg(value_name = "FILE|NAME")]
    pub weights: String,
    /// File to write: .ckpt, .pt or .pth (PyTorch), .safetensors, or .onnx
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Store 16-bit numbers, in half the bytes; for .safetensors
    #[arg(long)]
    #[serde(default)]
    pub half: bool,
    /// Refinement iterations, fixed in the file; for .onnx [default: the network's own, see `srflow models`]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_ITERATIONS))]
    #[serde(default)]
    pub iters: Option<u16>,
    /// Accept only frames of this size, WIDTHxHEIGHT; for .onnx [default: it takes any size]
    #[arg(long, value_name = "SIZE")]
    #[serde(default)]
    pub size: Option<Size>,
    /// Overwrite an existing file
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

/// Each iteration is written out in the file.
const MOST_ITERATIONS: i64 = 1000;

impl Job for ModelsJob {
    const NAME: &'static str = "models";

    type Report = Networks;

    fn work(&self, _: &Watch) -> anyhow::Result<Networks> {
        Ok(Networks(Architecture::ALL.map(ListedNetwork::new).into()))
    }
}

/// All networks.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
pub struct Networks(pub Vec<ListedNetwork>);

/// A network and its published weights.
#[derive(Debug, Clone, Serialize)]
pub struct ListedNetwork {
    pub name: &'static str,
    pub title: &'static str,
    pub paper: &'static str,
    pub parameters: usize,
    /// Frames are padded to a multiple of this number of pixels.
    pub padding: usize,
    pub iterations: ListedIterations,
    /// Where the authors' code is.
    pub authors: &'static str,
    pub licence: &'static str,
    /// Whether `srflow train` trains it.
    pub trains: bool,
    pub uncertainty: bool,
    pub occlusion: bool,
    pub settings: Vec<ListedSetting>,
    pub weights: Vec<ListedWeights>,
    /// Whether weights come with srflow.
    pub included: bool,
}

/// A setting of a network that is not stored in its weights.
#[derive(Debug, Clone, Serialize)]
pub struct ListedSetting {
    pub name: &'static str,
    pub description: &'static str,
    pub default: usize,
    #[serde(skip)]
    allowed: Allowed,
    pub least: usize,
    pub most: usize,
    /// Where not all between are allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub values: Option<&'static [usize]>,
}

/// Refinement iterations of a network.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ListedIterations {
    pub default: usize,
    /// In the authors' evaluation.
    pub authors: usize,
    pub training: usize,
}

/// Published weights.
#[derive(Debug, Clone, Serialize)]
pub struct ListedWeights {
    pub name: String,
    pub file: &'static str,
    pub url: &'static str,
    pub sha256: &'static str,
}

impl ListedSetting {
    fn new(setting: Setting) -> Self {
        let Setting { name, description, allowed, value, .. } = setting;
        let (least, most, values) = match &allowed {
            Allowed::Range(range) => (*range.start(), *range.end(), None),
            Allowed::OneOf(values) => {
                (values.first().copied().unwrap_or(0), values.last().copied().unwrap_or(0), Some(*values))
            }
        };
        Self { name, description, default: *value, allowed, least, most, values }
    }
}

impl ListedNetwork {
    fn new(architecture: Architecture) -> Self {
        let facts = architecture.facts();
        let mut network = architecture.init(&Default::default());
        let settings = network.settings().into_iter().map(ListedSetting::new).collect();
        let iterations = facts.iterations;
        let weights = facts.published.iter().map(|weights| ListedWeights {
            name: format!("{}-{}", facts.name, weights.trained_on),
            file: weights.file_name(),
            url: weights.url,
            sha256: weights.sha256,
        });
        Self {
            name: facts.name,
            title: facts.title,
            paper: facts.paper,
            parameters: facts.parameters,
            padding: facts.padding,
            iterations: ListedIterations {
                default: iterations.default,
                authors: iterations.authors,
                training: iterations.training,
            },
            authors: facts.authors,
            licence: facts.licence,
            trains: facts.trains,
            uncertainty: facts.mixture,
            occlusion: facts.occlusion,
            settings,
            weights: weights.collect(),
            included: facts.included.is_some(),
        }
    }
}

impl Report for Networks {}

impl fmt::Display for Networks {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self(networks) = self;
        let width = networks.iter().map(|network| network.name.len()).max().unwrap_or(0);
        let licences = networks.iter().map(|network| network.licence.len()).max().unwrap_or(0);
        writeln!(
            f,
            "{:<width$}  parameters  padding  iterations  {:<licences$}  weights by name",
            "name", "licence"
        )?;
        for network in networks {
            let ListedNetwork { name, parameters, padding, iterations, licence, weights, included, .. } =
                network;
            let included = included.then_some("included").into_iter();
            let weights: Vec<&str> =
                included.chain(weights.iter().map(|weights| weights.name.as_str())).collect();
            let (iterations, weights) = (iterations.default, weights.join(", "));
            writeln!(
                f,
                "{name:<width$}  {parameters:>10}  {padding:>7}  {iterations:>10}  {licence:<licences$}  {weights}"
            )?;
        }
        writeln!(f, "\nPapers, and the authors' code and weights:")?;
        let published = networks.iter().filter(|network| !network.paper.is_empty());
        for ListedNetwork { name, paper, authors, .. } in published {
            writeln!(f, "  {name:<width$}  {paper}  {authors}")?;
        }
        if networks.iter().any(|network| !network.settings.is_empty()) {
            writeln!(f, "\nSettings, for --set NAME=VALUE:")?;
        }
        for network in networks {
            for ListedSetting { name, description, default, allowed, .. } in &network.settings {
                writeln!(f, "  {:<width$}  {name}={default}  {description}: {allowed}", network.name)?;
            }
        }
        let folder =
            weights_folder().map_or("(none: set SRFLOW_CACHE)".into(), |folder| folder.display().to_string());
        writeln!(f, "\nPublished weights are ptlflow's; --json lists their URLs. They are cached in {folder}")
    }
}

impl Job for InspectJob {
    const NAME: &'static str = "models inspect";

    type Report = Inspected;

    fn work(&self, _: &Watch) -> anyhow::Result<Inspected> {
        let checkpoint = Checkpoint::open(&self.file)?;
        let infos = checkpoint.parameters();
        let fits = fits_of_file(&self.file)?;
        let best = &fits[0];
        let whole = best.difference.is_none().then_some(best.architecture);
        let names = |of: fn(&ParametersError) -> &Vec<String>| {
            best.difference.as_ref().map(of).cloned().unwrap_or_default()
        };
        Ok(Inspected {
            file: self.file.display().to_string(),
            format: checkpoint.format().to_string(),
            container: checkpoint.container().map(str::to_owned),
            prefix: checkpoint.prefix().to_owned(),
            types: checkpoint.types(),
            tensors: infos.len(),
            parameters: learned(&infos),
            network: whole.map(Architecture::name),
            lookalikes: whole.map_or(&[], |architecture| architecture.facts().lookalikes),
            nearest: fits.iter().map(Near::from).collect(),
            missing: names(|difference| &difference.missing),
            unknown: names(|difference| &difference.unknown),
            misshapen: names(|difference| &difference.misshapen),
            best: best.clone(),
        })
    }
}

/// A file of weights.
#[derive(Debug, Clone, Serialize)]
pub struct Inspected {
    pub file: String,
    pub format: String,
    /// The key under which a checkpoint keeps the parameters.
    pub container: Option<String>,
    /// Removed from the name of every parameter.
    pub prefix: String,
    pub types: Vec<String>,
    pub tensors: usize,
    /// Number of learned parameters, as PyTorch counts them.
    pub parameters: usize,
    /// The network that has exactly these parameters.
    pub network: Option<&'static str>,
    /// Others with the same parameters.
    pub lookalikes: &'static [&'static str],
    /// All networks, the most similar first.
    pub nearest: Vec<Near>,
    pub missing: Vec<String>,
    pub unknown: Vec<String>,
    pub misshapen: Vec<String>,
    #[serde(skip)]
    best: Fit,
}

/// How many parameters of a network a file has.
#[derive(Debug, Clone, Serialize)]
pub struct Near {
    pub network: &'static str,
    pub matching: usize,
    pub expected: usize,
    /// Parameters whose shape the file has, under whatever name.
    pub same_shape: usize,
}

impl From<&Fit> for Near {
    fn from(fit: &Fit) -> Self {
        Self {
            network: fit.architecture.name(),
            matching: fit.matching,
            expected: fit.expected,
            same_shape: fit.same_shape,
        }
    }
}

impl Report for Inspected {}

impl fmt::Display for Inspected {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { file, format, container, prefix, types, tensors, parameters, best, .. } = self;
        writeln!(f, "{file}: {format}")?;
        if let Some(container) = container {
            writeln!(f, "  parameters under {container}")?;
        }
        if !prefix.is_empty() {
            writeln!(f, "  prefix {prefix} removed from every name")?;
        }
        writeln!(f, "  {tensors} tensors, {parameters} parameters, {}", types.join(" and "))?;
        writeln!(f, "  {best}")?;
        match &best.difference {
            Some(difference) => writeln!(f, "  {difference}"),
            None => Ok(()),
        }
    }
}

/// Excludes the statistics of batch norm, which are stored but not learned.
fn learned(infos: &[ParameterInfo]) -> usize {
    let learned = infos.iter().filter(|info| !info.name.contains("running_"));
    learned.map(|info| info.shape.iter().product::<usize>()).sum()
}

/// A kind of file that networks are exported to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FileKind {
    PyTorch,
    Safetensors,
    Onnx,
}

impl ExportJob {
    /// The kind of file that the name `out` asks for.
    fn kind(&self) -> anyhow::Result<FileKind> {
        let extension = self.out.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        Ok(match extension {
            "ckpt" | "pt" | "pth" => FileKind::PyTorch,
            "safetensors" => FileKind::Safetensors,
            "onnx" => FileKind::Onnx,
            _ => wrong_settings!(
                "{}: expected a name that ends in .ckpt, .pt, .pth, .safetensors or .onnx",
                self.out.display()
            ),
        })
    }

    /// Checks that the settings apply to this kind of file.
    fn check(&self, kind: FileKind) -> anyhow::Result<()> {
        for (setting, given, of) in [
            ("half", self.half, FileKind::Safetensors),
            ("iters", self.iters.is_some(), FileKind::Onnx),
            ("size", self.size.is_some(), FileKind::Onnx),
        ] {
            if given && kind != of {
                let ending = if of == FileKind::Onnx { ".onnx" } else { ".safetensors" };
                wrong_settings!(
                    "`{setting}`: for files that end in {ending}, and not for {}: leave it out",
                    self.out.display()
                );
            }
        }
        match self.iters.filter(|iters| !(1..=MOST_ITERATIONS).contains(&(*iters).into())) {
            Some(iters) => {
                let expected = format!("1 to {MOST_ITERATIONS} iterations");
                Err(SettingError { field: "iters", found: iters.to_string(), expected }.into())
            }
            None => Ok(()),
        }
    }
}

impl Job for ExportJob {
    const NAME: &'static str = "models export";

    type Report = Exported;

    fn work(&self, watch: &Watch) -> anyhow::Result<Exported> {
        let Self { weights, out, half, iters, size, force } = self;
        let kind = self.kind()?;
        self.check(kind)?;
        ensure!(*force || !out.exists(), "{}: the file exists; give `force` to overwrite it", out.display());
        let device = srflow_ops::device("cpu")?;
        let named = Architecture::from_name(weights).filter(|_| !Path::new(weights).exists());
        let network = match named.and_then(|named| load_included(named, &device)) {
            Some(network) => network,
            None => {
                let path = weights_file(None, weights, watch)?;
                load_network(fits_of_file(&path)?[0].architecture, &path, &device)?
            }
        };
        let architecture = network.architecture();
        let mut exported = Exported {
            file: out.clone(),
            iterations: None,
            network: architecture.name(),
            size: None,
            architecture,
            kind,
        };
        match kind {
            FileKind::PyTorch => save_network_pytorch(&network, out)?,
            FileKind::Safetensors => {
                save_network(&network, if *half { StoredAs::F16 } else { StoredAs::F32 }, out)?;
            }
            FileKind::Onnx => {
                let own = architecture.facts().iterations.default;
                let iterations =
                    NonZeroUsize::new(iters.map_or(own, usize::from)).unwrap_or(NonZeroUsize::MIN);
                match save_network_onnx(&network, OnnxOptions { iterations, size: *size }, out) {
                    Err(error @ (OnnxError::NotExported { .. } | OnnxError::TooLarge { .. })) => {
                        wrong_settings!("{}: {error}", out.display())
                    }
                    saved => saved?,
                }
                exported.iterations = Some(iterations.get());
                exported.size = Some(size.map(|size| [size.width, size.height]));
            }
        }
        Ok(exported)
    }
}

/// A file that [`ExportJob`] has written.
#[derive(Debug, Clone, Serialize)]
pub struct Exported {
    pub file: PathBuf,
    /// Of an ONNX file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    pub network: &'static str,
    /// Width and height of the frames that an ONNX file takes; `null` for any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<Option<[usize; 2]>>,
    #[serde(skip)]
    architecture: Architecture,
    #[serde(skip)]
    kind: FileKind,
}

impl Report for Exported {}

impl fmt::Display for Exported {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let (file, facts) = (self.file.display(), self.architecture.facts());
        match self.iterations {
            Some(iterations) => {
                let frames = match self.size.flatten() {
                    Some([width, height]) => Size { width, height }.to_string(),
                    None => "any size".to_owned(),
                };
                writeln!(f, "{file}: {} with {iterations} iterations, for frames of {frames}", self.network)?;
            }
            None => writeln!(f, "{file}: weights of {}", facts.names_of_weights())?,
        }
        if self.kind == FileKind::PyTorch && facts.in_ptlflow {
            let model = self.network.replace('-', "_"); // ptlflow's name
            writeln!(f, "  ptlflow.get_model(\"{model}\", ckpt_path=\"{file}\")")?;
        }
        Ok(())
    }
}

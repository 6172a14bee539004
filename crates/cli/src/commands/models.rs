use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use clap::{Args, Subcommand};
use serde::Serialize;
use srflow_core::Size;
use srflow_nets::{
    Allowed, Architecture, Fit, OnnxError, OnnxOptions, Setting, fits_of_file, load_included, load_network,
    save_network, save_network_onnx, save_network_pytorch, weights_folder,
};
use srflow_nn::{Checkpoint, ParameterInfo, ParametersError, StoredAs};

use crate::Context;
use crate::networks::weights_file;
use srflow::wrong_settings;

/// List the networks, inspect a file of weights, or export one
///
/// Without a subcommand: lists every network with its parameters, the multiple that frames are padded to, the iterations,
/// the licence of the authors' code, and the published weights.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow models
  srflow models inspect skflow-things.ckpt --json
  srflow models export runs/first/best.safetensors -o raft.ckpt")]
pub struct Models {
    #[command(subcommand)]
    action: Option<Action>,
}

#[derive(Subcommand)]
enum Action {
    Inspect(Inspect),
    Export(Export),
}

/// Inspect a file of weights
///
/// Prints the kind of file and the network that its parameters fit, or the nearest network and what is missing.
#[derive(Args)]
#[command(after_help = "Example:
  srflow models inspect skflow-things.ckpt")]
struct Inspect {
    /// Weights: PyTorch (.pth, .pt, .ckpt), safetensors, burnpack, TensorFlow (.index) or Keras (.h5)
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

/// Export weights for PyTorch or as safetensors, or a network as ONNX
///
/// A .ckpt, .pt or .pth file is a Lightning checkpoint that torch.load reads, even with weights_only=True, and that ptlflow
/// loads into the network of the same name: get_model("raft", ckpt_path="raft.ckpt"). The parameters have the names of the
/// reference implementations.
///
/// A .onnx file holds a whole network with its weights, for onnxruntime and other programs: srflow, raft, raft-small or skflow. Its
/// inputs are `frame1` and `frame2`, f32 [1, 3, height, width], RGB in 0..255; its output is `flow`, f32 [1, 2, height, width], in
/// pixels, to the right and down. It takes frames of any size, or with --size of one, and pads and crops itself. srflow also takes
/// `start`, a flow to start from, and gives `uncertainty`: docs/reference/networks.md.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow models export runs/first/best.safetensors -o raft.ckpt
  srflow models export raft-things -o raft.onnx --iters 12
  srflow models export srflow -o srflow.onnx --size 640x480")]
struct Export {
    /// Weights of one of the networks: a file, the name of published weights, such as skflow-things, or the name of a network
    /// whose weights come with srflow
    #[arg(value_name = "FILE|NAME")]
    weights: String,
    /// File to write: .ckpt, .pt or .pth (PyTorch), .safetensors, or .onnx
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Store 16-bit numbers, rounded to the nearest, in half of the bytes; for .safetensors
    #[arg(long)]
    half: bool,
    /// Refinement iterations, each of which is in the file; for .onnx [default: the network's own, see `srflow models`]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000))]
    iters: Option<u16>,
    /// The one size of the frames that the file takes, WIDTHxHEIGHT; for .onnx [default: it takes any size]
    #[arg(long, value_name = "SIZE")]
    size: Option<Size>,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

pub fn run(args: Models, context: &Context) -> anyhow::Result<()> {
    match args.action {
        None => list(context),
        Some(Action::Inspect(args)) => inspect(args, context),
        Some(Action::Export(args)) => export(args, context),
    }
}

#[derive(Serialize)]
struct Listed {
    name: &'static str,
    title: &'static str,
    paper: &'static str,
    parameters: usize,
    padding: usize,
    iterations: ListedIterations,
    authors: &'static str,
    licence: &'static str,
    trains: bool,
    uncertainty: bool,
    occlusion: bool,
    settings: Vec<ListedSetting>,
    weights: Vec<ListedWeights>,
    /// Whether weights come with srflow.
    included: bool,
}

#[derive(Serialize)]
struct ListedSetting {
    name: &'static str,
    description: &'static str,
    default: usize,
    #[serde(skip)]
    allowed: Allowed,
    least: usize,
    most: usize,
    /// Where not all between are allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    values: Option<&'static [usize]>,
}

#[derive(Serialize)]
struct ListedIterations {
    default: usize,
    authors: usize,
    training: usize,
}

#[derive(Serialize)]
struct ListedWeights {
    name: String,
    file: &'static str,
    url: &'static str,
    sha256: &'static str,
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

impl Listed {
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

fn list(context: &Context) -> anyhow::Result<()> {
    let networks = Architecture::ALL.map(Listed::new);
    if context.json {
        return crate::output::print_json(&networks);
    }
    let width = networks.iter().map(|network| network.name.len()).max().unwrap_or(0);
    let licences = networks.iter().map(|network| network.licence.len()).max().unwrap_or(0);
    say!("{:<width$}  parameters  padding  iterations  {:<licences$}  weights by name", "name", "licence")?;
    for network in &networks {
        let Listed { name, parameters, padding, iterations, licence, weights, included, .. } = network;
        let included = included.then_some("included").into_iter();
        let weights: Vec<&str> =
            included.chain(weights.iter().map(|weights| weights.name.as_str())).collect();
        let (iterations, weights) = (iterations.default, weights.join(", "));
        say!(
            "{name:<width$}  {parameters:>10}  {padding:>7}  {iterations:>10}  {licence:<licences$}  {weights}"
        )?;
    }
    say!("\nPapers, and the authors' code and weights:")?;
    for Listed { name, paper, authors, .. } in networks.iter().filter(|network| !network.paper.is_empty()) {
        say!("  {name:<width$}  {paper}  {authors}")?;
    }
    if networks.iter().any(|network| !network.settings.is_empty()) {
        say!("\nSettings, for --set NAME=VALUE:")?;
    }
    for network in &networks {
        for ListedSetting { name, description, default, allowed, .. } in &network.settings {
            say!("  {:<width$}  {name}={default}  {description}: {allowed}", network.name)?;
        }
    }
    let folder =
        weights_folder().map_or("(none: set SRFLOW_CACHE)".into(), |folder| folder.display().to_string());
    say!("\nPublished weights are ptlflow's; --json lists their URLs. They are cached in {folder}")
}

#[derive(Serialize)]
struct Inspected<'a> {
    file: String,
    format: String,
    container: Option<&'a str>,
    prefix: &'a str,
    types: Vec<String>,
    tensors: usize,
    /// Number of learned parameters, as PyTorch counts them.
    parameters: usize,
    network: Option<&'static str>,
    lookalikes: &'static [&'static str],
    nearest: Vec<Near>,
    missing: &'a [String],
    unknown: &'a [String],
    misshapen: &'a [String],
}

#[derive(Serialize)]
struct Near {
    network: &'static str,
    matching: usize,
    expected: usize,
}

fn inspect(args: Inspect, context: &Context) -> anyhow::Result<()> {
    let checkpoint = Checkpoint::open(&args.file)?;
    let infos = checkpoint.parameters();
    let fits = fits_of_file(&args.file)?;
    let best = &fits[0];
    let types = checkpoint.types();
    if context.json {
        let whole = best.difference.is_none().then_some(best.architecture);
        let names = |of: fn(&ParametersError) -> &[String]| best.difference.as_ref().map_or(&[][..], of);
        let inspected = Inspected {
            file: args.file.display().to_string(),
            format: checkpoint.format().to_string(),
            container: checkpoint.container(),
            prefix: checkpoint.prefix(),
            types,
            tensors: infos.len(),
            parameters: learned(&infos),
            network: whole.map(Architecture::name),
            lookalikes: whole.map_or(&[], |architecture| architecture.facts().lookalikes),
            nearest: fits.iter().map(Near::from).collect(),
            missing: names(|difference| &difference.missing),
            unknown: names(|difference| &difference.unknown),
            misshapen: names(|difference| &difference.misshapen),
        };
        return crate::output::print_json(&inspected);
    }
    say!("{}: {}", args.file.display(), checkpoint.format())?;
    if let Some(container) = checkpoint.container() {
        say!("  parameters under {container}")?;
    }
    if !checkpoint.prefix().is_empty() {
        say!("  prefix {} removed from every name", checkpoint.prefix())?;
    }
    say!("  {} tensors, {} parameters, {}", infos.len(), learned(&infos), types.join(" and "))?;
    say!("  {best}")?;
    if let Some(difference) = &best.difference {
        say!("  {difference}")?;
    }
    Ok(())
}

/// A kind of file that networks are exported to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Exported {
    PyTorch,
    Safetensors,
    Onnx,
}

impl Exported {
    /// Checks that the given options apply to it.
    fn check(self, Export { out, half, iters, size, .. }: &Export) -> anyhow::Result<()> {
        for (option, given, of) in [
            ("--half", *half, Self::Safetensors),
            ("--iters", iters.is_some(), Self::Onnx),
            ("--size", size.is_some(), Self::Onnx),
        ] {
            if given && self != of {
                let ending = if of == Self::Onnx { ".onnx" } else { ".safetensors" };
                wrong_settings!(
                    "{option}: for files that end in {ending}, and not for {}: leave it out",
                    out.display()
                );
            }
        }
        Ok(())
    }
}

fn export(args: Export, context: &Context) -> anyhow::Result<()> {
    let Export { weights, out, half, iters, size, force } = &args;
    let extension = out.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let kind = match extension {
        "ckpt" | "pt" | "pth" => Exported::PyTorch,
        "safetensors" => Exported::Safetensors,
        "onnx" => Exported::Onnx,
        _ => wrong_settings!(
            "{}: expected a name that ends in .ckpt, .pt, .pth, .safetensors or .onnx",
            out.display()
        ),
    };
    kind.check(&args)?;
    ensure!(*force || !out.exists(), "{}: the file exists; give --force to overwrite it", out.display());
    let device = srflow_ops::device("cpu")?;
    let named = Architecture::from_name(weights).filter(|_| !Path::new(weights).exists());
    let network = match named.and_then(|named| load_included(named, &device)) {
        Some(network) => network,
        None => {
            let path = weights_file(None, weights, &crate::run::WATCH)?;
            load_network(fits_of_file(&path)?[0].architecture, &path, &device)?
        }
    };
    let architecture = network.architecture();
    let (name, facts) = (architecture.name(), architecture.facts());
    let iterations = iters.map_or(facts.iterations.default, usize::from);
    match kind {
        Exported::PyTorch => save_network_pytorch(&network, out)?,
        Exported::Safetensors => {
            save_network(&network, if *half { StoredAs::F16 } else { StoredAs::F32 }, out)?;
        }
        Exported::Onnx => {
            let iterations = NonZeroUsize::new(iterations).context("no iterations")?;
            match save_network_onnx(&network, OnnxOptions { iterations, size: *size }, out) {
                Err(error @ (OnnxError::NotExported { .. } | OnnxError::TooLarge { .. })) => {
                    wrong_settings!("{}: {error}", out.display())
                }
                saved => saved?,
            }
        }
    }
    if context.json {
        let mut exported = serde_json::json!({ "file": out, "network": name });
        if kind == Exported::Onnx {
            exported["iterations"] = iterations.into();
            exported["size"] = size.map(|size| serde_json::json!([size.width, size.height])).into();
        }
        return crate::output::print_json(&exported);
    }
    match kind {
        Exported::Onnx => {
            let frames = size.map_or("any size".to_owned(), |size| size.to_string());
            say!("{}: {name} with {iterations} iterations, for frames of {frames}", out.display())?;
        }
        _ => say!("{}: weights of {}", out.display(), facts.names_of_weights())?,
    }
    if kind == Exported::PyTorch && facts.in_ptlflow {
        let model = name.replace('-', "_"); // ptlflow's name
        say!("  ptlflow.get_model(\"{model}\", ckpt_path=\"{}\")", out.display())?;
    }
    Ok(())
}

/// Excludes the statistics of batch norm, which are stored but not learned.
fn learned(infos: &[ParameterInfo]) -> usize {
    let learned = infos.iter().filter(|info| !info.name.contains("running_"));
    learned.map(|info| info.shape.iter().product::<usize>()).sum()
}

impl From<&Fit> for Near {
    fn from(fit: &Fit) -> Self {
        Self { network: fit.architecture.name(), matching: fit.matching, expected: fit.expected }
    }
}

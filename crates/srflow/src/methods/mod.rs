//! The table behind `--method`: every estimator by name.

mod labels;
mod record;
mod rows;

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use crate::clap::Args;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use srflow_classical::{Farneback, FarnebackParameters, TvL1, TvL1Parameters};
use srflow_core::{FlowEstimator, FlowField, Image};
use srflow_data::flow::FlowDataset;
use srflow_eval::{FlowFiles, Zero};
use srflow_nets::{Architecture, Iterations, Start, Started, Wrapped};

use crate::Watch;
use crate::error::wrong_settings;
use crate::large_frames::LargeFrames;
use crate::networks::NetworkArgs;
use labels::labels;
pub use record::records;
pub use rows::{Rows, RowsArgs};

/// A method of optical flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Method {
    /// Gunnar Farneback's polynomial expansion
    Farneback,
    /// TV-L1: total variation smoothness, absolute differences
    TvL1,
    /// A network with weights from a checkpoint
    Network(Architecture),
    /// Flow files of the pairs of a dataset, written by another program
    Files,
}

impl Method {
    /// Methods without weights.
    pub const CLASSICAL: [Self; 2] = [Self::Farneback, Self::TvL1];

    /// The method of commands that are given none: a network whose weights come with srflow.
    pub const DEFAULT: Self = Self::Network(Architecture::SrFlow);

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Farneback => "farneback",
            Self::TvL1 => "tvl1",
            Self::Network(architecture) => architecture.name(),
            Self::Files => "files",
        }
    }

    /// The network, if it is one.
    pub fn network(self) -> Option<Architecture> {
        match self {
            Self::Network(architecture) => Some(architecture),
            _ => None,
        }
    }

    /// Help of an option that takes one method.
    pub fn help() -> String {
        format!(
            "How to estimate the flow: {}; a network followed by its weights, as in raft=FILE; srflow has its own",
            Self::names()
        )
    }

    /// Help of an option that takes several methods, for the purpose `what`.
    pub fn help_of_several(what: &str) -> String {
        format!(
            "{what}: {}; networks with their weights, as in skflow=FILE; srflow has its own; files:DIR for flow files of \
            another program; NAME:METHOD sets the name in tables, as in SRFlowNet:skflow=FILE; METHOD:iters=N sets the \
            refinement iterations of one network",
            Self::names()
        )
    }

    fn all() -> impl Iterator<Item = Self> {
        Self::CLASSICAL.into_iter().chain(Architecture::ALL.into_iter().map(Self::Network))
    }

    /// All names, for the help of `--method`.
    pub fn names() -> String {
        Self::all().map(Self::name).collect::<Vec<_>>().join(", ")
    }
}

/// Before the iterations of a method.
const ITERATIONS: &str = ":iters=";

/// A method as `--method` names it: `tvl1`, `skflow`, `skflow=WEIGHTS`, `files:DIR`, `LABEL:skflow=WEIGHTS`,
/// `skflow=WEIGHTS:iters=12`.
#[derive(Debug, Clone, PartialEq)]
pub struct MethodSpec {
    /// Name in tables.
    pub label: Option<String>,
    pub method: Method,
    /// Its own weights, a file or a published name; for files their folder.
    pub weights: Option<String>,
    /// Refinements of its own, for a network.
    pub iterations: Option<Iterations>,
    /// Settings of its own, for a network.
    pub settings: Vec<(String, usize)>,
}

/// The built-in network.
impl Default for MethodSpec {
    fn default() -> Self {
        Method::DEFAULT.into()
    }
}

impl From<Method> for MethodSpec {
    fn from(method: Method) -> Self {
        Self { label: None, method, weights: None, iterations: None, settings: Vec::new() }
    }
}

impl fmt::Display for MethodSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(label) = &self.label {
            write!(f, "{label}:")?;
        }
        match (self.method, &self.weights) {
            (Method::Files, dir) => write!(f, "files:{}", dir.as_deref().unwrap_or_default()),
            (method, None) => f.write_str(method.name()),
            (method, Some(weights)) => write!(f, "{}={weights}", method.name()),
        }?;
        match self.iterations {
            Some(iterations) => write!(f, "{ITERATIONS}{iterations}"),
            None => Ok(()),
        }
    }
}

srflow_core::serialize_as_text!(MethodSpec);

impl FromStr for MethodSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if label_and_files(text).is_some() {
            return Err("files:DIR scores flow files of a dataset: only `srflow eval` takes it".to_owned());
        }
        let (named, iterations) = match text.rsplit_once(ITERATIONS) {
            Some((named, iterations)) => {
                (named, Some(iterations.parse::<Iterations>().map_err(|e| e.to_string())?))
            }
            None => (text, None),
        };
        let (name, weights) = match named.split_once('=') {
            Some((name, weights)) => (name, Some(weights)),
            None => (named, None),
        };
        let (label, name) = match name.rsplit_once(':') {
            Some((label, name)) => (Some(label), name),
            None => (None, name),
        };
        let method = Method::all()
            .find(|method| method.name() == name)
            .ok_or_else(|| format!("unknown method `{name}`; the methods are {}", Method::names()))?;
        if label.is_some_and(|label| label.trim().is_empty()) {
            return Err(format!("`{text}` begins with an empty name; expected NAME:{name}"));
        }
        let refines = method.network().is_some_and(|architecture| architecture.facts().refines());
        if iterations.is_some() && !refines {
            return Err(format!("{name} has no iterations: leave out `{ITERATIONS}...`"));
        }
        match (method, weights) {
            (_, Some("")) => Err(format!("`{text}` names no weights; expected {name}=FILE")),
            (Method::Farneback | Method::TvL1, Some(_)) => {
                Err(format!("{name} has no weights; leave out `=...`"))
            }
            _ => Ok(Self {
                label: label.map(str::to_owned),
                weights: weights.map(str::to_owned),
                iterations,
                ..method.into()
            }),
        }
    }
}

/// The methods of a job for several that is given none.
pub fn default_methods() -> Vec<MethodSpec> {
    vec![MethodSpec::default()]
}

/// A method of `srflow eval`: also `files:DIR` and `LABEL:files:DIR`.
///
/// # Errors
/// A message for the user.
pub fn scored_method(text: &str) -> Result<MethodSpec, String> {
    match label_and_files(text) {
        Some((_, "")) => Err(format!("`{text}` names no folder; expected files:DIR")),
        Some((label, dir)) => Ok(MethodSpec {
            label: label.map(str::to_owned),
            weights: Some(dir.to_owned()),
            ..Method::Files.into()
        }),
        None => text.parse(),
    }
}

/// Deserializes methods with [`scored_method`].
pub(crate) fn scored_methods<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<MethodSpec>, D::Error> {
    let texts = Vec::<String>::deserialize(deserializer)?;
    texts.iter().map(|text| scored_method(text)).collect::<Result<_, _>>().map_err(D::Error::custom)
}

/// Splits `files:DIR` or `LABEL:files:DIR`.
fn label_and_files(text: &str) -> Option<(Option<&str>, &str)> {
    let labelled = || text.split_once(":files:").filter(|(label, _)| !label.trim().is_empty());
    text.strip_prefix("files:")
        .map(|dir| (None, dir))
        .or_else(|| labelled().map(|(label, dir)| (Some(label), dir)))
}

/// Parameters of the methods. Each applies to the methods in its heading and has a default.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MethodParameters {
    /// Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and
    /// --warps are set; the other parameters of tvl1 apply too
    #[arg(long)]
    refine: bool,
    /// Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start
    #[arg(long, value_name = "METHOD")]
    pub start: Option<MethodSpec>,
    #[command(flatten)]
    #[serde(flatten)]
    pub network: NetworkArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub large_frames: LargeFrames,
    #[command(flatten)]
    #[serde(flatten)]
    farneback: FarnebackArgs,
    #[command(flatten)]
    #[serde(flatten)]
    tvl1: TvL1Args,
}

/// OpenCV's parameters of `calcOpticalFlowFarneback`.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(next_help_heading = "Parameters of farneback")]
struct FarnebackArgs {
    /// Size of a pyramid level relative to the next finer one [default: 0.5]
    #[arg(long, value_name = "SCALE")]
    pyr_scale: Option<f64>,
    /// Pyramid levels in addition to the full size [default: 5]
    #[arg(long, value_name = "N")]
    levels: Option<usize>,
    /// Side of the averaging window in pixels [default: 13]
    #[arg(long, value_name = "PIXELS")]
    winsize: Option<usize>,
    /// Iterations at each level [default: 10]
    #[arg(long, value_name = "N")]
    iterations: Option<usize>,
    /// Radius of the polynomial fit in pixels [default: 5]
    #[arg(long, value_name = "PIXELS")]
    poly_n: Option<usize>,
    /// Standard deviation of the fit's weight in pixels [default: 1.1]
    #[arg(long, value_name = "PIXELS")]
    poly_sigma: Option<f64>,
    /// Use a Gaussian averaging window in place of a box
    #[arg(long)]
    farneback_gaussian: bool,
}

/// OpenCV's parameters of `DualTVL1OpticalFlow`.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(next_help_heading = "Parameters of tvl1")]
struct TvL1Args {
    /// Time step of the dual update [default: 0.25]
    #[arg(long, value_name = "STEP")]
    tau: Option<f64>,
    /// Weight of the data term; smaller is smoother [default: 0.15]
    #[arg(long, value_name = "WEIGHT")]
    lambda: Option<f64>,
    /// Tightness of the coupling of data term and smoothness [default: 0.3]
    #[arg(long, value_name = "TIGHTNESS")]
    theta: Option<f64>,
    /// Number of scales [default: 5]
    #[arg(long, value_name = "N")]
    nscales: Option<usize>,
    /// Warps at each scale [default: 5]
    #[arg(long, value_name = "N")]
    warps: Option<usize>,
    /// Stop iterating when the flow changes by less than this, in pixels [default: 0.01]
    #[arg(long, value_name = "PIXELS")]
    epsilon: Option<f64>,
    /// Iterations between two median filters [default: 30]
    #[arg(long, value_name = "N")]
    inner_iterations: Option<usize>,
    /// Median filters after each warp [default: 10]
    #[arg(long, value_name = "N")]
    outer_iterations: Option<usize>,
    /// Size of a scale relative to the next finer one [default: 0.8]
    #[arg(long, value_name = "SCALE")]
    scale_step: Option<f64>,
    /// Weight of an additional brightness change; 0 disables it [default: 0]
    #[arg(long, value_name = "WEIGHT")]
    gamma: Option<f64>,
    /// Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5]
    #[arg(long, value_name = "PIXELS")]
    median_filtering: Option<usize>,
}

/// The estimator of one method.
///
/// # Errors
/// As [`estimators`].
pub fn estimator(
    spec: &MethodSpec,
    parameters: &MethodParameters,
    watch: &Watch,
) -> anyhow::Result<Box<dyn FlowEstimator>> {
    Ok(estimators(std::slice::from_ref(spec), parameters, watch)?.swap_remove(0))
}

/// The estimators of these methods, in order, without duplicates.
///
/// # Errors
/// When a parameter is out of range or applies to none of the methods, or weights cannot be loaded.
pub fn estimators(
    specs: &[MethodSpec],
    parameters: &MethodParameters,
    watch: &Watch,
) -> anyhow::Result<Vec<Box<dyn FlowEstimator>>> {
    named(specs, parameters)?.into_iter().map(|(spec, label)| built(spec, label, parameters, watch)).collect()
}

/// A method of `srflow eval`.
pub enum Source {
    Estimator(Box<dyn FlowEstimator>),
    Files(FlowFiles),
}

impl Source {
    pub fn method(&self) -> srflow_eval::Method<'_> {
        match self {
            Self::Estimator(estimator) => srflow_eval::Method::Estimator(estimator.as_ref()),
            Self::Files(files) => srflow_eval::Method::Files(files),
        }
    }

    /// The flow of one of the pairs that the sources were opened for, which has this name and these frames.
    ///
    /// # Errors
    /// When it cannot be estimated, or its file not read.
    pub fn flow(&self, pair: &str, frame1: &Image, frame2: &Image) -> anyhow::Result<FlowField> {
        match self {
            Self::Estimator(estimator) => Ok(estimator.estimate(frame1, frame2)?),
            Self::Files(files) => Ok(files.flow(pair, frame1.size())?),
        }
    }
}

/// The estimators and the flow files of the scored pairs of `dataset`, in order, without duplicates.
///
/// # Errors
/// As [`estimators`], and when a pair has no flow file.
pub fn sources(
    specs: &[MethodSpec],
    parameters: &MethodParameters,
    dataset: &FlowDataset,
    limit: Option<usize>,
    watch: &Watch,
) -> anyhow::Result<Vec<Source>> {
    let specs = named(specs, parameters)?;
    // Files first: missing ones are reported before networks are loaded.
    let mut files: Vec<Option<FlowFiles>> = Vec::new();
    for (spec, label) in &specs {
        let dir = spec.weights.as_deref().filter(|_| spec.method == Method::Files);
        let found = dir.map(|dir| FlowFiles::find(label.clone(), Path::new(dir), dataset, limit));
        files.push(found.transpose()?);
    }
    let source = |((spec, label), files): ((&MethodSpec, String), Option<FlowFiles>)| match files {
        Some(files) => Ok(Source::Files(files)),
        None => built(spec, label, parameters, watch).map(Source::Estimator),
    };
    specs.into_iter().zip(files).map(source).collect()
}

/// These methods in order, without duplicates, with their names in tables.
fn named<'a>(
    specs: &'a [MethodSpec],
    parameters: &MethodParameters,
) -> anyhow::Result<Vec<(&'a MethodSpec, String)>> {
    let networks: Vec<Architecture> = specs.iter().filter_map(|spec| spec.method.network()).collect();
    let without =
        specs.iter().filter(|spec| spec.method.network().is_some() && spec.weights.is_none()).count();
    let network = &parameters.network;
    match network.given() {
        Some(setting) if networks.is_empty() => {
            wrong_settings!("`{setting}` is for networks, and `method` names none: leave it out")
        }
        _ => network.check(&networks)?,
    }
    if network.weights.is_some() && without != 1 {
        wrong_settings!(
            "`weights` is for one network, and `method` names {without} without weights of their own: write \
             `method` NETWORK=WEIGHTS for each"
        );
    }
    if let Some(start) = &parameters.start
        && !networks.iter().any(|network| starts(*network))
    {
        wrong_settings!("`start` {start}: none of the methods can start from a flow; leave it out");
    }
    parameters.large_frames.check()?;
    let specs = distinct(specs);
    let labels = labels(&specs);
    for (number, label) in labels.iter().enumerate() {
        if label == Zero.name() {
            wrong_settings!("`zero` is the baseline of the tables: give the method another name");
        }
        if labels[..number].contains(label) {
            wrong_settings!("two methods have the name {label}: rename one, as in `method` NAME:skflow=FILE");
        }
    }
    Ok(specs.into_iter().zip(labels).collect())
}

/// Without duplicates, in the given order.
fn distinct(specs: &[MethodSpec]) -> Vec<&MethodSpec> {
    let mut found: Vec<&MethodSpec> = Vec::new();
    for spec in specs {
        if !found.contains(&spec) {
            found.push(spec);
        }
    }
    found
}

fn built(
    spec: &MethodSpec,
    label: String,
    parameters: &MethodParameters,
    watch: &Watch,
) -> anyhow::Result<Box<dyn FlowEstimator>> {
    let large_frames = &parameters.large_frames;
    let estimator: Box<dyn FlowEstimator> = match spec.method {
        Method::Farneback => Box::new(Farneback::new(parameters.farneback.parameters())?),
        Method::TvL1 => Box::new(TvL1::new(parameters.tvl1.or(TvL1Parameters::default()))?),
        Method::Network(architecture) => {
            let network = parameters.network.of(spec.iterations, &spec.settings);
            let scale = large_frames.scale.unwrap_or(1.0);
            let network =
                network.estimator(architecture, spec.weights.as_deref(), label.clone(), scale, watch)?;
            match parameters.start_of(architecture) {
                None => Box::new(network),
                Some((start, parameters)) => {
                    let start = built(start, start.method.name().to_owned(), &parameters, watch)?;
                    Box::new(Started::new(network, start))
                }
            }
        }
        Method::Files => wrong_settings!("files:DIR estimates nothing"),
    };
    let tiling = large_frames.tiling(spec.method, &parameters.network)?;
    let refinement = parameters.refinement().map(TvL1::new).transpose()?;
    let wrapped = Wrapped::new(estimator).labelled(label).tiled(tiling).scaled(large_frames.scale)?;
    Ok(Box::new(wrapped.refined(refinement)))
}

/// Whether a network can start each pair from a flow, and takes nothing else from the pairs before.
fn starts(architecture: Architecture) -> bool {
    let facts = architecture.facts();
    !facts.remembers && !matches!(facts.start, Start::Frames(_))
}

/// Whether one of the methods refines its flow until it is still, so that pairs differ in their iterations.
pub fn any_auto(specs: &[MethodSpec], parameters: &MethodParameters) -> bool {
    let network = &parameters.network;
    specs.iter().any(|spec| {
        spec.method
            .network()
            .is_some_and(|architecture| network.of(spec.iterations, &[]).is_auto(architecture))
    })
}

impl FarnebackArgs {
    fn parameters(&self) -> FarnebackParameters {
        let default = FarnebackParameters::default();
        FarnebackParameters {
            pyr_scale: self.pyr_scale.unwrap_or(default.pyr_scale),
            levels: self.levels.unwrap_or(default.levels),
            winsize: self.winsize.unwrap_or(default.winsize),
            iterations: self.iterations.unwrap_or(default.iterations),
            poly_n: self.poly_n.unwrap_or(default.poly_n),
            poly_sigma: self.poly_sigma.unwrap_or(default.poly_sigma),
            gaussian: self.farneback_gaussian,
        }
    }
}

impl MethodParameters {
    /// The method that a network is to start from, with its parameters; `None` for its own start.
    fn start_of(&self, architecture: Architecture) -> Option<(&MethodSpec, Self)> {
        let start = self.start.as_ref().filter(|_| starts(architecture))?;
        // Frames are already scaled or cut where it sees them, and refinement is for the result.
        let inner = Self { refine: false, start: None, large_frames: LargeFrames::default(), ..self.clone() };
        Some((start, inner))
    }

    /// The parameters of the refinement, if there is one.
    fn refinement(&self) -> Option<TvL1Parameters> {
        // More warps fit the noise.
        let once = TvL1Parameters { nscales: 1, warps: 1, ..TvL1Parameters::default() };
        self.refine.then(|| self.tvl1.or(once))
    }
}

impl TvL1Args {
    fn or(&self, default: TvL1Parameters) -> TvL1Parameters {
        TvL1Parameters {
            tau: self.tau.unwrap_or(default.tau),
            lambda: self.lambda.unwrap_or(default.lambda),
            theta: self.theta.unwrap_or(default.theta),
            nscales: self.nscales.unwrap_or(default.nscales),
            warps: self.warps.unwrap_or(default.warps),
            epsilon: self.epsilon.unwrap_or(default.epsilon),
            inner_iterations: self.inner_iterations.unwrap_or(default.inner_iterations),
            outer_iterations: self.outer_iterations.unwrap_or(default.outer_iterations),
            scale_step: self.scale_step.unwrap_or(default.scale_step),
            gamma: self.gamma.unwrap_or(default.gamma),
            median_filtering: self.median_filtering.unwrap_or(default.median_filtering),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_are_named_with_their_weights() {
        let spec = |text: &str| text.parse::<MethodSpec>();
        assert_eq!(spec("tvl1"), Ok(Method::TvL1.into()));
        let skflow = Method::Network(Architecture::SkFlow);
        assert_eq!(spec("skflow"), Ok(skflow.into()));
        let weights = Some("a=b/c.ckpt".to_owned());
        let with_weights = MethodSpec { weights, ..skflow.into() };
        assert_eq!(spec("skflow=a=b/c.ckpt"), Ok(with_weights.clone()));
        let labelled = MethodSpec { label: Some("Ours: 3".to_owned()), ..with_weights.clone() };
        assert_eq!(spec("Ours: 3:skflow=a=b/c.ckpt"), Ok(labelled));
        assert_eq!(spec("tvl1").unwrap().label, None);
        let iterations = Some("12".parse().unwrap());
        assert_eq!(spec("skflow=a=b/c.ckpt:iters=12"), Ok(MethodSpec { iterations, ..with_weights.clone() }));
        let text = "Ours:srflow:iters=auto:0.02";
        assert_eq!(spec(text).unwrap().to_string(), text);
        assert!(spec("srflow:iters=0").unwrap_err().contains("iterations"));
        assert_eq!(spec("tvl1:iters=3").unwrap_err(), "tvl1 has no iterations: leave out `:iters=...`");
        assert!(spec("pwc").unwrap_err().contains("farneback, tvl1, srflow, raft"));
        assert!(spec("a:pwc").unwrap_err().contains("unknown method `pwc`"));
        assert!(spec("tvl1=a").is_err() && spec("raft=").is_err() && spec("").is_err());
        assert!(spec(":tvl1").unwrap_err().contains("empty name"));
        let files = MethodSpec { weights: Some("out/a:b=c".to_owned()), ..Method::Files.into() };
        assert_eq!(scored_method("files:out/a:b=c"), Ok(files.clone()));
        assert_eq!(
            scored_method("Theirs:files:out/a:b=c"),
            Ok(MethodSpec { label: Some("Theirs".to_owned()), ..files })
        );
        assert!(scored_method("files:").unwrap_err().contains("names no folder"));
        assert!(spec("files:out").unwrap_err().contains("only `srflow eval`"));
        assert_eq!(scored_method("tvl1"), spec("tvl1"));
    }

    #[test]
    fn a_network_starts_from_the_flow_of_a_method() {
        let frame = |shift: f32| {
            Image::from_fn(96, 80, |x, y| {
                let wave = |a: f32| (127.0 + 90.0 * (a * (x as f32 - shift) + 0.2 * y as f32).sin()) as u8;
                [wave(0.3), wave(0.2), wave(0.45)]
            })
        };
        let (one, two) = (frame(0.0), frame(2.0));
        let flow = |parameters: &MethodParameters, method: &str| {
            let built = estimator(&method.parse().unwrap(), parameters, &Watch::SILENT).unwrap();
            built.estimate(&one, &two).unwrap()
        };
        let from_farneback =
            MethodParameters { start: Some("farneback".parse().unwrap()), ..MethodParameters::default() };
        let plain = MethodParameters::default();
        let network = estimator(&MethodSpec::default(), &plain, &Watch::SILENT).unwrap();
        let expected = network.estimate_from(&one, &two, &flow(&plain, "farneback")).unwrap().flow;
        assert_eq!(flow(&from_farneback, "srflow"), expected);
        assert_ne!(flow(&plain, "srflow"), expected);
        let both = ["srflow", "tvl1"].map(|method| method.parse().unwrap());
        let both = estimators(&both, &from_farneback, &Watch::SILENT).unwrap();
        assert_eq!(both[1].estimate(&one, &two).unwrap(), flow(&plain, "tvl1"), "not a network");
        let error = estimators(&["tvl1".parse().unwrap()], &from_farneback, &Watch::SILENT).err().unwrap();
        assert!(error.to_string().contains("`start` farneback: none of the methods"), "{error}");
        let texts =
            |parameters| records(&[MethodSpec::default()], parameters, &Watch::SILENT).unwrap().remove(0);
        assert_ne!(texts(&plain).identity, texts(&from_farneback).identity);
    }

    #[test]
    fn two_methods_of_one_name_are_refused() {
        let specs = ["a:tvl1", "a:farneback"].map(|text| text.parse().unwrap());
        let error =
            estimators(&specs, &MethodParameters::default(), &Watch::SILENT).err().unwrap().to_string();
        assert!(error.contains("have the name a:"), "{error}");
    }
}

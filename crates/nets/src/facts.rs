//! Facts about networks: names, sources, needs and abilities.

use crate::{LaplaceMixture, MemoryNeed};

/// Facts about a network.
#[derive(Debug, Clone, Copy)]
pub struct Facts {
    /// Name on the command line.
    pub name: &'static str,
    /// Name in the paper.
    pub title: &'static str,
    /// URL of the paper; empty for a network of srflow's own.
    pub paper: &'static str,
    /// Number of trained parameters, counted as scalars; running statistics of batch norm do not count.
    pub parameters: usize,
    /// Height and width of frames are brought to multiples of this many pixels, by padding, or by resizing if the authors do so.
    /// Large frames may need larger multiples: [`Network::padding`](crate::Network::padding).
    pub padding: usize,
    /// Sides of a frame below this many pixels are padded to it by repeating the border; the reference implementation gives NaN
    /// or fails for these.
    pub smallest_side: usize,
    /// Common numbers of refinement iterations.
    pub iterations: IterationPresets,
    /// Whether a flow can be given to start from.
    pub start: Start,
    /// Whether iterations can be computed one by one from the output of [`Network::encode`](crate::Network::encode).
    pub recompute: bool,
    /// Whether training is supported, by srflow and by the reference implementation.
    pub trains: bool,
    /// Whether it estimates the uncertainty of the flow: [`Estimate::mixtures`](crate::Estimate::mixtures).
    pub mixture: bool,
    /// Range of the logarithms of the scales of that mixture in training, as [`LaplaceMixture::LOG_SCALE_RANGE`].
    pub log_scale_range: [f64; 2],
    /// Whether it estimates which pixels are occluded: [`Estimate::occlusion`](crate::Estimate::occlusion).
    pub occlusion: bool,
    /// Whether it uses earlier pairs of a video: [`Estimate::memory`](crate::Estimate::memory).
    pub remembers: bool,
    /// Peak memory for estimating one pair on a CPU, without parameters and the program itself (100 MB): an upper bound of the
    /// peaks of whole processes at 320x256 to 3840x2160 that `tools/bench/memory.py` measured on two threads (listed in
    /// `tools/bench/history/memory.csv`). It does not depend on the number of iterations.
    pub memory: MemoryNeed,
    /// Whether ptlflow has it, under its name with underscores.
    pub in_ptlflow: bool,
    /// Prefix of the names of its parameters in ptlflow.
    pub ptlflow_prefix: &'static str,
    /// URL of the authors' code; empty for a network of srflow's own.
    pub authors: &'static str,
    /// Licence of the authors' code, as stated in their repository, and of their weights, if different.
    pub licence: &'static str,
    /// Maps names in files of weights to names of parameters; `None` drops the tensor. Called for each name in the file, after
    /// containers and prefixes are removed.
    pub renamed: fn(&str) -> Option<String>,
    /// Names of networks in the table that use the same weights and differ only in their iterations.
    pub same_weights: &'static [&'static str],
    /// Titles of networks whose parameters have the same names and shapes.
    pub lookalikes: &'static [&'static str],
    /// Weights that can be downloaded by name.
    pub published: &'static [PublishedWeights],
    /// The file of weights that comes with srflow, if there is one.
    pub included: Option<&'static [u8]>,
}

/// Common numbers of refinement iterations; 1 for a network without refinement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IterationPresets {
    /// The default, which is that of ptlflow, the source of published results for many networks.
    pub default: usize,
    /// The authors' number for evaluation on Sintel.
    pub authors: usize,
    /// The authors' number for training.
    pub training: usize,
}

/// The multiple, in pixels, to which height and width of frames are padded.
#[derive(Debug, Clone, Copy)]
pub enum Padding {
    /// Independent of the size.
    Fixed(usize),
    /// Depending on height and width.
    BySize(fn([usize; 2]) -> usize),
}

impl Padding {
    /// The multiple for a frame of this height and width.
    pub fn of(self, size: [usize; 2]) -> usize {
        match self {
            Self::Fixed(pixels) => pixels,
            Self::BySize(pixels) => pixels(size),
        }
    }
}

/// Whether a network can start from a given flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// It can start from a coarse flow, such as that of the previous pair. The number is the side of a coarse pixel in pixels of
    /// the padded frame.
    Coarse(usize),
    /// It can start from a flow at the coarsest level of its pyramid, whose pixels have the size of the [`Padding`].
    CoarsestLevel,
    /// It uses only the frames, for the given reason, which completes an error message.
    Frames(&'static str),
}

/// A published file of weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublishedWeights {
    /// Dataset of the last stage of training.
    pub trained_on: &'static str,
    pub url: &'static str,
    /// First digits of the SHA-256 of the file in lower-case hexadecimal; all 64 if the file could be verified.
    pub sha256: &'static str,
}

impl Facts {
    /// Whether the network refines its flow, so that the number of iterations matters.
    pub fn refines(&self) -> bool {
        self.iterations.default > 1
    }

    /// The names of all networks that use its weights, such as `sea-raft-m and sea-raft-l`.
    pub fn names_of_weights(&self) -> String {
        [&[self.name], self.same_weights].concat().join(" and ")
    }

    /// Base for struct update. Every network sets at least name, title, paper, parameters, memory, authors and licence.
    pub(crate) const DEFAULT: Self = Self {
        name: "",
        title: "",
        paper: "",
        parameters: 0,
        padding: 8,
        smallest_side: 1,
        iterations: IterationPresets { default: 1, authors: 1, training: 1 },
        start: Start::Frames("it computes flow from the frames alone"),
        recompute: false,
        trains: false,
        mixture: false,
        log_scale_range: LaplaceMixture::LOG_SCALE_RANGE,
        occlusion: false,
        remembers: false,
        memory: MemoryNeed { fixed: 0, per_pixel: 0, attending: 0, most_weights: 0 },
        in_ptlflow: true,
        ptlflow_prefix: "",
        authors: "",
        licence: "",
        renamed: |name| Some(name.to_owned()),
        same_weights: &[],
        lookalikes: &[],
        published: &[],
        included: None,
    };
}

impl PublishedWeights {
    pub fn file_name(&self) -> &'static str {
        self.url.rsplit('/').next().unwrap_or(self.url)
    }
}

/// Weights published by ptlflow, in files named after the network, the dataset and the first digits of the SHA-256.
macro_rules! ptlflow {
    ($network:literal, $trained_on:literal, $sha256:literal) => {
        $crate::facts::PublishedWeights {
            trained_on: $trained_on,
            url: concat!(
                "https://github.com/hmorimitsu/ptlflow/releases/download/weights1/",
                $network,
                "-",
                $trained_on,
                "-",
                $sha256,
                ".ckpt"
            ),
            sha256: $sha256,
        }
    };
}
pub(crate) use ptlflow;

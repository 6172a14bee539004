//! What is known of a network.

use crate::MemoryNeed;

/// Facts about a network.
#[derive(Debug, Clone, Copy)]
pub struct Facts {
    /// On the command line.
    pub name: &'static str,
    /// In its paper.
    pub title: &'static str,
    /// Where the paper is.
    pub paper: &'static str,
    /// Learned numbers; the statistics of batch norm are none.
    pub parameters: usize,
    /// Height and width of frames are made multiples of this many pixels: by a border, or by resizing where the network's
    /// authors resize. Those of large frames perhaps of more: [`Network::padding`](crate::Network::padding).
    pub padding: usize,
    /// Shorter sides of a frame are padded to this many pixels by repeating the border, where the reference implementation
    /// gives NaN or fails.
    pub smallest_side: usize,
    /// Common numbers of refinements.
    pub iterations: IterationPresets,
    /// Where a flow may start from.
    pub start: Start,
    /// Whether [`Network::encode`](crate::Network::encode) gives the parts that refinements are computed from one by one.
    pub recompute: bool,
    /// Whether it can be trained here, which its reference implementation can too.
    pub trains: bool,
    /// Whether it estimates how sure it is of a flow: [`Estimate::mixtures`](crate::Estimate::mixtures).
    pub mixture: bool,
    /// Whether it estimates which pixels are occluded: [`Estimate::occlusion`](crate::Estimate::occlusion).
    pub occlusion: bool,
    /// Whether it remembers earlier pairs of a video: [`Estimate::memory`](crate::Estimate::memory).
    pub remembers: bool,
    /// Memory that estimating one pair takes on a CPU at its peak, beside parameters and the program itself (100 MB): laid
    /// above the peaks of whole processes at 320x256 to 3840x2160 that `tools/bench/memory.py` measured on two threads
    /// (`docs/benchmarks.md` lists them). The number of iterations does not matter.
    pub memory: MemoryNeed,
    /// Whether ptlflow has it, under its name with underscores.
    pub in_ptlflow: bool,
    /// Where the authors publish their code and weights.
    pub authors: &'static str,
    /// Licence of the authors' code, as their repository states it, and of their weights, where they have another.
    pub licence: &'static str,
    /// The name here of what a file of weights calls otherwise; `None` for what is no parameter. Called with each name of
    /// the file, after containers and prefixes are taken off.
    pub renamed: fn(&str) -> Option<String>,
    /// Networks of the table that take the same weights and differ in their iterations alone, by name.
    pub same_weights: &'static [&'static str],
    /// Networks whose parameters have the same names and shapes: nothing in a file distinguishes them.
    pub lookalikes: &'static [&'static str],
    /// Weights that are downloaded by name.
    pub published: &'static [PublishedWeights],
}

/// Common numbers of refinements; 1 for a network without refinement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IterationPresets {
    /// Of ptlflow, with which the published tables of many networks are made. The default here.
    pub default: usize,
    /// Of the authors' evaluation on Sintel.
    pub authors: usize,
    /// Of the authors' training.
    pub training: usize,
}

/// What height and width of a frame are padded to multiples of.
#[derive(Debug, Clone, Copy)]
pub enum Padding {
    /// So many pixels, whatever the size.
    Fixed(usize),
    /// Pixels by height and width.
    BySize(fn([usize; 2]) -> usize),
}

impl Padding {
    /// For a frame of this height and width.
    pub fn of(self, size: [usize; 2]) -> usize {
        match self {
            Self::Fixed(pixels) => pixels,
            Self::BySize(pixels) => pixels(size),
        }
    }
}

/// Where a flow may start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// From a coarse flow, such as that of the pair before: with so many pixels of the padded frame along a side of its pixels.
    Coarse(usize),
    /// From a coarse flow whose pixels are as large as the padding: the coarsest level of a pyramid.
    CoarsestLevel,
    /// From nothing else than the frames. Says why, as the end of a sentence.
    Frames(&'static str),
}

/// Weights that somebody publishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublishedWeights {
    /// The last stage of their training.
    pub trained_on: &'static str,
    /// Where the file is.
    pub url: &'static str,
    /// How the SHA-256 of the file begins, in lower-case hexadecimal digits; all 64 where the file could be checked.
    pub sha256: &'static str,
}

impl Facts {
    /// Whether flow is refined, so that the number of iterations matters.
    pub fn refines(&self) -> bool {
        self.iterations.default > 1
    }

    /// Its name and those of the networks with the same weights, such as `sea-raft-m and sea-raft-l`.
    pub fn names_of_weights(&self) -> String {
        [&[self.name], self.same_weights].concat().join(" and ")
    }

    /// What most networks have in common. Name, paper, numbers and licence are each network's own.
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
        occlusion: false,
        remembers: false,
        memory: MemoryNeed { fixed: 0, per_pixel: 0, attending: 0, most_weights: 0 },
        in_ptlflow: true,
        authors: "",
        licence: "",
        renamed: |name| Some(name.to_owned()),
        same_weights: &[],
        lookalikes: &[],
        published: &[],
    };
}

impl PublishedWeights {
    pub fn file_name(&self) -> &'static str {
        self.url.rsplit('/').next().unwrap_or(self.url)
    }
}

/// Weights that ptlflow publishes, which names a file after the network, the training and the first digits of its SHA-256.
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

//! The networks by name, with the facts about each.

use burn::tensor::Device;

use crate::network::Network;
use crate::{Gma, Raft, RaftSmall, SkFlow};

/// Weights that ptlflow publishes, which names a file after the network, the training and the first digits of its SHA-256.
macro_rules! ptlflow {
    ($network:literal, $trained_on:literal, $sha256:literal) => {
        PublishedWeights {
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

/// One of the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Architecture {
    Raft,
    RaftSmall,
    Gma,
    SkFlow,
}

/// Facts about a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Facts {
    /// On the command line.
    pub name: &'static str,
    /// In its paper.
    pub title: &'static str,
    /// Where the paper is.
    pub paper: &'static str,
    /// Learned numbers; the statistics of batch norm are none.
    pub parameters: usize,
    /// Height and width of frames are padded to multiples of this many pixels.
    pub padding: usize,
    /// Common numbers of refinements.
    pub iterations: IterationPresets,
    /// Where the authors publish their code and weights.
    pub authors: &'static str,
    /// Licence of the authors' code, as their repository states it; weights are published under no other.
    pub licence: &'static str,
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

const RAFT: Facts = Facts {
    name: "raft",
    title: "RAFT",
    paper: "https://arxiv.org/abs/2003.12039",
    parameters: 5_257_536,
    padding: 8,
    iterations: IterationPresets { default: 32, authors: 32, training: 12 },
    authors: "https://github.com/princeton-vl/RAFT",
    licence: "BSD-3-Clause",
    lookalikes: &[],
    published: &[
        ptlflow!("raft", "chairs", "590f38f7"),
        ptlflow!("raft", "things", "802bbcfd"),
        ptlflow!("raft", "sintel", "fb44381e"),
        ptlflow!("raft", "kitti", "3a831a4b"),
    ],
};

const RAFT_SMALL: Facts = Facts {
    name: "raft-small",
    title: "RAFT-S",
    parameters: 990_162,
    published: &[ptlflow!("raft_small", "things", "b7d9f997")],
    ..RAFT
};

const GMA: Facts = Facts {
    name: "gma",
    title: "GMA",
    paper: "https://arxiv.org/abs/2104.02409",
    parameters: 5_879_873,
    padding: 8,
    iterations: IterationPresets { default: 32, authors: 32, training: 12 },
    authors: "https://github.com/zacjiang/GMA",
    licence: "WTFPL",
    lookalikes: &[],
    published: &[
        ptlflow!("gma", "chairs", "d4ec321d"),
        ptlflow!("gma", "things", "90aafb63"),
        ptlflow!("gma", "sintel", "98d6f3d0"),
        ptlflow!("gma", "kitti", "8ca3ec80"),
    ],
};

const SKFLOW: Facts = Facts {
    name: "skflow",
    title: "SKFlow",
    paper: "https://arxiv.org/abs/2205.14623",
    parameters: 6_273_149,
    padding: 8,
    iterations: IterationPresets { default: 32, authors: 15, training: 12 },
    authors: "https://github.com/littlespray/SKFlow",
    licence: "MIT",
    lookalikes: &["MemFlow"],
    published: &[
        ptlflow!("skflow", "things", "f84e6538"),
        ptlflow!("skflow", "sintel", "98fb67cf"),
        ptlflow!("skflow", "kitti", "4e1f8b63"),
    ],
};

impl PublishedWeights {
    pub fn file_name(&self) -> &'static str {
        self.url.rsplit('/').next().unwrap_or(self.url)
    }
}

impl Architecture {
    /// Every network.
    pub const ALL: [Self; 4] = [Self::Raft, Self::RaftSmall, Self::Gma, Self::SkFlow];

    /// The network of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|architecture| architecture.name() == name)
    }

    /// As typed on a command line, such as `raft-small`.
    pub fn name(self) -> &'static str {
        self.facts().name
    }

    /// The facts about it.
    pub fn facts(self) -> &'static Facts {
        match self {
            Self::Raft => &RAFT,
            Self::RaftSmall => &RAFT_SMALL,
            Self::Gma => &GMA,
            Self::SkFlow => &SKFLOW,
        }
    }

    /// The network of the paper with random parameters, as training starts.
    pub fn init(self, device: &Device) -> Network {
        match self {
            Self::Raft => Network::Raft(Raft::new(device)),
            Self::RaftSmall => Network::RaftSmall(RaftSmall::new(device)),
            Self::Gma => Network::Gma(Gma::new(device)),
            Self::SkFlow => Network::SkFlow(SkFlow::new(device)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_files_carry_the_name_and_the_digest() {
        for architecture in Architecture::ALL {
            assert_eq!(Architecture::from_name(architecture.name()), Some(architecture));
            for weights in architecture.facts().published {
                let file = weights.file_name();
                let network = architecture.name().replace('-', "_");
                assert_eq!(file, format!("{network}-{}-{}.ckpt", weights.trained_on, &weights.sha256[..8]));
            }
        }
        assert_eq!(Architecture::from_name("RAFT"), None);
    }
}

//! The networks by name, and what is known of each.

use burn::tensor::Device;

use crate::network::Network;
use crate::{Gma, Raft, RaftSmall, SkFlow};

/// Where ptlflow publishes its weights.
macro_rules! ptlflow {
    ($file:literal) => {
        concat!("https://github.com/hmorimitsu/ptlflow/releases/download/weights1/", $file)
    };
}

/// A network, as its name on a command line says which.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Architecture {
    /// RAFT.
    Raft,
    /// RAFT-S.
    RaftSmall,
    /// GMA.
    Gma,
    /// SKFlow.
    SkFlow,
}

/// What is known of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Facts {
    /// As typed on a command line.
    pub name: &'static str,
    /// As in its paper.
    pub title: &'static str,
    /// Where the paper is.
    pub paper: &'static str,
    /// Learned numbers; the statistics of batch norm are none.
    pub parameters: usize,
    /// Frames get a border to a height and a width that are multiples of so many pixels.
    pub padding: usize,
    /// Refinements in use.
    pub iterations: IterationPresets,
    /// Where the authors publish their code and weights.
    pub authors: &'static str,
    /// Licence of the authors' code, as their repository states it; weights are published under no other.
    pub licence: &'static str,
    /// Networks whose parameters have the same names and shapes, so that a file does not tell whose they are.
    pub lookalikes: &'static [&'static str],
    /// Weights that can be had by name.
    pub published: &'static [PublishedWeights],
}

/// Numbers of refinements in use; 1 for a network that refines nothing.
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
        PublishedWeights {
            trained_on: "chairs",
            url: ptlflow!("raft-chairs-590f38f7.ckpt"),
            sha256: "590f38f7",
        },
        PublishedWeights {
            trained_on: "things",
            url: ptlflow!("raft-things-802bbcfd.ckpt"),
            sha256: "802bbcfd",
        },
        PublishedWeights {
            trained_on: "sintel",
            url: ptlflow!("raft-sintel-fb44381e.ckpt"),
            sha256: "fb44381e",
        },
        PublishedWeights {
            trained_on: "kitti",
            url: ptlflow!("raft-kitti-3a831a4b.ckpt"),
            sha256: "3a831a4b",
        },
    ],
};

const RAFT_SMALL: Facts = Facts {
    name: "raft-small",
    title: "RAFT-S",
    parameters: 990_162,
    published: &[PublishedWeights {
        trained_on: "things",
        url: ptlflow!("raft_small-things-b7d9f997.ckpt"),
        sha256: "b7d9f997",
    }],
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
        PublishedWeights {
            trained_on: "chairs",
            url: ptlflow!("gma-chairs-d4ec321d.ckpt"),
            sha256: "d4ec321d",
        },
        PublishedWeights {
            trained_on: "things",
            url: ptlflow!("gma-things-90aafb63.ckpt"),
            sha256: "90aafb63",
        },
        PublishedWeights {
            trained_on: "sintel",
            url: ptlflow!("gma-sintel-98d6f3d0.ckpt"),
            sha256: "98d6f3d0",
        },
        PublishedWeights {
            trained_on: "kitti",
            url: ptlflow!("gma-kitti-8ca3ec80.ckpt"),
            sha256: "8ca3ec80",
        },
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
        PublishedWeights {
            trained_on: "things",
            url: ptlflow!("skflow-things-f84e6538.ckpt"),
            sha256: "f84e6538",
        },
        PublishedWeights {
            trained_on: "sintel",
            url: ptlflow!("skflow-sintel-98fb67cf.ckpt"),
            sha256: "98fb67cf",
        },
        PublishedWeights {
            trained_on: "kitti",
            url: ptlflow!("skflow-kitti-4e1f8b63.ckpt"),
            sha256: "4e1f8b63",
        },
    ],
};

impl PublishedWeights {
    /// The name of the file.
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

    /// What is known of it.
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

    /// ptlflow names a file after the network, the training and the first eight digits of its SHA-256.
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

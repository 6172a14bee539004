//! The table of networks, at the end of this file: a network is a file of this crate with an [`Entry`] for each of its names,
//! and a line here for each. Names, facts, dispatch, memory needs, the list of `srflow models` and the parity tests follow.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::estimate::{Encoded, Estimate, Request};
use crate::facts::{Facts, Padding};
use crate::features::Features;
use crate::frames::Frames;
use crate::settings::{Setting, SettingError, set};
use crate::{dpflow, flownet, flownetcss, gma, memflow, raft, raft_small, rpknet, sea_raft, skflow};

/// What the table says of a network.
pub(crate) struct Entry<N> {
    pub(crate) facts: Facts,
    /// The network of the paper with random parameters, as training starts.
    pub(crate) init: fn(&Device) -> N,
}

/// What every network does. Those that refine flow as RAFT does implement [`Recurrent`](crate::recurrent::Recurrent) instead.
pub(crate) trait FlowNetwork {
    /// See [`Network::features`].
    fn features(&self, frames: Tensor<4>) -> Features;

    /// See [`Network::forward`].
    fn forward(&self, frames: Frames, request: &Request) -> Estimate;

    /// See [`Network::encode`].
    fn encode(&self, _frames: Frames) -> Option<Encoded> {
        None
    }

    /// See [`Network::padding`]; `None` for that of [`Facts::padding`].
    fn padding(&self) -> Option<Padding> {
        None
    }

    /// See [`Network::levels`].
    fn levels(&self, _size: [usize; 2]) -> Option<usize> {
        None
    }

    /// See [`Network::settings`].
    fn settings(&mut self) -> Vec<Setting<'_>> {
        Vec::new()
    }
}

macro_rules! networks {
    ($($variant:ident($network:ty) = $entry:path,)*) => {
        /// A network by its name; a line of the table.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Architecture {
            $($variant,)*
        }

        impl Architecture {
            /// Every network.
            pub const ALL: [Self; [$(stringify!($variant)),*].len()] = [$(Self::$variant),*];

            /// The facts about it.
            pub fn facts(self) -> &'static Facts {
                match self {
                    $(Self::$variant => &$entry.facts,)*
                }
            }

            /// The network of the paper with random parameters, as training starts.
            pub fn init(self, device: &Device) -> Network {
                match self {
                    $(Self::$variant => Network::$variant(($entry.init)(device)),)*
                }
            }
        }

        /// A network of any [`Architecture`], made by [`Architecture::init`] or [`load_network`](crate::load_network).
        ///
        /// Its parameters have the same names as those of the network inside.
        #[derive(Module, Debug)]
        #[allow(clippy::large_enum_variant, reason = "few are alive at a time, and none is moved in a loop")]
        pub enum Network {
            $($variant($network),)*
        }

        impl Network {
            pub fn architecture(&self) -> Architecture {
                match self {
                    $(Self::$variant(_) => Architecture::$variant,)*
                }
            }

            /// What the network computes of each frame alone, RGB in 0..1, `[batch, 3, height, width]`, for
            /// [`Request::features`].
            pub fn features(&self, frames: Tensor<4>) -> Features {
                match self {
                    $(Self::$variant(network) => FlowNetwork::features(network, frames),)*
                }
            }

            /// Flow from the first frames to the second. Panics when the frames differ in size, no iteration is asked for,
            /// or a start is of another size.
            pub fn forward(&self, frames: Frames, request: &Request) -> Estimate {
                match self {
                    $(Self::$variant(network) => FlowNetwork::forward(network, frames, request),)*
                }
            }

            /// What refinements start from and read, for networks whose refinements can be computed one by one
            /// ([`Facts::recompute`]). Panics when the frames differ in size.
            pub fn encode(&self, frames: Frames) -> Option<Encoded> {
                match self {
                    $(Self::$variant(network) => FlowNetwork::encode(network, frames),)*
                }
            }

            /// What height and width of frames are padded to multiples of.
            pub fn padding(&self) -> Padding {
                let own = match self {
                    $(Self::$variant(network) => FlowNetwork::padding(network),)*
                };
                own.unwrap_or(Padding::Fixed(self.architecture().facts().padding))
            }

            /// In how many levels, from coarse to fine, the flow between frames of this height and width is refined; `None` for
            /// a network that refines it in one, or not at all.
            pub fn levels(&self, size: [usize; 2]) -> Option<usize> {
                match self {
                    $(Self::$variant(network) => FlowNetwork::levels(network, size),)*
                }
            }

            /// What can be set beside the parameters, with its present value.
            pub fn settings(&mut self) -> Vec<Setting<'_>> {
                match self {
                    $(Self::$variant(network) => FlowNetwork::settings(network),)*
                }
            }
        }
    };
}

impl Architecture {
    /// The network of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|architecture| architecture.name() == name)
    }

    /// As typed on a command line, such as `raft-small`.
    pub fn name(self) -> &'static str {
        self.facts().name
    }
}

impl Network {
    /// Gives one of the [`settings`](Self::settings) another value.
    ///
    /// # Errors
    /// When the network has no such setting, or does not take the value.
    pub fn set(&mut self, name: &str, value: usize) -> Result<(), SettingError> {
        let network = self.architecture().name();
        set(network, self.settings(), name, value)
    }
}

networks! {
    Raft(raft::Raft) = raft::RAFT,
    RaftSmall(raft_small::RaftSmall) = raft_small::RAFT_SMALL,
    Gma(gma::Gma) = gma::GMA,
    SkFlow(skflow::SkFlow) = skflow::SKFLOW,
    RpkNet(rpknet::RpkNet) = rpknet::RPKNET,
    DpFlow(dpflow::DpFlow) = dpflow::DPFLOW,
    SeaRaftS(sea_raft::SeaRaft) = sea_raft::SEA_RAFT_S,
    SeaRaftM(sea_raft::SeaRaft) = sea_raft::SEA_RAFT_M,
    SeaRaftL(sea_raft::SeaRaft) = sea_raft::SEA_RAFT_L,
    MemFlow(memflow::MemFlow) = memflow::MEMFLOW,
    FlowNetS(flownet::FlowNet) = flownet::FLOWNETS,
    FlowNetC(flownet::FlowNet) = flownet::FLOWNETC,
    FlowNetCss(flownetcss::FlowNetCss) = flownetcss::FLOWNETCSS,
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
                let end = format!("-{}-{}.ckpt", weights.trained_on, &weights.sha256[..8]);
                let network = file.strip_suffix(&end).expect(file).replace('_', "-");
                let facts = architecture.facts();
                assert!(network == facts.name || facts.same_weights.contains(&network.as_str()), "{file}");
            }
        }
        assert_eq!(Architecture::from_name("RAFT"), None);
    }
}

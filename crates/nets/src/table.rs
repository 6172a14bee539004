//! The table of networks, at the end of this file. To add a network, add a file with an [`Entry`](crate::network::Entry) for each of its names, and a
//! line here for each. Names, facts, dispatch, memory needs, the list of `srflow models` and the parity tests follow from it.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::estimate::{Encoded, Estimate, Request};
use crate::facts::{Facts, Padding};
use crate::features::Features;
use crate::frames::Frames;
use crate::network::FlowNetwork;
use crate::settings::{Setting, SettingError, set};
use crate::{
    ccmr, dpflow, flownet, flownet3, flownetcss, gma, memflow, raft, raft_small, rpknet, sea_raft, skflow,
    srflow, ssa, unimatch,
};

macro_rules! networks {
    ($($variant:ident($network:ty) = $entry:path,)*) => {
        /// A network of the table, without parameters.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Architecture {
            $($variant,)*
        }

        impl Architecture {
            pub const ALL: [Self; [$(stringify!($variant)),*].len()] = [$(Self::$variant),*];

            pub fn facts(self) -> &'static Facts {
                match self {
                    $(Self::$variant => &$entry.facts,)*
                }
            }

            /// The network with random parameters from the initial distributions of the reference implementation.
            pub fn init(self, device: &Device) -> Network {
                match self {
                    $(Self::$variant => Network::$variant(($entry.init)(device)),)*
                }
            }
        }

        /// A network of any [`Architecture`], from [`Architecture::init`] or [`load_network`](crate::load_network). The enum adds
        /// nothing to the names of parameters.
        #[derive(Module, Debug)]
        #[allow(clippy::large_enum_variant, reason = "few are alive at a time, and none is moved in a loop")]
        pub enum Network {
            $($variant($network),)*
        }

        impl Network {
            /// The same parameters on another device. Clones share the running statistics of batch norms, which move for all of them.
            pub fn on(self, device: &Device) -> Self {
                self.to_device(device)
            }

            pub fn architecture(&self) -> Architecture {
                match self {
                    $(Self::$variant(_) => Architecture::$variant,)*
                }
            }

            /// Features of frames, RGB in 0..1, `[batch, 3, height, width]`, for [`Request::features`].
            pub fn features(&self, frames: Tensor<4>) -> Features {
                match self {
                    $(Self::$variant(network) => FlowNetwork::features(network, frames),)*
                }
            }

            /// Estimates the flow from the first frames to the second. Panics when the frames differ in size, the number of
            /// iterations is 0, or [`Request::start`] has the wrong size.
            pub fn forward(&self, frames: Frames, request: &Request) -> Estimate {
                match self {
                    $(Self::$variant(network) => FlowNetwork::forward(network, frames, request),)*
                }
            }

            /// The output of the encoders, for networks with [`Facts::recompute`]. Panics when the frames differ in size.
            pub fn encode(&self, frames: Frames) -> Option<Encoded> {
                match self {
                    $(Self::$variant(network) => FlowNetwork::encode(network, frames),)*
                }
            }

            /// The multiple, in pixels, to which height and width of frames are padded.
            pub fn padding(&self) -> Padding {
                let own = match self {
                    $(Self::$variant(network) => FlowNetwork::padding(network),)*
                };
                own.unwrap_or(Padding::Fixed(self.architecture().facts().padding))
            }

            /// Number of levels, from coarse to fine, in which flow between frames of this height and width is refined; `None`
            /// for networks with a single level or without refinement.
            pub fn levels(&self, size: [usize; 2]) -> Option<usize> {
                match self {
                    $(Self::$variant(network) => FlowNetwork::levels(network, size),)*
                }
            }

            /// The settings besides parameters, with their current values.
            pub fn settings(&mut self) -> Vec<Setting<'_>> {
                match self {
                    $(Self::$variant(network) => FlowNetwork::settings(network),)*
                }
            }
        }
    };
}

impl Architecture {
    /// The network with this [name](Self::name).
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|architecture| architecture.name() == name)
    }

    /// Name on the command line, such as `raft-small`.
    pub fn name(self) -> &'static str {
        self.facts().name
    }
}

impl Network {
    /// Changes one of the [`settings`](Self::settings).
    ///
    /// # Errors
    /// When the network has no such setting, or the value is not allowed.
    pub fn set(&mut self, name: &str, value: usize) -> Result<(), SettingError> {
        let network = self.architecture().name();
        set(network, self.settings(), name, value)
    }
}

networks! {
    SrFlow(srflow::SrFlow) = srflow::SRFLOW,
    Raft(raft::Raft) = raft::RAFT,
    RaftSmall(raft::Raft) = raft_small::RAFT_SMALL,
    Gma(raft::Raft) = gma::GMA,
    SkFlow(skflow::SkFlow) = skflow::SKFLOW,
    RpkNet(rpknet::RpkNet) = rpknet::RPKNET,
    DpFlow(dpflow::DpFlow) = dpflow::DPFLOW,
    Ccmr(ccmr::Ccmr) = ccmr::CCMR,
    CcmrP(ccmr::Ccmr) = ccmr::CCMR_P,
    SeaRaftS(sea_raft::SeaRaft) = sea_raft::SEA_RAFT_S,
    SeaRaftM(sea_raft::SeaRaft) = sea_raft::SEA_RAFT_M,
    SeaRaftL(sea_raft::SeaRaft) = sea_raft::SEA_RAFT_L,
    MemFlow(memflow::MemFlow) = memflow::MEMFLOW,
    FlowNetS(flownet::FlowNet) = flownet::FLOWNETS,
    FlowNetC(flownet::FlowNet) = flownet::FLOWNETC,
    FlowNetCss(flownetcss::FlowNetCss) = flownetcss::FLOWNETCSS,
    FlowNet3Css(flownet3::FlowNet3) = flownet3::FLOWNET3_CSS,
    UniMatch(unimatch::UniMatch) = unimatch::UNIMATCH,
    UniMatchSc2(unimatch::UniMatch) = unimatch::UNIMATCH_SC2,
    UniMatchSc2Ref6(unimatch::UniMatch) = unimatch::UNIMATCH_SC2_REF6,
    Ssa(ssa::Ssa) = ssa::SSA,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_files_are_named_after_network_and_digest() {
        for architecture in Architecture::ALL {
            assert_eq!(Architecture::from_name(architecture.name()), Some(architecture));
            for weights in architecture.facts().published {
                let file = weights.file_name();
                let end = format!("-{}-{}.ckpt", weights.trained_on, &weights.sha256[..8]);
                // ptlflow's models have shorter names than its files.
                let network = file.strip_suffix(&end).expect(file).replace('_', "-");
                let network = network.replace("-scale", "-sc").replace("-refine", "-ref").replace('+', "-p");
                let facts = architecture.facts();
                assert!(network == facts.name || facts.same_weights.contains(&network.as_str()), "{file}");
            }
        }
        assert_eq!(Architecture::from_name("RAFT"), None);
    }
}

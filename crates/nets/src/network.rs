//! Any of the networks, as one type.

use burn::module::Module;
use burn::tensor::Tensor;

use crate::recurrent::Recurrent as _;
use crate::{Architecture, Encoded, Estimate, Features, Frames, Gma, Raft, RaftSmall, Request, SkFlow};

/// A network of any [`Architecture`], made by [`Architecture::init`] or [`load_network`](crate::load_network).
///
/// Its parameters have the same names as those of the network inside.
#[derive(Module, Debug)]
#[expect(clippy::large_enum_variant, reason = "few are alive at a time, and none is moved in a loop")]
pub enum Network {
    Raft(Raft),
    RaftSmall(RaftSmall),
    Gma(Gma),
    SkFlow(SkFlow),
}

/// Whichever network it is.
macro_rules! with_network {
    ($self:ident, $network:ident => $call:expr) => {
        match $self {
            Self::Raft($network) => $call,
            Self::RaftSmall($network) => $call,
            Self::Gma($network) => $call,
            Self::SkFlow($network) => $call,
        }
    };
}

impl Network {
    pub fn architecture(&self) -> Architecture {
        match self {
            Self::Raft(_) => Architecture::Raft,
            Self::RaftSmall(_) => Architecture::RaftSmall,
            Self::Gma(_) => Architecture::Gma,
            Self::SkFlow(_) => Architecture::SkFlow,
        }
    }

    /// Features of frames, RGB in 0..1, `[batch, 3, height, width]`, for [`Request::features`].
    pub fn features(&self, frames: Tensor<4>) -> Features {
        with_network!(self, network => network.features(frames))
    }

    /// What refinements start from and read. Panics when the frames differ in size.
    pub fn encode(&self, frames: Frames) -> Encoded {
        with_network!(self, network => network.encode(frames))
    }

    /// Flow from the first frames to the second. Panics when the frames differ in size, no iteration is asked for, or a start
    /// is of another size.
    pub fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        with_network!(self, network => network.forward(frames, request))
    }
}

//! What a network is: the interface of its file to the table.

use burn::tensor::{Device, Tensor};

use crate::estimate::{Encoded, Estimate, Request};
use crate::facts::{Facts, Padding};
use crate::features::Features;
use crate::frames::Frames;
use crate::settings::Setting;

/// An entry of the table.
pub(crate) struct Entry<N> {
    pub(crate) facts: Facts,
    /// See [`Architecture::init`](crate::Architecture::init).
    pub(crate) init: fn(&Device) -> N,
}

/// Interface of all networks. Those that refine flow like RAFT implement [`Recurrent`](crate::recurrent::Recurrent) instead.
pub(crate) trait FlowNetwork {
    /// See [`Network::features`](crate::Network::features).
    fn features(&self, frames: Tensor<4>) -> Features;

    /// See [`Network::forward`](crate::Network::forward).
    fn forward(&self, frames: Frames, request: &Request) -> Estimate;

    /// See [`Network::encode`](crate::Network::encode).
    fn encode(&self, _frames: Frames) -> Option<Encoded> {
        None
    }

    /// See [`Network::padding`](crate::Network::padding); `None` for that of [`Facts::padding`].
    fn padding(&self) -> Option<Padding> {
        None
    }

    /// See [`Network::levels`](crate::Network::levels).
    fn levels(&self, _size: [usize; 2]) -> Option<usize> {
        None
    }

    /// See [`Network::settings`](crate::Network::settings).
    fn settings(&mut self) -> Vec<Setting<'_>> {
        Vec::new()
    }
}

//! Layers under PyTorch's parameter names, in training and in evaluation.

mod batch_norm;
mod conv;
mod dropout;
mod linear;

use burn::module::Module;
use srflow_field::random::Stream;

pub(crate) use batch_norm::BatchNorm2d;
pub(crate) use conv::Conv2d;
pub(crate) use dropout::dropout;
pub(crate) use linear::Linear;

/// What a network is asked for its output for.
#[derive(Debug)]
pub enum Mode<'a> {
    /// To learn: batch norms go by the batch and update their running statistics, dropout drops.
    Training {
        /// Where the choices of dropout come from; without it nothing is dropped.
        dropout: Option<&'a mut Stream>,
    },
    /// To tell: the same clip gives the same scores whatever else is asked.
    Evaluation,
}

/// Holds the place of a layer without parameters in a sequence, so that what follows has the reference's number.
#[derive(Module, Debug)]
pub(crate) struct NoParameters;

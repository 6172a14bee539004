//! The table of sequence losses. The table of regularizers is the list in `config.rs`, which defines their weights too.

use super::entry::SequenceLoss;
use super::{l1, l2, mixture};

/// Every sequence loss, the default first.
pub static SEQUENCE_LOSSES: &[SequenceLoss] =
    &[l1::L1, l2::L2, mixture::MIXTURE_OF_LAPLACE, mixture::L1_AND_MIXTURE];

//! Parts that several networks share.

mod attention;
mod conv;
mod encoder;
mod gru;
mod motion;
mod norm;
mod upsampler;

pub(crate) use attention::{Aggregate, Attention, KEPT_BYTES};
pub(crate) use conv::{Conv2d, Conv2dConfig, NoParameters};
pub(crate) use encoder::{Encoder, EncoderConfig};
pub(crate) use gru::{ConvGru, SepConvGru};
pub(crate) use motion::{FlowHead, MotionEncoder, SmallMotionEncoder, window_entries};
pub(crate) use norm::NormKind;
pub use norm::with_batch_statistics;
pub(crate) use upsampler::{ConvexMask, bilinear_upsample, convex_mask, convex_upsample};

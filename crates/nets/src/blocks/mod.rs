//! Parts shared by several networks.

mod attention;
mod cross_covariance;
mod encoder;
mod gru;
pub(crate) mod level;
mod motion;
mod resize;
mod strips;
mod upsampler;

pub(crate) use attention::{Aggregate, Attention, KEPT_BYTES, attention_map};
pub(crate) use cross_covariance::{Attending, CrossCovariance};
pub(crate) use encoder::{Block, Encoder, EncoderConfig, Norm, NormKind, conv as encoder_conv};
pub(crate) use gru::{ConvGru, Gru, SepConvGru};
pub(crate) use motion::{FlowHead, MotionEncoder, window_entries};
pub(crate) use resize::{Grids, resize, resize_flow, resize_flow_smoothed, resize_smoothed};
pub(crate) use strips::{Divided, Strips};
pub(crate) use upsampler::{
    ConvexMask, bilinear_upsample, convex_mask, convex_mask_by, convex_upsample, convex_upsample_of_strips,
    unscaled_convex_upsample, upsample_by,
};

//! Head avatars: a head model that moves, and Gaussians bound to its triangles.
//!
//! World units are metres. A head looks along +z, +y is up, and +x is the subject's left, as in FLAME.

mod head_model;

pub use head_model::{
    ActionUnit, HeadModel, HeadModelError, HeadPose, Joint, Region, Shape, ShapedHead, Side,
};

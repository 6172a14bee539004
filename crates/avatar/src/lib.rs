//! Head avatars: a head model that moves, and Gaussians bound to its triangles.
//!
//! World units are metres. A head looks along +z, +y is up, and +x is the subject's left, as in FLAME.

mod avatar;
mod binding;
mod builtin;
mod dress;
mod head_model;
mod ict;
mod micro_expression;
pub mod motion;
mod obj;

pub use avatar::{Avatar, AvatarError, PosedHead};
pub use binding::{BoundGaussians, TriangleFrame};
pub use head_model::{
    ActionUnit, HeadModel, HeadModelError, HeadPose, Joint, JointRole, Offsets, PoseCorrective, Region,
    Shape, ShapedHead, Side, Skinning,
};
pub use micro_expression::MicroExpression;
pub use motion::{Moment, Motion};

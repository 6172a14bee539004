//! Head avatars: a head model that moves, and Gaussians bound to its triangles.
//!
//! World units are metres. A head looks along +z, +y is up, and +x is the subject's left, as in FLAME.

mod avatar;
mod binding;
mod builtin;
pub mod capture;
mod dress;
mod files;
pub mod fit;
mod head_model;
mod ict;
mod micro_expression;
pub mod motion;
mod obj;
mod parameters;
pub mod train;

pub use avatar::{Avatar, AvatarError, PosedHead};
pub use binding::{
    BindingError, BoundGaussians, BoundGradients, TriangleFrame, TriangleFrameGradient, vertex_gradients,
};
pub use files::{AvatarFiles, AvatarFilesError};
pub use head_model::{
    ActionUnit, HeadGradient, HeadModel, HeadModelError, HeadPoints, HeadPose, HeadState, Joint, JointRole,
    Offsets, PointDerivatives, PoseCorrective, Region, Shape, ShapedHead, Side, Skinning,
    rotation_of_axis_angle,
};
pub use micro_expression::MicroExpression;
pub use motion::{Moment, Motion};
pub use parameters::{HeadParameters, ParametersError, PoseParameters};

//! Head avatars: a head model that moves, and Gaussians bound to its triangles.
//!
//! World units are metres. A head looks along +z, +y is up, and +x is the subject's left, as in FLAME.

mod arkit;
mod avatar;
mod avatars;
mod binding;
mod builtin;
pub mod capture;
mod dress;
mod files;
pub mod fit;
mod flame;
mod gltf;
mod gnm;
mod head_model;
mod head_source;
mod ict;
mod landmark_file;
mod mesh;
mod micro_expression;
pub mod motion;
mod obj;
mod parameters;
mod pickle;
mod regions;
mod skeleton_names;
pub mod train;
mod unit_fit;
mod unit_name;
mod unit_table;

pub use avatar::{Avatar, AvatarError, PosedHead};
pub use avatars::Avatars;
pub use binding::{
    BindingError, BoundGaussians, BoundGradients, TriangleFrame, TriangleFrameGradient, vertex_gradients,
};
pub use files::AvatarFiles;
pub use head_model::{
    ActionUnit, HeadGradient, HeadModel, HeadModelError, HeadPoints, HeadPose, HeadState, Joint, JointRole,
    Offsets, PointDerivatives, PoseCorrective, Region, Shape, ShapedHead, Side, Skinning, TextureMap,
    rotation_of_axis_angle,
};
pub use head_source::{HEAD_KINDS, HeadKind, HeadSource};
pub use mesh::{MeshFormat, MeshMotion, add_mesh, write_mesh};
pub use micro_expression::MicroExpression;
pub use motion::{Moment, Motion};
pub use parameters::{HeadParameters, ParametersError, PoseParameters};
pub use unit_fit::{Left, UnitQuality, unit_qualities};
pub use unit_name::unit_name;
pub use unit_table::{UNITS_NAME, write_units};

//! Head models that move: readers, action units, motion, and the Gaussians that dress them.
//!
//! World units are metres. A head looks along +z, +y is up, and +x is the subject's left, as in FLAME.

mod arkit;
mod builtin;
mod clip;
mod dress;
mod error;
mod flame;
mod found_head;
mod gltf;
mod gnm;
mod head_model;
mod ict;
mod lam;
mod landmark_file;
mod look;
mod mesh;
mod mesh_colors;
mod micro_expression;
mod model_source;
pub mod motion;
mod obj;
mod parameters;
mod pickled_arrays;
mod regions;
mod scan;
mod skeleton_names;
mod srgb;
mod triangle_frame;
mod unit_fit;
mod unit_name;
mod unit_table;

pub use clip::Clip;
pub use dress::{Crease, Dress, Shading, ShadingFacts, ShadingTables, Splat, dress};
pub use error::HeadError;
pub use head_model::{
    ActionUnit, HeadGradient, HeadModel, HeadModelError, HeadPoints, HeadPose, HeadState, Joint, JointRole,
    LinearisedPoints, Offsets, PointDerivatives, PoseCorrective, Region, Shape, ShapedHead, Side, Skinning,
    TextureMap, rotation_of_axis_angle,
};
pub use look::Look;
pub use mesh::{MeshFormat, MeshMotion, add_mesh, vertex_normals, write_mesh};
pub use mesh_colors::MeshColors;
pub use micro_expression::MicroExpression;
pub use model_source::ModelSource;
pub use motion::{Moment, Motion};
pub use parameters::{HeadParameters, ParametersError, PoseParameters};
pub use triangle_frame::{TriangleFrame, TriangleFrameGradient, vertex_gradients};
pub use unit_fit::{Left, UnitQuality, unit_qualities};
pub use unit_name::unit_name;
pub use unit_table::{UNITS_NAME, write_units};

//! glTF 2.0: the parts of a document that the readers of heads and of Gaussians use, and a builder of binary files.
//!
//! Only structure is here: what the meshes mean, others know.

mod animation;
mod builder;
mod document;
mod material;
mod tracks;

pub use animation::Animation;
pub use builder::GltfBuilder;
pub use document::{Document, Json, Mesh, Node, Placed, Primitive, Scene, Skin};
pub use material::{Material, TextureInfo};
pub use tracks::Track;

/// The modes of a primitive (section 5.24.4 of the specification).
pub const POINTS: u32 = 0;
pub const TRIANGLES: u32 = 4;

/// Types of components (section 3.6.2.2 of the specification).
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;

//! Head avatars: Gaussians bound to the triangles of a head model, captures, fitting and training.
//!
//! World units are metres. A head looks along +z, +y is up, and +x is the subject's left, as in FLAME.

mod avatar;
mod avatars;
mod binding;
pub mod capture;
mod files;
pub mod fit;
mod head_source;
mod similarity;
mod surface;
pub mod train;

pub use avatar::{Avatar, AvatarError, PosedHead};
pub use avatars::Avatars;
pub use binding::{BindingError, BoundGaussians, BoundGradients};
pub use files::AvatarFiles;
pub use head_source::HeadSource;
pub use similarity::Similarity;
pub use surface::{SEEN_THROUGH_METRES, SurfacePoint, visible_surface};

//! Gaussians, avatars, datasets and flow as pages for a browser: one file each that needs no network, or served on this machine.
//!
//! A page is HTML with the scripts of `page/` and with packs of arrays ([`Pack`]): one that says what the page shows, and for
//! datasets one for each pair. Gaussians are drawn by WebGL 2 as [`srflow_splat::reference`] defines, heads are posed as
//! [`srflow_head::HeadModel`] does.

mod head;
mod pack;
mod page;
mod pairs;
mod serve;
mod splats;

pub use head::{ViewedMotion, avatar};
pub use pack::Pack;
pub use page::Page;
pub use pairs::{ViewedFlow, ViewedPair, pairs};
pub use serve::{Answer, ServeError, Server};
pub use splats::{ViewError, splats};

//! Facial optical flow, end to end: synthetic heads and avatars of 3D Gaussians, rendered datasets with exact flow, networks, and
//! micro-expression recognition.
//!
//! Each job is a struct with its settings as fields. [`Job::run`] does the work and returns a report, which displays as text and
//! serializes as JSON:
//!
//! ```no_run
//! use srflow::render::{RenderJob, Settings};
//! use srflow::{Job, Watch};
//!
//! let settings = Settings { scenes: 3, frames: 8.0, size: "550x802".parse().unwrap(), ..Settings::default() };
//! let job = RenderJob { settings, ..RenderJob::new("tiny") };
//! let report = job.run(&Watch::SILENT)?;
//! println!("{report}");
//! # Ok::<(), srflow::Error>(())
//! ```
//!
//! [`Watch`] follows a job and can stop it; running a stopped job again continues. With the feature `clap` the same structs are the
//! options of the command `srflow`.
//!
//! For work in memory, [`flow::estimator`] opens a method with its settings, and the building blocks of the jobs are
//! re-exported: fields and images ([`core`]), their files ([`files`]), the rasterizer ([`splat`]), classical methods
//! ([`classical`]) and networks ([`nets`]).
#![cfg_attr(not(feature = "clap"), allow(dead_code, reason = "parsers of arguments"))]

pub mod ablation;
mod assignments;
pub mod avatar;
pub mod check;
pub mod convert;
pub mod demo;
pub mod device;
#[doc(hidden)]
pub mod error;
pub mod eval;
pub mod face;
pub mod figure;
pub mod flow;
mod head_page;
mod job;
mod job_engine;
pub mod large_frames;
mod machine;
mod made;
pub mod mer;
pub mod merge;
pub mod methods;
pub mod metrics;
pub mod models;
pub mod networks;
mod opening;
mod output;
pub mod pack;
pub mod posed_head;
pub mod rasterize;
pub mod render;
pub mod rendering;
mod scoring;
pub mod settings;
pub mod shapes;
mod table;
pub mod train;
mod video;
pub mod view;
mod watch;

pub use error::{Error, ErrorKind};
pub use job::{FollowUp, Job, Report, WhenStopped};
pub use machine::threads_of_job;
pub use table::{Done, Entry, JOBS};
pub use watch::{Progress, Watch};

#[doc(inline)]
pub use {
    srflow_classical as classical, srflow_core as core, srflow_files as files, srflow_nets as nets,
    srflow_splat as splat,
};

/// Clap's derives with the feature `clap`; otherwise derives that generate nothing.
pub(crate) mod clap {
    #[cfg(feature = "clap")]
    pub use ::clap::{Args, ValueEnum};
    #[cfg(not(feature = "clap"))]
    pub use srflow_no_clap::{Args, ValueEnum};
}

//! Files over HTTP(S): whole files that are checked against a published digest, and ranges of files too large to download.

mod download;
mod range;

pub use download::{DownloadError, download_if_missing};
pub use range::{Client, FetchError, FetchProblem, Part, Patience};

const USER_AGENT: &str = concat!("srflow/", env!("CARGO_PKG_VERSION"));

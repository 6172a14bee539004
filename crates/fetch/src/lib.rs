//! Files over HTTP(S): whole files that are checked against a published digest, and ranges of files too large to download.

mod download;
mod range;

pub use download::{DownloadError, download_if_missing};
pub use range::{Client, FetchError, FetchProblem, Part, Patience};

use sha2::{Digest, Sha256};

const USER_AGENT: &str = concat!("srflow/", env!("CARGO_PKG_VERSION"));

/// The digits of a finished hash, in lower case.
pub fn hexadecimal(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

//! Which pairs go into which tar.

use std::fs;
use std::path::Path;

use srflow_core::excerpt;
use srflow_files::read_flow;

use crate::error::{PackError, ReadError};
use crate::names::is_plain;
use crate::packed::Shard;
use crate::settings::{PackSettings, PackedFlow};
use crate::source::{PairSource, Source};
use crate::split::SceneSplit;
use crate::ustar;

/// Divides the pairs of each split evenly among as many tars as their size asks for, and estimates the size of all in bytes. Calls
/// `on_pair` with the number of pairs so far.
pub(crate) fn plan(
    source: &Source,
    first: &PairSource,
    settings: PackSettings,
    on_pair: &dyn Fn(u64),
) -> Result<(Vec<Shard>, u64), PackError> {
    // Files of flow grow alike when they are converted.
    let flow = read_flow(&first.flow)?;
    let converted = source.encoded(settings.flow, &first.flow, &flow)?.len() as f64;
    let raw = matches!(settings.flow, PackedFlow::Npy | PackedFlow::Npy32);
    let growth = converted / fs::metadata(&first.flow).map_or(1, |metadata| metadata.len().max(1)) as f64;
    let mut missing = Missing::default();
    let (mut shards, mut total, mut found) = (Vec::new(), 0, 0);
    for split in SceneSplit::ALL {
        let pairs = source.pairs(split);
        let mut bytes = 0;
        source.each(split, 0, pairs, |pair| {
            check_key(&pair)?;
            if missing.count > Missing::MOST {
                return Err(missing.error(source));
            }
            for (_, path) in pair.copied() {
                bytes += with_header(missing.size(&source.dir, path));
            }
            for (_, path) in pair.flows() {
                let stored = missing.size(&source.dir, path) as f64;
                bytes += with_header(if raw { converted } else { stored * growth } as u64);
            }
            found += 1;
            on_pair(found);
            Ok::<_, PackError>(())
        })?;
        let count = bytes.div_ceil(settings.shard_size.bytes).clamp(1, pairs.max(1));
        if pairs > 0 {
            let start = |number: u64| (u128::from(pairs) * u128::from(number) / u128::from(count)) as u64;
            shards.extend((0..count).map(|number| {
                let first = start(number);
                Shard { split, number, first, count: start(number + 1) - first }
            }));
        }
        total += bytes;
    }
    if missing.count > 0 { Err(missing.error(source)) } else { Ok((shards, total)) }
}

/// Files of the dataset that are missing.
#[derive(Default)]
struct Missing {
    count: usize,
    listed: String,
}

impl Missing {
    /// Most that are counted: a manifest may claim any number of pairs.
    const MOST: usize = 10_000;
    /// Most that are listed.
    const NAMED: usize = 8;

    /// Size of a file of the dataset in bytes; 0 if it is missing.
    fn size(&mut self, dir: &Path, path: &Path) -> u64 {
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_file() => metadata.len(),
            _ => {
                self.count += 1;
                if self.count <= Self::NAMED {
                    self.listed += &format!("  {}\n", path.strip_prefix(dir).unwrap_or(path).display());
                }
                0
            }
        }
    }

    fn error(&self, source: &Source) -> PackError {
        let listed = self.listed.trim_end().to_owned();
        PackError::Incomplete { dir: source.dir.clone(), count: self.count, listed, command: source.command }
    }
}

/// Size of a member in a tar.
fn with_header(size: u64) -> u64 {
    ustar::BLOCK + size.next_multiple_of(ustar::BLOCK)
}

fn check_key(pair: &PairSource) -> Result<(), PackError> {
    let key = pair.key();
    if is_plain(&key) && key.len() <= 60 {
        return Ok(());
    }
    let reason = format!(
        "expected a name of at most 60 letters, digits, hyphens and underscores, found `{}`",
        excerpt(&key)
    );
    Err(ReadError::Content { path: pair.flow.clone(), reason }.into())
}

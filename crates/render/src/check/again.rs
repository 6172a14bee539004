//! Whether a dataset still has the bytes it was made with: by its hashes, and by rendering pairs again.

use std::collections::{BTreeSet, HashSet};
use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use serde::Serialize;
use srflow_core::random::Key;
use srflow_core::{Shard, excerpt};
use srflow_data::manifest::Manifest;
use srflow_files::{FileKind, SHA256SUMS, hexadecimal, parse_sha256sums_line, sha256_of_file};

use super::plan::is_of_this_version;
use super::problem::Problem;
use crate::RenderError;
use crate::generate::{Background, Settings, generate};
use crate::job::{Layout, Request};
use crate::long::Videos;
use crate::shapes::ShapesLayout;
use crate::synth::Clips;

/// Files hashed at once.
const AT_ONCE: usize = 1024;
/// The longest line of [`SHA256SUMS`], in bytes.
const LONGEST_LINE: u64 = 4096 + 66;

/// Pairs that were rendered again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Rerendered {
    /// The seed that drew them.
    pub seed: u64,
    /// Their names.
    pub pairs: Vec<String>,
    /// Files that have the bytes of the dataset's.
    pub equal_files: usize,
    pub problems: Vec<Problem>,
}

/// Compares every file of the dataset in `dir`, of `srflow render`, `srflow shapes`, `srflow mer synth` or `srflow mer synth-long`, with its hash in `SHA256SUMS`.
/// Calls `on_files` with the number of files that were read, and of all. Returns the first and the problems.
///
/// # Errors
/// When there is no such dataset, or the list of hashes cannot be read.
pub fn check_hashes(dir: &Path, on_files: &dyn Fn(u64, u64)) -> Result<(u64, Vec<Problem>), RenderError> {
    let has = |name: &str| dir.join(name).is_file();
    if has(Manifest::MANIFEST) {
        check_hashes_of(&Manifest::read(dir)?, dir, on_files)
    } else if has(ShapesLayout::MANIFEST) {
        check_hashes_of(&ShapesLayout::read(dir)?, dir, on_files)
    } else if has(Clips::MANIFEST) {
        check_hashes_of(&Clips::read(dir)?, dir, on_files)
    } else if has(Videos::MANIFEST) {
        check_hashes_of(&Videos::read(dir)?, dir, on_files)
    } else {
        Err(RenderError::NoDataset(dir.to_owned()))
    }
}

fn check_hashes_of<L: Layout>(
    layout: &L,
    dir: &Path,
    on_files: &dyn Fn(u64, u64),
) -> Result<(u64, Vec<Problem>), RenderError> {
    let path = dir.join(SHA256SUMS);
    let unread = |error| RenderError::io(&path, error);
    let problem = |file: &Path, what: String| Problem { file: file.to_owned(), what };
    let mut problems = Vec::new();
    if !path.is_file() {
        let what =
            "missing: datasets get it when they are complete; run the command that made this one again";
        return Ok((0, vec![problem(&path, what.to_owned())]));
    }
    let all = count_lines(&path).map_err(unread)?;
    let mut reader = BufReader::new(File::open(&path).map_err(unread)?);
    // Hashes of the names, since there may be millions.
    let mut listed: HashSet<u64> = HashSet::new();
    let name_hash = |file: &Path| {
        let mut hasher = DefaultHasher::new();
        file.hash(&mut hasher);
        hasher.finish()
    };
    let (mut files, mut number) = (0, 0_u64);
    loop {
        let mut some: Vec<(PathBuf, String)> = Vec::new();
        while some.len() < AT_ONCE {
            let mut line = Vec::new();
            if reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line).map_err(unread)? == 0 {
                break;
            }
            number += 1;
            match String::from_utf8(line).ok().as_deref().and_then(parse_sha256sums_line) {
                Some((hash, name)) => some.push((dir.join(name), hash.to_owned())),
                None => {
                    let what = format!(
                        "line {number}: expected a SHA-256, two spaces and the name of a file in the dataset"
                    );
                    problems.push(problem(&path, what));
                    return Ok((files, problems));
                }
            }
        }
        if some.is_empty() {
            break;
        }
        let wrong = |(file, hash): &(PathBuf, String)| {
            if !file.is_file() {
                return Some(problem(file, "missing, or not a file".to_owned()));
            }
            match sha256_of_file(file, FileKind::OfDataset).map(hexadecimal) {
                Ok(found) if found == *hash => None,
                Ok(found) => Some(problem(file, format!("its SHA-256 is {found}, expected {hash}"))),
                Err(error) => Some(problem(file, format!("cannot be read: {error}"))),
            }
        };
        problems.extend(some.par_iter().filter_map(wrong).collect::<Vec<_>>());
        listed.extend(some.iter().map(|(file, _)| name_hash(file)));
        files += some.len() as u64;
        on_files(files, all);
    }
    let of_all = layout.others().into_iter().map(|name| dir.join(name));
    let of_units =
        (0..).zip(layout.groups()).flat_map(|(group, units)| (0..units).map(move |unit| (group, unit)));
    let of_units = of_units.flat_map(|(group, unit)| layout.files(dir, group, unit));
    let unlisted = of_all.chain(of_units).filter(|file| !listed.contains(&name_hash(file)));
    problems.extend(unlisted.map(|file| problem(&file, format!("not listed in {SHA256SUMS}"))));
    Ok((files, problems))
}

fn count_lines(path: &Path) -> io::Result<u64> {
    let mut reader = BufReader::new(File::open(path)?);
    let mut lines = 0;
    loop {
        let bytes = reader.fill_buf()?;
        if bytes.is_empty() {
            return Ok(lines);
        }
        lines += bytes.iter().filter(|byte| **byte == b'\n').count() as u64;
        let read = bytes.len();
        reader.consume(read);
    }
}

/// Renders `count` pairs of the dataset in `dir` again, drawn by `seed`, and compares the bytes of all their files. Calls `on_pair` after
/// each.
///
/// # Errors
/// When `dataset.json` cannot be read, the dataset cannot be made from it alone, or the pairs cannot be rendered into the system's folder of
/// temporary files.
pub fn check_rerendered(
    dir: &Path,
    count: u64,
    seed: u64,
    on_pair: &dyn Fn(),
) -> Result<Rerendered, RenderError> {
    let manifest = Manifest::read(dir)?;
    let cannot = |why: &str| {
        RenderError::Setting(srflow_core::SettingError {
            field: "rerender",
            found: count.to_string(),
            expected: format!(
                "a dataset that this program can render from {} alone; {why}",
                dir.join(Manifest::MANIFEST).display()
            ),
        })
    };
    let (settings, _) = Settings::of(&manifest).map_err(|what| cannot(&excerpt(&what)))?;
    if !is_of_this_version(&manifest) {
        return Err(cannot(&format!("srflow {} wrote it", excerpt(&manifest.srflow_version))));
    }
    if let Some(device) = manifest.arguments.others.get("device").and_then(serde_json::Value::as_str) {
        return Err(cannot(&format!("it was rasterized on a GPU ({})", excerpt(device))));
    }
    let from_files = !settings.head.is_builtin()
        || settings.motion.is_of_files()
        || matches!(settings.background, Background::Images(_));
    if from_files {
        return Err(cannot("its head, motion or background came from files"));
    }
    let all = u32::try_from(manifest.pairs()).map_err(|_| cannot("it has too many pairs"))?;
    let mut stream = Key::new(seed).stream("check");
    let mut chosen = BTreeSet::new();
    while (chosen.len() as u64) < count.min(u64::from(all)) {
        chosen.insert(stream.below(all));
    }
    let mut rerendered = Rerendered { seed, pairs: Vec::new(), equal_files: 0, problems: Vec::new() };
    let made = Temporary::new()?;
    for number in chosen {
        generate(
            &settings,
            Request { shard: Shard { number: number + 1, of: all }, ..Request::new(&made.0) },
        )?;
        let (group, pair) = pair_of(&manifest, number);
        for file in Layout::files(&manifest, &made.0, group, pair) {
            let original = dir.join(file.strip_prefix(&made.0).unwrap_or(&file));
            // Files of a pair are small enough to be read whole.
            match (fs::read(&file), fs::read(&original)) {
                (Ok(new), Ok(old)) if new == old => rerendered.equal_files += 1,
                (Ok(_), Ok(_)) => {
                    let what = "its bytes are not those that this program renders on this machine".to_owned();
                    rerendered.problems.push(Problem { file: original, what });
                }
                (_, Err(error)) | (Err(error), _) => {
                    rerendered
                        .problems
                        .push(Problem { file: original, what: format!("cannot be read: {error}") });
                }
            }
        }
        rerendered.pairs.push(manifest.name(group, pair));
        on_pair();
    }
    Ok(rerendered)
}

/// The scene of a pair, counted over all scenes, and its number within.
fn pair_of(manifest: &Manifest, number: u32) -> (u32, u32) {
    let mut left = number;
    for (group, pairs) in (0..).zip(manifest.groups()) {
        if left < pairs {
            return (group, left);
        }
        left -= pairs;
    }
    (0, 0)
}

/// A folder that is removed when this is dropped.
struct Temporary(PathBuf);

impl Temporary {
    fn new() -> Result<Self, RenderError> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("srflow-check-{}-{number}", std::process::id()));
        fs::create_dir(&path).map_err(|error| RenderError::io(&path, error))?;
        Ok(Self(path))
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        _ = fs::remove_dir_all(&self.0);
    }
}

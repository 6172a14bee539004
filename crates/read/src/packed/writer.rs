//! Packing a dataset: as many tars as its size asks for, each with the same number of pairs, written one after the other.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;
use sha2::{Digest, Sha256};
use srflow_core::{FlowField, SettingError, excerpt, named, serialize_as_text};
use srflow_files::{
    FileBytes, FileError, FileKind, FileProblem, FlowFormat, LockError, RunLock, SHA256SUMS, create_folder,
    encode_flow, encode_flow_half, hexadecimal, read_file, read_flow, read_json_lines, remove_partial,
    sha256_of_file, sha256sums_line, write_atomically, write_file,
};

use super::index::{FlowStatistics, INDEX_NAME, IndexRecord, MemberRecord, lines};
use super::place::Place;
use super::source::{PairSource, Source};
use super::tar_size::TarSize;
use super::{card, croissant, is_plain, ustar};
use crate::clap::Args;
use crate::flow::DatasetError;
use crate::manifest::{ManifestError, SceneSplit};

/// Name of the file with the arguments in a packed dataset.
const ARGUMENTS_NAME: &str = "pack.json";
/// Name of the file with a line for each tar, which is written last.
pub(super) const TARS_NAME: &str = "tars.jsonl";
/// Folder of the parts of the index while tars are missing.
const PARTS: &str = ".index";
/// Version of the layout.
const PACK_VERSION: u32 = 1;
/// Most pairs in memory.
const AT_ONCE: usize = 16;
/// Smallest size of a tar in bytes: a smaller one makes more files than anyone wants.
const SMALLEST_TAR: u64 = 1 << 16;

/// How flow is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PackedFlow {
    /// `.npy` of float16: half the size of float32; see [`encode_flow_half`] for its error.
    Npy,
    /// `.npy` of float32.
    Npy32,
    /// KITTI's 16-bit PNG.
    Png,
    /// The format of SRFlow datasets, which `srflow` and NumPy read, and others take for bytes.
    Npz16,
}

named!(PackedFlow, "a format of packed flow", {
    Npy => "npy",
    Npy32 => "npy32",
    Png => "png",
    Npz16 => "npz16",
});

serialize_as_text!(PackedFlow);

impl PackedFlow {
    /// The file extension.
    pub(super) fn extension(self) -> &'static str {
        match self {
            Self::Npy | Self::Npy32 => "npy",
            Self::Png => "png",
            Self::Npz16 => "npz16",
        }
    }

    /// Its description in a dataset card.
    pub(super) fn about(self) -> &'static str {
        match self {
            Self::Npy => "NumPy array of float16, NaN where unknown",
            Self::Npy32 => "NumPy array of float32, NaN where unknown",
            Self::Png => "KITTI's 16-bit PNG: `(value - 32768) / 64`, blue is 0 where unknown",
            Self::Npz16 => {
                "NumPy archive of steps of 1/256 px, as srflow's docs/reference/dataset-format.md describes it"
            }
        }
    }

    /// The format of files that have the same bytes.
    fn format(self) -> Option<FlowFormat> {
        match self {
            // A `.npy` file of a dataset may have any type of number.
            Self::Npy | Self::Npy32 => None,
            Self::Png => Some(FlowFormat::KittiPng),
            Self::Npz16 => Some(FlowFormat::Npz16),
        }
    }

    fn encode(self, flow: &FlowField) -> Result<Vec<u8>, FileProblem> {
        match self {
            Self::Npy => encode_flow_half(flow),
            Self::Npy32 => encode_flow(flow, FlowFormat::Npy),
            Self::Png => encode_flow(flow, FlowFormat::KittiPng),
            Self::Npz16 => encode_flow(flow, FlowFormat::Npz16),
        }
    }
}

/// The settings that determine the bytes of a packed dataset.
#[derive(Args, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PackSettings {
    /// Flow: npy (float16), npy32 (float32), png (KITTI's 16-bit PNG) or npz16 (as `srflow render` writes it)
    #[arg(long, value_name = "FORMAT", default_value_t = Self::default().flow)]
    pub flow: PackedFlow,
    /// Approximate size of a tar: bytes, or with kB, MB or GB
    #[arg(long, value_name = "SIZE", default_value_t = Self::default().shard_size)]
    pub shard_size: TarSize,
}

impl Default for PackSettings {
    fn default() -> Self {
        Self { flow: PackedFlow::Npy, shard_size: TarSize { bytes: 1_000_000_000 } }
    }
}

/// What [`pack`] is asked for.
pub struct PackRequest<'a> {
    /// Folder of the dataset.
    pub dir: &'a Path,
    /// Folder of the packed dataset.
    pub out: &'a Path,
    /// Whether to delete another packed dataset in the folder.
    pub force: bool,
    /// Stop after this many pairs.
    pub stop_after: Option<u64>,
    /// Whether to stop. Asked between pairs.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called on progress.
    pub on_event: &'a dyn Fn(PackEvent),
}

/// Progress of [`pack`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PackEvent {
    /// So many pairs were found in the dataset so far.
    Found { pairs: u64 },
    /// The pairs in all, those of them in whole tars, and about how many bytes all tars will have.
    Started { pairs: u64, whole: u64, bytes: u64 },
    /// Another pair is packed; how many bytes of tars there are, those of earlier runs included.
    Packed { bytes: u64 },
}

/// What [`pack`] has done.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PackReport {
    /// Pairs of the dataset.
    pub pairs: u64,
    /// Pairs that this run has packed.
    pub packed: u64,
    /// Number of tars.
    pub tars: u64,
    /// Size of all whole tars in bytes.
    pub bytes: u64,
    /// Whether it was stopped before the end.
    pub stopped: bool,
    /// Largest difference between a component of the packed flow and of the dataset's, in pixels, over whole tars.
    pub flow_error: f32,
}

/// Errors of packing.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// The folder has no dataset that can be packed.
    #[error("{}: expected the folder of a dataset of `srflow render` or `srflow shapes` (with dataset.json or shapes.json), found none", .dir.display())]
    NoDataset { dir: PathBuf },
    /// A setting is out of range.
    #[error("{0}")]
    Setting(#[from] SettingError),
    /// The folder has something else in it.
    #[error("{}: {found}; choose another folder, or give `force` to delete it", .dir.display())]
    Occupied {
        dir: PathBuf,
        /// What was found.
        found: String,
    },
    /// A file has other content than expected.
    #[error("{}: {reason}", .path.display())]
    Content { path: PathBuf, reason: String },
    /// A flow cannot be packed as asked.
    #[error("{}: {problem}; choose another `flow`", .path.display())]
    Flow {
        path: PathBuf,
        #[source]
        problem: FileProblem,
    },
    /// Files of the dataset are missing.
    #[error("{}: {count} files of the dataset are missing:\n{listed}\nrun `{command}` again to complete it", .dir.display())]
    Incomplete {
        dir: PathBuf,
        count: usize,
        /// The first of them, one per line.
        listed: String,
        command: &'static str,
    },
    #[error(transparent)]
    Lock(#[from] LockError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error(transparent)]
    Dataset(#[from] DatasetError),
}

/// The pairs of one tar.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Shard {
    pub split: SceneSplit,
    /// Its number within the split.
    pub number: u64,
    /// The first of its pairs, and how many it has.
    pub first: u64,
    pub count: u64,
}

impl Shard {
    pub fn name(&self) -> String {
        format!("{}-{:06}.tar", self.split, self.number)
    }
}

/// A whole tar.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct WholeTar {
    pub name: String,
    pub split: SceneSplit,
    /// Size in bytes.
    pub size: u64,
    pub sha256: String,
    pub pairs: u64,
    pub flow: FlowStatistics,
    pub flow_error: f32,
}

/// What the card and its like describe.
pub(super) struct Packed<'a> {
    pub source: &'a Source,
    pub settings: PackSettings,
    pub tars: &'a [WholeTar],
    /// Ends of the names of every pair's members, such as `frame1.png`.
    pub fields: Vec<String>,
    /// Width and height of the frames.
    pub size: (usize, usize),
    /// Keys of the pairs that are shown.
    pub shown: Vec<String>,
}

/// Packs the dataset in the folder `dir`, or continues a run that was stopped: whole tars are kept. The bytes depend on the dataset and
/// the settings alone.
///
/// # Errors
/// When the dataset is incomplete or broken, the folder has another packed dataset, or a flow cannot be packed as asked.
pub fn pack(settings: PackSettings, request: &PackRequest) -> Result<PackReport, PackError> {
    let PackRequest { dir, out, .. } = *request;
    if !(SMALLEST_TAR..=ustar::LARGEST).contains(&settings.shard_size.bytes) {
        let expected = format!("{SMALLEST_TAR} to {} bytes", ustar::LARGEST);
        let found = settings.shard_size.to_string();
        return Err(SettingError { field: "shard_size", found, expected }.into());
    }
    if fs::canonicalize(dir).ok().is_some_and(|dir| fs::canonicalize(out).is_ok_and(|out| out == dir)) {
        let expected = "another folder than the dataset's".to_owned();
        return Err(SettingError { field: "out", found: out.display().to_string(), expected }.into());
    }
    let source = Source::open(dir)?;
    let Some(first) = source.first() else { return Err(PackError::NoDataset { dir: dir.to_owned() }) };
    prepare(&source, settings, request)?;
    let parts = out.join(PARTS);
    if let Some(tars) = finished(out)? {
        remove_parts(&parts)?;
        let pairs = tars.iter().map(|tar| tar.pairs).sum();
        let report = PackReport::new(pairs, 0, tars.len(), &tars);
        (request.on_event)(PackEvent::Started { pairs, whole: pairs, bytes: report.bytes });
        return Ok(report);
    }
    create_folder(&parts)?;
    let lock = RunLock::take(&parts)?;
    for folder in [out, &parts] {
        remove_partial(folder, |_, _| true)?;
    }
    let (shards, bytes) = plan(&source, &first, settings, request)?;
    let pairs = shards.iter().map(|shard| shard.count).sum();
    let mut kept = shards.iter().map(|shard| whole(out, shard)).collect::<Result<Vec<_>, _>>()?;
    let whole = kept.iter().flatten().map(|tar| tar.pairs).sum();
    (request.on_event)(PackEvent::Started { pairs, whole, bytes });
    let bytes = kept.iter().flatten().map(|tar| tar.size).sum();
    let mut run = Run { source: &source, settings, request, packed: 0, bytes };
    for (shard, tar) in shards.iter().zip(&mut kept) {
        if tar.is_none() {
            *tar = run.write(shard)?;
        }
        if tar.is_none() {
            break;
        }
    }
    let packed = run.packed;
    let tars: Vec<WholeTar> = kept.into_iter().flatten().collect();
    if tars.len() == shards.len() {
        finish(&source, settings, out, &shards, &tars)?;
        drop(lock); // its file is in the folder
        remove_parts(&parts)?;
    }
    Ok(PackReport::new(pairs, packed, shards.len(), &tars))
}

impl PackReport {
    fn new(pairs: u64, packed: u64, shards: usize, whole: &[WholeTar]) -> Self {
        Self {
            pairs,
            packed,
            tars: shards as u64,
            bytes: whole.iter().map(|tar| tar.size).sum(),
            stopped: whole.len() < shards,
            flow_error: whole.iter().map(|tar| tar.flow_error).fold(0.0, f32::max),
        }
    }
}

/// The tars of a dataset that is packed already; `None` while it is not.
fn finished(out: &Path) -> Result<Option<Vec<WholeTar>>, PackError> {
    let path = out.join(TARS_NAME);
    if !path.exists() {
        return Ok(None);
    }
    let tars: Vec<WholeTar> = read_json_lines(&path)?;
    for tar in &tars {
        let path = out.join(&tar.name);
        let found = fs::metadata(&path).map_or(0, |metadata| metadata.len());
        if found != tar.size {
            let reason = format!(
                "expected {} bytes, found {found}; copy it again, or give --force to pack everything again",
                tar.size
            );
            return Err(PackError::Content { path, reason });
        }
    }
    Ok(Some(tars))
}

/// Divides the pairs of each split evenly among as many tars as their size asks for, and estimates the size of all in bytes.
fn plan(
    source: &Source,
    first: &PairSource,
    settings: PackSettings,
    request: &PackRequest,
) -> Result<(Vec<Shard>, u64), PackError> {
    let dir = request.dir;
    // Files of flow grow alike when they are converted.
    let flow = read_flow(&first.flow)?;
    let converted = encoded(settings.flow, source.flow_format(), &first.flow, &flow)?.len() as f64;
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
                return Err(missing.error(source, dir));
            }
            for (_, path) in pair.copied() {
                bytes += with_header(missing.size(dir, path));
            }
            for (_, path) in pair.flows() {
                let stored = missing.size(dir, path) as f64;
                bytes += with_header(if raw { converted } else { stored * growth } as u64);
            }
            found += 1;
            (request.on_event)(PackEvent::Found { pairs: found });
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
    if missing.count > 0 { Err(missing.error(source, dir)) } else { Ok((shards, total)) }
}

/// Files of the dataset that are missing.
#[derive(Default)]
struct Missing {
    count: usize,
    /// The first of them, one per line.
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

    fn error(&self, source: &Source, dir: &Path) -> PackError {
        let listed = self.listed.trim_end().to_owned();
        PackError::Incomplete { dir: dir.to_owned(), count: self.count, listed, command: source.command }
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
    Err(PackError::Content { path: pair.flow.clone(), reason })
}

/// Makes the folder ready: its arguments are the same, or it is empty.
fn prepare(source: &Source, settings: PackSettings, request: &PackRequest) -> Result<(), PackError> {
    let out = request.out;
    create_folder(out)?;
    let arguments = json!({
        "pack_version": PACK_VERSION,
        "srflow_version": env!("CARGO_PKG_VERSION"),
        "flow": settings.flow.name(),
        "shard_size": settings.shard_size.bytes,
        "command": source.command,
        "dataset": source.description,
    });
    let mut arguments = serde_json::to_string_pretty(&arguments).unwrap_or_default();
    arguments.push('\n');
    let path = out.join(ARGUMENTS_NAME);
    let existing = if path.exists() { Some(read_file(&path, FileKind::Json)?) } else { None };
    let same = existing.as_deref() == Some(arguments.as_bytes());
    if request.force || !same {
        clear(out, request.force)?;
        write_file(&path, &arguments)?;
    }
    Ok(())
}

/// Deletes a packed dataset if `force` allows it. Nothing else may be in the folder.
fn clear(out: &Path, force: bool) -> Result<(), PackError> {
    let occupied = |found| PackError::Occupied { dir: out.to_owned(), found };
    let failed = |doing, path: &Path| {
        let path = path.to_owned();
        move |error| PackError::File(FileProblem::Io { doing, error }.in_file(&path))
    };
    let mut own = Vec::new();
    for entry in fs::read_dir(out).map_err(failed("listing the folder", out))? {
        let path = entry.map_err(failed("listing the folder", out))?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let is_own = [
            ARGUMENTS_NAME,
            SHA256SUMS,
            INDEX_NAME,
            TARS_NAME,
            PARTS,
            card::NAME,
            croissant::NAME,
            card::PICTURES,
        ]
        .contains(&name.as_str())
            || SceneSplit::ALL
                .iter()
                .any(|split| name.starts_with(&format!("{split}-")) && name.ends_with(".tar"));
        match is_own {
            true => own.push(path),
            // Version control of those who publish datasets.
            false if name.starts_with('.') => {}
            false => {
                let name = excerpt(&name);
                return Err(PackError::Setting(SettingError {
                    field: "out",
                    found: format!("{name} in {}", out.display()),
                    expected: "an empty folder, or one with a packed dataset".to_owned(),
                }));
            }
        }
    }
    if !own.is_empty() && !force {
        return Err(occupied("it has files of a dataset that was packed with other arguments".to_owned()));
    }
    for path in own {
        let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        removed.map_err(failed("removing", &path))?;
    }
    Ok(())
}

/// The file with the part of the index for a tar.
fn part_of(out: &Path, shard: &Shard) -> PathBuf {
    out.join(PARTS).join(format!("{}.jsonl", shard.name()))
}

/// The file that says that a tar is whole.
fn note_of(out: &Path, shard: &Shard) -> PathBuf {
    out.join(PARTS).join(format!("{}.json", shard.name()))
}

/// What is known of a tar, if it is whole.
fn whole(out: &Path, shard: &Shard) -> Result<Option<WholeTar>, PackError> {
    let note = note_of(out, shard);
    if !note.exists() || !part_of(out, shard).exists() {
        return Ok(None);
    }
    let tar = read_json_lines::<WholeTar>(&note)?.pop();
    let size = fs::metadata(out.join(shard.name())).map(|metadata| metadata.len());
    Ok(tar.filter(|tar| tar.pairs == shard.count && size.is_ok_and(|size| size == tar.size)))
}

/// A run of [`pack`].
struct Run<'a> {
    source: &'a Source,
    settings: PackSettings,
    request: &'a PackRequest<'a>,
    /// Pairs that it has packed.
    packed: u64,
    /// Size of all tars, those of earlier runs included.
    bytes: u64,
}

/// The members of one pair, as they are in the tar.
struct PackedPair {
    bytes: Vec<u8>,
    /// Offsets are from the start of `bytes`.
    record: IndexRecord,
}

/// Why a tar was not written.
enum Unwritten {
    Stopped,
    Failed(PackError),
    /// The tar or its part of the index could not be written.
    Io(io::Error),
}

impl From<PackError> for Unwritten {
    fn from(error: PackError) -> Self {
        Self::Failed(error)
    }
}

impl From<io::Error> for Unwritten {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl Run<'_> {
    fn should_stop(&self) -> bool {
        self.request.stop_after.is_some_and(|pairs| self.packed >= pairs) || (self.request.stop)()
    }

    /// Writes a tar and its part of the index; `None` when it is stopped before the end, which leaves nothing.
    fn write(&mut self, shard: &Shard) -> Result<Option<WholeTar>, PackError> {
        let out = self.request.out;
        let mut whole = None;
        let mut unwritten = None;
        // The part of the index exists only beside a whole tar.
        let written = write_atomically(&part_of(out, shard), |index| {
            let mut failed = None;
            let tar = write_atomically(&out.join(shard.name()), |file| {
                self.fill(shard, file, index).map(|tar| whole = Some(tar)).map_err(|error| match error {
                    Unwritten::Io(error) => error,
                    other => {
                        failed = Some(other);
                        io::ErrorKind::Other.into()
                    }
                })
            });
            unwritten = failed.or_else(|| Some(Unwritten::Failed(tar.err()?.into())));
            if unwritten.is_some() { Err(io::ErrorKind::Other.into()) } else { Ok(()) }
        });
        match unwritten {
            Some(Unwritten::Stopped) => return Ok(None),
            Some(Unwritten::Failed(error)) => return Err(error),
            Some(Unwritten::Io(_)) | None => written?,
        }
        if let Some(tar) = &whole {
            write_file(&note_of(out, shard), json_line(tar))?;
        }
        Ok(whole)
    }

    fn fill(
        &mut self,
        shard: &Shard,
        file: &mut impl Write,
        index: &mut impl Write,
    ) -> Result<WholeTar, Unwritten> {
        let mut tar = WholeTar {
            name: shard.name(),
            split: shard.split,
            size: 0,
            sha256: String::new(),
            pairs: shard.count,
            flow: FlowStatistics::default(),
            flow_error: 0.0,
        };
        let (source, format) = (self.source, self.settings.flow);
        let mut hash = Sha256::new();
        let at_once = rayon::current_num_threads().clamp(1, AT_ONCE);
        let mut waiting = Vec::with_capacity(at_once);
        let mut pack = |waiting: &mut Vec<PairSource>| {
            let packed: Vec<_> =
                waiting.par_drain(..).map(|pair| pack_pair(source, format, shard, &pair)).collect();
            for pair in packed {
                let PackedPair { bytes, mut record } = pair?;
                record.offset = tar.size;
                record.members.values_mut().for_each(|member| member.offset += tar.size);
                index.write_all(json_line(&record).as_bytes())?;
                hash.update(&bytes);
                file.write_all(&bytes)?;
                tar.size += record.size;
                tar.flow.add(&record.flow);
                tar.flow_error = tar.flow_error.max(record.flow_error);
                self.packed += 1;
                self.bytes += record.size;
                (self.request.on_event)(PackEvent::Packed { bytes: self.bytes });
            }
            if self.should_stop() { Err(Unwritten::Stopped) } else { Ok(()) }
        };
        let mut left = shard.count;
        source.each(shard.split, shard.first, shard.count, |pair| {
            waiting.push(pair);
            left -= 1;
            if waiting.len() < at_once && left > 0 { Ok(()) } else { pack(&mut waiting) }
        })?;
        hash.update(ustar::END);
        file.write_all(&ustar::END)?;
        tar.size += ustar::END.len() as u64;
        tar.sha256 = hexadecimal(hash.finalize());
        Ok(tar)
    }
}

/// The members of a pair, each with its header.
fn pack_pair(
    source: &Source,
    format: PackedFlow,
    shard: &Shard,
    pair: &PairSource,
) -> Result<PackedPair, PackError> {
    let key = pair.key();
    let mut contents: BTreeMap<String, Vec<u8>> = BTreeMap::new();
    for (field, path) in pair.copied() {
        let (ending, kind) = match field {
            "meta" => ("json", FileKind::Json),
            _ => ("png", FileKind::Image),
        };
        contents.insert(format!("{field}.{ending}"), read_file(path, kind)?);
    }
    let (mut statistics, mut flow_error) = (FlowStatistics::default(), 0.0_f32);
    for (field, path) in pair.flows() {
        let flow = read_flow(path)?;
        let bytes = encoded(format, source.flow_format(), path, &flow)?;
        let name = format!("{field}.{}", format.extension());
        let packed = FileBytes { name: name.as_ref(), bytes: &bytes }.flow()?;
        let differences = packed.pixels().as_flattened().iter().zip(flow.pixels().as_flattened());
        // `max` leaves out NaN, the difference where the flow is unknown.
        flow_error = differences.map(|(packed, flow)| (packed - flow).abs()).fold(flow_error, f32::max);
        if field == "flow" {
            statistics = pair.statistics(&flow)?;
        }
        contents.insert(name, bytes);
    }
    let mut bytes = Vec::new();
    let mut members = BTreeMap::new();
    for (ending, content) in contents {
        let name = format!("{key}.{ending}");
        let size = content.len() as u64;
        let header = ustar::header(&name, size).ok_or_else(|| PackError::Content {
            path: pair.flow.clone(),
            reason: format!("{name}: expected at most {} bytes, found {size}", ustar::LARGEST),
        })?;
        bytes.extend(header);
        let offset = bytes.len() as u64;
        let sha256 = hexadecimal(Sha256::digest(&content));
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(ustar::BLOCK as usize), 0);
        members.insert(ending, MemberRecord { offset, size, sha256 });
    }
    let record = IndexRecord {
        key,
        split: shard.split,
        scene: pair.scene.clone(),
        frame: pair.frame.clone(),
        tar: shard.name(),
        offset: 0,
        size: bytes.len() as u64,
        members,
        flow: statistics,
        flow_error,
    };
    Ok(PackedPair { bytes, record })
}

/// A line of JSON Lines.
fn json_line(content: &impl Serialize) -> String {
    serde_json::to_string(content).expect("numbers, text, lists and maps by text") + "\n"
}

/// A flow as it is packed: the file itself if it has that format.
fn encoded(
    format: PackedFlow,
    stored: Option<FlowFormat>,
    path: &Path,
    flow: &FlowField,
) -> Result<Vec<u8>, PackError> {
    if format.format().is_some() && format.format() == stored {
        return Ok(read_file(path, FileKind::Flow)?);
    }
    format.encode(flow).map_err(|problem| PackError::Flow { path: path.to_owned(), problem })
}

/// Writes what describes the tars, and last [`TARS_NAME`], which says that the dataset is whole.
fn finish(
    source: &Source,
    settings: PackSettings,
    out: &Path,
    shards: &[Shard],
    tars: &[WholeTar],
) -> Result<(), PackError> {
    let mut failed = None;
    let mut fields = Vec::new();
    let written = write_atomically(&out.join(INDEX_NAME), |index| {
        for shard in shards {
            let part = Place::Disk(part_of(out, shard));
            let copied = lines(&part, &mut |line| {
                if fields.is_empty() {
                    let record: Option<IndexRecord> = serde_json::from_slice(line).ok();
                    fields.extend(record.into_iter().flat_map(|record| record.members.into_keys()));
                }
                [line, b"\n"].iter().try_for_each(|piece| index.write_all(piece)).map_err(|error| {
                    FileProblem::Io { doing: "writing", error }.in_file(&out.join(INDEX_NAME)).into()
                })
            });
            if let Err(error) = copied {
                failed = Some(error);
                return Err(io::ErrorKind::Other.into());
            }
        }
        Ok(())
    });
    failed.map_or(Ok(()), Err)?;
    written?;
    let shown = card::write_pictures(source, out)?;
    let packed = Packed { source, settings, tars, fields, size: source.size()?, shown };
    write_file(&out.join(card::NAME), card::text(&packed))?;
    let tar_lines: String = tars.iter().map(json_line).collect();
    // The hashes name this file, which must be the last one to be written.
    let mut hashes: BTreeMap<String, String> =
        tars.iter().map(|tar| (tar.name.clone(), tar.sha256.clone())).collect();
    hashes.insert(TARS_NAME.to_owned(), hexadecimal(Sha256::digest(&tar_lines)));
    let pictures = packed.shown.iter().map(|key| card::picture(key));
    let described = [INDEX_NAME, ARGUMENTS_NAME, card::NAME].map(str::to_owned);
    for name in described.into_iter().chain(pictures) {
        hashes.insert(name.clone(), digits(&out.join(name))?);
    }
    write_file(&out.join(croissant::NAME), croissant::text(&packed, &hashes))?;
    hashes.insert(croissant::NAME.to_owned(), digits(&out.join(croissant::NAME))?);
    let lines: String = hashes.iter().map(|(name, hash)| sha256sums_line(hash, name)).collect();
    write_file(&out.join(SHA256SUMS), lines)?;
    write_file(&out.join(TARS_NAME), tar_lines)?;
    Ok(())
}

fn remove_parts(parts: &Path) -> Result<(), FileError> {
    match fs::remove_dir_all(parts) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(FileProblem::Io { doing: "removing the folder", error }.in_file(parts))
        }
        _ => Ok(()),
    }
}

fn digits(path: &Path) -> Result<String, FileError> {
    Ok(hexadecimal(sha256_of_file(path, FileKind::OfDataset)?))
}

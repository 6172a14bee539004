//! Packing a dataset: as many tars as its size asks for, each with the same number of pairs, written one after the other.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use sha2::{Digest, Sha256};
use srflow_core::SettingError;
use srflow_files::{
    FileBytes, FileError, FileKind, FileProblem, RunLock, SHA256SUMS, create_folder, hexadecimal, read_file,
    read_flow, remove_partial, sha256_of_file, sha256sums_line, write_atomically, write_file,
};

use crate::error::{PackError, ReadError};
use crate::folder::{
    ARGUMENTS_NAME, PARTS, TARS_NAME, finished, note_of, part_of, prepare, remove_parts, whole,
};
use crate::index::{FlowStatistics, INDEX_NAME, IndexRecord, MemberRecord, lines};
use crate::packed::{Packed, Shard, WholeTar};
use crate::place::Place;
use crate::plan::plan;
use crate::settings::{PackSettings, PackedFlow};
use crate::source::{PairSource, Source};
use crate::{card, croissant, ustar};

/// Most pairs in memory.
const AT_ONCE: usize = 16;
/// Smallest size of a tar in bytes: a smaller one makes more files than anyone wants.
const SMALLEST_TAR: u64 = 1 << 16;

/// What [`pack`] is asked for.
pub struct PackRequest<'a> {
    /// Folder of the packed dataset.
    pub out: &'a Path,
    /// Whether to delete another packed dataset in the folder.
    pub force: bool,
    pub stop_after: Option<u64>,
    /// Whether to stop. Asked between pairs.
    pub stop: &'a (dyn Fn() -> bool + Sync),
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
    pub pairs: u64,
    /// Pairs that this run has packed.
    pub packed: u64,
    pub tars: u64,
    /// Size of all whole tars in bytes.
    pub bytes: u64,
    pub stopped: bool,
    /// Largest difference between a component of the packed flow and of the dataset's, in pixels, over whole tars.
    pub flow_error: f32,
}

/// Packs a dataset, or continues a run that was stopped: whole tars are kept. The bytes depend on the dataset and
/// the settings alone.
///
/// # Errors
/// When the dataset is incomplete or broken, the folder has another packed dataset, or a flow cannot be packed as asked.
pub fn pack(source: &Source, settings: PackSettings, request: &PackRequest) -> Result<PackReport, PackError> {
    let (dir, out) = (&source.dir, request.out);
    if !(SMALLEST_TAR..=ustar::LARGEST).contains(&settings.shard_size.bytes) {
        let expected = format!("{SMALLEST_TAR} to {} bytes", ustar::LARGEST);
        let found = settings.shard_size.to_string();
        return Err(SettingError { field: "shard_size", found, expected }.into());
    }
    if fs::canonicalize(dir).ok().is_some_and(|dir| fs::canonicalize(out).is_ok_and(|out| out == dir)) {
        let expected = "another folder than the dataset's".to_owned();
        return Err(SettingError { field: "out", found: out.display().to_string(), expected }.into());
    }
    let Some(first) = source.first() else {
        let reason = "expected a dataset with pairs, found none".to_owned();
        return Err(ReadError::Content { path: dir.clone(), reason }.into());
    };
    prepare(source, settings, out, request.force)?;
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
    let (shards, bytes) =
        plan(source, &first, settings, &|pairs| (request.on_event)(PackEvent::Found { pairs }))?;
    let pairs = shards.iter().map(|shard| shard.count).sum();
    let mut kept = shards.iter().map(|shard| whole(out, shard)).collect::<Result<Vec<_>, _>>()?;
    let whole = kept.iter().flatten().map(|tar| tar.pairs).sum();
    (request.on_event)(PackEvent::Started { pairs, whole, bytes });
    let bytes = kept.iter().flatten().map(|tar| tar.size).sum();
    let mut run = Run { source, settings, request, packed: 0, bytes };
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
        finish(source, settings, out, &shards, &tars)?;
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
        let bytes = source.encoded(format, path, &flow)?;
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
        let header = ustar::header(&name, size).ok_or_else(|| ReadError::Content {
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
    let packed = Packed { source, settings, tars, fields, shown };
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

fn digits(path: &Path) -> Result<String, FileError> {
    Ok(hexadecimal(sha256_of_file(path, FileKind::OfDataset)?))
}

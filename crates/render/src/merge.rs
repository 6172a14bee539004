//! Bringing parts of a dataset together that were made in folders of their own, by several machines.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;
use serde::Serialize;
use serde_json::Value;
use srflow_data::manifest::Manifest;
use srflow_files::{FileError, FileKind, create_folder, read_text, remove_partial, write_atomically};

use crate::RenderError;
use crate::generate::write_statistics;
use crate::job::{Event, Layout, claim_as, complete, first_difference, until_kept};
use crate::long::{self, Videos};
use crate::record::read_record;
use crate::shapes::{ShapesLayout, write_split};
use crate::synth::{self, Clips};

/// Units whose names are listed in messages.
const NAMED: usize = 10;

/// What to merge.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// Folders with parts of one dataset.
    pub parts: &'a [PathBuf],
    /// Folder of the whole: a new one, or one of an earlier merge, or one of the parts.
    pub out: &'a Path,
    /// Copy files instead of linking them.
    pub copy: bool,
    /// Merge although units are missing.
    pub partial: bool,
    pub on_event: &'a (dyn Fn(Event) + Sync),
}

/// The result of [`merge`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Merged {
    /// What units are called: pairs or clips.
    pub kind: &'static str,
    /// Units of the whole dataset.
    pub units: u64,
    /// Units that came from the parts; the others were there.
    pub merged: u64,
    /// Files that share their content with those of the parts.
    pub linked: u64,
    pub copied: u64,
    /// Units that no part has.
    pub missing: u64,
    /// Names of the first of them.
    pub missing_names: Vec<String>,
    /// Units that several parts have, with the same bytes.
    pub doubled: u64,
    /// Names of the first of them.
    pub doubled_names: Vec<String>,
    /// Whether the dataset is whole, with its statistics or tables and its hashes.
    pub complete: bool,
}

/// Why parts could not be merged.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    #[error("expected the folders of at least one part, found none")]
    NoPart,
    #[error(
        "{}: expected a part of a dataset of `srflow render`, `srflow shapes` or `srflow mer synth`, found no dataset.json, \
         shapes.json or synth.json; give the folders that these commands wrote with `shard`",
        .0.display()
    )]
    NotAPart(PathBuf),
    #[error(
        "{}: {field} is {found}, in {} it is {expected}; parts of one dataset have the same arguments, seed and version of srflow",
        .part.display(), .first.display()
    )]
    OtherDataset { part: PathBuf, field: String, found: String, first: PathBuf, expected: String },
    #[error(
        "{} and {} have different bytes; one of them is damaged or of another machine's program: `sha256sum` and `srflow check` tell more",
        .0.display(), .1.display()
    )]
    Differing(PathBuf, PathBuf),
    #[error(
        "{missing} of {units} {kind} are in none of the {parts} parts, such as {}; run the commands of their parts again, or set `partial`",
        .names.join(", ")
    )]
    Missing { missing: u64, units: u64, kind: &'static str, parts: usize, names: Vec<String> },
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    File(#[from] FileError),
}

/// Brings the parts of a dataset of `srflow render`, `srflow shapes`, `srflow mer synth` or `srflow mer synth-long` together by hard links, or by copies where the
/// parts are on another disk, and writes what parts alone cannot: statistics, tables and hashes. Nothing is changed in the parts.
/// A merge that was interrupted is continued by the next.
///
/// # Errors
/// Before anything is written when the parts are of different datasets, or units are missing and `partial` is not set; later when two
/// parts have different files of one name, or a file cannot be linked or written.
pub fn merge(request: Request) -> Result<Merged, MergeError> {
    let first = request.parts.first().ok_or(MergeError::NoPart)?;
    let has = |name: &str| first.join(name).is_file();
    if has(Manifest::MANIFEST) {
        let manifest = Manifest::read(first).map_err(RenderError::from)?;
        merge_of(&manifest, request, |dir| write_statistics(dir, &manifest).map(drop))
    } else if has(ShapesLayout::MANIFEST) {
        let shapes = ShapesLayout::read(first)?;
        merge_of(&shapes, request, |dir| write_split(dir, shapes.pairs()))
    } else if has(Clips::MANIFEST) {
        let clips = Clips::read(first)?;
        merge_of(&clips, request, |dir| synth::finish(dir, &clips).map(drop))
    } else if has(Videos::MANIFEST) {
        let videos = Videos::read(first)?;
        merge_of(&videos, request, |dir| long::finish(dir, &videos).map(drop))
    } else {
        Err(MergeError::NotAPart(first.clone()))
    }
}

/// A unit and the number of the part that has it.
type Found = (u32, u32, usize);

fn merge_of<L: Layout>(
    layout: &L,
    Request { parts, out, copy, partial, on_event }: Request,
    finish: impl FnOnce(&Path) -> Result<(), RenderError>,
) -> Result<Merged, MergeError> {
    same_dataset(L::MANIFEST, parts)?;
    let units: u64 = layout.groups().into_iter().map(u64::from).sum();

    // By unit, so that the parts that have the same one are neighbours.
    let count = AtomicU64::new(0);
    let in_part = |(number, part): (usize, &PathBuf)| {
        let begun = layout.begun_in(part).into_iter();
        let whole = begun.filter(|&(group, unit)| layout.is_whole(part, group, unit));
        let counted = whole.inspect(|_| {
            let units = count.fetch_add(1, Ordering::Relaxed) + 1;
            on_event(Event::Found { units });
        });
        counted.map(|(group, unit)| (group, unit, number)).collect::<Vec<Found>>()
    };
    let mut found: Vec<Found> = parts.par_iter().enumerate().flat_map_iter(in_part).collect();
    found.par_sort_unstable();
    let of_unit: Vec<&[Found]> = found.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).collect();
    let there = |&(group, unit): &(u32, u32)| layout.is_whole(out, group, unit);
    let before: BTreeSet<(u32, u32)> =
        if out.is_dir() { layout.begun_in(out).into_iter().filter(there).collect() } else { BTreeSet::new() };
    let of_parts = |(group, unit): &(u32, u32)| {
        of_unit.binary_search_by_key(&(*group, *unit), |found| (found[0].0, found[0].1)).is_ok()
    };
    let only_there = before.iter().filter(|unit| !of_parts(unit)).count() as u64;
    let missing = units.saturating_sub(of_unit.len() as u64 + only_there);
    let missing_names = match missing {
        0 => Vec::new(),
        _ => {
            let all = (0..)
                .zip(layout.groups())
                .flat_map(|(group, units)| (0..units).map(move |unit| (group, unit)));
            let missing = all.filter(|unit| !of_parts(unit) && !before.contains(unit));
            missing.take(NAMED).map(|(group, unit)| layout.name(group, unit)).collect()
        }
    };
    if missing > 0 && !partial {
        let (kind, parts) = (L::UNITS, parts.len());
        return Err(MergeError::Missing { missing, units, kind, parts, names: missing_names });
    }

    let doubled: Vec<&[Found]> = of_unit.iter().copied().filter(|parts| parts.len() > 1).collect();
    let compared = AtomicU64::new(0);
    doubled.par_iter().try_for_each(|found| {
        let files = |part: usize| layout.files(&parts[part], found[0].0, found[0].1);
        let first = files(found[0].2);
        found[1..].iter().try_for_each(|other| {
            let others = files(other.2);
            first.iter().zip(&others).try_for_each(|(a, b)| same_bytes(a, b))
        })?;
        on_event(Event::Compared { units: compared.fetch_add(1, Ordering::Relaxed) + 1 });
        Ok::<(), MergeError>(())
    })?;

    claim_as(out, L::MANIFEST, &read_text(&parts[0].join(L::MANIFEST), FileKind::Json)?)?;
    let wanted: Vec<&&[Found]> =
        of_unit.iter().filter(|found| !before.contains(&(found[0].0, found[0].1))).collect();
    on_event(Event::Started { units, whole: before.len() as u64 });
    let (linked, copied, bytes) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
    let tidied = Mutex::default();
    wanted.par_iter().try_for_each(|found| {
        let (group, unit, part) = found[0];
        let sources = layout.files(&parts[part], group, unit);
        // The file that is written last comes last here too.
        for source in sources.iter().rev() {
            let target = out.join(source.strip_prefix(&parts[part]).unwrap_or(source));
            match place(source, &target, copy, &tidied)? {
                Placed::Linked => linked.fetch_add(1, Ordering::Relaxed),
                Placed::Copied(size) => {
                    bytes.fetch_add(size, Ordering::Relaxed);
                    copied.fetch_add(1, Ordering::Relaxed)
                }
            };
        }
        on_event(Event::Made { bytes: bytes.load(Ordering::Relaxed) });
        Ok::<(), MergeError>(())
    })?;
    if missing == 0 {
        complete(out, layout, !wanted.is_empty(), on_event, finish)?;
    }
    Ok(Merged {
        kind: L::UNITS,
        units,
        merged: wanted.len() as u64,
        linked: linked.into_inner(),
        copied: copied.into_inner(),
        missing,
        missing_names,
        doubled: doubled.len() as u64,
        doubled_names: doubled.iter().take(NAMED).map(|found| layout.name(found[0].0, found[0].1)).collect(),
        complete: missing == 0,
    })
}

/// Whether all parts have the same arguments.
fn same_dataset(manifest: &'static str, parts: &[PathBuf]) -> Result<(), MergeError> {
    let first: Value = read_record(&parts[0].join(manifest))?;
    for part in &parts[1..] {
        if !part.join(manifest).is_file() {
            return Err(MergeError::NotAPart(part.clone()));
        }
        let other: Value = read_record(&part.join(manifest))?;
        if other != first {
            let (part, whole) =
                (part.clone(), || (manifest.to_owned(), "other text".to_owned(), "of its kind".to_owned()));
            let (field, found, expected) = first_difference(&other, &first).unwrap_or_else(whole);
            return Err(MergeError::OtherDataset { part, field, found, first: parts[0].clone(), expected });
        }
    }
    Ok(())
}

enum Placed {
    Linked,
    /// With so many bytes.
    Copied(u64),
}

/// Makes `source` appear as `target`. Folders in which files were copied are `tidied`.
fn place(
    source: &Path,
    target: &Path,
    copy: bool,
    tidied: &Mutex<BTreeSet<PathBuf>>,
) -> Result<Placed, MergeError> {
    // A hard link to a symbolic one would be the symbolic one.
    let is_file = || fs::symlink_metadata(source).is_ok_and(|metadata| metadata.is_file());
    if !copy && is_file() {
        let mut linked = fs::hard_link(source, target);
        if linked.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
            target.parent().map_or(Ok(()), create_folder)?;
            linked = fs::hard_link(source, target);
        }
        match linked {
            Ok(()) => return Ok(Placed::Linked),
            // An earlier merge was interrupted.
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                same_bytes(source, target)?;
                return Ok(Placed::Linked);
            }
            // Another disk, or a file system without links.
            Err(_) => {}
        }
    }
    target.parent().map_or(Ok(()), |folder| tidy(folder, tidied))?;
    let mut size = 0;
    until_kept(|| {
        write_atomically(target, |writer| {
            size = io::copy(&mut File::open(source)?, writer)?;
            Ok(())
        })
    })?;
    Ok(Placed::Copied(size))
}

/// Makes a folder ready for copies, once: what a merge that was killed has left there is removed.
fn tidy(folder: &Path, tidied: &Mutex<BTreeSet<PathBuf>>) -> Result<(), FileError> {
    let mut tidied = tidied.lock().unwrap_or_else(PoisonError::into_inner);
    if !tidied.contains(folder) {
        create_folder(folder)?;
        remove_partial(folder, |_, _| true)?;
        tidied.insert(folder.to_owned());
    }
    Ok(())
}

fn same_bytes(a: &Path, b: &Path) -> Result<(), MergeError> {
    let compare = || -> io::Result<bool> {
        let (mut left, mut right) = (File::open(a)?, File::open(b)?);
        if left.metadata()?.len() != right.metadata()?.len() {
            return Ok(false);
        }
        let (mut one, mut other) = (vec![0; 1 << 16], vec![0; 1 << 16]);
        loop {
            let read = left.read(&mut one)?;
            right.read_exact(&mut other[..read])?;
            if one[..read] != other[..read] {
                return Ok(false);
            }
            if read == 0 {
                return Ok(true);
            }
        }
    };
    match compare() {
        Ok(true) => Ok(()),
        Ok(false) => Err(MergeError::Differing(a.to_owned(), b.to_owned())),
        Err(error) => Err(RenderError::io(a, error).into()),
    }
}

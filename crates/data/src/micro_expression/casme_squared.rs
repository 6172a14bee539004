//! Micro-expressions of CAS(ME)² (Qu et al. 2018), excerpts of its long videos.
//!
//! Spreadsheet `CAS(ME)^2code_final.xlsx`, as for spotting; frames `sSS/SS_CODE*/img001.jpg` of the whole video, cropped ones
//! `sSS/SS_CODE*/img_1.jpg`, or videos `sSS/SS_CODE*.avi`. The clip `0401_2` is the second expression in the video 0401.

use std::path::{Path, PathBuf};

use super::apex_list::ApexList;
use super::classes::Coded;
use super::forms;
use super::frames::ClipFolders;
use super::intervals::ExpressionKind;
use super::intervals::casme_squared::{Expression, read_expressions};
use super::release::below_release;
use super::sheet::spreadsheet_files;
use super::{Annotation, ClipKind, ClipSource, DropReason, Dropped, Labels, MicroExpressionError};
use crate::listing;

pub(super) const KIND: ClipKind = ClipKind {
    releases: &["raw", "cropped"],
    ..ClipKind::new(
        "casme-squared",
        "CAS(ME)², micro-expressions in whole or cropped videos (default: those that are found)",
        read,
        folders,
    )
};

fn read(source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let (file, expressions) = expressions(source)?;
    let listed = ApexList::of(source, &[])?;
    let (mut annotations, mut dropped) = (Vec::new(), Vec::new());
    let all = expressions.len();
    let micro: Vec<Expression> =
        expressions.into_iter().filter(|e| e.interval.kind == ExpressionKind::Micro).collect();
    let notes = vec![format!("{} macro-expressions are left out", all - micro.len())];
    for Expression { subject, clip, interval } in micro {
        let (label, action_units) = (interval.label, interval.action_units);
        let coded = Coded { kind: KIND.name, emotion: &label, action_units: &action_units, objective: "" };
        let class = source.classes.of(&coded).ok_or(DropReason::Label);
        // Frames are numbered from 1.
        let [onset, apex, offset] = [Some(interval.onset), interval.apex, Some(interval.offset)]
            .map(|frame| frame.and_then(|frame| u64::try_from(frame).ok()).unwrap_or_default());
        let usable = match (apex, offset) {
            (_, offset) if offset <= onset => Err(DropReason::FramesOutOfOrder),
            (apex, _) if apex > onset => Ok(Some(apex)),
            (apex, _) => {
                let reason = if apex == 0 { DropReason::ApexUnknown } else { DropReason::ApexNotAfterOnset };
                listed.instead(source, &subject, &clip, [onset, offset], reason)?
            }
        };
        match class.and_then(|class| Ok((class, usable?))) {
            Ok((class, apex)) => {
                let offset = offset.max(apex.unwrap_or_default());
                annotations.push(Annotation {
                    subject,
                    clip,
                    class,
                    label,
                    action_units,
                    onset,
                    apex,
                    offset,
                });
            }
            Err(reason) => dropped.push(Dropped { subject, clip, label, reason }),
        }
    }
    Ok(Labels { dataset: KIND.name.to_owned(), file: Some(file), annotations, dropped, notes })
}

/// The expressions, and the file that lists them. Only macro-expressions are repaired in the published one.
fn expressions(source: &ClipSource) -> Result<(PathBuf, Vec<Expression>), MicroExpressionError> {
    if let Some(path) = &source.annotations {
        return Ok((path.clone(), read_expressions(path)?.0));
    }
    for path in spreadsheet_files(&source.dir, &["xlsx", "xls"])? {
        match read_expressions(&path) {
            Err(MicroExpressionError::Columns { .. }) => {}
            found => return Ok((path, found?.0)),
        }
    }
    Err(MicroExpressionError::NoAnnotations {
        kind: KIND.name,
        dir: source.dir.clone(),
        expected: forms::CASME_SQUARED,
        found: format!(
            "{}. Put it there, or give it with `annotations` casme-squared:FILE",
            listing::contents(&source.dir)
        ),
    })
}

/// Places of each release in the unpacked archives.
const PLACES: [(&str, &str); 4] = [
    ("rawpic", "raw"),
    ("rawvideo", "raw"),
    ("longVideoFaceCropped", "cropped"),
    ("CAS(ME)2_longVideoFaceCropped/longVideoFaceCropped", "cropped"),
];

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    below_release(source, &PLACES, "img_", annotations, |root: &Path, annotation| {
        let subject = root.join(&annotation.subject);
        let code = annotation.clip.split('_').next().unwrap_or_default();
        // 15_0401 and a word, which is misspelt once.
        let is_video = |folder: &PathBuf| {
            listing::name(folder).split_once('_').is_some_and(|(_, name)| name.starts_with(code))
        };
        let there = || {
            let mut there = listing::folders(&subject).ok()?;
            there.extend(listing::files(&subject, listing::VIDEOS).ok()?);
            there.into_iter().find(is_video)
        };
        let expected = format!("{}_{code}", annotation.subject.trim_start_matches('s'));
        [there().unwrap_or_else(|| subject.join(expected))]
    })
}

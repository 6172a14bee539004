//! Clips of micro-expressions with true flow, as pairs of onset and apex: those of `srflow mer synth`, and any in their form.
//! `clips.csv` lists them; beside a clip's folder `s03/c05/` are the flow `s03/c05_flow.flo` and, if there are some, the mask of the head
//! `s03/c05_mask.png` and the parts of the flow, `s03/c05_head_flow.flo` and `s03/c05_expression_flow.flo`.

use std::path::{Path, PathBuf};

use super::gaps::Gaps;
use super::{DatasetError, Entry, Kind, Request, Split, Truth};
use crate::listing;
use crate::micro_expression::{Clip, ClipDataset, ClipSource};

pub(super) const KIND: Kind = Kind {
    name: "clips",
    options: &[],
    about: "clips of srflow mer synth, from onset to apex",
    default_split: Split::All,
    truth: Truth::USUAL,
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    if split != Split::All {
        return Err(request.no_split("all"));
    }
    // A pair needs no other frames than onset and apex.
    let found = ClipDataset::open(&ClipSource::plain(dir), true).map_err(Box::new)?;
    found.missing.iter().filter(|clip| clip.dropped).for_each(|clip| gaps.push(clip.to_string()));
    Ok(found.clips.iter().filter_map(|clip| pair(clip, gaps)).collect())
}

fn pair(clip: &Clip, gaps: &mut Gaps) -> Option<Entry> {
    let annotation = &clip.annotation;
    let Some(apex) = annotation.apex else {
        gaps.push(format!("clip {} has no apex in its row", annotation.clip));
        return None;
    };
    let frame = |number| clip.frame(number).map(Path::to_owned);
    let (frame1, frame2) = (frame(annotation.onset)?, frame(apex)?);
    let flow = beside(clip, "flow", listing::FLOWS);
    if flow.is_none() {
        gaps.push(format!("clip {} has no flow {}_flow.*", annotation.clip, annotation.clip));
    }
    let part = |part| beside(clip, part, listing::FLOWS).map(|path| Box::new(path.into()));
    Some(Entry {
        flow: flow.map(Into::into),
        head_flow: part("head_flow"),
        expression_flow: part("expression_flow"),
        mask: beside(clip, "mask", listing::MASKS).map(Into::into),
        ..Entry::bare(annotation.clip.clone(), frame1, frame2)
    })
}

/// The file `c05_PART.EXTENSION` beside the folder `c05`.
fn beside(clip: &Clip, part: &str, extensions: &[&str]) -> Option<PathBuf> {
    let stem = listing::name(&clip.folder);
    let file = |extension: &&str| clip.folder.with_file_name(format!("{stem}_{part}.{extension}"));
    extensions.iter().map(file).find(|file| file.is_file())
}

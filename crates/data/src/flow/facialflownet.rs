//! FacialFlowNet: `image/{facial,head}/{train,val,test}/EMOTION/SUBJECT/*.jpg`, `flow/…/*.flo` in the same folders, one fewer than
//! the images, and `mask/{train,val,test}/EMOTION/SUBJECT/*.npy`. `facial` is the whole motion, `head` the rigid head motion.
//! Images, flows and masks are matched by sorted order.
//! Layout: RIA1159/FacialFlowNet, core/datasets.py, `FacialFlow`.

use std::path::Path;

use super::gaps::Gaps;
use super::layout;
use super::{DatasetError, Entry, Kind, Request, Split, Truth};
use crate::listing;

pub(super) const KIND: Kind = Kind {
    name: "facialflownet",
    options: &[&["facial", "head"]],
    about: "FacialFlowNet",
    default_split: Split::Test,
    truth: Truth { max_flow: 1000.0, ..Truth::USUAL },
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let motion = request.options[0];
    let parts: &[&str] = match split {
        Split::Train => &["train"],
        Split::Val => &["val"],
        Split::Test => &["test"],
        Split::All => &["train", "val", "test"],
    };
    let [images, flows] = ["image", "flow"].map(|folder| format!("{folder}/{motion}"));
    let mut entries = Vec::new();
    for place in layout::places(&request.title, dir, parts, [&images, &flows], gaps)? {
        entries.extend(sequence(dir, motion, &place, gaps)?);
    }
    Ok(entries)
}

/// The pairs of one subject with one emotion, e.g. `test/happy/012`.
fn sequence(dir: &Path, motion: &str, place: &str, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let images = listing::files(&dir.join("image").join(motion).join(place), &["jpg", "jpeg", "png"])?;
    let flow_dir = dir.join("flow").join(motion).join(place);
    let flows = listing::files_if_there(&flow_dir, &["flo"])?;
    let masks = listing::files_if_there(&dir.join("mask").join(place), &["npy"])?;
    let pairs = images.len().saturating_sub(1);
    if flows.len() != pairs {
        let (found, dir) = (flows.len(), gaps.shown(&flow_dir));
        gaps.push(format!("{place}: {} images need {pairs} flows, {dir} holds {found}", images.len()));
        return Ok(Vec::new());
    }
    if !masks.is_empty() && masks.len() < pairs {
        gaps.push(format!(
            "{place}: {} images need {pairs} masks, mask/{place} holds {}",
            images.len(),
            masks.len()
        ));
        return Ok(Vec::new());
    }
    let mut masks = masks.into_iter();
    let entry = |(pair, flow): (&[std::path::PathBuf], std::path::PathBuf)| {
        let [frame1, frame2] = pair else { return None };
        Some(Entry {
            flow: Some(flow.into()),
            mask: masks.next().map(Into::into),
            ..Entry::bare(place.to_owned(), frame1.clone(), frame2.clone())
        })
    };
    Ok(images.windows(2).zip(flows).filter_map(entry).collect())
}

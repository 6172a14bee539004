//! Pairs side by side in one folder, as in FlyingChairs: `NAME_img1`, `NAME_img2`, `NAME_flow`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::file::Folders;
use super::gaps::Gaps;
use super::layout;
use super::{DatasetError, Entry, Occlusion};
use crate::listing;

/// Parts of a triplet by the suffix of their stem, and the extensions that each may have.
const PARTS: [(&str, &[&str]); 6] = [
    ("_img1", listing::IMAGES),
    ("_img2", listing::IMAGES),
    ("_flow", listing::FLOWS),
    ("_mask", listing::MASKS),
    ("_occlusion", listing::IMAGES),
    ("_regions", listing::IMAGES),
];

/// The pairs of `dir` in natural order. Either all have a flow or none; anything else is a gap.
pub fn triplets(dir: &Path, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let mut found: [BTreeMap<String, PathBuf>; PARTS.len()] = Default::default();
    for (files, (suffix, endings)) in found.iter_mut().zip(PARTS) {
        for path in listing::files(dir, endings)? {
            if let Some(name) = listing::stem(&path).strip_suffix(suffix) {
                layout::insert_once(files, name.to_owned(), path, gaps);
            }
        }
    }
    let names: BTreeSet<String> = found.iter().flat_map(BTreeMap::keys).cloned().collect();
    let mut names = Vec::from_iter(names);
    names.sort_by(|a, b| listing::natural_order(a, b));
    let with_flow = !found[2].is_empty();
    let mut entries = Vec::with_capacity(names.len());
    let mut folders = Folders::default();
    for name in names {
        let [frame1, frame2, flow, mask, occlusion, regions] =
            found.each_mut().map(|files| files.remove(&name));
        let missing = [
            ("_img1", frame1.is_none()),
            ("_img2", frame2.is_none()),
            ("_flow", with_flow && flow.is_none()),
        ];
        for (suffix, _) in missing.iter().filter(|(_, is_missing)| *is_missing) {
            gaps.push(format!("{name}: no {}.*", gaps.shown(&dir.join(format!("{name}{suffix}")))));
        }
        if let (Some(frame1), Some(frame2)) = (frame1, frame2) {
            let occlusion = occlusion.map(|path| Occlusion::Picture(folders.file(path)));
            entries.push(Entry {
                frame: name,
                flow: flow.map(|path| folders.file(path)),
                mask: mask.map(|path| folders.file(path)),
                occlusion,
                regions: regions.map(|path| folders.file(path)),
                ..Entry::bare(String::new(), folders.file(frame1), folders.file(frame2))
            });
            gaps.listed(1);
        }
    }
    Ok(entries)
}

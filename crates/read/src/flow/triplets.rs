//! Pairs that lie side by side in one folder, as FlyingChairs has them: `NAME_img1`, `NAME_img2`, `NAME_flow`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::gaps::Gaps;
use super::listing;
use super::{DatasetError, Entry, Occlusion};

/// Parts of a triplet by the end of their stem, and the endings that each may have.
const PARTS: [(&str, &[&str]); 5] = [
    ("_img1", listing::IMAGES),
    ("_img2", listing::IMAGES),
    ("_flow", listing::FLOWS),
    ("_mask", listing::MASKS),
    ("_occlusion", listing::IMAGES),
];

/// The pairs of `dir` in natural order of their names. Either all have a flow or none; anything else is a gap.
pub fn triplets(dir: &Path, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let mut found: BTreeMap<String, [Option<PathBuf>; 5]> = BTreeMap::new();
    let mut names = Vec::new();
    for (part, (suffix, endings)) in PARTS.iter().enumerate() {
        for path in listing::files(dir, endings)? {
            let stem = listing::stem(&path);
            let Some(name) = stem.strip_suffix(suffix) else { continue };
            let files = found.entry(name.to_owned()).or_insert_with(|| {
                names.push(name.to_owned());
                Default::default()
            });
            match &files[part] {
                Some(other) => gaps.push(format!(
                    "{} is there twice, also as {}",
                    gaps.shown(&path),
                    listing::name(other)
                )),
                None => files[part] = Some(path),
            }
        }
    }
    names.sort_by(|a, b| listing::natural_order(a, b));
    let with_flow = found.values().any(|[_, _, flow, ..]| flow.is_some());
    let mut entries = Vec::new();
    for name in names {
        let Some([frame1, frame2, flow, mask, occlusion]) = found.remove(&name) else { continue };
        let missing = [
            ("_img1", frame1.is_none()),
            ("_img2", frame2.is_none()),
            ("_flow", with_flow && flow.is_none()),
        ];
        for (suffix, _) in missing.iter().filter(|(_, is_missing)| *is_missing) {
            gaps.push(format!("{name}: no {}.*", gaps.shown(&dir.join(format!("{name}{suffix}")))));
        }
        if let (Some(frame1), Some(frame2)) = (frame1, frame2) {
            let occlusion = occlusion.map(Occlusion::Picture);
            entries.push(Entry { scene: String::new(), frame: name, frame1, frame2, flow, mask, occlusion });
        }
    }
    Ok(entries)
}

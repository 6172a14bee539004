//! SMIC-HS (Li et al. 2013), extended or short recordings.
//!
//! Extended: spreadsheet `SMIC-HS-E_annotation.xlsx`, sheet HS; frames `SMIC_HS_E/sSS/CLIP/imageFRAME.jpg`. Short: frames
//! `HS/SUBJECT/micro/CLASS/CLIP/*`, from onset to offset. A subject below 10 is `1` in the clip names of one form and `01` in
//! those of the other, so names are compared by their parts.
//!
//! The class is taken from the clip's name: the spreadsheet's column lists s18_sur_03 as negative. There is no annotated apex;
//! a list of apex frames, as published with CapsuleNet for micro-expressions (Quang et al. 2019), is read if present.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::classes::Coded;
use super::forms;
use super::frames::{ClipFolders, numbered_frames};
use super::sheet::{Table, read_csv, read_spreadsheet, spreadsheet_in};
use super::{
    Annotation, ClipKind, ClipSource, DropReason, Dropped, EmotionClass, Labels, MicroExpressionError,
};
use crate::listing;

pub(super) const KIND: ClipKind = ClipKind {
    name: "smic",
    releases: &[],
    about: "SMIC-HS, extended or short",
    published: Some([65, 51, 41]),
    megc2019: Some([70, 51, 43]),
    labels: read,
    folders,
};

const APEX_LISTS: [&str; 2] = ["smic_apex.csv", "data_apex.csv"];

/// The clips of MEGC 2019's list that CapsuleNet, and with it the paper, leave out.
const NOT_IN_APEX_LIST: [Key; 7] = [
    Key { subject: 1, class: EmotionClass::Negative, number: 2 },
    Key { subject: 3, class: EmotionClass::Negative, number: 3 },
    Key { subject: 3, class: EmotionClass::Negative, number: 20 },
    Key { subject: 4, class: EmotionClass::Negative, number: 5 },
    Key { subject: 4, class: EmotionClass::Negative, number: 6 },
    Key { subject: 2, class: EmotionClass::Surprise, number: 5 },
    Key { subject: 9, class: EmotionClass::Surprise, number: 2 },
];

/// The parts of a clip's name, e.g. `s01_ne_02` and `s1_ne_02`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    subject: u32,
    class: EmotionClass,
    number: u32,
}

impl Key {
    fn of(clip: &str) -> Option<Self> {
        let mut parts = clip.trim().split('_');
        let subject = parts.next()?.strip_prefix(['s', 'S'])?.parse().ok()?;
        let class = match parts.next()? {
            "ne" => EmotionClass::Negative,
            "po" => EmotionClass::Positive,
            "sur" => EmotionClass::Surprise,
            _ => return None,
        };
        let number = parts.next()?.parse().ok()?;
        parts.next().is_none().then_some(Self { subject, class, number })
    }

    /// The number of its class; its emotion is given by its name.
    fn class(self, source: &ClipSource) -> Option<usize> {
        source.classes.of(&Coded {
            kind: "smic",
            emotion: self.class.name(),
            action_units: "",
            objective: "",
        })
    }

    fn subject_name(self) -> String {
        format!("{:02}", self.subject)
    }

    /// For maps; classes have no order.
    fn order(self) -> (u32, u8, u32) {
        (self.subject, self.class as u8, self.number)
    }
}

fn read(source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let Rows { file, mut annotations, dropped } = if source.annotations.is_some() {
        of_table(source, read_spreadsheet(&forms::SMIC, source)?)?
    } else if let Some(table) = spreadsheet_in(&forms::SMIC, &source.dir)? {
        of_table(source, table)?
    } else if let Some(root) = short_root(&source.dir)? {
        of_short_clips(source, &root)?
    } else {
        of_table(source, read_spreadsheet(&forms::SMIC, source)?)?
    };
    let beside = || APEX_LISTS.iter().map(|name| source.dir.join(name)).find(|path| path.is_file());
    if let Some(list) = source.apex_list.clone().or_else(beside) {
        add_apexes(&list, &mut annotations)?;
    }
    Ok(Labels { dataset: "smic".to_owned(), file, annotations, dropped })
}

/// The annotations of the spreadsheet or the clips' folders.
#[derive(Default)]
struct Rows {
    file: Option<PathBuf>,
    annotations: Vec<Annotation>,
    dropped: Vec<Dropped>,
}

impl Rows {
    fn keep(&mut self, key: Key, class: usize, clip: String, label: String, [onset, offset]: [u64; 2]) {
        self.annotations.push(Annotation {
            subject: key.subject_name(),
            clip,
            class,
            label,
            action_units: String::new(),
            onset,
            apex: None,
            offset,
        });
    }

    fn drop(&mut self, key: Key, clip: String, label: String, reason: DropReason) {
        self.dropped.push(Dropped { subject: key.subject_name(), clip, label, reason });
    }

    /// The class of a clip; one that has none, or is left out of the published list, is dropped.
    fn class(&mut self, source: &ClipSource, key: Key, clip: &str, label: &str) -> Option<usize> {
        let left_out = !source.classes.are_of_megc2019() && NOT_IN_APEX_LIST.contains(&key);
        let class = match left_out {
            true => Err(DropReason::NotInApexList),
            false => key.class(source).ok_or(DropReason::Label),
        };
        class.map_err(|reason| self.drop(key, clip.to_owned(), label.to_owned(), reason)).ok()
    }
}

fn of_table(source: &ClipSource, table: Table) -> Result<Rows, MicroExpressionError> {
    let mut rows = Rows::default();
    for row in table.rows() {
        let clip = row.filled("Filename")?.to_owned();
        let label = row.text("Emotion").to_owned();
        let Some(key) = Key::of(&clip) else {
            return Err(row.wrong(format!("Filename: expected a name like s20_ne_01, found `{clip}`")));
        };
        let subject = row.filled("Subject")?;
        if subject.trim_start_matches(['s', 'S']).parse() != Ok(key.subject) {
            return Err(row.wrong(format!("clip {clip} is listed under subject `{subject}`")));
        }
        let Some(class) = rows.class(source, key, &clip, &label) else { continue };
        let (onset, offset) = (row.frame("OnsetF")?, row.frame("OffsetF")?);
        if offset <= onset {
            return Err(row.wrong(format!("OffsetF: expected a frame after OnsetF {onset}, found {offset}")));
        }
        rows.keep(key, class, clip, label, [onset, offset]);
    }
    rows.file = Some(table.path);
    Ok(rows)
}

/// The parent of the subjects' folders of the short recordings, if present.
fn short_root(dir: &Path) -> Result<Option<PathBuf>, MicroExpressionError> {
    for place in ["", "HS", "SMIC_all_cropped/HS", "SMIC_all_raw/HS"] {
        let root = dir.join(place);
        if root.is_dir() && listing::folders(&root)?.iter().any(|subject| subject.join("micro").is_dir()) {
            return Ok(Some(root));
        }
    }
    Ok(None)
}

/// The clips' folders of the short recordings.
fn short_clips(root: &Path) -> Result<Vec<(Key, PathBuf)>, MicroExpressionError> {
    let mut clips = Vec::new();
    for subject in listing::folders(root)?.iter().map(|subject| subject.join("micro")) {
        for class in folders_if_there(&subject)? {
            clips.extend(clips_in(&class)?);
        }
    }
    Ok(clips)
}

/// The clips' folders of the extended recordings.
fn extended_clips(root: &Path) -> Result<Vec<(Key, PathBuf)>, MicroExpressionError> {
    let mut clips = Vec::new();
    for subject in folders_if_there(root)? {
        clips.extend(clips_in(&subject)?);
    }
    Ok(clips)
}

/// The folders of `dir` with names of clips.
fn clips_in(dir: &Path) -> Result<impl Iterator<Item = (Key, PathBuf)> + use<>, MicroExpressionError> {
    let folders = listing::folders(dir)?;
    Ok(folders.into_iter().filter_map(|clip| Some((Key::of(&listing::name(&clip))?, clip))))
}

fn folders_if_there(dir: &Path) -> Result<Vec<PathBuf>, MicroExpressionError> {
    Ok(if dir.is_dir() { listing::folders(dir)? } else { Vec::new() })
}

fn of_short_clips(source: &ClipSource, root: &Path) -> Result<Rows, MicroExpressionError> {
    let mut rows = Rows::default();
    for (key, folder) in short_clips(root)? {
        let clip = listing::name(&folder);
        let label = folder.parent().map(listing::name).unwrap_or_default();
        let Some(class) = rows.class(source, key, &clip, &label) else { continue };
        let frames = numbered_frames(&folder)?;
        let (Some((&onset, _)), Some((&offset, _))) = (frames.first_key_value(), frames.last_key_value())
        else {
            rows.drop(key, clip, label, DropReason::FramesMissing);
            continue;
        };
        rows.keep(key, class, clip, label, [onset, offset]);
    }
    Ok(rows)
}

/// Sets the apex of each clip from a list with the columns data, clip and apex_frame; rows of other datasets are ignored.
fn add_apexes(list: &Path, annotations: &mut [Annotation]) -> Result<(), MicroExpressionError> {
    let table = read_csv("smic", list, &["data", "clip", "apex_frame"])?;
    let mut apexes = BTreeMap::new();
    for row in table.rows().filter(|row| row.text("data").eq_ignore_ascii_case("smic")) {
        let Some(key) = Key::of(row.text("clip")) else {
            return Err(
                row.wrong(format!("clip: expected a name like s20_ne_01, found `{}`", row.text("clip")))
            );
        };
        apexes.insert(key.order(), (row, row.frame("apex_frame")?));
    }
    for annotation in annotations {
        let apex = Key::of(&annotation.clip).and_then(|key| apexes.get(&key.order()));
        if let Some(&(row, apex)) = apex {
            let Annotation { onset, offset, clip, .. } = annotation;
            if apex <= *onset || apex > *offset {
                return Err(row.wrong(format!(
                    "apex_frame: expected a frame after the onset {onset} and not after the offset {offset} of {clip}, \
                     found {apex}"
                )));
            }
            annotation.apex = Some(apex);
        }
    }
    Ok(())
}

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let dir = &source.dir;
    let mut found = BTreeMap::new();
    let (root, form) = match short_root(dir)? {
        Some(root) => {
            found.extend(short_clips(&root)?.into_iter().map(|(key, folder)| (key.order(), folder)));
            (root, "short")
        }
        None => {
            let places = ["", "SMIC_HS_E", "HS_long/SMIC_HS_E"].map(|place| dir.join(place));
            let holds_clips = |root: &&PathBuf| !extended_clips(root).unwrap_or_default().is_empty();
            let Some(root) = places.iter().find(holds_clips) else {
                let found = listing::contents(dir);
                return Err(MicroExpressionError::NoFolders {
                    kind: "smic",
                    looked_for: format!(
                        "{} or {}",
                        places[2].join("s01/s1_ne_01").display(),
                        dir.join("HS/s1/micro/negative").display()
                    ),
                    found: format!("{found}. Give the folder that contains HS_long or HS"),
                });
            };
            found.extend(extended_clips(root)?.into_iter().map(|(key, folder)| (key.order(), folder)));
            (root.clone(), "extended")
        }
    };
    let expected =
        |annotation: &Annotation| root.join(format!("s{}", annotation.subject)).join(&annotation.clip);
    let folder = |annotation: &Annotation| {
        let key = Key::of(&annotation.clip).map(Key::order);
        key.and_then(|key| found.get(&key)).cloned().unwrap_or_else(|| expected(annotation))
    };
    Ok(ClipFolders { folders: annotations.iter().map(folder).collect(), root: root.clone(), form })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_and_without_zeros_are_the_same_clip() {
        let key = Key::of("s01_sur_03").unwrap();
        assert_eq!(key, Key::of("s1_sur_03").unwrap());
        assert_eq!((key.subject, key.class, key.number), (1, EmotionClass::Surprise, 3));
        for name in ["", "s1", "1_ne_01", "s1_xx_01", "s1_ne_", "s1_ne_01_x", "sx_ne_01"] {
            assert_eq!(Key::of(name), None, "{name}");
        }
    }
}

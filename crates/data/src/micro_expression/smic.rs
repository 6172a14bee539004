//! SMIC (Li et al. 2013): SMIC-HS, SMIC-VIS and SMIC-NIR, extended or short recordings.
//!
//! Extended: spreadsheet `SMIC-HS-E_annotation.xlsx`, sheet HS; frames `SMIC_HS_E/sSS/CLIP/imageFRAME.jpg`. Short: frames
//! `HS/SUBJECT/micro/CLASS/CLIP/*`, from onset to offset. A subject below 10 is `1` in the clip names of one form and `01` in
//! those of the other, so names are compared by their parts. VIS and NIR have the same names below folders of their own.
//!
//! The class is taken from the clip's name: the spreadsheet's column lists s18_sur_03 as negative. There is no annotated apex;
//! a list of apex frames, as published with CapsuleNet for micro-expressions (Quang et al. 2019), is read if present.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::apex_list::ApexList;
use super::classes::Coded;
use super::forms::{self, Form};
use super::frames::{ClipFolders, numbered_frames};
use super::sheet::{Row, Table, none_fits, read_form, read_spreadsheet, spreadsheet_files, spreadsheet_in};
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
    takes_apex_list: true,
    labels: |source| read(&HS, source),
    folders: |source, annotations| folders(&HS, source, annotations),
};

pub(super) const VIS_KIND: ClipKind = ClipKind::new(
    "smic-vis",
    "SMIC-VIS, extended or short",
    |source| read(&VIS, source),
    |source, annotations| folders(&VIS, source, annotations),
);

pub(super) const NIR_KIND: ClipKind = ClipKind::new(
    "smic-nir",
    "SMIC-NIR, extended or short",
    |source| read(&NIR, source),
    |source, annotations| folders(&NIR, source, annotations),
);

/// What the recordings of a camera are called.
struct Camera {
    form: &'static Form,
    /// Part of the spreadsheet's name, where its columns are those of the other cameras.
    spreadsheet: &'static str,
    /// Where spreadsheets are.
    annotations: &'static [&'static str],
    /// Places of the subjects' folders.
    extended: &'static [&'static str],
    short: &'static [&'static str],
}

const HS: Camera = Camera {
    form: &forms::SMIC,
    spreadsheet: "",
    annotations: &[""],
    extended: &["", "SMIC_HS_E", "HS_long/SMIC_HS_E"],
    short: &["", "HS", "SMIC_all_cropped/HS", "SMIC_all_raw/HS"],
};

const VIS: Camera = Camera {
    form: &forms::SMIC_VIS,
    spreadsheet: "VIS",
    annotations: &["", "VIS_long", "SMIC-E_raw image/VIS_long"],
    extended: &[
        "",
        "VIS",
        "SMIC-VIS-E/VIS",
        "VIS_long/SMIC-VIS-E/VIS",
        "SMIC-E_raw image/VIS_long/SMIC-VIS-E/VIS",
        "VIS_long/SMIC_VIS_E",
    ],
    short: &["", "VIS", "SMIC_all_cropped/VIS", "SMIC_all_raw/VIS"],
};

const NIR: Camera = Camera {
    form: &forms::SMIC_NIR,
    spreadsheet: "NIR",
    annotations: &["", "NIR_long", "SMIC-E_raw image/NIR_long"],
    extended: &[
        "",
        "NIR",
        "SMIC-NIR-E/NIR",
        "NIR_long/SMIC-NIR-E/NIR",
        "SMIC-E_raw image/NIR_long/SMIC-NIR-E/NIR",
        "NIR_long/SMIC_NIR_E",
    ],
    short: &["", "NIR", "SMIC_all_cropped/NIR", "SMIC_all_raw/NIR"],
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

fn read(camera: &Camera, source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let Rows { file, mut annotations, dropped } = if source.annotations.is_some() {
        of_table(source, read_spreadsheet(camera.form, source)?)?
    } else if let Some(table) = camera.spreadsheet_in(&source.dir)? {
        of_table(source, table)?
    } else if let Some(root) = camera.short_root(&source.dir)? {
        of_short_clips(source, &root)?
    } else {
        return Err(none_fits(camera.form, &source.dir));
    };
    let beside = if source.kind == &KIND { &APEX_LISTS[..] } else { &[] };
    let apexes = ApexList::of(source, beside)?;
    for Annotation { subject, clip, onset, offset, apex, .. } in &mut annotations {
        *apex = apexes.apex(subject, clip, [*onset, *offset])?;
    }
    let dataset = source.kind.name.to_owned();
    Ok(Labels { dataset, file, annotations, dropped, notes: Vec::new() })
}

impl Camera {
    fn spreadsheet_in(&self, dir: &Path) -> Result<Option<Table>, MicroExpressionError> {
        if self.spreadsheet.is_empty() {
            return spreadsheet_in(self.form, dir);
        }
        for place in self.annotations {
            let place = dir.join(place);
            let files =
                if place.is_dir() { spreadsheet_files(&place, &["xlsx", "xls", "csv"])? } else { Vec::new() };
            let named = |path: &&PathBuf| listing::name(path).to_uppercase().contains(self.spreadsheet);
            for path in files.iter().filter(named) {
                match read_form(self.form, path) {
                    Err(MicroExpressionError::Columns { .. }) => {}
                    table => return table.map(Some),
                }
            }
        }
        Ok(None)
    }

    /// The parent of the subjects' folders of the short recordings, if present.
    fn short_root(&self, dir: &Path) -> Result<Option<PathBuf>, MicroExpressionError> {
        for place in self.short {
            let root = dir.join(place);
            if root.is_dir() && listing::folders(&root)?.iter().any(|subject| subject.join("micro").is_dir())
            {
                return Ok(Some(root));
            }
        }
        Ok(None)
    }
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
        let listed = source.kind == &KIND;
        let left_out = listed && !source.classes.are_of_megc2019() && NOT_IN_APEX_LIST.contains(&key);
        let class = match left_out {
            true => Err(DropReason::NotInApexList),
            false => key.class(source).ok_or(DropReason::Label),
        };
        class.map_err(|reason| self.drop(key, clip.to_owned(), label.to_owned(), reason)).ok()
    }
}

fn of_table(source: &ClipSource, table: Table) -> Result<Rows, MicroExpressionError> {
    let mut rows = Rows::default();
    // The sheets of VIS and NIR end with notes.
    let is_clip = |row: &Row| !row.text("Filename").is_empty() && !row.text("OnsetF").is_empty();
    let notes = |row: &Row| source.kind != &KIND && !is_clip(row);
    for row in table.rows().filter(|row| !notes(row)) {
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

fn folders(
    camera: &Camera,
    source: &ClipSource,
    annotations: &[Annotation],
) -> Result<ClipFolders, MicroExpressionError> {
    let dir = &source.dir;
    let mut found = BTreeMap::new();
    let (root, form) = match camera.short_root(dir)? {
        Some(root) => {
            found.extend(short_clips(&root)?.into_iter().map(|(key, folder)| (key.order(), folder)));
            (root, "short")
        }
        None => {
            let places: Vec<PathBuf> = camera.extended.iter().map(|place| dir.join(place)).collect();
            let holds_clips = |root: &&PathBuf| !extended_clips(root).unwrap_or_default().is_empty();
            let Some(root) = places.iter().find(holds_clips) else {
                let short = camera.short[1];
                return Err(MicroExpressionError::NoFolders {
                    kind: source.kind.name,
                    looked_for: format!(
                        "{} or {}",
                        places[2].join("s01/s1_ne_01").display(),
                        dir.join(short).join("s1/micro/negative").display()
                    ),
                    found: format!(
                        "{}. Give the folder that contains {short}_long or {short}",
                        listing::contents(dir)
                    ),
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
    let folders = annotations.iter().map(folder).collect();
    Ok(ClipFolders { folders, root: root.clone(), form, alone: false })
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

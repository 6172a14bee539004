//! Spreadsheets with one coded clip per row: onset, apex, offset, action units and emotion. Those of most datasets differ only in the
//! names of their columns and emotions.

use std::collections::BTreeMap;
use std::path::Path;

use super::apex_list::ApexList;
use super::classes::Coded;
use super::forms::{self, Form};
use super::sheet::{Row, Table, read_spreadsheet, read_spreadsheets, spreadsheet_in};
use super::{Annotation, ClipSource, DropReason, Dropped, Labels, MicroExpressionError};

/// The format of one dataset's spreadsheet.
pub struct Coding {
    pub form: &'static Form,
    /// Whether the clips are in several spreadsheets, which are read together.
    pub several_files: bool,
    /// Columns.
    pub subject: &'static str,
    pub clip: &'static str,
    pub onset: &'static str,
    /// `None` where the dataset does not annotate it.
    pub apex: Option<&'static str>,
    pub offset: &'static str,
    pub action_units: &'static str,
    pub emotion: &'static str,
    /// Number of digits in a subject's name: spreadsheets drop leading zeros.
    pub subject_digits: usize,
    /// Whether the column of clips names their videos, in any case. A clip's own name is the video's and the onset.
    pub of_videos: bool,
    /// All that there are; if empty, any.
    pub emotions: &'static [&'static str],
    /// Name of the emotions in messages.
    pub emotions_called: &'static str,
    /// Whether a clip may have several emotions.
    pub several_emotions: bool,
    /// Whether frames that are no numbers or in the wrong order drop their row instead of being an error.
    pub frames_may_be_wrong: bool,
    pub repairs: &'static [Repair],
    pub objective: Objective,
}

impl Coding {
    /// With the names of most.
    pub const COMMON: Self = Self {
        form: &forms::CASME2,
        several_files: false,
        subject: "Subject",
        clip: "Filename",
        onset: "OnsetFrame",
        apex: Some("ApexFrame"),
        offset: "OffsetFrame",
        action_units: "Action Units",
        emotion: "Estimated Emotion",
        subject_digits: 1,
        of_videos: false,
        emotions: &[],
        emotions_called: "",
        several_emotions: false,
        frames_may_be_wrong: true,
        repairs: &[],
        objective: Objective::None,
    };
}

/// A row that is known to be wrong.
pub struct Repair {
    pub subject: &'static str,
    pub clip: &'static str,
    /// Onset, apex and offset.
    pub wrong: [u64; 3],
    pub right: [u64; 3],
}

/// Where the objective classes of clips (Davison, Merghani and Yap 2018) are stored.
pub enum Objective {
    None,
    /// In a column of the spreadsheet, which older releases lack.
    Column(&'static str),
    /// In a column, as Roman numerals.
    Roman(&'static str),
    /// In a separate spreadsheet.
    Spreadsheet(&'static Form),
}

/// Reads the spreadsheet of `source`.
pub fn read(coding: &Coding, source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let tables = match coding.several_files {
        true => read_spreadsheets(coding.form, source)?,
        false => vec![read_spreadsheet(coding.form, source)?],
    };
    let objective = match coding.objective {
        Objective::Spreadsheet(form) if source.classes.need_objective() => {
            objective_classes(form, coding, source)?
        }
        _ => BTreeMap::new(),
    };
    let reading = Reading { coding, source, objective, listed: ApexList::of(source, &[])? };
    let mut labels = Labels {
        dataset: coding.form.kind.to_owned(),
        file: tables.first().map(|table: &Table| table.path.clone()),
        ..Labels::default()
    };
    let mut repaired = 0;
    for row in tables.iter().flat_map(Table::rows) {
        match reading.clip(row, &mut repaired)? {
            Ok(annotation) => labels.annotations.push(annotation),
            Err(row) => labels.dropped.push(row),
        }
    }
    if repaired > 0 {
        labels.notes.push(format!("{repaired} rows with wrong frames are repaired"));
    }
    Ok(labels)
}

struct Reading<'a> {
    coding: &'a Coding,
    source: &'a ClipSource,
    /// Objective classes by subject and clip.
    objective: BTreeMap<(String, String), String>,
    listed: ApexList,
}

impl Reading<'_> {
    fn clip(
        &self,
        row: Row,
        repaired: &mut usize,
    ) -> Result<Result<Annotation, Dropped>, MicroExpressionError> {
        let Self { coding, source, .. } = self;
        let subject = format!("{:0>1$}", row.filled(coding.subject)?, coding.subject_digits);
        let video = row.filled(coding.clip)?;
        let clip = match coding.of_videos {
            true => {
                let onset = row.text(coding.onset);
                let onset = row.frame(coding.onset).map_or(onset.to_owned(), |onset| onset.to_string());
                format!("{}_{onset}", video.to_lowercase())
            }
            false => video.to_owned(),
        };
        let label = row.filled(coding.emotion)?.to_owned();
        let action_units = action_units(row.text(coding.action_units));
        let dropped = |reason| {
            let (subject, clip, label) = (subject.clone(), clip.clone(), label.clone());
            Ok(Err(Dropped { subject, clip, label, reason }))
        };
        let class = match self.class(row, &subject, &clip, &label, &action_units)? {
            Ok(class) => class,
            Err(reason) => return dropped(reason),
        };
        let frame = |column: &str| match row.frame(column) {
            Err(_) if coding.frames_may_be_wrong => Ok(None),
            frame => frame.map(Some),
        };
        let (Some(onset), Some(offset)) = (frame(coding.onset)?, frame(coding.offset)?) else {
            return dropped(DropReason::FramesUnknown);
        };
        let apex = coding.apex.map(frame).transpose()?.flatten();
        let repair = coding.repairs.iter().find(|repair| {
            (repair.subject, repair.clip) == (&subject, video)
                && [Some(onset), apex, Some(offset)] == repair.wrong.map(Some)
        });
        *repaired += usize::from(repair.is_some());
        let [onset, apex, offset] = repair.map_or([Some(onset), apex, Some(offset)], |r| r.right.map(Some));
        // An offset before the apex is mistyped: the expression lasts to the apex at least.
        let (onset, offset) = (onset.unwrap_or_default(), offset.max(apex).unwrap_or_default());
        if offset <= onset {
            let reason = format!("expected onset < offset, found onset {onset}, offset {offset}");
            return if coding.frames_may_be_wrong {
                dropped(DropReason::FramesOutOfOrder)
            } else {
                Err(row.wrong(reason))
            };
        }
        let apex = match (coding.apex, apex) {
            (None, _) => Ok(self.listed.apex(&subject, &clip, [onset, offset])?),
            (Some(_), Some(apex)) if apex > onset => Ok(Some(apex)),
            (Some(_), Some(_)) => Err(DropReason::ApexNotAfterOnset),
            (Some(_), None) => Err(DropReason::ApexUnknown),
        };
        let apex = match apex {
            Ok(apex) => apex,
            Err(reason) => match self.listed.instead(source, &subject, &clip, [onset, offset], reason)? {
                Ok(apex) => apex,
                Err(reason) => return dropped(reason),
            },
        };
        Ok(Ok(Annotation { subject, clip, class, label, action_units, onset, apex, offset }))
    }

    /// The class of a row, or why it has none.
    fn class(
        &self,
        row: Row,
        subject: &str,
        clip: &str,
        label: &str,
        action_units: &str,
    ) -> Result<Result<usize, DropReason>, MicroExpressionError> {
        let Self { coding, source, .. } = self;
        let objective = match coding.objective {
            Objective::None => "",
            Objective::Column(column) => row.text(column),
            Objective::Roman(column) => {
                let text = row.text(column);
                let number =
                    ["I", "II", "III", "IV", "V", "VI", "VII"].iter().position(|roman| *roman == text);
                number.map_or(text, |at| ["1", "2", "3", "4", "5", "6", "7"][at])
            }
            Objective::Spreadsheet(_) => {
                self.objective.get(&(subject.to_owned(), clip.to_owned())).map_or("", String::as_str)
            }
        };
        let emotions: Vec<&str> = match coding.several_emotions {
            true => emotions(label).collect(),
            false => vec![label],
        };
        let mut found = Vec::new();
        for emotion in emotions {
            let known = coding.emotions;
            if !known.is_empty() && !known.contains(&emotion.to_lowercase().as_str()) {
                return Err(row.wrong(format!(
                    "{}: `{emotion}` is none of {}",
                    coding.emotion, coding.emotions_called
                )));
            }
            found.push(source.classes.of(&Coded {
                kind: coding.form.kind,
                emotion,
                action_units,
                objective,
            }));
        }
        found.dedup();
        Ok(match found[..] {
            [class] => class.ok_or(DropReason::Label),
            _ => Err(DropReason::SeveralClasses),
        })
    }
}

/// The emotions of a label such as `Negative+Repression`.
fn emotions(label: &str) -> impl Iterator<Item = &str> {
    label.split(['+', ',', '/', ';', '&', '，']).map(str::trim).filter(|emotion| !emotion.is_empty())
}

/// Action units with plus signs between them: `R4,5` is `R4+5`.
fn action_units(coded: &str) -> String {
    match coded.contains([',', '，']) {
        true => {
            let units = coded.split([',', '，']).map(str::trim).filter(|unit| !unit.is_empty());
            units.collect::<Vec<&str>>().join("+")
        }
        false => coded.to_owned(),
    }
}

/// The objective class of each clip, by subject and clip, from the spreadsheet in the dataset's folder or next to the
/// annotations.
fn objective_classes(
    form: &Form,
    coding: &Coding,
    source: &ClipSource,
) -> Result<BTreeMap<(String, String), String>, MicroExpressionError> {
    let beside = source.annotations.as_deref().and_then(Path::parent);
    for dir in [Some(source.dir.as_path()), beside].into_iter().flatten().filter(|dir| dir.is_dir()) {
        let Some(table) = spreadsheet_in(form, dir)? else { continue };
        let class = |row: Row| {
            let subject = format!("{:0>1$}", row.filled("Subject")?, coding.subject_digits);
            Ok(((subject, row.filled("Filename")?.to_owned()), row.filled("Objective Class")?.to_owned()))
        };
        return table.rows().map(class).collect();
    }
    Err(MicroExpressionError::NoAnnotations {
        kind: form.kind,
        dir: source.dir.clone(),
        expected: form.called,
        found: "it is missing. Put it there, or next to the file of `annotations`".to_owned(),
    })
}

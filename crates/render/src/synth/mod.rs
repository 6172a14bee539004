//! Rendering a labelled micro-expression set: the built-in heads show micro-expressions, with the true flow from onset to
//! apex that no recorded set has.
//!
//! ```text
//! synth.json                what the set was asked to be
//! s03/c05/0012.png          frame 12 of subject 3's fifth clip
//! s03/c05_flow.flo          true flow from onset to apex
//! s03/c05.json              class, action units and their intensities, onset, apex, offset, landmarks; written last
//! clips.csv                 the set as plain clips; once it is whole
//! landmarks.csv             the 68 landmarks of dlib in every clip's onset frame
//! ```
//!
//! Every file's bytes depend on the settings alone: not on how often a run was killed or how many threads there are.

mod clip;
mod error;
mod sensor;
mod settings;
mod work;

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::time::Instant;

use serde::{Deserialize, Serialize};
use srflow_field::{FileKind, create_folder, excerpt, read_text, write_atomically};
use srflow_read::micro_expression::EmotionClass;

pub use error::SynthError;
pub use settings::SynthSettings;

use settings::ClipPlan;
use srflow_read::micro_expression::{Annotation, Classes, PLAIN_NAME, write_plain};

/// Name of the file that says what the set was asked to be.
const SETTINGS_NAME: &str = "synth.json";

/// Name of the file of landmarks.
pub const LANDMARKS_NAME: &str = "landmarks.csv";

/// What [`synthesize`] tells while it works.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SynthEvent {
    /// The folder has been looked through.
    Started {
        /// Clips of the set.
        clips: usize,
        /// Those that are whole already.
        whole: usize,
    },
    /// One more clip is whole.
    ClipWritten {
        /// Its number of frames.
        frames: usize,
    },
}

/// What [`synthesize`] did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SynthReport {
    /// Clips of the set.
    pub clips: usize,
    /// Those that this run made.
    pub made: usize,
    /// Frames of the set.
    pub frames: usize,
    /// Subjects of the set.
    pub subjects: u32,
    /// Clips of each class.
    pub classes: BTreeMap<&'static str, usize>,
    /// Mean length of the true flow from onset to apex on the head, in pixels.
    pub mean_flow: f64,
    /// Seconds that this run took.
    pub seconds: f64,
}

/// What `s03/c05.json` holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct ClipRecord {
    subject: String,
    class: String,
    /// Action units at the apex and their intensity, 0 to 1.
    action_units: BTreeMap<String, f32>,
    coded_units: String,
    onset: u64,
    apex: u64,
    offset: u64,
    frames: usize,
    /// Mean length of the true flow from onset to apex on the head, in pixels.
    mean_flow: f64,
    /// The 68 landmarks of dlib in the onset frame, in pixels.
    landmarks: Vec<[f64; 2]>,
}

/// Makes a set of micro-expressions in the folder `dir` with the threads of the current rayon pool. What is there already,
/// made with the same settings, is left as it is.
///
/// # Errors
/// Before any work when a setting is out of range or the folder is not this set's (`force` deletes another set there); later
/// when a file cannot be written. What is complete stays, and the next call with the same settings goes on from there.
pub fn synthesize(
    settings: &SynthSettings,
    dir: &Path,
    force: bool,
    on_event: &(dyn Fn(SynthEvent) + Sync),
) -> Result<SynthReport, SynthError> {
    let start = Instant::now();
    let plan = settings.plan()?;
    claim(dir, settings, force)?;
    let missing: Vec<&ClipPlan> = plan.iter().filter(|clip| !clip.record(dir).is_file()).collect();
    on_event(SynthEvent::Started { clips: plan.len(), whole: plan.len() - missing.len() });
    work::make(settings, dir, &missing, on_event)?;

    let records = plan.iter().map(|clip| read_record(&clip.record(dir))).collect::<Result<Vec<_>, _>>()?;
    write_tables(dir, &plan, &records)?;
    let class = |class: EmotionClass| (class.name(), plan.iter().filter(|clip| clip.class == class).count());
    Ok(SynthReport {
        clips: plan.len(),
        made: missing.len(),
        frames: records.iter().map(|record| record.frames).sum(),
        subjects: settings.subjects,
        classes: EmotionClass::ALL.into_iter().map(class).collect(),
        mean_flow: records.iter().map(|record| record.mean_flow).sum::<f64>() / records.len().max(1) as f64,
        seconds: start.elapsed().as_secs_f64(),
    })
}

/// Makes `dir` the folder of this set: a new one, or the same one begun before.
fn claim(dir: &Path, settings: &SynthSettings, force: bool) -> Result<(), SynthError> {
    let path = dir.join(SETTINGS_NAME);
    let io_error = |error| SynthError::Io { path: path.clone(), error };
    if path.is_file() {
        let text = read_text(&path, FileKind::Json)?;
        match serde_json::from_str::<SynthSettings>(&text) {
            Ok(found) if found == *settings && !force => return Ok(()),
            Ok(found) if force => delete(dir, &found)?,
            Ok(found) => {
                return Err(SynthError::OtherSet {
                    path: dir.to_owned(),
                    differs: difference(&found, settings),
                });
            }
            // Nobody can tell which files are the set's: they are written over.
            Err(_) if force => {}
            Err(error) => {
                return Err(SynthError::Malformed {
                    path,
                    reason: srflow_field::parse_error_in_words(&error),
                });
            }
        }
    } else if !is_empty(dir).map_err(|error| SynthError::Io { path: dir.to_owned(), error })? {
        return Err(SynthError::NotASet(dir.to_owned()));
    }
    create_folder(dir)?;
    let text = serde_json::to_string_pretty(settings).map_err(|error| io_error(error.into()))?;
    write_atomically(&path, |writer| writeln!(writer, "{text}"))?;
    Ok(())
}

fn is_empty(dir: &Path) -> io::Result<bool> {
    match fs::read_dir(dir) {
        Ok(mut entries) => Ok(entries.next().is_none()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(true),
        Err(error) => Err(error),
    }
}

/// The first argument in which two settings differ.
fn difference(found: &SynthSettings, asked: &SynthSettings) -> String {
    let fields = |settings| serde_json::to_value(settings).unwrap_or_default();
    let (found, asked) = (fields(found), fields(asked));
    let empty = serde_json::Map::new();
    let names = asked.as_object().unwrap_or(&empty);
    let differing = names.iter().find(|(name, value)| found[name.as_str()] != **value);
    differing.map_or_else(String::new, |(name, value)| {
        format!("{name} {}, asked for is {value}", excerpt(&found[name.as_str()].to_string()))
    })
}

/// Deletes the clips of another set, and nothing else.
fn delete(dir: &Path, settings: &SynthSettings) -> Result<(), SynthError> {
    let format = settings.flow_format()?;
    for clip in settings.plan()? {
        // The record first: without it the clip does not count.
        let files = [clip.record(dir), clip.flow(dir, format)];
        let results = files.map(|file| (fs::remove_file(&file), file));
        let folder = clip.folder(dir);
        for (result, path) in results.into_iter().chain([(fs::remove_dir_all(&folder), folder)]) {
            match result {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(SynthError::Io { path, error });
                }
                _ => {}
            }
        }
    }
    Ok(())
}

fn read_record(path: &Path) -> Result<ClipRecord, SynthError> {
    let text = read_text(path, FileKind::Json)?;
    serde_json::from_str(&text).map_err(|error| SynthError::Malformed {
        path: path.to_owned(),
        reason: srflow_field::parse_error_in_words(&error),
    })
}

/// Writes `landmarks.csv` and, last, `clips.csv`.
fn write_tables(dir: &Path, plan: &[ClipPlan], records: &[ClipRecord]) -> Result<(), SynthError> {
    write_atomically(&dir.join(LANDMARKS_NAME), |writer| {
        write!(writer, "subject,clip,frame")?;
        for axis in ["x", "y"] {
            for number in 0..68 {
                write!(writer, ",{axis}_{number}")?;
            }
        }
        for (clip, record) in plan.iter().zip(records) {
            write!(writer, "\n{},{},{}", clip.subject_name, clip.name, record.onset)?;
            for axis in 0..2 {
                for point in &record.landmarks {
                    write!(writer, ",{:.3}", point[axis])?;
                }
            }
        }
        writeln!(writer)
    })?;
    let annotation = |(clip, record): (&ClipPlan, &ClipRecord)| Annotation {
        subject: clip.subject_name.clone(),
        clip: clip.name.clone(),
        class: clip.class as usize,
        label: clip.class.name().to_owned(),
        action_units: record.coded_units.clone(),
        onset: record.onset,
        apex: Some(record.apex),
        offset: record.offset,
    };
    let rows: Vec<Annotation> = plan.iter().zip(records).map(annotation).collect();
    write_plain(&dir.join(PLAIN_NAME), &Classes::default(), &rows)?;
    Ok(())
}

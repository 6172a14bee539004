//! Rendering a labelled micro-expression dataset: heads show micro-expressions, with the true flow from onset to
//! apex, which no recorded dataset has.
//!
//! ```text
//! synth.json                the arguments of the dataset
//! s03/c05/0012.png          frame 12 of subject 3's fifth clip
//! s03/c05_flow.flo          true flow from onset to apex
//! s03/c05_head_flow.flo     the same with the head moving alone, its face as at the onset
//! s03/c05_expression_flow.flo   what the face adds to it: the two add up to the flow
//! s03/c05_mask.png          white on the head at the onset
//! s03/c05.json              class, action units and their intensities, onset, apex, offset, landmarks; written last
//! clips.csv                 the dataset as plain clips; written once it is complete
//! disturbances.csv          every blink, glance, sentence, nod and shake, with its first and last frame, if there are any
//! landmarks.csv             the 68 landmarks of dlib in every clip's onset frame
//! ```
//!
//! [`crate::job`] renders it clip by clip. Every file's bytes depend on the settings alone: not on shards, interruptions, or
//! the number of threads.

mod clip;
pub(crate) mod portrait;
mod settings;
mod work;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use serde::Serialize;
use srflow_files::write_atomically;

pub use settings::SynthSettings;

use crate::RenderError;
use crate::job::{self, Request};
use crate::record::read_record;
use clip::Disturbance;
use settings::ClipPlan;
use srflow_data::micro_expression::{Annotation, Classes, EmotionClass, PLAIN_NAME, write_plain};
use work::ClipRecord;
pub(crate) use work::Clips;
pub use work::{DISTURBANCES_NAME, LANDMARKS_NAME};

/// The result of [`synthesize`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SynthReport {
    /// Clips of this shard.
    pub clips: u64,
    /// Clips rendered by this run.
    pub made: u64,
    /// Number of frames, once the dataset is complete.
    pub frames: Option<usize>,
    pub subjects: u32,
    /// Clips of each class.
    pub classes: BTreeMap<&'static str, usize>,
    /// Mean length of the true flow from onset to apex on the head, in pixels, once the dataset is complete.
    pub mean_flow: Option<f64>,
    pub seconds: f64,
    /// Whether it was stopped on request before all clips were rendered.
    pub stopped: bool,
}

/// Renders a micro-expression dataset, or one shard of it, with the threads of the current rayon pool. Existing files with
/// the same settings are kept.
///
/// # Errors
/// Before any work when a setting is out of range or the folder has another dataset; later when a file cannot be written.
/// Complete files stay, and the next call with the same settings continues.
pub fn synthesize(settings: &SynthSettings, request: Request) -> Result<SynthReport, RenderError> {
    let plan = Clips::new(settings.clone())?;
    let (made, set) = job::make(&plan, request, |dir| finish(dir, &plan))?;
    let class =
        |class: EmotionClass| (class.name(), plan.clips.iter().filter(|clip| clip.class == class).count());
    Ok(SynthReport {
        clips: made.units,
        made: made.made,
        subjects: settings.subjects,
        classes: EmotionClass::ALL.into_iter().map(class).collect(),
        frames: set.map(|(frames, _)| frames),
        mean_flow: set.map(|(_, mean_flow)| mean_flow),
        seconds: made.seconds,
        stopped: made.stopped,
    })
}

/// Writes the tables of a complete dataset; returns its number of frames and its mean flow.
pub(crate) fn finish(dir: &Path, plan: &Clips) -> Result<(usize, f64), RenderError> {
    let records: Vec<ClipRecord> =
        plan.clips.iter().map(|clip| read_record(&clip.record(dir))).collect::<Result<_, _>>()?;
    if plan.settings().has_disturbances() {
        write_disturbances(dir, &plan.clips, &records)?;
    }
    write_tables(dir, &plan.clips, &records)?;
    let mean_flow = records.iter().map(|record| record.mean_flow).sum::<f64>() / records.len().max(1) as f64;
    Ok((records.iter().map(|record| record.frames).sum(), mean_flow))
}

/// Writes `disturbances.csv`.
fn write_disturbances(dir: &Path, plan: &[ClipPlan], records: &[ClipRecord]) -> Result<(), RenderError> {
    Ok(write_atomically(&dir.join(DISTURBANCES_NAME), |writer| {
        writeln!(writer, "subject,clip,what,first,last")?;
        for (clip, record) in plan.iter().zip(records) {
            for Disturbance { what, first, last } in &record.disturbances {
                writeln!(writer, "{},{},{what},{first},{last}", clip.subject_name, clip.name)?;
            }
        }
        Ok(())
    })?)
}

/// Writes `landmarks.csv` and, last, `clips.csv`.
fn write_tables(dir: &Path, plan: &[ClipPlan], records: &[ClipRecord]) -> Result<(), RenderError> {
    let rows = plan.iter().zip(records).map(|(clip, record)| {
        let keys = vec![clip.subject_name.clone(), clip.name.clone(), record.onset.to_string()];
        (keys, record.landmarks.as_slice())
    });
    write_landmarks(&dir.join(LANDMARKS_NAME), &["subject", "clip", "frame"], rows)?;
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

/// Writes a table of the 68 points of dlib, with these columns before them, as `--landmarks` reads it.
pub(crate) fn write_landmarks<'a>(
    path: &Path,
    keys: &[&str],
    rows: impl IntoIterator<Item = (Vec<String>, &'a [[f64; 2]])>,
) -> Result<(), RenderError> {
    Ok(write_atomically(path, |writer| {
        write!(writer, "{}", keys.join(","))?;
        for axis in ["x", "y"] {
            for number in 0..68 {
                write!(writer, ",{axis}_{number}")?;
            }
        }
        for (keys, points) in rows {
            write!(writer, "\n{}", keys.join(","))?;
            for axis in 0..2 {
                for point in points {
                    write!(writer, ",{:.3}", point[axis])?;
                }
            }
        }
        writeln!(writer)
    })?)
}

//! Rendering long videos of the built-in heads: micro- and macro-expressions among blinks, glances, speech and motion of the
//! head, with the truth that spotting is scored against.
//!
//! ```text
//! long.json           the arguments of the set
//! s01/000001.png      frame 1 of subject 1's video
//! events.csv          every expression: video, type, onset, apex, offset, class, action units; written once the set is complete
//! disturbances.csv    every blink, glance, sentence, nod and shake: video, what, first and last frame
//! landmarks.csv       the 68 landmarks of dlib in every video's first frame
//! ```
//!
//! [`crate::job`] renders it in pieces of [`PIECE`] frames. Every file's bytes depend on the settings alone: not on shards,
//! interruptions, or the number of threads.

mod settings;
mod timeline;
mod work;

use std::io::Write;
use std::path::Path;

use serde::Serialize;
use srflow_data::micro_expression::intervals::{ExpressionKind, write_intervals};
use srflow_files::write_atomically;

pub use settings::LongSettings;
pub(crate) use work::Videos;
pub use work::{EVENTS_NAME, PIECE};

use crate::RenderError;
use crate::job::{self, Request};
use crate::synth::{DISTURBANCES_NAME, LANDMARKS_NAME, write_landmarks};
use timeline::Video;

/// The result of [`record`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LongReport {
    /// Frames of this shard.
    pub frames: u64,
    /// Frames rendered by this run.
    pub made: u64,
    pub videos: u32,
    /// How many there are in the videos, once the set is complete.
    pub events: Option<EventCounts>,
    pub seconds: f64,
    /// Whether it was stopped on request before all frames were rendered.
    pub stopped: bool,
}

/// Expressions of a complete set.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct EventCounts {
    pub micro: usize,
    pub macros: usize,
}

/// Renders long videos, or one shard of them, with the threads of the current rayon pool. Existing files with the same settings are
/// kept.
///
/// # Errors
/// Before any work when a setting is out of range or the folder has another dataset; later when a file cannot be written. Complete
/// files stay, and the next call with the same settings continues.
pub fn record(settings: &LongSettings, request: Request) -> Result<LongReport, RenderError> {
    let plan = Videos::new(settings.clone())?;
    let (made, events) = job::make(&plan, request, |dir| finish(dir, &plan))?;
    Ok(LongReport {
        frames: made.units * u64::from(PIECE),
        made: made.made * u64::from(PIECE),
        videos: settings.subjects,
        events,
        seconds: made.seconds,
        stopped: made.stopped,
    })
}

/// Writes the tables of a complete set.
pub(crate) fn finish(dir: &Path, plan: &Videos) -> Result<EventCounts, RenderError> {
    let videos: Vec<Video> =
        (0..plan.settings().subjects).map(|subject| plan.video(subject)).collect::<Result<_, _>>()?;
    let faces =
        videos.iter().map(|video| (vec![video.name.clone(), "1".to_owned()], video.landmarks.as_slice()));
    write_landmarks(&dir.join(LANDMARKS_NAME), &["video", "frame"], faces)?;
    write_atomically(&dir.join(DISTURBANCES_NAME), |writer| {
        writeln!(writer, "video,what,first,last")?;
        for video in &videos {
            for (what, [first, last]) in video.timeline.disturbances() {
                writeln!(writer, "{},{what},{first},{last}", video.name)?;
            }
        }
        Ok(())
    })?;
    let events: Vec<_> = videos.iter().flat_map(|video| video.timeline.intervals(&video.name)).collect();
    write_intervals(&dir.join(EVENTS_NAME), &events)?;
    let micro = events.iter().filter(|event| event.kind == ExpressionKind::Micro).count();
    Ok(EventCounts { micro, macros: events.len() - micro })
}

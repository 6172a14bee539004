//! What the job reports.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::Report;
use crate::large_frames::Resolution;
use crate::output::write_line;
use crate::rendering::Rendered;

/// The flow of one sequence.
#[derive(Debug, Serialize)]
pub struct SequenceReport {
    pub method: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub network: Option<NetworkUsed>,
    /// Landmarks of the detected face.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub landmarks: Option<PathBuf>,
    /// Size of the network's input, after scaling and tiling.
    pub resolution: Option<Resolution>,
    /// Pairs already written by an interrupted run; they are not listed.
    #[serde(skip_serializing_if = "is_zero")]
    pub resumed: u64,
    pub pairs: Vec<EstimatedPair>,
    /// Whether the run was stopped before the last pair.
    #[serde(skip)]
    pub stopped: bool,
}

/// The network of a run, and how it computes.
#[derive(Debug, Serialize)]
pub struct NetworkUsed {
    pub weights: Option<String>,
    /// At most.
    pub iterations: usize,
    /// The movement in pixels below which the iterations end, where their number is automatic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub still_px: Option<f32>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<&'static str, usize>,
    /// In which the flow of an input of this size is refined.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub levels: Option<usize>,
    pub device: String,
    /// The precision of products; where it was `auto`, the chosen one.
    pub precision: &'static str,
    pub batch: usize,
    pub warm_start: bool,
}

/// The flow of one pair.
#[derive(Debug, Serialize)]
pub struct EstimatedPair {
    pub frame1: String,
    pub frame2: String,
    pub flow: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub viz: Option<PathBuf>,
    /// Files of `uncertainty` and `occlusion`.
    #[serde(flatten)]
    pub extra: BTreeMap<&'static str, PathBuf>,
    pub width: usize,
    pub height: usize,
    /// Time of estimation, while other frames are read and written; in a batch, an equal share.
    pub seconds: f64,
    /// The iterations done, where their number is automatic; the mean over tiles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<f32>,
}

/// What [`FlowJob`](super::FlowJob) has estimated.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum FlowReport {
    /// Two frames, a folder of frames or a video.
    Sequence(Box<SequenceReport>),
    /// Several folders or videos.
    Sequences(Rendered<Sequences>),
}

/// Flow of several sequences, by the names of their folders.
#[derive(Debug, Serialize)]
pub struct Sequences {
    pub sequences: BTreeMap<String, SequenceReport>,
}

impl FlowReport {
    /// The sequences in the order of their names.
    fn sequences(&self) -> Vec<&SequenceReport> {
        match self {
            Self::Sequence(sequence) => vec![sequence],
            Self::Sequences(several) => several.report.sequences.values().collect(),
        }
    }
}

impl Report for FlowReport {
    fn stopped(&self) -> bool {
        self.sequences().iter().any(|sequence| sequence.stopped)
    }
}

impl fmt::Display for FlowReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.sequences().into_iter().try_for_each(|sequence| sequence.fmt(f))
    }
}

impl fmt::Display for SequenceReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.resumed > 0 {
            writeln!(f, "{} flows from the interrupted run were kept", self.resumed)?;
        }
        if let Some(file) = &self.landmarks {
            write_line(f, format_args!("{}: landmarks of the face in the first frame", file.display()))?;
        }
        for EstimatedPair { flow, width, height, seconds, iterations, .. } in &self.pairs {
            let iterations = match iterations {
                Some(number) => format!("  {} iterations", (10.0 * number).round() / 10.0),
                None => String::new(),
            };
            write_line(f, format_args!("{}  {width}x{height}  {seconds:.3} s{iterations}", flow.display()))?;
        }
        Ok(())
    }
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

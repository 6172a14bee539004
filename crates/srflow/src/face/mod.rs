//! Landmarks of a face along a video; and where faces and their landmarks come from in other jobs.

mod arguments;
mod picture;
mod table;

use std::fmt;
use std::path::PathBuf;

use anyhow::bail;
use serde::{Deserialize, Serialize};
use srflow_core::SettingError;
use srflow_face::FaceFinder;
use srflow_files::write_file;

pub use arguments::{
    FACE_MODELS_VARIABLE, FaceArgs, FaceBoxes, FaceModels, FaceTrack, FoundFace, FoundTrack,
};
use picture::Pictures;
pub(crate) use picture::draw_points;
use table::FaceTable;

use crate::clap::{Args, ValueEnum};
use crate::error::wrong_settings;
use crate::flow::frames::Source;
use crate::output::{ensure_extension, ensure_free, write_line};
use crate::{Job, Report, Watch};

/// Write the landmarks of a face in each frame
///
/// Finds the face with MediaPipe's networks, frame by frame without smoothing. The CSV file has a row for each frame, which
/// `--landmarks` of other commands reads. Several faces need `--face-index`; that face is then followed.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow face clip.mp4 -o landmarks.csv
  srflow face clip.mp4 -o landmarks.csv --points mesh --viz points.mp4
  srflow face clip.mp4 -o face.csv --blendshapes --face-models face_landmarker.task
  srflow mer spot clip.mp4 --landmarks landmarks.csv --out spotted

Columns: frame (from 1 in a video, else the number in the file's name), timestamp in seconds, success (0 where no face was found), \
confidence of the detector, x_0, x_1, ... and y_0, y_1, ... in pixels (an integer is the centre of a pixel), and a column for each \
blend shape, 0 to 1. docs/guides/faces.md says where to get the networks.")]
pub struct FaceJob {
    /// A video, a folder of frames, or frames
    #[arg(required = true, value_name = "VIDEO|FOLDER|FRAME")]
    pub frames: Vec<PathBuf>,
    /// CSV file to write
    #[arg(short, long, value_name = "CSV")]
    pub out: PathBuf,
    /// Points: dlib (68) or mesh (MediaPipe's 468; 478 with the irises from face_landmarker.task)
    #[arg(long, value_name = "POINTS", value_enum, default_value_t)]
    #[serde(default)]
    pub points: PointChoice,
    /// Also write MediaPipe's 52 blend shapes; needs face_landmarker.task
    #[arg(long)]
    #[serde(default)]
    pub blendshapes: bool,
    /// Draw the points into frames: a video, or a folder of PNGs
    #[arg(long, value_name = "VIDEO|DIR")]
    #[serde(default)]
    pub viz: Option<PathBuf>,
    /// Face to follow if there are several; 1 is the leftmost
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    #[serde(default)]
    pub face_index: Option<u16>,
    /// Frames per second [default: those of the video; without any, there are no timestamps]
    #[arg(long, value_name = "FPS")]
    #[serde(default)]
    pub fps: Option<f64>,
    /// Overwrite existing files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub models: FaceModels,
}

/// Which points of a face are written.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PointChoice {
    /// The points of MediaPipe's mesh that are nearest to dlib's 68.
    #[default]
    Dlib,
    /// All points of MediaPipe's mesh.
    Mesh,
}

impl Job for FaceJob {
    const NAME: &'static str = "face";

    type Report = FaceReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<FaceReport> {
        ensure_extension(&self.out, "csv")?;
        if let Some(fps) = self.fps.filter(|fps| !(*fps > 0.0 && fps.is_finite())) {
            let expected = "a number above 0".to_owned();
            return Err(SettingError { field: "fps", found: fps.to_string(), expected }.into());
        }
        ensure_free([Some(&self.out), self.viz.as_ref()].into_iter().flatten(), self.force)?;
        let source = Source::of_any(&self.frames)?;
        let finder = FaceFinder::read(&self.models.path()?)?;
        if self.blendshapes && !finder.has_blend_shapes() {
            wrong_settings!(
                "`blendshapes` needs the networks in face_landmarker.task: give it with `face_models`"
            );
        }
        let fps = self.fps.or_else(|| source.measured_rate());
        let mut table = FaceTable::new(self, &finder, fps);
        let mut pictures = self.viz.as_deref().map(|viz| Pictures::new(viz, source.rate()));
        let mut track = FoundTrack::new(finder, self.face_index.map(usize::from));
        let progress = watch.count("frames", source.pairs().map(|pairs| pairs + 1));
        let first = source.first_number();
        let (mut failed, mut stopped, mut place) = (None, false, 0);
        source.read(0, 1, |frame| {
            let taken = frame.and_then(|frame| {
                let face = track.face(&frame.image)?;
                let shapes = match &face {
                    Some(face) if self.blendshapes => track.finder().blend_shapes(face)?,
                    _ => None,
                };
                table.push(first + place, face.as_ref(), shapes.as_ref());
                match &mut pictures {
                    Some(pictures) => pictures.push(&frame, face.as_ref(), self.points),
                    None => Ok(()),
                }
            });
            place += 1;
            progress.inc();
            failed = taken.err();
            stopped = watch.stops();
            failed.is_none() && !stopped
        });
        if let Some(error) = failed {
            return Err(error);
        }
        if table.with_face == 0 && !stopped {
            bail!(
                "{}: no face was found in any frame; is it upright, turned to the camera and at least a \
                 fifteenth of the frame's shorter side?",
                self.frames.first().map_or_else(String::new, |path| path.display().to_string())
            );
        }
        if !stopped {
            write_file(&self.out, table.text())?;
            pictures.map_or(Ok(()), Pictures::finish)?;
        }
        Ok(FaceReport {
            out: self.out.clone(),
            frames: table.frames,
            with_face: table.with_face,
            confidence: table.confidence(),
            stopped,
        })
    }
}

/// The landmarks that were written.
#[derive(Debug, Clone, Serialize)]
pub struct FaceReport {
    pub out: PathBuf,
    pub frames: usize,
    /// Frames in which a face was found.
    pub with_face: usize,
    /// Mean over them of the detector's score, 0.5 to 1.
    pub confidence: Option<f64>,
    /// Whether it was stopped before anything was written.
    pub stopped: bool,
}

impl Report for FaceReport {
    fn stopped(&self) -> bool {
        self.stopped
    }
}

impl fmt::Display for FaceReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.stopped {
            return writeln!(f, "Stopped on request; nothing is written");
        }
        let Self { out, frames, with_face, .. } = self;
        write_line(f, format_args!("{}: a face in {with_face} of {frames} frames", out.display()))
    }
}

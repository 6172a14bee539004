//! The CSV file of a face's landmarks, as [`srflow_files::PointTable`] reads it.

use std::fmt::Write as _;

use srflow_face::{BLEND_SHAPES, BlendShapes, Face, FaceFinder};

use super::{FaceJob, PointChoice};

/// Rows of a face, one for each frame.
pub(super) struct FaceTable {
    text: String,
    points: PointChoice,
    /// Numbers of a row after its confidence.
    columns: usize,
    /// Seconds between frames, where they are known.
    interval: Option<f64>,
    pub(super) frames: usize,
    pub(super) with_face: usize,
    sum_of_confidence: f64,
}

impl FaceTable {
    pub(super) fn new(job: &FaceJob, finder: &FaceFinder, fps: Option<f64>) -> Self {
        let points = match job.points {
            PointChoice::Dlib => 68,
            PointChoice::Mesh => finder.mesh_points(),
        };
        let mut text = String::from(if fps.is_some() { "frame,timestamp" } else { "frame" });
        text += ",success,confidence";
        for (axis, point) in
            ["x", "y"].into_iter().flat_map(|axis| (0..points).map(move |point| (axis, point)))
        {
            _ = write!(text, ",{axis}_{point}");
        }
        let shapes: &[&str] = if job.blendshapes { &BLEND_SHAPES } else { &[] };
        for shape in shapes {
            _ = write!(text, ",{shape}");
        }
        text.push('\n');
        Self {
            text,
            points: job.points,
            columns: 2 * points + shapes.len(),
            interval: fps.map(|fps| 1.0 / fps),
            frames: 0,
            with_face: 0,
            sum_of_confidence: 0.0,
        }
    }

    /// Adds the row of a frame.
    pub(super) fn push(&mut self, number: i64, face: Option<&Face>, shapes: Option<&BlendShapes>) {
        let text = &mut self.text;
        _ = write!(text, "{number}");
        if let Some(interval) = self.interval {
            _ = write!(text, ",{:.4}", self.frames as f64 * interval);
        }
        self.frames += 1;
        let Some(face) = face else {
            *text += ",0,0";
            text.extend(std::iter::repeat_n(',', self.columns));
            text.push('\n');
            return;
        };
        self.with_face += 1;
        self.sum_of_confidence += f64::from(face.score);
        _ = write!(text, ",1,{:.4}", face.score);
        for coordinate in [0, 1]
            .into_iter()
            .flat_map(|axis| points_of(face, self.points).iter().map(move |point| point[axis]))
        {
            _ = write!(text, ",{coordinate:.4}");
        }
        for shape in shapes.into_iter().flatten() {
            _ = write!(text, ",{shape:.5}");
        }
        text.push('\n');
    }

    /// The whole file.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// Mean of the rows with a face.
    pub(super) fn confidence(&self) -> Option<f64> {
        (self.with_face > 0).then(|| self.sum_of_confidence / self.with_face as f64)
    }
}

/// Points of a face, pixels.
pub(super) fn points_of(face: &Face, choice: PointChoice) -> &[[f64; 2]] {
    match choice {
        PointChoice::Dlib => face.points.dlib.as_deref().map_or(&[], |points| points),
        PointChoice::Mesh => &face.mesh,
    }
}

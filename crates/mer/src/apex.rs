//! The apex frame of a clip: annotated, or spotted between onset and offset.

use rayon::prelude::*;
use serde::Serialize;
use srflow_core::{FlowEstimator, Plane, luminance, named, serialize_as_text};
use srflow_data::micro_expression::Clip;
use srflow_face::{FacePoints, FrameCrop};
use srflow_files::read_image;

use crate::extract::{Preparation, features_of_frames};
use crate::extract_error::{ExtractError, ExtractProblem};
use crate::face::FaceCrop;
use crate::features::{Channel, FEATURE_SIDE, Features};
use crate::time_course::TimeCourse;

/// The rule for spotting an apex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ApexRule {
    /// The frame that differs most from the onset and least from the previous frame: the greatest mean of
    /// `(|I(t) - I(onset)| + 1) / (|I(t) - I(t - 1)| + 1)` over grey values (Quang et al. 2019, who published a list of SMIC's
    /// apexes spotted in this way). With dlib's 68 points it is the mean over their ten cells about mouth, nose, eyes and brows,
    /// placed by the onset's landmarks; otherwise over the whole picture.
    Ratio,
    /// The frame to which the flow from the onset strains the face most: the greatest mean of squared optical strain.
    Strain,
    /// The apex of a rise and fall between onset and offset that explains most of the flow from the onset ([`TimeCourse`]).
    #[default]
    Course,
}

named!(ApexRule, "a rule of spotting the apex", { Ratio => "ratio", Strain => "strain", Course => "course" });
serialize_as_text!(ApexRule);

#[derive(Debug, Clone, PartialEq)]
pub struct SpottedApex {
    /// Number of the frame.
    pub frame: u64,
    /// The rule's score of every frame after the onset.
    pub scores: Vec<(u64, f64)>,
}

/// Spots the apex of a clip among its frames after the onset; the first of equal frames wins. The flow of [`ApexRule::Strain`] and
/// [`ApexRule::Course`] is prepared as for features.
///
/// # Errors
/// When a frame cannot be read or cropped, or the flow method fails.
pub fn spot_apex(
    clip: &Clip,
    rule: ApexRule,
    preparation: &Preparation,
    estimator: &dyn FlowEstimator,
) -> Result<SpottedApex, ExtractError> {
    spot(clip, rule, preparation, estimator).map_err(|problem| ExtractError { clip: clip.id(), problem })
}

/// Spots the apexes of several clips, in their order; calls `on_clip` after each.
///
/// # Errors
/// Those of [`spot_apex`], of the first clip that has one.
pub fn spot_apexes(
    clips: &[&Clip],
    rule: ApexRule,
    preparation: &Preparation,
    estimator: &dyn FlowEstimator,
    on_clip: &(dyn Fn() + Sync),
) -> Result<Vec<SpottedApex>, ExtractError> {
    let spot = |clip: &&Clip| {
        let spotted = spot_apex(clip, rule, preparation, estimator);
        on_clip();
        spotted
    };
    let spotted: Vec<Result<SpottedApex, ExtractError>> = clips.par_iter().map(spot).collect();
    spotted.into_iter().collect()
}

/// Sets the apex of every clip without one; returns how many there were.
///
/// # Errors
/// Those of [`spot_apexes`].
pub fn fill_apexes(
    clips: &mut [Clip],
    rule: ApexRule,
    preparation: &Preparation,
    estimator: &dyn FlowEstimator,
    on_clip: &(dyn Fn() + Sync),
) -> Result<usize, ExtractError> {
    let without: Vec<&Clip> = clips.iter().filter(|clip| clip.annotation.apex.is_none()).collect();
    let spotted = spot_apexes(&without, rule, preparation, estimator, on_clip)?;
    let without = clips.iter_mut().filter(|clip| clip.annotation.apex.is_none());
    without.zip(&spotted).for_each(|(clip, apex)| clip.annotation.apex = Some(apex.frame));
    Ok(spotted.len())
}

fn spot(
    clip: &Clip,
    rule: ApexRule,
    preparation: &Preparation,
    estimator: &dyn FlowEstimator,
) -> Result<SpottedApex, ExtractProblem> {
    let annotation = &clip.annotation;
    let Preparation { face, features: settings } = preparation;
    let crop = face.of_clip(&clip.dataset, annotation)?;
    let frame = |number: u64| {
        let path = clip.frame(number).ok_or(ExtractProblem::NoFrame(number))?;
        Ok::<_, ExtractProblem>(crop.apply(&read_image(path)?)?)
    };
    let onset = frame(annotation.onset)?;
    let features = |number: u64| -> Result<Features, ExtractProblem> {
        Ok(features_of_frames(&onset, &frame(number)?, estimator, *settings)?.0)
    };
    let after = clip.frames.range(annotation.onset.saturating_add(1)..).map(|(number, _)| *number);
    let mut scores = Vec::new();
    match rule {
        ApexRule::Ratio => {
            let onset = luminance(&onset);
            let cells = match face {
                FaceCrop::Landmarks(landmarks) => cells(landmarks.of_clip(&clip.dataset, annotation)?, &crop),
                FaceCrop::Whole | FaceCrop::Fixed(_) => Vec::new(),
            };
            let mut before = onset.clone();
            for number in after {
                let now = luminance(&frame(number)?);
                same_size(clip, number, &onset, &now)?;
                scores.push((number, difference_ratio(&onset, &before, &now, &cells)));
                before = now;
            }
        }
        ApexRule::Strain => {
            for number in after {
                let features = features(number)?;
                let strain = features.channel(Channel::Strain);
                let energy = strain.iter().map(|&strain| f64::from(strain) * f64::from(strain));
                scores.push((number, energy.sum::<f64>() / strain.len() as f64));
            }
        }
        ApexRule::Course => {
            let mut frames = Vec::new();
            for number in after {
                frames.push((number - annotation.onset, in_cells(&features(number)?)));
            }
            let numbers = frames.iter().map(|(time, _)| annotation.onset + time);
            let course = TimeCourse::fit(&frames, annotation.offset - annotation.onset)
                .ok_or(ExtractProblem::NoFrame(annotation.onset.saturating_add(1)))?;
            let scores = numbers.zip(course.strengths).collect();
            return Ok(SpottedApex { frame: annotation.onset + course.apex, scores });
        }
    }
    let mut best = None;
    for &(number, score) in &scores {
        if best.is_none_or(|(_, greatest)| score > greatest) {
            best = Some((number, score));
        }
    }
    match best {
        Some((frame, _)) => Ok(SpottedApex { frame, scores }),
        None => Err(ExtractProblem::NoFrame(annotation.onset.saturating_add(1))),
    }
}

/// Means of u and v in 16 x 16 cells.
fn in_cells(features: &Features) -> Vec<f32> {
    const CELLS: usize = 16;
    const SIDE: usize = FEATURE_SIDE / CELLS;
    let mean = |channel: Channel, cell: usize| {
        let (x, y) = (cell % CELLS * SIDE, cell / CELLS * SIDE);
        let rows = features.channel(channel).chunks(FEATURE_SIDE).skip(y).take(SIDE);
        rows.flat_map(|row| &row[x..x + SIDE]).sum::<f32>() / (SIDE * SIDE) as f32
    };
    let of = |channel| (0..CELLS * CELLS).map(move |cell| mean(channel, cell));
    of(Channel::U).chain(of(Channel::V)).collect()
}

fn same_size(clip: &Clip, number: u64, onset: &Plane, now: &Plane) -> Result<(), ExtractProblem> {
    if onset.size() == now.size() {
        return Ok(());
    }
    let path = |number| clip.frame(number).unwrap_or(&clip.folder).to_owned();
    Err(ExtractProblem::Sizes {
        onset: path(clip.annotation.onset),
        onset_size: onset.size(),
        apex: path(number),
        apex_size: now.size(),
    })
}

/// A rectangle: columns and rows, the second not included.
pub type Cell = [[usize; 2]; 2];

/// How much more a frame `now` differs from the onset than from the frame `before` it: per pixel, the ratio of the absolute
/// differences of luminance, each plus 1. Mean over the cells of the mean within each; cells outside the picture are ignored.
/// Without cells, the mean over the whole picture.
pub fn difference_ratio(onset: &Plane, before: &Plane, now: &Plane, cells: &[Cell]) -> f64 {
    let whole = [[0, now.width()], [0, now.height()]];
    let means: Vec<f64> = cells.iter().filter_map(|cell| mean_ratio(onset, before, now, cell)).collect();
    if means.is_empty() {
        return mean_ratio(onset, before, now, &whole).unwrap_or_default();
    }
    means.iter().sum::<f64>() / means.len() as f64
}

fn mean_ratio(onset: &Plane, before: &Plane, now: &Plane, [columns, rows]: &Cell) -> Option<f64> {
    let (right, bottom) = (columns[1].min(now.width()), rows[1].min(now.height()));
    let (mut sum, mut count) = (0.0, 0_u64);
    for y in rows[0]..bottom {
        for x in columns[0]..right {
            let value = now.get(x, y);
            let ratio = ((value - onset.get(x, y)).abs() + 1.0) / ((value - before.get(x, y)).abs() + 1.0);
            sum += f64::from(ratio);
            count += 1;
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// The ten cells about mouth, chin, nose, eyes and brows, half a mouth wide, in the cropped picture; none without the 68 points.
pub fn cells(face: &FacePoints, crop: &FrameCrop) -> Vec<Cell> {
    let Some(dlib) = &face.dlib else { return Vec::new() };
    let at = |index: usize| crop.point(dlib[index]);
    let [mouth_left, mouth_right, chin] = [at(48), at(54), at(8)];
    let width = (mouth_right[0] - mouth_left[0]) / 2.0;
    let half = width / 2.0;
    let about = |[x, y]: [f64; 2]| [[x - half, x + half], [y - half, y + half]];
    let (left_eye, right_eye) = (at(36), at(45));
    let brows = [0, 1].map(|axis| (at(19)[axis] + at(24)[axis]) / 2.0);
    let beside_nose =
        |x0: f64, mouth: [f64; 2]| [[x0, x0 + width], [mouth[1] - half - width, mouth[1] - half]];
    let rectangles = [
        about(mouth_left),
        about(mouth_right),
        [[chin[0] - half, chin[0] + half], [chin[1] - width, chin[1]]],
        beside_nose(at(31)[0] - width, mouth_left),
        beside_nose(at(35)[0], mouth_right),
        [[left_eye[0] - width, left_eye[0]], [left_eye[1] - half, left_eye[1] + half]],
        [[right_eye[0], right_eye[0] + width], [right_eye[1] - half, right_eye[1] + half]],
        about(brows),
        about([brows[0] - width, brows[1]]),
        about([brows[0] + width, brows[1]]),
    ];
    // The cast clamps coordinates before the picture to its border.
    rectangles.map(|rectangle| rectangle.map(|range| range.map(|place| place as usize))).to_vec()
}

/// Accuracy of a rule against the annotated apexes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ApexErrors {
    /// Number of compared clips.
    pub clips: usize,
    /// Mean absolute difference between spotted and annotated apex, in frames.
    #[serde(rename = "mean_absolute_frames")]
    pub mean_absolute: f64,
    /// The same for the middle between onset and offset, as a baseline.
    #[serde(rename = "middle_of_clip_frames")]
    pub of_the_middle: f64,
}

/// Compares spotted apexes with the annotated ones; clips without an annotated apex are ignored. `None` if no clip remains.
pub fn apex_errors<'a>(spotted: impl IntoIterator<Item = (&'a Clip, u64)>) -> Option<ApexErrors> {
    let (mut clips, mut of_rule, mut of_middle) = (0_usize, 0.0, 0.0);
    for (clip, frame) in spotted {
        let annotation = &clip.annotation;
        if let Some(apex) = annotation.apex {
            let middle = annotation.onset + (annotation.offset - annotation.onset) / 2;
            clips += 1;
            of_rule += apex.abs_diff(frame) as f64;
            of_middle += apex.abs_diff(middle) as f64;
        }
    }
    let mean = |sum: f64| sum / clips as f64;
    (clips > 0).then(|| ApexErrors { clips, mean_absolute: mean(of_rule), of_the_middle: mean(of_middle) })
}

//! Fitting a head model to landmarks in calibrated views: identity, and expressions, joint rotations and translation of every
//! timestep.
//!
//! The most probable parameters are found by Levenberg-Marquardt with analytic derivatives. A landmark's distance in the picture
//! counts by the loss of Geman and McClure in units of the detector's noise, so that outliers lose their pull; priors and
//! smoothness over time are normal distributions ([`Priors`]). Stages follow VHAP (`vhap/model/tracker.py`): the pose of one
//! timestep, then all its parameters and the identity, then the others one after the other, and at last all timesteps together,
//! with the identity. The result is the same for any number of threads.

mod arrow;
mod detectors;
mod gaze;
mod hidden;
mod initial;
mod landmarks;
mod lids;
mod look;
mod pictures;
mod priors;
mod problem;
mod report;
mod robust;
#[cfg(test)]
mod tests;

use srflow_files::FileError;
use srflow_splat::Camera;

pub use detectors::Detector;
pub use pictures::{HiddenView, PictureFit, ReadPicture};
pub use priors::Priors;
pub use report::{CameraFit, FitReport, Reach, ViewFit};

use crate::capture::{Face, LANDMARK_COUNT};
use problem::{Problem, Window};
use srflow_head::{HeadModel, HeadParameters, HeadState, PoseParameters};

/// One picture of a head.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkView {
    pub timestep: u32,
    pub camera_index: u32,
    pub camera: Camera,
    /// All missing where the detector found no face.
    pub landmarks: Face,
}

/// Settings of [`fit`].
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// How many shapes of the identity basis are fitted, from the first one; the others stay at zero.
    pub identities: usize,
    /// How many shapes of the expression basis are fitted, from the first one.
    pub expressions: usize,
    /// Distance between the pupils in metres, if it is known: it gives the scale that one camera cannot see.
    pub eye_distance: Option<f64>,
    /// Standard deviation of a landmark's coordinates in pixels; `None` to estimate it from the residuals.
    pub noise: Option<f64>,
    /// A landmark further from the fit than this many standard deviations counts as an outlier.
    pub outlier: f64,
    /// How many times less precise the contour of the jaw (landmarks 0 to 16) is than other landmarks, until each landmark's
    /// precision is learned from its residuals: detectors put it on the edge of the face in the picture, not on a point of the
    /// skin.
    pub contour: f64,
    pub priors: Priors,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            identities: 100,
            expressions: 100,
            eye_distance: None,
            noise: None,
            outlier: 4.0,
            contour: 2.0,
            priors: Priors::default(),
        }
    }
}

/// How often all timesteps are fitted together: first with the given precision of landmarks and offsets, then with what was learned.
const REFINEMENTS: usize = 4;

/// A stage of the fit, for progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FitStage {
    /// Pose, then all parameters, of one timestep.
    First,
    /// The other timesteps, one after the other.
    Track,
    /// All timesteps together.
    Refine,
    /// The pictures with each other.
    Align,
}

/// A fitted head.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Numbers of the timesteps, ascending.
    pub timesteps: Vec<u32>,
    /// One for each timestep; the identity is the same in all.
    pub states: Vec<HeadState>,
    pub report: FitReport,
}

impl Fit {
    /// The parameters in the form of files, with a weight for every shape of the model: zero for those that were not fitted.
    pub fn parameters(&self, model: &HeadModel) -> HeadParameters {
        let mut shape: Vec<f32> =
            self.states.first().map_or(&[][..], |state| &state.identity).iter().map(|w| *w as f32).collect();
        shape.resize(model.identities.len(), 0.0);
        let pose = |state: &HeadState| {
            let mut pose = PoseParameters::of(model, &state.pose());
            pose.expr.resize(model.expressions.len(), 0.0);
            pose
        };
        HeadParameters { shape, static_offset: Vec::new(), poses: self.states.iter().map(pose).collect() }
    }
}

/// Why a head could not be fitted.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// A picture cannot be read.
    #[error(transparent)]
    Picture(#[from] FileError),
    /// The model has no landmarks.
    #[error("the head model {model} has {found} landmarks; fitting it needs the {LANDMARK_COUNT} of dlib")]
    Model { model: String, found: usize },
    /// No picture shows enough of the face.
    #[error(
        "no picture has {} landmarks or more (the best has {best}), which the pose of the head needs; check the landmarks' timestep and camera numbers against those of the pictures",
        initial::LEAST
    )]
    Landmarks { best: usize },
    /// The pose of the head cannot be found.
    #[error(
        "the landmarks of timestep {timestep} agree with no pose of the head in front of its cameras; check that they belong to these cameras, and that x and y are pixels"
    )]
    Pose { timestep: u32 },
}

/// Fits `model` to the landmarks in `views`, of which each timestep may have any number, also with no landmark at all: such
/// timesteps follow from their neighbours. If `pictures` can be read, they are then aligned with each other by the colours of the skin.
/// `progress` gets the stage, how many steps of it are done, and how many it has.
///
/// # Errors
/// When the model has no landmarks, no timestep has enough of them to begin with, or a picture cannot be read.
pub fn fit(
    model: &HeadModel,
    views: &[LandmarkView],
    pictures: Option<ReadPicture>,
    options: &FitOptions,
    mut progress: impl FnMut(FitStage, usize, usize),
) -> Result<Fit, FitError> {
    if model.landmarks.len() < LANDMARK_COUNT {
        return Err(FitError::Model { model: model.name.clone(), found: model.landmarks.len() });
    }
    let mut problem = Problem::new(model, views, options);
    let most = views.iter().map(|view| view.landmarks.iter().flatten().count()).max().unwrap_or(0);
    if most < initial::LEAST {
        return Err(FitError::Landmarks { best: most });
    }
    let count = problem.timesteps.len();
    let first = problem.first_timestep();

    progress(FitStage::First, 0, 1);
    let timestep = problem.timesteps[first];
    let (mut heads, mut noise) = problem.begin(first).ok_or(FitError::Pose { timestep })?;
    progress(FitStage::First, 1, 1);

    // From the first timestep to both ends, each from its neighbour.
    let after = (first + 1..count).map(|timestep| (timestep, timestep - 1));
    let before = (0..first).rev().map(|timestep| (timestep, timestep + 1));
    for (done, (timestep, neighbour)) in after.chain(before).enumerate() {
        progress(FitStage::Track, done, count - 1);
        problem.track(&mut heads, timestep, neighbour, noise);
    }

    let window = Window::all(count).with_identity();
    for round in 0..REFINEMENTS {
        progress(FitStage::Refine, round, REFINEMENTS);
        if round > 0 {
            problem.weigh_landmarks(&heads, noise);
            problem.weigh_offsets(&heads, &window, noise);
        }
        noise = problem.anneal(&mut heads, &window);
    }
    progress(FitStage::Refine, REFINEMENTS, REFINEMENTS);
    let mut step = |done, steps| progress(FitStage::Align, done, steps);
    let agreement = pictures.map(|read| problem.align(&mut heads, noise, read, &mut step)).transpose()?;
    let report = FitReport { pictures: agreement, ..problem.report(&heads, first, noise) };
    Ok(Fit { timesteps: problem.timesteps, states: heads.states, report })
}

//! The head that a capture shows, made again: with it everything is known of the capture, its true flow included.

use std::path::Path;

use serde::Deserialize;
use srflow_avatar::capture::{Capture, HeadRecord};
use srflow_avatar::{Avatar, PosedHead};
use srflow_files::{FileKind, FileProblem, parse_error_in_words, read_text};
use srflow_head::HeadPose;
use srflow_splat::{Frame, Gaussians, Options, Outputs, Rasterizer};

use super::settings::MANIFEST_NAME;
use crate::{RenderError, head};

/// The folder of the true cameras and landmarks in a capture.
pub const TRUE_FOLDER: &str = "true";

/// The truth of a capture that [`capture`](super::capture) made.
#[derive(Debug, Clone)]
pub struct TrueCapture {
    /// Its pictures with their true cameras.
    pub capture: Capture,
    pub avatar: Avatar,
    /// In the order of [`Capture::timesteps`].
    pub poses: Vec<HeadPose>,
}

/// What is read of `capture.json`.
#[derive(Deserialize)]
struct Arguments {
    srflow_version: String,
    head: String,
}

/// How far alpha may be from its 8 bits in the file, and the share of pixels that may be farther.
const ALPHA_TOLERANCE: f32 = 2.0 / 255.0;
const FAR_SHARE: f64 = 1e-3;

impl TrueCapture {
    /// Makes the head of the capture in `dir` again and compares it with what the files say of it, the alpha of the first picture
    /// included.
    ///
    /// # Errors
    /// [`RenderError::NoTruth`] when the capture is of another origin or its head cannot be made again; or when a file cannot be
    /// read.
    pub fn read(dir: &Path) -> Result<Self, RenderError> {
        let unknown = |reason: String| RenderError::NoTruth { dir: dir.to_owned(), reason };
        let path = dir.join(MANIFEST_NAME);
        let text = match read_text(&path, FileKind::Json) {
            Err(error) if error.is_not_found() => {
                return Err(unknown(format!(
                    "it has no {MANIFEST_NAME}, and only captures that `srflow avatar capture` made show a head that can be made again"
                )));
            }
            text => text?,
        };
        let arguments: Arguments = serde_json::from_str(&text).map_err(|error| {
            let expected = "srflow_version and head, as srflow writes them";
            FileProblem::field("arguments", expected, parse_error_in_words(&error)).in_file(&path)
        })?;
        let record = HeadRecord::read(dir)?
            .ok_or_else(|| unknown("it has no head.json, which names its head".to_owned()))?;
        let source = record.source().map_err(|reason| unknown(format!("head.json: {reason}")))?;
        if let Some(missing) = source.paths().iter().find(|path| !path.exists()) {
            return Err(unknown(format!(
                "the files of its head {source} are missing: {}; a relative path counts from the current folder",
                missing.display()
            )));
        }
        let recorded = head::recorded(&source)?;
        if recorded != arguments.head {
            return Err(unknown(format!(
                "its pictures show the head `{}`, and {source} of head.json is `{recorded}`",
                arguments.head
            )));
        }
        let failed = |error| RenderError::Head { who: dir.display().to_string(), reason: format!("{error}") };
        let avatar = source.avatar(record.subject).map_err(failed)?;
        record.check(dir, avatar.model())?;
        let capture = Capture::read(&dir.join(TRUE_FOLDER))?;
        let parameters = capture.parameters()?;
        if parameters.shape != avatar.identity().shape {
            return Err(unknown(format!("the shape in its parameters is not that of {source}")));
        }
        let poses = parameters.poses.iter().map(|pose| pose.pose(avatar.model())).collect();
        let truth = Self { capture, avatar, poses };
        match truth.first_picture_agrees()? {
            true => Ok(truth),
            false => Err(unknown(format!(
                "its first mask is not that of {source} in its first pose; it was made by srflow {}, this is {}",
                arguments.srflow_version,
                env!("CARGO_PKG_VERSION")
            ))),
        }
    }

    fn first_picture_agrees(&self) -> Result<bool, RenderError> {
        let (Some(view), Some(pose)) = (self.capture.views().first(), self.poses.first()) else {
            return Ok(false);
        };
        let Some(mask) = self.capture.mask(view)? else { return Ok(false) };
        let (mut head, mut gaussians, mut frame) = (PosedHead::default(), Gaussians::default(), Frame::new());
        self.avatar.gaussians_into(pose, &mut head, &mut gaussians);
        let options = Options { outputs: Outputs { alpha: true, ..Outputs::NONE }, ..Options::default() };
        Rasterizer::new()
            .render(&gaussians, &view.camera, None, &options, &mut frame)
            .map_err(|error| RenderError::Rasterize { frame: view.image.display().to_string(), error })?;
        let alphas = mask.pixels().iter().zip(frame.alpha.pixels());
        let far = alphas.filter(|(mask, alpha)| (*mask - *alpha).abs() > ALPHA_TOLERANCE).count();
        Ok(far as f64 <= FAR_SHARE * mask.pixels().len() as f64)
    }
}

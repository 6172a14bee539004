//! Clips whose onset is known, classified.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use srflow_data::micro_expression::{Annotation, Clip};
use srflow_files::write_image_png;
use srflow_mer::{ApexRule, Preparation, faces_of_clip, fill_apexes};

use super::classified::{Classified, Classifier, Seen};
use crate::Watch;
use crate::error::wrong_settings;
use crate::face::FaceArgs;
use crate::flow::frames::Source;

/// How clips are seen.
pub struct ClipSettings<'a> {
    pub face: &'a FaceArgs,
    pub apex: ApexRule,
    /// Where detected landmarks are written.
    pub landmarks: PathBuf,
    pub force: bool,
    /// Names of the clips' own classes, by number; empty if they are not the model's.
    pub classes: &'a [String],
}

/// Classifies clips; `None` if it was stopped.
///
/// # Errors
/// When a frame or a face cannot be read, or the flow method fails.
pub fn classify_clips(
    classifier: &Classifier,
    settings: ClipSettings,
    mut clips: Vec<Clip>,
    watch: &Watch,
) -> anyhow::Result<Option<Vec<Seen>>> {
    let ClipSettings { face, apex, landmarks, force, classes } = settings;
    let face = face.of_clips(clips.iter(), || landmarks, force, watch)?;
    let preparation = Preparation { face, features: classifier.model.card.features };
    let done = watch.count("clips", clips.len() as u64);
    fill_apexes(&mut clips, apex, &preparation, classifier.estimator, &|| {})?;
    let mut classified = Vec::new();
    for clip in &clips {
        if watch.stops() {
            return Ok(None);
        }
        let [onset, apex] = faces_of_clip(clip, &preparation.face)?;
        let truth = classes.get(clip.annotation.class).cloned();
        classified.push(classifier.classify(expression(clip, truth), onset, apex)?);
        done.inc();
    }
    Ok(Some(classified))
}

/// A clip whose class is not known yet.
fn expression(clip: &Clip, truth: Option<String>) -> Classified {
    let Annotation { subject, clip: name, onset, apex, offset, .. } = &clip.annotation;
    let number = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
    Classified {
        source: clip.dataset.clone(),
        subject: subject.clone(),
        clip: name.clone(),
        onset: number(*onset),
        apex: apex.map_or(number(*onset), number),
        offset: number(*offset),
        truth,
        ..Classified::default()
    }
}

/// A video or a folder of frames as one clip. The frames of a video are written below a folder.
///
/// # Errors
/// When frames cannot be read, or there are fewer than two.
pub fn whole_clip(path: &Path, frames_below: &Path) -> anyhow::Result<Clip> {
    let source = Source::open(&[path.to_owned()])?;
    let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
    let name = name.unwrap_or_default().to_string_lossy().into_owned();
    let frames: BTreeMap<u64, PathBuf> = match &source {
        Source::Files(files) => {
            let Ok(first) = u64::try_from(source.first_number()) else {
                wrong_settings!("{}: expected frames with numbers from 0 on", path.display())
            };
            (first..).zip(files.iter().cloned()).collect()
        }
        Source::Video(..) => {
            let folder = tempfile::tempdir_in(frames_below)?.keep();
            let mut frames = BTreeMap::new();
            let mut failed = None;
            source.read(0, 1, |frame| {
                let number = frames.len() as u64 + 1;
                let file = folder.join(format!("{number:06}.png"));
                failed = frame.and_then(|frame| Ok(write_image_png(&file, &frame.image)?)).err();
                frames.insert(number, file);
                failed.is_none()
            });
            failed.map_or(Ok(frames), Err).with_context(|| path.display().to_string())?
        }
    };
    let end = |frame: Option<(&u64, &PathBuf)>| frame.map_or(0, |(number, _)| *number);
    let annotation = Annotation {
        subject: name.clone(),
        clip: name,
        class: 0,
        label: String::new(),
        action_units: String::new(),
        onset: end(frames.first_key_value()),
        apex: None,
        offset: end(frames.last_key_value()),
    };
    Ok(Clip { dataset: "clips".to_owned(), annotation, folder: path.to_owned(), frames })
}

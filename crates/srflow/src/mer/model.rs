//! The model that a run leaves behind.

use srflow_data::micro_expression::Clip;
use srflow_eval::MethodRecord;
use srflow_files::read_image_size;
use srflow_mer::{
    DataRecord, ModelCard, ModelData, ModelFlow, ModelLesson, RecognitionModel, RunResults, Sample,
    TrainingRange,
};

/// Trains a classifier on all clips of a run with one flow method, given as `method`.
///
/// # Errors
/// When a face cannot be measured, or training diverges.
pub fn train_model(results: &RunResults, method: String, date: &str) -> anyhow::Result<RecognitionModel> {
    let RunResults { settings, features, methods, trials, .. } = results;
    // Sets are in order, and the one with all datasets is the last.
    let (Some(trial), Some((_, samples)), Some(record)) =
        (trials.last(), features.samples.first(), methods.first())
    else {
        anyhow::bail!("expected the results of a flow method, found none");
    };
    let MethodRecord { sha256, parameters, .. } = record;
    let samples: Vec<&Sample> = samples.iter().collect();
    let lesson = ModelLesson { samples: &samples, trial, protocol: &settings.protocol };
    let (temperature, held_out) = lesson.calibrated();
    let widths = features.clips.iter().map(|clip| face_width(results, clip));
    let widths = widths.collect::<anyhow::Result<Vec<usize>>>()?;
    let data = features.data.iter().map(|DataRecord { dataset, clips, subjects, .. }| ModelData {
        dataset: dataset.clone(),
        clips: *clips,
        subjects: *subjects,
    });
    let card = ModelCard {
        srflow_version: env!("CARGO_PKG_VERSION").to_owned(),
        date: date.to_owned(),
        note: String::new(),
        classifier: settings.classifier,
        classes: settings.classes.to_vec(),
        features: settings.preparation.features,
        faces: settings.preparation.face.kind().to_owned(),
        flow: ModelFlow { method, sha256: sha256.clone(), parameters: parameters.clone() },
        data: data.collect(),
        held_out,
        temperature,
        range: TrainingRange {
            motion_px: lesson.motion_px(),
            unexplained: lesson.unexplained(),
            face_px: [widths.iter().min(), widths.iter().max()].map(|width| width.copied().unwrap_or(0)),
        },
    };
    Ok(RecognitionModel::train(card, &lesson)?)
}

/// Width of the face that is cut out of a clip, in pixels.
fn face_width(results: &RunResults, clip: &Clip) -> anyhow::Result<usize> {
    let crop = results.settings.preparation.face.of_clip(&clip.dataset, &clip.annotation)?;
    let frame = clip.frame(clip.annotation.onset).map(read_image_size).transpose()?;
    Ok(crop.size_in(frame.unwrap_or_default()).width)
}

//! Spotted expressions, classified.

use std::collections::BTreeMap;

use anyhow::Context as _;
use srflow_core::Image;
use srflow_face::FrameCrop;

use super::classified::{Classified, Classifier, Seen};
use crate::Watch;
use crate::face::{FaceArgs, FaceTrack};
use crate::flow::frames::Source;
use crate::mer::spot::{Event, SpottedVideo};

/// The face in the onset of an expression, until its apex is read.
struct Onset {
    crop: FrameCrop,
    face: Image,
}

/// Classifies the expressions of a video by their onset and apex frames. Each is cropped as the face is in its onset.
///
/// # Errors
/// When frames or landmarks cannot be read, or the flow method fails.
pub fn classify_events(
    classifier: &Classifier,
    face: &FaceArgs,
    video: &SpottedVideo,
    watch: &Watch,
) -> anyhow::Result<Vec<Seen>> {
    let Some(last) = video.events.iter().map(|event| event.apex).max() else { return Ok(Vec::new()) };
    let source = Source::open(std::slice::from_ref(&video.path))?;
    let mut track = face.along(&video.video)?;
    let done = watch.count("expressions", Some(video.events.len() as u64));
    done.message(video.video.as_str());
    let mut onsets = BTreeMap::<usize, Onset>::new();
    let mut classified = BTreeMap::new();
    let mut number = source.first_number();
    let mut take = |number: i64, image: &Image| -> anyhow::Result<()> {
        for (place, event) in video.events.iter().enumerate() {
            if event.onset == number {
                match crop_of(&mut track, number, image)? {
                    Some(crop) => {
                        let face = crop.apply(image)?;
                        onsets.insert(place, Onset { crop, face });
                    }
                    None => _ = classified.insert(place, (without_face(video, event, classifier), None)),
                }
            }
            if event.apex == number
                && let Some(Onset { crop, face }) = onsets.remove(&place)
            {
                let apex = crop.apply(image)?;
                classified.insert(place, classifier.classify(expression(video, event), face, apex)?);
                done.inc();
            }
        }
        Ok(())
    };
    let mut failed = None;
    source.read(0, 1, |frame| {
        failed = frame.and_then(|frame| take(number, &frame.image)).err();
        number += 1;
        failed.is_none() && number <= last
    });
    match failed {
        Some(error) => Err(error).with_context(|| video.video.clone()),
        None => Ok(classified.into_values().collect()),
    }
}

/// The crop about the face in a frame.
fn crop_of(track: &mut FaceTrack, number: i64, frame: &Image) -> anyhow::Result<Option<FrameCrop>> {
    if let FaceTrack::Still(face) = track {
        return Ok(Some(face.crop.clone()));
    }
    Ok(track.points(number, frame)?.as_ref().map(FrameCrop::upright))
}

/// An event whose class is not known yet.
fn expression(video: &SpottedVideo, event: &Event) -> Classified {
    Classified {
        source: video.video.clone(),
        kind: Some(event.kind),
        onset: event.onset,
        apex: event.apex,
        offset: event.offset,
        onset_seconds: Some(event.onset_seconds),
        ..Classified::default()
    }
}

fn without_face(video: &SpottedVideo, event: &Event, classifier: &Classifier) -> Classified {
    Classified {
        probabilities: vec![f64::NAN; classifier.model.card.classes.len()],
        doubt: Some("no face is found in the onset frame".to_owned()),
        ..expression(video, event)
    }
}

//! From a clip to its features: crop, resize, flow from onset to apex, strain.

use std::fmt;
use std::path::Path;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use srflow_core::resize::{resize_cubic, resize_flow_area};
use srflow_core::{FlowEstimator, FlowField, Image, Plane, Size, in_stages, named, serialize_as_text};
use srflow_data::micro_expression::Clip;
use srflow_face::FrameCrop;
use srflow_files::read_image;

use crate::cache::{FeatureCache, FeatureKey};
use crate::extract_error::{ExtractError, ExtractProblem};
use crate::face::FaceCrop;
use crate::features::{FEATURE_SIDE, Features};
use crate::head_motion::{HeadMotion, SubtractedMotion};
use crate::sample::Sample;
use crate::strain::{StrainFormula, optical_strain};

/// Whether pictures or flow are resized to 112x112. The paper does not say; Off-TANet's code resizes pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResizeOrder {
    /// Pictures are resized (cubic, as OpenCV), and flow is computed at 112x112.
    Before,
    /// Flow is computed at the pictures' own size and averaged down to 112x112, in pixels of that size.
    After,
}

named!(ResizeOrder, "before or after the flow", { Before => "before", After => "after" });
serialize_as_text!(ResizeOrder);

/// How two faces become features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureSettings {
    /// Whether pictures or flow are resized.
    pub resize: ResizeOrder,
    pub head_motion: HeadMotion,
    pub strain: StrainFormula,
}

impl fmt::Display for FeatureSettings {
    /// Description for results.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { resize, head_motion, strain } = self;
        let head = match head_motion {
            HeadMotion::Keep => "head motion kept",
            HeadMotion::Subtract => "head motion subtracted within the face",
        };
        write!(f, "resized to {FEATURE_SIDE}x{FEATURE_SIDE} {resize} the flow, {head}, {strain} strain")
    }
}

/// The settings that features depend on, apart from the pictures and the flow method.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Preparation {
    pub face: FaceCrop,
    pub features: FeatureSettings,
}

impl fmt::Display for Preparation {
    /// Description for results.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {}", self.face, self.features)
    }
}

/// A flow method, identified by its name, parameters and weights.
pub struct Method<'a> {
    pub estimator: &'a dyn FlowEstimator,
    /// Its name with every parameter, and a digest of its weights, if it has any: features are cached under it.
    pub identity: String,
}

/// The flow from `onset` to `apex` at the features' size, and its strain; and the motion of the head that was subtracted.
///
/// # Errors
/// When the flow method fails, or its flow is not finite.
pub fn features_of_frames(
    onset: &Image,
    apex: &Image,
    estimator: &dyn FlowEstimator,
    settings: FeatureSettings,
) -> Result<(Features, Option<SubtractedMotion>), ExtractProblem> {
    let flow = match settings.resize {
        ResizeOrder::Before => estimator.estimate(&resize_cubic(onset, SIZE), &resize_cubic(apex, SIZE))?,
        ResizeOrder::After => estimator.estimate(onset, apex)?,
    };
    features_of_flow(flow, settings)
}

/// Of the feature maps.
const SIZE: Size = Size::new(FEATURE_SIDE, FEATURE_SIDE);

/// The flow from onset to apex, of any size, as [`features_of_frames`] gives it.
///
/// # Errors
/// When the flow is not finite.
pub fn features_of_flow(
    flow: FlowField,
    FeatureSettings { head_motion, strain, .. }: FeatureSettings,
) -> Result<(Features, Option<SubtractedMotion>), ExtractProblem> {
    let (mut flow, subtracted) = head_motion.applied(flow);
    if flow.size() != SIZE {
        flow = resize_flow_area(&flow, SIZE);
    }
    let [u, v] = components(&flow);
    // Strain first: the edge of the face is none.
    let [u, v, strain] = [u, v, optical_strain(&flow, strain)].map(|map| head_motion.within_face(map));
    Ok((Features::new(&u, &v, &strain)?, subtracted))
}

fn components(flow: &FlowField) -> [Plane; 2] {
    [0, 1].map(|component| Plane::from_fn(flow.width(), flow.height(), |x, y| flow.get(x, y)[component]))
}

/// Features of a clip, and the motion of the head that they are without.
type OfClip = (Features, Option<SubtractedMotion>);

/// What is known of a clip before the flow is estimated.
enum Prepared {
    /// Features in the cache.
    Cached(OfClip),
    /// The faces in its onset and apex frames, and the key for the cache.
    Faces([Image; 2], Option<FeatureKey>),
}

/// Features of a clip, and the key under which they are to be cached; `None` for those that are.
type Computed = (OfClip, Option<FeatureKey>);

/// How features of clips are computed.
struct Extraction<'a> {
    method: &'a Method<'a>,
    preparation: &'a Preparation,
    cache: Option<&'a FeatureCache>,
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl Extraction<'_> {
    /// Looks into the cache, and if that has no features reads the faces.
    fn prepared(&self, clip: &Clip) -> Result<Prepared, ExtractProblem> {
        if (self.stop)() {
            return Err(ExtractProblem::Stopped);
        }
        let apex = clip.annotation.apex.ok_or(ExtractProblem::NoApex)?;
        let file = |number| clip.frame(number).ok_or(ExtractProblem::NoFrame(number));
        let (onset, apex) = (file(clip.annotation.onset)?, file(apex)?);
        let crop = self.preparation.face.of_clip(&clip.dataset, &clip.annotation)?;
        let recipe = || recipe(self.method, &crop, self.preparation);
        let key = self.cache.map(|cache| cache.key(onset, apex, &recipe())).transpose()?;
        let head_motion = self.preparation.features.head_motion;
        match self.cache.zip(key.as_ref()).and_then(|(cache, key)| cache.get(key, head_motion)) {
            Some(of_clip) => Ok(Prepared::Cached(of_clip)),
            None => Ok(Prepared::Faces(read_faces(onset, apex, &crop)?, key)),
        }
    }

    fn computed(&self, prepared: Prepared) -> Result<Computed, ExtractProblem> {
        let ([onset, apex], key) = match prepared {
            Prepared::Cached(of_clip) => return Ok((of_clip, None)),
            Prepared::Faces(faces, key) => (faces, key),
        };
        Ok((features_of_frames(&onset, &apex, self.method.estimator, self.preparation.features)?, key))
    }

    /// Keeps new features, and reports them.
    fn sample(
        &self,
        clip: &Clip,
        ((features, head_motion), key): Computed,
        on_clip: &(dyn Fn(Extracted) + Sync),
    ) -> Result<Sample, ExtractProblem> {
        if let (Some(cache), Some(key)) = (self.cache, &key) {
            cache.put(key, &features, head_motion.as_ref())?;
        }
        on_clip(Extracted { clip: &clip.id(), cached: self.cache.is_some() && key.is_none() });
        Ok(Sample {
            dataset: clip.dataset.clone(),
            subject: clip.annotation.subject.clone(),
            clip: clip.annotation.clip.clone(),
            class: clip.annotation.class,
            features,
            head_motion,
        })
    }
}

/// The faces in a clip's onset and apex frames, cropped as for features but at full resolution.
///
/// # Errors
/// When the clip has no apex, or a frame cannot be read or cropped.
pub fn faces_of_clip(clip: &Clip, face: &FaceCrop) -> Result<[Image; 2], ExtractError> {
    let faces = || {
        let apex = clip.annotation.apex.ok_or(ExtractProblem::NoApex)?;
        let file = |number| clip.frame(number).ok_or(ExtractProblem::NoFrame(number));
        let crop = face.of_clip(&clip.dataset, &clip.annotation)?;
        read_faces(file(clip.annotation.onset)?, file(apex)?, &crop)
    };
    faces().map_err(|problem| ExtractError { clip: clip.id(), problem })
}

fn read_faces(onset: &Path, apex: &Path, crop: &FrameCrop) -> Result<[Image; 2], ExtractProblem> {
    let (first, second) = rayon::join(|| read_image(onset), || read_image(apex));
    let (first, second) = (first?, second?);
    if first.size() != second.size() || first.pixels().is_empty() {
        return Err(ExtractProblem::Sizes {
            onset: onset.to_owned(),
            onset_size: first.size(),
            apex: apex.to_owned(),
            apex_size: second.size(),
        });
    }
    Ok([crop.apply(&first)?, crop.apply(&second)?])
}

/// Everything apart from the pictures that the features depend on. The crop is this clip's: other rows of a landmark file may
/// change.
fn recipe(method: &Method, crop: &FrameCrop, preparation: &Preparation) -> String {
    let FeatureSettings { resize, head_motion, strain } = preparation.features;
    format!("{}\n{crop:?}\n{resize}\n{head_motion}\n{strain}", method.identity)
}

/// Progress of [`extract`].
#[derive(Debug, Clone, Copy)]
pub struct Extracted<'a> {
    /// The clip, as dataset/subject/clip.
    pub clip: &'a str,
    /// Whether its features were in the cache.
    pub cached: bool,
}

/// Features of every clip, in the clips' order; each clip must have an apex. `stop` is asked before each clip.
///
/// # Errors
/// The error of the first clip, in order, whose frames cannot be used, or before which `stop` is true: no clip is left out
/// silently.
pub fn extract(
    clips: &[Clip],
    method: &Method,
    preparation: &Preparation,
    cache: Option<&FeatureCache>,
    on_clip: &(dyn Fn(Extracted) + Sync),
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Sample>, ExtractError> {
    let extraction = Extraction { method, preparation, cache, stop };
    let of = |clip: &Clip, problem| ExtractError { clip: clip.id(), problem };
    if preparation.features.resize == ResizeOrder::After {
        // Large frames occupy all threads one pair at a time, while the next is read.
        let mut samples = Vec::with_capacity(clips.len());
        in_stages(
            1,
            |give| {
                let read = |clip| Ok((clip, extraction.prepared(clip).map_err(|problem| of(clip, problem))?));
                _ = clips.iter().map(read).all(give);
            },
            |(clip, prepared)| {
                Ok((clip, extraction.computed(prepared).map_err(|problem| of(clip, problem))?))
            },
            |(clip, computed)| {
                let sample = extraction.sample(clip, computed, on_clip);
                samples.push(sample.map_err(|problem| of(clip, problem))?);
                Ok(())
            },
        )?;
        return Ok(samples);
    }
    let sample = |clip: &Clip| {
        let computed = extraction.prepared(clip).and_then(|prepared| extraction.computed(prepared));
        let sample = computed.and_then(|computed| extraction.sample(clip, computed, on_clip));
        sample.map_err(|problem| of(clip, problem))
    };
    let results: Vec<Result<Sample, ExtractError>> = clips.par_iter().map(sample).collect();
    results.into_iter().collect()
}

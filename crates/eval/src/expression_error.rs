//! How exact the flow of an expression is that an estimate gives once the motion of the head is subtracted from it.

use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, Labels, Mask, Plane, Size, SurfaceMotion};
use srflow_data::region_map::HeadPart;

/// Errors in the face of a flow, and of what is left of it as the expression's: the motion that most of the face follows
/// ([`SurfaceMotion`]) is the head's, and is subtracted. For one pair, or the mean over pairs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ExpressionError {
    /// Mean end-point error of the flow, pixels.
    pub flow_epe: f64,
    /// Mean end-point error of what is left of it, against the true flow of the expression, pixels.
    pub expression_epe: f64,
    /// `expression_epe` relative to `flow_epe`, of means where they are: 1.15 is 15 % more. `None` for a flow without error.
    pub ratio: Option<f64>,
    /// `expression_epe` of the true flow, pixels: what a fit to the motion of the head leaves without any error of an estimate.
    pub floor_epe: f64,
}

impl ExpressionError {
    fn new(flow_epe: f64, expression_epe: f64, floor_epe: f64) -> Self {
        let ratio = Some(expression_epe / flow_epe).filter(|ratio| ratio.is_finite());
        Self { flow_epe, expression_epe, ratio, floor_epe }
    }

    /// The mean over pairs; `None` without pairs.
    pub(crate) fn mean(pairs: impl Iterator<Item = Self>) -> Option<Self> {
        let (mut sums, mut count) = ([0.0; 3], 0.0);
        for Self { flow_epe, expression_epe, floor_epe, .. } in pairs {
            for (sum, value) in sums.iter_mut().zip([flow_epe, expression_epe, floor_epe]) {
                *sum += value;
            }
            count += 1.0;
        }
        let [flow_epe, expression_epe, floor_epe] = sums.map(|sum| sum / count);
        (count > 0.0).then(|| Self::new(flow_epe, expression_epe, floor_epe))
    }
}

/// The pixels of a face.
pub(crate) struct Face {
    /// 1 where the motion of the head is fitted to the flow, else 0.
    fitted: Plane,
    /// The pixels that are scored.
    scored: Mask,
}

impl Face {
    /// By a region map, skin is fitted, and skin, eyes and mouth are scored; without one, both are the head, or the frame. All are of
    /// one size.
    pub fn new(map: Option<&Labels>, head: Option<&Mask>, Size { width, height }: Size) -> Self {
        let part = |x, y| map.map(|map| HeadPart::of_label(map.get(x, y)));
        let in_head = |x, y| head.is_none_or(|head| head.get(x, y));
        let fitted = |x, y| part(x, y).map_or_else(|| in_head(x, y), |part| part == Some(HeadPart::Skin));
        let in_face = |part| matches!(part, Some(HeadPart::Skin | HeadPart::Eyes | HeadPart::Mouth));
        Self {
            fitted: Plane::from_fn(width, height, |x, y| f32::from(fitted(x, y))),
            scored: Mask::from_fn(width, height, |x, y| part(x, y).map_or_else(|| in_head(x, y), in_face)),
        }
    }

    /// The flow without the motion of the head; `None` when it is not known in the face.
    fn without_head(&self, flow: &FlowField) -> Option<FlowField> {
        Some(SurfaceMotion::fit(flow, Some(&self.fitted))?.subtracted_from(flow))
    }

    /// Mean end-point error over the pixels where both flows are known; `None` without such pixels.
    fn epe(&self, flow: &FlowField, truth: &FlowField) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0_u64);
        let flows = flow.pixels().iter().zip(truth.pixels());
        for ((flow, truth), _) in flows.zip(self.scored.pixels()).filter(|(_, scored)| **scored) {
            let error = f64::from(flow[0] - truth[0]).hypot(f64::from(flow[1] - truth[1]));
            if error.is_finite() {
                sum += error;
                count += 1;
            }
        }
        (count > 0).then(|| sum / count as f64)
    }
}

/// What the flow of an expression is scored against.
pub(crate) struct ExpressionTruth {
    expression: FlowField,
    face: Face,
    /// See [`ExpressionError::floor_epe`]; `None` when the pair shows no face.
    floor_epe: Option<f64>,
}

impl ExpressionTruth {
    /// `flow` is the whole true flow. All are of one size.
    pub fn new(flow: &FlowField, expression: FlowField, face: Face) -> Self {
        let floor_epe = face.without_head(flow).and_then(|rest| face.epe(&rest, &expression));
        Self { expression, face, floor_epe }
    }

    /// The errors of an estimate of `truth`, the whole flow; `None` when the pair shows no face, or no flow is known there.
    pub fn error(&self, estimate: &FlowField, truth: &FlowField) -> Option<ExpressionError> {
        let Self { expression, face, floor_epe } = self;
        let rest = face.without_head(estimate)?;
        Some(ExpressionError::new(face.epe(estimate, truth)?, face.epe(&rest, expression)?, (*floor_epe)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_face_of_a_region_map_is_skin_eyes_and_mouth() {
        // From left to right: background, skin, eyes, mouth, hair, neck.
        let map = Labels::from_fn(6, 2, |x, _| x as u8);
        let head = Mask::from_fn(6, 2, |x, _| x > 0);
        let rows = |face: &Face| (face.fitted.row(1).to_vec(), face.scored.row(0).to_vec());
        let (yes, no) = (true, false);
        let expected = (vec![0.0, 1.0, 0.0, 0.0, 0.0, 0.0], vec![no, yes, yes, yes, no, no]);
        assert_eq!(rows(&Face::new(Some(&map), Some(&head), Size::new(6, 2))), expected);
        let expected = (vec![0.0, 1.0, 1.0, 1.0, 1.0, 1.0], vec![no, yes, yes, yes, yes, yes]);
        assert_eq!(rows(&Face::new(None, Some(&head), Size::new(6, 2))), expected);
        assert_eq!(rows(&Face::new(None, None, Size::new(6, 2))), (vec![1.0; 6], vec![yes; 6]));
    }
}

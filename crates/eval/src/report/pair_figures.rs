//! One scored pair as pictures: the frame and the ground truth, and the flow and error of every method.

use rayon::prelude::*;
use srflow_core::{FlowField, Image, Plane, flow_colors};
use srflow_data::flow::Sample;

use super::charts::number;
use super::heat::{error_map, heat};
use super::legend::{heat_legend, wheel_legend};
use super::panels::{Panel, columns, panels};
use super::picture::{Picture, PictureError};
use super::shrink::{shrink_flow, shrink_image, shrink_mask, shrink_plane};
use super::{Figure, side_by_side};
use crate::evaluate::ScoredPair;

/// The frame above the true flow in a first column, then one column per method: its flow above its error. Landscape pictures
/// are shown in rows of two, in the same order. All flow colours share one scale, and so do all error colours. Pictures are
/// at most `max_width` pixels wide.
///
/// # Errors
/// When a picture cannot be encoded.
pub fn pair_figures(
    pair: &ScoredPair<'_>,
    max_width: usize,
    caption: &str,
) -> Result<Vec<Figure>, PictureError> {
    let maps = PairMaps::new(pair, max_width);

    let panel = |picture, title: &str, note: String| Panel::new(picture, title, note);
    let flow_picture = |flow: &FlowField, alt: &str| Picture::jpeg(&maps.colors(flow), alt);
    let of_truth = || -> Result<Vec<Panel>, PictureError> {
        let frame = Picture::jpeg(&shrink_image(&pair.sample.frame1, max_width), "frame 1")?;
        Ok(vec![
            panel(frame, "Frame 1", pair.name.to_owned()),
            panel(flow_picture(&maps.truth, "true flow")?, "Truth", String::new()),
        ])
    };
    let of_method = |(place, error): &(usize, Plane)| -> Result<Vec<Panel>, PictureError> {
        let estimate = &pair.estimates[*place];
        let epe = estimate
            .kept
            .scores
            .whole
            .as_ref()
            .map_or(String::new(), |metrics| format!("EPE {:.3} px", metrics.epe));
        let flow = shrink_flow(&estimate.flow, max_width);
        Ok(vec![
            panel(flow_picture(&flow, "estimated flow")?, &estimate.method, String::new()),
            panel(Picture::jpeg(&heat(error, maps.largest as f32), "end-point error")?, "Error", epe),
        ])
    };
    let of_methods = || maps.errors.par_iter().map(of_method).collect::<Result<Vec<_>, _>>();
    let (of_truth, of_methods) = rayon::join(of_truth, of_methods);
    let all = [vec![of_truth?], of_methods?].concat();
    // Portrait pictures go side by side; landscape ones need half the page.
    let upright = 5 * pair.truth.height() > 4 * pair.truth.width();
    let pictures = match upright {
        true => columns(&all, 240, caption),
        false => panels(&all.concat(), 420, caption),
    };
    let heat_words =
        "The scale ends where 98 % of the pixels of the middle method lie below. Grey: no ground truth.";
    let wheel_words = "Longer flow has the colour of the rim. Black: no ground truth.";
    let legends = vec![wheel_legend(maps.longest, wheel_words)?, heat_legend(maps.largest, heat_words)?];
    Ok(vec![pictures, side_by_side(legends, 420)])
}

/// What the pictures of a pair are made of, with one scale for all methods.
struct PairMaps {
    truth: FlowField,
    /// The place of each method but the baseline among the estimates, and its end-point errors.
    errors: Vec<(usize, Plane)>,
    /// Length in pixels of the flow with the full colour.
    longest: f64,
    /// Error in pixels with the lightest colour.
    largest: f64,
}

impl PairMaps {
    /// At most `max_width` pixels wide.
    fn new(pair: &ScoredPair<'_>, max_width: usize) -> Self {
        let methods = pair.estimates.par_iter().enumerate().filter(|(_, estimate)| !estimate.baseline);
        let error = |flow| shrink_plane(&error_map(flow, pair.truth), max_width);
        let errors = methods.map(|(place, estimate)| (place, error(&estimate.flow)));
        let (truth, errors): (_, Vec<(usize, Plane)>) =
            rayon::join(|| shrink_flow(pair.truth, max_width), || errors.collect());
        let longest = flow_scale(&truth);
        let largest = error_scale(&errors.iter().map(|(_, error)| error).collect::<Vec<_>>());
        Self { truth, errors, longest, largest }
    }

    fn colors(&self, flow: &FlowField) -> Image {
        flow_picture(flow, self.longest)
    }
}

/// A flow in the colours of its directions, full at `longest` pixels; longer flow has the colour of that length in its direction.
pub fn flow_picture(flow: &FlowField, longest: f64) -> Image {
    flow_colors(&within(flow, longest as f32), Some(longest as f32))
}

/// A round length in pixels for the lightest colour of several methods' errors.
fn error_scale(errors: &[&Plane]) -> f64 {
    middle_scale(errors, 0.98, 0.1)
}

/// A round upper end of the colour scale of several methods' maps, robust to one method that is far off: the value below which `share`
/// of the pixels of the middle method lie, or of the better of two; at least `least`.
pub fn middle_scale(maps: &[&Plane], share: f64, least: f64) -> f64 {
    let mut ends: Vec<f64> = maps.iter().map(|map| share_below(map, share)).collect();
    ends.sort_by(f64::total_cmp);
    round_up(ends.get(ends.len().saturating_sub(1) / 2).copied().unwrap_or(0.0).max(least))
}

/// The flow with vectors longer than `longest` shortened to it.
fn within(flow: &FlowField, longest: f32) -> FlowField {
    FlowField::from_fn(flow.width(), flow.height(), |x, y| {
        let [u, v] = flow.get(x, y);
        let beyond = u.hypot(v) / longest;
        if beyond > 1.0 { [u / beyond, v / beyond] } else { [u, v] }
    })
}

/// The data of one pair called `name`: frame, true flow, mask and occlusion, as far as the dataset has them.
///
/// # Errors
/// When a picture cannot be encoded.
pub fn sample_panels(sample: &Sample, name: &str, max_width: usize) -> Result<Vec<Panel>, PictureError> {
    let panel = |picture, title: &str, note: &str| Panel::new(picture, title, note);
    let frame = Picture::jpeg(&shrink_image(&sample.frame1, max_width), "frame 1")?;
    let mut panels = vec![panel(frame, "Frame", name)];
    if let Some(flow) = &sample.flow {
        let flow = shrink_flow(flow, max_width);
        let longest = flow_scale(&flow);
        let picture = Picture::jpeg(&flow_colors(&flow, Some(longest as f32)), "true flow to frame 2")?;
        panels.push(panel(picture, "Flow", &format!("full colour at {} px", number(longest))));
    }
    let grey = |mask, alt: &str| Picture::grey(&shrink_mask(mask, max_width), alt);
    if let Some(mask) = &sample.mask {
        panels.push(panel(grey(mask, "mask of the head")?, "Mask", "where the head is"));
    }
    if let Some(occlusion) = &sample.occlusion {
        panels.push(panel(grey(occlusion, "occluded pixels")?, "Occlusion", "not seen in frame 2"));
    }
    Ok(panels)
}

/// A round length in pixels for the full colour of a flow: its 99.5th percentile or more.
pub fn flow_scale(flow: &FlowField) -> f64 {
    color_scale(flow.pixels().iter().map(|[u, v]| u.hypot(*v)), 0.1)
}

/// A round upper end of a colour scale, at least `least`: the 99.5th percentile of the values or more.
pub fn color_scale(values: impl IntoIterator<Item = f32>, least: f64) -> f64 {
    let values: Vec<f32> = values.into_iter().collect();
    let plane = Plane::from_fn(values.len(), 1, |x, _| values[x]);
    round_up(share_below(&plane, 0.995).max(least))
}

/// The quantile `share` of the finite values; 0 when there are none.
fn share_below(plane: &Plane, share: f64) -> f64 {
    let mut values: Vec<f32> = plane.pixels().iter().copied().filter(|value| value.is_finite()).collect();
    let place = ((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1));
    match values.is_empty() {
        true => 0.0,
        false => f64::from(*values.select_nth_unstable_by(place, f32::total_cmp).1),
    }
}

/// The next of 1, 2, 3, 5, 10 times a power of ten above a positive value.
fn round_up(value: f64) -> f64 {
    let power = 10_f64.powf(value.log10().floor());
    let step = [1.0, 2.0, 3.0, 5.0, 10.0].into_iter().find(|step| step * power >= value * 0.999);
    let scale = step.unwrap_or(10.0) * power;
    (scale * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_are_round_and_hold_the_values() {
        assert_eq!([0.1, 0.13, 1.0, 2.2, 4.0, 61.0].map(round_up), [0.1, 0.2, 1.0, 3.0, 5.0, 100.0]);
        let plane = Plane::from_fn(100, 1, |x, _| if x == 0 { f32::NAN } else { x as f32 });
        assert_eq!(share_below(&plane, 0.5), 50.0);
        assert_eq!(share_below(&Plane::filled(2, 2, f32::NAN), 0.5), 0.0);
    }

    #[test]
    fn one_method_that_is_far_off_does_not_set_the_scale_of_the_errors() {
        let errors = [0.9, 400.0, 1.9].map(|error| Plane::filled(4, 4, error));
        let scale =
            |methods: &[usize]| error_scale(&methods.iter().map(|at| &errors[*at]).collect::<Vec<_>>());
        assert_eq!([scale(&[0]), scale(&[0, 1]), scale(&[0, 1, 2]), scale(&[])], [1.0, 1.0, 2.0, 0.1]);
    }

    #[test]
    fn flow_beyond_the_rim_keeps_its_direction() {
        let flow = FlowField::from_fn(3, 1, |x, _| [[3.0, 4.0], [30.0, 40.0], [f32::NAN; 2]][x]);
        let cut = within(&flow, 10.0);
        assert_eq!((cut.get(0, 0), cut.get(1, 0)), ([3.0, 4.0], [6.0, 8.0]));
        assert!(!cut.is_known(2, 0));
    }
}

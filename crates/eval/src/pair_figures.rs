//! One scored pair as pictures: the frame and the ground truth, and the flow and error of every method.

use rayon::prelude::*;
use srflow_core::{FlowField, Image, Plane, flow_colors};
use srflow_data::flow::Sample;
use srflow_report::html::{
    Figure, Panel, Picture, PictureError, columns, heat_legend, number, panels, side_by_side, wheel_legend,
};
use srflow_report::{
    error_map, flow_picture, flow_scale, heat, middle_scale, shrink_flow, shrink_image, shrink_mask,
    shrink_plane,
};

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

/// A round length in pixels for the lightest colour of several methods' errors.
fn error_scale(errors: &[&Plane]) -> f64 {
    middle_scale(errors, 0.98, 0.1)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_method_that_is_far_off_does_not_set_the_scale_of_the_errors() {
        let errors = [0.9, 400.0, 1.9].map(|error| Plane::filled(4, 4, error));
        let scale =
            |methods: &[usize]| error_scale(&methods.iter().map(|at| &errors[*at]).collect::<Vec<_>>());
        assert_eq!([scale(&[0]), scale(&[0, 1]), scale(&[0, 1, 2]), scale(&[])], [1.0, 1.0, 2.0, 0.1]);
    }
}

//! Colours of flow, and round ends of colour scales.

use srflow_core::{FlowField, Image, Plane, flow_colors};

/// A flow in the colours of its directions, full at `longest` pixels; longer flow has the colour of that length in its direction.
pub fn flow_picture(flow: &FlowField, longest: f64) -> Image {
    flow_colors(&within(flow, longest as f32), Some(longest as f32))
}

/// The flow with vectors longer than `longest` shortened to it.
fn within(flow: &FlowField, longest: f32) -> FlowField {
    FlowField::from_fn(flow.width(), flow.height(), |x, y| {
        let [u, v] = flow.get(x, y);
        let beyond = u.hypot(v) / longest;
        if beyond > 1.0 { [u / beyond, v / beyond] } else { [u, v] }
    })
}

/// A disc in flow colours, full at its rim.
pub fn color_wheel() -> Image {
    const RADIUS: f32 = 62.0;
    let place = |at: usize| (at as f32 - RADIUS) / RADIUS;
    let side = 2 * RADIUS as usize + 1;
    // Zero flow outside the disc: white corners, which the style sheet rounds off.
    let disc = FlowField::from_fn(side, side, |x, y| match (place(x), place(y)) {
        (u, v) if u.hypot(v) <= 1.0 => [u, v],
        _ => [0.0; 2],
    });
    flow_colors(&disc, Some(1.0))
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

/// A round upper end of the colour scale of several methods' maps, robust to one method that is far off: the value below which `share`
/// of the pixels of the middle method lie, or of the better of two; at least `least`.
pub fn middle_scale(maps: &[&Plane], share: f64, least: f64) -> f64 {
    let mut ends: Vec<f64> = maps.iter().map(|map| share_below(map, share)).collect();
    ends.sort_by(f64::total_cmp);
    round_up(ends.get(ends.len().saturating_sub(1) / 2).copied().unwrap_or(0.0).max(least))
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
    fn flow_beyond_the_rim_keeps_its_direction() {
        let flow = FlowField::from_fn(3, 1, |x, _| [[3.0, 4.0], [30.0, 40.0], [f32::NAN; 2]][x]);
        let cut = within(&flow, 10.0);
        assert_eq!((cut.get(0, 0), cut.get(1, 0)), ([3.0, 4.0], [6.0, 8.0]));
        assert!(!cut.is_known(2, 0));
    }
}

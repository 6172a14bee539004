//! When an expression that begins and ends at known frames is strongest.

use std::f64::consts::PI;

use srflow_core::dense::dot;

/// The apex is expected in the middle, with this deviation as a share of the length.
const EXPECTED_DEVIATION: f64 = 0.1;

/// How much of the length remains on either side of the apex, at least.
const NEAREST_END: f64 = 0.1;

/// Twice the flow's share of evidence per frame: flow of neighbouring places has the same errors, so a frame counts as one observation.
const EVIDENCE: f64 = 2.0;

/// The time course of an expression.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeCourse {
    /// Frames from the onset to the apex.
    pub apex: u64,
    /// Strength of the expression in every given frame, 1 at the apex of the fitted course.
    pub strengths: Vec<f64>,
}

impl TimeCourse {
    /// Fits `flow(t) = expression * s(t) + drift * t` to the flow from the onset to frames `t` in `1..=length`, each with its values at the same
    /// places; `s` rises from 0 at the onset to 1 at the apex and falls to 0 at the offset, in half waves of a cosine. The drift is
    /// what remains of the head's motion and of changing light. The apex explains most of the flow; it tends to the middle
    /// where the flow shows little. `None` without frames.
    pub fn fit(frames: &[(u64, Vec<f32>)], length: u64) -> Option<Self> {
        let places = frames.iter().map(|(_, values)| values.len()).min()?;
        let times: Vec<f64> = frames.iter().map(|(time, _)| *time as f64).collect();
        let squared_times: f64 = times.iter().map(|time| time * time).sum();
        // What is left of a course without its drift, and of the values at each place.
        let without_drift = |course: &[f64]| -> Vec<f64> {
            let slope = dot(course, &times) / squared_times.max(f64::MIN_POSITIVE);
            course.iter().zip(&times).map(|(value, time)| value - slope * time).collect()
        };
        let columns: Vec<Vec<f64>> = (0..places)
            .map(|place| {
                without_drift(&frames.iter().map(|(_, values)| values[place].into()).collect::<Vec<f64>>())
            })
            .collect();
        let total: f64 = columns.iter().map(|column| dot(column, column)).sum();

        let length = length.max(1);
        let margin = ((length as f64 * NEAREST_END) as u64).max(1);
        let course_to = |apex: u64| -> Vec<f64> {
            times.iter().map(|time| strength(*time, apex as f64, length as f64)).collect()
        };
        let explained_by = |apex: u64| {
            let course = without_drift(&course_to(apex));
            let squared = dot(&course, &course);
            let explained: f64 = columns.iter().map(|column| dot(column, &course).powi(2)).sum();
            if squared > 1e-9 { explained / squared } else { 0.0 }
        };
        let candidates: Vec<(u64, f64)> = (margin..=length.saturating_sub(margin).max(margin))
            .map(|apex| (apex, explained_by(apex)))
            .collect();
        let most = candidates.iter().map(|(_, explained)| *explained).fold(0.0, f64::max);
        let unexplained_per_frame =
            ((total - most) / frames.len() as f64).max(total * 1e-9).max(f64::MIN_POSITIVE);
        let score = |&(apex, explained): &(u64, f64)| {
            let from_middle = (apex as f64 / length as f64 - 0.5) / EXPECTED_DEVIATION;
            EVIDENCE * explained / unexplained_per_frame - from_middle * from_middle / 2.0
        };
        let mut best = *candidates.first()?;
        for candidate in &candidates {
            if score(candidate) > score(&best) {
                best = *candidate;
            }
        }
        let apex = best.0;

        let course = course_to(apex);
        let fitted = without_drift(&course);
        let expression: Vec<f64> = columns.iter().map(|column| dot(column, &fitted)).collect();
        let projected = |frame: usize| -> f64 {
            columns.iter().zip(&expression).map(|(column, weight)| column[frame] * weight).sum()
        };
        let strengths: Vec<f64> = (0..times.len()).map(projected).collect();
        // The drift is put back, so that the course is 0 at the onset and the offset, not on average.
        let slope = dot(&course, &times) / squared_times.max(f64::MIN_POSITIVE);
        let scale = dot(&expression, &expression) / dot(&fitted, &fitted).max(f64::MIN_POSITIVE);
        let strengths = strengths.iter().zip(&times);
        let strengths = strengths
            .map(|(strength, time)| if scale > 0.0 { strength / scale + slope * time } else { 0.0 })
            .collect();
        Some(Self { apex, strengths })
    }
}

fn strength(time: f64, apex: f64, length: f64) -> f64 {
    let share = if time <= apex { time / apex } else { (length - time) / (length - apex).max(1.0) };
    0.5 - 0.5 * (PI * share.clamp(0.0, 1.0)).cos()
}

//! The apex of a rise and fall is found on a drift.

use srflow_mer::TimeCourse;

fn strength(time: f64, apex: f64, length: f64) -> f64 {
    let share = if time <= apex { time / apex } else { (length - time) / (length - apex) };
    0.5 - 0.5 * (std::f64::consts::PI * share).cos()
}

/// An expression of two places with its apex at `apex` of 20 frames, on a drift, with a deterministic disturbance.
fn frames(apex: f64, disturbance: f32) -> Vec<(u64, Vec<f32>)> {
    let frame = |time: u64| {
        let strength = strength(time as f64, apex, 20.0) as f32;
        let noise = |place: u64| disturbance * (((time * 7 + place * 5) % 11) as f32 / 5.0 - 1.0);
        let drift = time as f32 * 0.05;
        vec![strength + drift + noise(0), -0.5 * strength - drift + noise(1), 0.2 * drift + noise(2)]
    };
    (1..=20).map(|time| (time, frame(time))).collect()
}

#[test]
fn the_apex_is_found_on_a_drift() {
    for apex in [5, 8, 12, 15] {
        let course = TimeCourse::fit(&frames(apex as f64, 0.02), 20).unwrap();
        assert_eq!(course.apex, apex);
        let strongest = course.strengths[apex as usize - 1];
        assert!((strongest - 1.0).abs() < 0.1, "{strongest}");
        assert!(course.strengths[19].abs() < 0.1, "the offset is at rest: {}", course.strengths[19]);
    }
}

#[test]
fn without_motion_the_apex_is_in_the_middle() {
    let still: Vec<(u64, Vec<f32>)> = (1..=20).map(|time| (time, vec![0.0; 3])).collect();
    assert_eq!(TimeCourse::fit(&still, 20).unwrap().apex, 10);
}

#[test]
fn short_and_empty_clips_have_an_answer() {
    assert_eq!(TimeCourse::fit(&[], 5), None);
    for length in 1..5 {
        let frames: Vec<_> = (1..=length).map(|time| (time, vec![time as f32])).collect();
        let apex = TimeCourse::fit(&frames, length).unwrap().apex;
        assert!((1..=length).contains(&apex), "{apex} of {length}");
    }
}

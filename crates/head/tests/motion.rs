//! Motion is smooth, starts and ends at rest, and every frame can be computed alone; micro-expressions follow the coding.

use srflow_core::random::Key;
use srflow_head::{HeadModel, MicroExpression, Motion, motion};

const FRAMES_PER_SECOND: f32 = 73.0;

fn model() -> HeadModel {
    HeadModel::builtin(1)
}

fn is_rest(pose: &srflow_head::HeadPose) -> bool {
    pose.expressions.iter().all(|w| *w == 0.0)
        && pose.joints.iter().all(|q| q.angle_between(glam::Quat::IDENTITY) < 1e-3)
        && pose.translation == glam::Vec3::ZERO
}

#[test]
fn a_sequence_leaves_rest_and_comes_back() {
    let model = model();
    for scene in 0..5 {
        let moments = motion::sequence(&model, Key::new(2).scene(scene), 300, FRAMES_PER_SECOND);
        assert!(is_rest(&moments[0].pose) && is_rest(&moments[299].pose), "scene {scene}");
        assert!(moments[0].action_units.is_empty() && moments[299].action_units.is_empty());
        let shown = moments.iter().filter(|m| !m.action_units.is_empty()).count();
        assert!(shown > 100, "scene {scene}: only {shown} of 300 frames show an expression");
    }
}

#[test]
fn faces_move_without_jumps() {
    let model = model();
    let shaped = model.shaped(&[]);
    let (mut before, mut now) = (Vec::new(), Vec::new());
    for scene in 0..3 {
        let motion = Motion::new(&model, Key::new(9).scene(scene), 260, FRAMES_PER_SECOND);
        let mut fastest = 0.0_f32;
        model.vertices(&shaped, &motion.at(&model, 0).pose, &mut before);
        for frame in 1..motion.len() {
            model.vertices(&shaped, &motion.at(&model, frame).pose, &mut now);
            let step = now.iter().zip(&before).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max);
            fastest = fastest.max(step);
            std::mem::swap(&mut before, &mut now);
        }
        // A blink moves the lid by over a centimetre in a few frames; nothing on a face is faster.
        assert!(fastest < 0.004, "scene {scene}: {} mm in one frame", fastest * 1e3);
        assert!(fastest > 0.0004, "scene {scene}: {} mm in one frame is no motion", fastest * 1e3);
    }
}

#[test]
fn scenes_differ_and_frames_stand_alone() {
    let model = model();
    let all = motion::sequence(&model, Key::new(4).scene(1), 120, 24.0);
    let alone = Motion::new(&model, Key::new(4).scene(1), 120, 24.0).at(&model, 60);
    assert_eq!(all[60], alone);
    let other = Motion::new(&model, Key::new(4).scene(2), 120, 24.0).at(&model, 60);
    assert_ne!(all[60].pose, other.pose);
}

#[test]
fn eyes_blink_for_a_third_of_a_second_every_few_seconds() {
    let model = model();
    let moments = motion::sequence(&model, Key::new(11), 2400, 60.0);
    let closed = |m: &motion::Moment| m.action_units.iter().any(|u| u.0 == 45 && u.2 > 0.6);
    let blinks: usize = moments.windows(2).filter(|w| !closed(&w[0]) && closed(&w[1])).count();
    // 40 seconds.
    assert!((6..=30).contains(&blinks), "{blinks} blinks");
}

#[test]
fn odd_lengths_and_rates_make_motions() {
    let model = model();
    for (frames, rate) in [(0, 24.0), (1, 24.0), (2, 24.0), (3, 0.0), (5, f32::NAN), (4, 1e6), (2, -3.0)] {
        let moments = motion::sequence(&model, Key::new(1), frames, rate);
        assert_eq!(moments.len(), frames);
        assert!(moments.first().is_none_or(|m| is_rest(&m.pose)), "{frames} frames at {rate}");
        assert!(moments.iter().all(|m| m.pose.joints.iter().all(|q| q.is_finite())));
    }
}

/// Sets of action units of the brow.
const BROWS: &[&[u8]] = &[&[4], &[1, 4], &[1, 2]];

#[test]
fn micro_expressions_rise_to_their_apex_and_are_gone_within_half_a_second() {
    let model = model();
    for sets in [BROWS, &[&[12], &[6, 12]], &[&[5]]] {
        for scene in 0..40 {
            let key = Key::new(3).scene(scene);
            let micro = MicroExpression::random(&model, sets, key, 20, 200.0).expect("units of the model");
            assert!(micro.onset == 20 && micro.onset < micro.apex && micro.apex < micro.offset);
            assert!((micro.offset - micro.onset) as f32 / 200.0 < 0.5);
            let mut numbers: Vec<u8> = micro.action_units.iter().map(|u| u.0).collect();
            numbers.dedup();
            assert!(sets.contains(&numbers.as_slice()), "{numbers:?} of {sets:?}");
            assert!(
                micro.action_units.iter().all(|u| u.2 > 0.0 && u.2 < 0.7),
                "weak: {:?}",
                micro.action_units
            );
            let strengths: Vec<f32> = (0..140).map(|frame| micro.strength(frame)).collect();
            assert!(strengths[..=20].iter().chain(&strengths[micro.offset..]).all(|s| *s == 0.0));
            assert_eq!(strengths[micro.apex], 1.0);
            assert!(strengths[20..=micro.apex].is_sorted());
            assert!(strengths[micro.apex..].iter().rev().is_sorted());
            assert!(is_rest(&micro.pose(&model, micro.onset).expect("a pose")));
            assert!(!is_rest(&micro.pose(&model, micro.apex).expect("a pose")));
        }
    }
}

#[test]
fn micro_expressions_fit_slow_recordings() {
    let model = model();
    for rate in [0.0, 5.0, 24.0, 30.0, 60.0] {
        let micro = MicroExpression::random(&model, BROWS, Key::new(1), 0, rate).expect("units");
        assert!(micro.onset < micro.apex && micro.apex < micro.offset, "{rate}: {micro:?}");
    }
}

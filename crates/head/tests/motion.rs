//! Motion is smooth, starts and ends at rest, and every frame can be computed alone; micro-expressions follow the coding.

use srflow_core::random::Key;
use srflow_head::{HeadModel, Look, MicroExpression, Motion, Side, motion};

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
        let moments =
            motion::sequence(&model, Look::Second, Key::new(2).scene(scene), 300, FRAMES_PER_SECOND);
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
    for (look, scene) in
        [(Look::First, 0), (Look::First, 1), (Look::Second, 0), (Look::Second, 1), (Look::Second, 2)]
    {
        let motion = Motion::new(&model, look, Key::new(9).scene(scene), 260, FRAMES_PER_SECOND);
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
    let look = Look::Second;
    let all = motion::sequence(&model, look, Key::new(4).scene(1), 120, 24.0);
    let alone = Motion::new(&model, look, Key::new(4).scene(1), 120, 24.0).at(&model, 60);
    assert_eq!(all[60], alone);
    let other = Motion::new(&model, look, Key::new(4).scene(2), 120, 24.0).at(&model, 60);
    assert_ne!(all[60].pose, other.pose);
}

#[test]
fn eyes_blink_for_a_third_of_a_second_every_few_seconds() {
    let model = model();
    let moments = motion::sequence(&model, Look::Second, Key::new(11), 2400, 60.0);
    let closed = |m: &motion::Moment| m.action_units.iter().any(|u| u.0 == 45 && u.2 > 0.6);
    let blinks: usize = moments.windows(2).filter(|w| !closed(&w[0]) && closed(&w[1])).count();
    // 40 seconds.
    assert!((6..=30).contains(&blinks), "{blinks} blinks");
}

#[test]
fn odd_lengths_and_rates_make_motions() {
    let model = model();
    for (frames, rate) in [(0, 24.0), (1, 24.0), (2, 24.0), (3, 0.0), (5, f32::NAN), (4, 1e6), (2, -3.0)] {
        let moments = motion::sequence(&model, Look::Second, Key::new(1), frames, rate);
        assert_eq!(moments.len(), frames);
        assert!(moments.first().is_none_or(|m| is_rest(&m.pose)), "{frames} frames at {rate}");
        assert!(moments.iter().all(|m| m.pose.joints.iter().all(|q| q.is_finite())));
    }
}

#[test]
fn people_speak_in_sounds_that_close_the_lips_and_open_the_jaw() {
    let available = [(24, Side::Both), (25, Side::Both), (26, Side::Both), (18, Side::Both)];
    let speech = motion::Speech::random(Key::new(5), 60.0, Look::Second);
    let strengths = |number: u8| -> Vec<f32> {
        let at = |frame: usize| speech.units_at(&available, frame as f32 / 100.0, 1.0);
        let of_unit = |units: Vec<(u8, Side, f32)>| units.iter().find(|u| u.0 == number).map_or(0.0, |u| u.2);
        (0..6000).map(|frame| of_unit(at(frame))).collect()
    };
    let (pressed, jaw) = (strengths(24), strengths(26));
    let peaks = jaw.windows(3).filter(|w| w[1] > w[0] && w[1] >= w[2] && w[1] > 0.2).count();
    assert!((120..420).contains(&peaks), "{peaks} open vowels in a minute of about 260 syllables");
    let closed = pressed.windows(2).filter(|w| w[0] < 0.2 && w[1] >= 0.2).count();
    assert!((20..150).contains(&closed), "the lips close {closed} times a minute");
    let fastest = jaw.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f32::max);
    assert!(fastest < 0.2, "{fastest} of the jaw's range in 10 ms is a jump");
}

#[test]
fn people_breathe_and_nod_as_often_as_people_do() {
    let breathing = motion::Breathing::random(Key::new(6), 120.0);
    let chest: Vec<f32> = (0..12000).map(|frame| breathing.at(frame as f32 / 100.0)).collect();
    let breaths = chest.windows(2).filter(|w| w[0] < 0.25 && w[1] >= 0.25).count();
    assert!((24..=40).contains(&breaths), "{breaths} breaths in two minutes");
    assert!(chest.windows(2).all(|w| (w[1] - w[0]).abs() < 0.03));

    let nods = motion::Nods::random(Key::new(6), 600.0);
    let names: Vec<&str> = nods.spans().map(|(name, _)| name).collect();
    assert!((45..=140).contains(&names.len()), "{} nods in ten minutes", names.len());
    assert!(names.contains(&"nod") && names.contains(&"shake"));
    let [mut most, mut fastest] = [0.0_f32; 2];
    let mut before = nods.at(0.0);
    for frame in 1..60_000 {
        let now = nods.at(frame as f32 / 100.0);
        let listed = nods.spans().any(|(_, [first, last])| (first..=last).contains(&(frame as f32 / 100.0)));
        assert!(listed || now == [0.0; 2]);
        most = most.max(now[0].hypot(now[1]));
        fastest = fastest.max((now[0] - before[0]).hypot(now[1] - before[1]));
        before = now;
    }
    assert!((3.0..5.5).contains(&most.to_degrees()), "up to {} degrees", most.to_degrees());
    assert!(fastest.to_degrees() < 1.5, "{} degrees in 10 ms is a jump", fastest.to_degrees());
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

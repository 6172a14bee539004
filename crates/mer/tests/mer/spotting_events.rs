//! Expressions are found in the motion of a face's regions.

use std::f64::consts::PI;

use srflow_core::random::Key;
use srflow_core::{EstimateError, FlowEstimator, FlowField, Image, Size};
use srflow_data::micro_expression::intervals::{ExpressionKind, Interval};
use srflow_face::{FaceError, FacePoints, FrameCrop};
use srflow_mer::HeadMotion;
use srflow_mer::spotting::{
    FaceFollower, FaceView, REGIONS, Sight, SignalRecorder, Signals, SpottedEvent, SpottingSettings, elan,
    regions, spot_events,
};

const FPS: f64 = 30.0;
const SIDE: usize = 180;

/// Twenty seconds of noise, with bumps: region, first frame, frames, height in pixels.
fn signals(bumps: &[(usize, usize, usize, f64)]) -> Signals {
    let mut stream = Key::new(5).stream("noise");
    let mut signals =
        Signals { regions: vec![[[0.0; 2]; 16]; 600], head: vec![[0.0; 2]; 600], usable: vec![true; 600] };
    for value in signals.regions.as_flattened_mut().as_flattened_mut() {
        *value = 0.02 * f64::from(stream.normal());
    }
    for &(region, first, frames, height) in bumps {
        for frame in 0..=frames {
            let wave = 0.5 - 0.5 * (2.0 * PI * frame as f64 / frames as f64).cos();
            signals.regions[first + frame][region][1] += height * wave;
        }
    }
    signals
}

fn spotted(bumps: &[(usize, usize, usize, f64)]) -> Vec<SpottedEvent> {
    spot_events(&signals(bumps), FPS, SIDE, SpottingSettings::default())
}

#[test]
fn short_bumps_are_found_where_they_are() {
    let events = spotted(&[(0, 100, 12, 0.5), (11, 300, 9, 0.4)]);
    let found: Vec<_> = events.iter().map(|event| (event.kind, event.region)).collect();
    let micro = ExpressionKind::Micro;
    assert_eq!(found, [(micro, "inner-brow-left"), (micro, "mouth-corner-left")], "{events:?}");
    for (event, [onset, offset]) in events.iter().zip([[100, 112], [300, 309]]) {
        assert!(event.onset.abs_diff(onset) <= 2 && event.offset.abs_diff(offset) <= 2, "{event:?}");
        assert!(event.onset < event.apex && event.apex < event.offset);
    }
}

#[test]
fn long_bumps_are_macro_expressions() {
    let events = spotted(&[(12, 200, 60, 4.0)]);
    assert_eq!(events.len(), 1, "{events:?}");
    assert_eq!(events[0].kind, ExpressionKind::Macro);
    assert!(events[0].onset.abs_diff(200) <= 15 && events[0].offset.abs_diff(260) <= 15, "{events:?}");
}

#[test]
fn noise_blinks_and_speech_are_no_micro_expressions() {
    assert_eq!(spotted(&[]), []);
    // Blinks, which the brows follow.
    let blinks: Vec<_> = (0..8)
        .flat_map(|blink| {
            let first = 40 + 65 * blink;
            [(5, first, 9, 4.0), (6, first, 9, 4.0), (0, first, 9, 0.6), (1, first, 9, 0.6)]
        })
        .collect();
    assert_eq!(spotted(&blinks), []);
    // The mouth opens and closes all the time.
    let speech: Vec<_> = (0..40).map(|word| (14, 50 + 12 * word, 9, 1.5)).collect();
    let micro = spotted(&speech).iter().filter(|event| event.kind == ExpressionKind::Micro).count();
    assert!(micro <= 1, "{micro} of forty words");
}

#[test]
fn nothing_is_spotted_where_no_face_is_seen() {
    let mut hidden = signals(&[(0, 100, 12, 0.5), (11, 300, 9, 0.4)]);
    hidden.usable[290..400].fill(false);
    let events = spot_events(&hidden, FPS, SIDE, SpottingSettings::default());
    let regions: Vec<_> = events.iter().map(|event| event.region).collect();
    assert_eq!(regions, ["inner-brow-left"]);
}

#[test]
fn short_videos_have_no_events() {
    for frames in 0..4 {
        let few = Signals {
            regions: vec![[[0.0; 2]; 16]; frames],
            head: vec![[0.0; 2]; frames],
            usable: vec![true; frames],
        };
        assert_eq!(spot_events(&few, FPS, SIDE, SpottingSettings::default()), []);
    }
}

/// Reads the motion out of the first pixel: every frame says how far everything has moved.
struct Written;

impl FlowEstimator for Written {
    fn name(&self) -> &str {
        "written"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        let moved = f32::from(frame2.get(0, 0)[0]) - f32::from(frame1.get(0, 0)[0]);
        Ok(FlowField::from_fn(frame1.width(), frame1.height(), |_, _| [moved, -2.0 * moved]))
    }
}

fn frame_at(place: u8) -> Image {
    Image::from_fn(4, 4, |_, _| [place; 3])
}

#[test]
fn motion_is_relative_to_the_first_frame_across_segments() {
    for frames in [1, 2, 11, 25, 57] {
        let mut recorder = SignalRecorder::new(&Written, HeadMotion::Keep, 10.0);
        let places: Vec<u8> = (0..frames).map(|frame| 100 + (frame * 7 % 23) as u8).collect();
        let view = Box::new(FaceView::new(None, FrameCrop::Whole, &frame_at(0)).unwrap());
        for (frame, place) in places.iter().enumerate() {
            // Seen anew now and then, as a face that has moved.
            let anew = frame % 9 == 0;
            recorder
                .push(&frame_at(*place), if anew { Sight::Anew(view.clone()) } else { Sight::Same })
                .unwrap();
        }
        let signals = recorder.finish();
        assert_eq!((signals.regions.len(), signals.head.len()), (frames, frames));
        assert_eq!(signals.usable, vec![true; frames]);
        for (regions, place) in signals.regions.iter().zip(&places) {
            let expected = f64::from(*place) - 100.0;
            for [u, v] in regions {
                assert!((u - expected).abs() < 1e-9 && (v + 2.0 * expected).abs() < 1e-9, "{u} {expected}");
            }
        }
    }
}

#[test]
fn motion_stays_as_it_was_while_no_face_is_seen() {
    let view = Box::new(FaceView::new(None, FrameCrop::Whole, &frame_at(0)).unwrap());
    let mut recorder = SignalRecorder::new(&Written, HeadMotion::Keep, 10.0);
    let frames = [
        (90, Sight::Lost),
        (100, Sight::Anew(view.clone())),
        (103, Sight::Same),
        (200, Sight::Lost),
        (50, Sight::Anew(view)),
        (51, Sight::Same),
    ];
    for (place, sight) in frames {
        recorder.push(&frame_at(place), sight).unwrap();
    }
    let signals = recorder.finish();
    assert_eq!(signals.usable, [false, true, true, false, true, true]);
    let moved: Vec<f64> = signals.regions.iter().map(|regions| regions[3][0]).collect();
    assert_eq!(moved, [0.0, 0.0, 3.0, 3.0, 3.0, 4.0]);
}

/// A face that is looked for in every frame, at this column or nowhere: how it is seen, and whether it is steady.
fn followed(columns: &[Option<f64>]) -> (Vec<Sight>, Vec<bool>) {
    let frame = Image::from_fn(400, 300, |_, _| [0; 3]);
    let mut follower = FaceFollower::new(5.0);
    let points = |x: f64| FacePoints::of(&[[x, 120.0], [x + 40.0, 120.0]]).unwrap();
    let mut follow = |x: &Option<f64>| follower.follow(&frame, || Ok::<_, FaceError>(x.map(points))).unwrap();
    let sights = columns.iter().map(&mut follow).collect();
    (sights, follower.steady().to_vec())
}

#[test]
fn a_face_is_seen_anew_only_where_it_has_moved() {
    // The crop is 100 px wide: 2 px are noise of the landmarks, 4 are motion.
    let (sights, steady) =
        followed(&[None, Some(150.0), Some(152.0), Some(154.0), None, Some(154.0), None, None, Some(154.0)]);
    let words: Vec<&str> = sights
        .iter()
        .map(|sight| match sight {
            Sight::Same => "same",
            Sight::Anew(_) => "anew",
            Sight::Lost => "lost",
        })
        .collect();
    assert_eq!(words, ["lost", "anew", "same", "anew", "same", "same", "same", "lost", "anew"]);
    let origins: Vec<[f64; 2]> = sights
        .iter()
        .filter_map(|sight| match sight {
            Sight::Anew(view) => Some(view.crop().point([0.0, 0.0]).map(|at| -at)),
            _ => None,
        })
        .collect();
    assert_eq!(steady, [true; 9], "it moves slowly");
    let (_, steady) = followed(&[Some(150.0), Some(150.0), Some(160.0), Some(160.0)]);
    assert_eq!(steady, [true, false, false, true], "ten pixels in a fifth of a second are fast");
    assert_eq!(origins, [[120.0, 84.0], [124.0, 84.0], [124.0, 84.0]], "by whole pixels, exactly");
}

#[test]
fn regions_lie_in_the_crop_and_lids_at_its_eyes() {
    let boxes = regions(None, &FrameCrop::Whole, Size::new(200, 200));
    for [[left, right], [top, bottom]] in boxes {
        assert!(left < right && right <= 200 && top < bottom && bottom <= 200);
    }
    let [[left, right], [top, bottom]] = boxes[REGIONS.iter().position(|name| *name == "lids-left").unwrap()];
    assert!((left..right).contains(&60) && (top..bottom).contains(&72), "as FrameCrop::upright places eyes");
    for [[left, right], [top, bottom]] in regions(None, &FrameCrop::Whole, Size::new(1, 1)) {
        assert_eq!([left, right, top, bottom], [0, 1, 0, 1]);
    }
}

#[test]
fn events_become_tiers_of_elan() {
    let interval = |kind, onset, offset| Interval {
        video: "v".to_owned(),
        kind,
        onset,
        apex: None,
        offset,
        label: "<brow> & \"lip\"".to_owned(),
        action_units: "1+2".to_owned(),
    };
    let events = [interval(ExpressionKind::Micro, 31, 45), interval(ExpressionKind::Macro, 1, 300)];
    let text = elan("a&b.mp4", &events, 1, 30.0, "2026-01-31T12:00:00+00:00");
    // Frame 31 begins after a second; frame 45 ends after one and a half.
    for part in ["TIME_VALUE=\"1000\"", "TIME_VALUE=\"1500\"", "TIME_VALUE=\"0\"", "TIME_VALUE=\"10000\""] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(text.contains("&lt;brow&gt; &amp; &quot;lip&quot;") && text.contains("a&amp;b.mp4"), "{text}");
    assert_eq!(text.matches("<TIER ").count(), 4);
    assert!(text.contains("TIER_ID=\"ME AU\"") && text.contains("<ANNOTATION_VALUE>1+2</"), "{text}");
}

//! Augmented samples are consistent: their flow still maps frame 1 to frame 2, and the same key gives the same sample.

use proptest::prelude::*;
use rayon::prelude::*;
use srflow_core::random::Key;
use srflow_core::{FlowField, Image, Mask, Size, warp};
use srflow_data::flow::{Sample, TruthDensity};
use srflow_train::augment::{AugmentConfig, Augmentation};

/// Smooth everywhere, so that interpolation changes it little.
fn texture([x, y]: [f32; 2]) -> [u8; 3] {
    let wave = |a: f32, b: f32, phase: f32| 127.5 + 100.0 * (a * x + b * y + phase).sin();
    [wave(0.07, 0.03, 0.0) as u8, wave(-0.04, 0.06, 1.0) as u8, wave(0.02, -0.08, 2.0) as u8]
}

/// A zoom, a shear and a shift.
fn motion(x: usize, y: usize) -> [f32; 2] {
    let (x, y) = (x as f32, y as f32);
    [3.0 + 0.02 * x - 0.01 * y, -2.0 + 0.015 * y + 0.01 * x]
}

/// A textured pair that moves by [`motion`]. The mask is a disc, which frame 1 shows too.
fn moving(width: usize, height: usize) -> Sample {
    let inside = |x: usize, y: usize| {
        let away = [x as f32 - width as f32 / 2.0, y as f32 - height as f32 / 2.0];
        away[0] * away[0] + away[1] * away[1] < (height * height) as f32 / 9.0
    };
    let at = |x: usize, y: usize| [x as f32, y as f32];
    Sample {
        frame1: Image::from_fn(width, height, |x, y| {
            let ([x, y], [u, v]) = (at(x, y), motion(x, y));
            texture([x + u, y + v])
        }),
        frame2: Image::from_fn(width, height, |x, y| texture(at(x, y))),
        flow: Some(FlowField::from_fn(width, height, motion)),
        mask: Some(Mask::from_fn(width, height, inside)),
        occlusion: Some(Mask::from_fn(width, height, |x, y| !inside(x, y))),
    }
}

fn apply(config: AugmentConfig, sample: Sample, key: Key) -> Sample {
    Augmentation::new(config).expect("a configuration").apply(sample, key).expect("a sample")
}

/// Every geometric change, no colour changes.
fn moving_only(mut config: AugmentConfig) -> AugmentConfig {
    config.eraser_probability = 0.0;
    [config.brightness, config.contrast, config.saturation, config.hue] = [0.0; 4];
    config
}

/// Mean difference of a channel between frame 1 and frame 2 warped back, where the flow is known and stays inside.
fn warp_residual(sample: &Sample) -> f64 {
    let (warped, valid) = warp(&sample.frame2, sample.flow.as_ref().expect("a flow")).expect("one size");
    let pixels = warped.pixels().iter().zip(sample.frame1.pixels()).zip(valid.pixels());
    let differences: Vec<f64> = pixels
        .filter(|(_, valid)| **valid)
        .flat_map(|((a, b), _)| (0..3).map(|c| f64::from(a[c].abs_diff(b[c]))))
        .collect();
    assert!(differences.len() > 300, "too little to compare: {}", differences.len());
    differences.iter().sum::<f64>() / differences.len() as f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_flow_still_maps_frame_1_to_frame_2(seed in any::<u64>(), sparse in any::<bool>()) {
        let crop = [64, 48];
        let config = if sparse { AugmentConfig::sparse(crop) } else { AugmentConfig::dense(crop) };
        // Flips with probability one half, and clearly visible stretches.
        let config = AugmentConfig {
            vertical_flip: if sparse { 0.0 } else { 0.5 },
            max_log2_stretch: 0.5,
            ..moving_only(config)
        };
        let before = moving(120, 100);
        prop_assert!(warp_residual(&before) < 1.0);
        let after = apply(config, before, Key::new(seed));
        prop_assert_eq!(after.frame1.size(), Size::new(64, 48));
        let residual = warp_residual(&after);
        prop_assert!(residual < 1.5, "{}", residual);
    }

    /// Frame 2 is cropped elsewhere. Without a mask the whole flow is known; with one, the outside is not.
    #[test]
    fn the_flow_of_a_shifted_sample_maps_to_frame_2(seed in any::<u64>(), sparse in any::<bool>(), masked in any::<bool>()) {
        let crop = [64, 48];
        let config = if sparse { AugmentConfig::sparse(crop) } else { AugmentConfig::dense(crop) };
        let config = AugmentConfig { shift_probability: 1.0, max_shift: 12, ..moving_only(config) };
        let still = AugmentConfig { shift_probability: 0.0, ..config.clone() };
        let before = Sample { mask: moving(120, 100).mask.filter(|_| masked), ..moving(120, 100) };
        let (after, still) = (apply(config, before.clone(), Key::new(seed)), apply(still, before, Key::new(seed)));
        prop_assert_eq!(&after.frame1, &still.frame1);
        let (flow, still_flow) = (after.flow.as_ref().expect("a flow"), still.flow.as_ref().expect("a flow"));
        let added: Vec<[f32; 2]> = flow.pixels().iter().zip(still_flow.pixels())
            .map(|(a, b)| [a[0] - b[0], a[1] - b[1]])
            .filter(|added| added[0].is_finite())
            .collect();
        prop_assert!(added.iter().all(|a| (0..2).all(|c| a[c].abs() < 12.01 && (a[c] - added[0][c]).abs() < 1e-3)));
        let unmoved = added.first() == Some(&[0.0; 2]);
        for (index, pixel) in flow.pixels().iter().enumerate() {
            let shown = unmoved || after.mask.as_ref().is_none_or(|mask| mask.pixels()[index]);
            prop_assert_eq!(pixel[0].is_finite(), shown && still_flow.pixels()[index][0].is_finite());
        }
        if !masked {
            let residual = warp_residual(&after);
            prop_assert!(residual < 1.5, "{}", residual);
        }
    }

    /// As if the camera moved.
    #[test]
    fn a_background_that_shows_the_shift_has_a_known_flow(seed in any::<u64>()) {
        let config = AugmentConfig { shift_probability: 1.0, shift_background: true, ..AugmentConfig::dense([64, 48]) };
        let after = apply(moving_only(config), moving(120, 100), Key::new(seed));
        prop_assert!(after.flow.as_ref().expect("a flow").pixels().iter().all(|[u, v]| u.is_finite() && v.is_finite()));
        let residual = warp_residual(&after);
        prop_assert!(residual < 1.5, "{}", residual);
    }

    /// Nothing moves, and both frames are the picture with noise of their own, if any.
    #[test]
    fn a_still_sample_has_no_flow(seed in any::<u64>()) {
        let config = AugmentConfig { still_probability: 1.0, ..AugmentConfig::crop_only([64, 48]) };
        let after = apply(config, moving(120, 100), Key::new(seed));
        prop_assert!(after.flow.as_ref().expect("a flow").pixels().iter().all(|flow| *flow == [0.0; 2]));
        prop_assert!(after.occlusion.as_ref().expect("a mask").pixels().iter().all(|hidden| !hidden));
        let residual = warp_residual(&after);
        prop_assert!(residual < 5.0, "{}", residual);
    }

    /// Frame 1 is white where the mask is true, and the other mask is its opposite.
    #[test]
    fn masks_follow_frame_1(seed in any::<u64>()) {
        let mut sample = moving(90, 100);
        let mask = sample.mask.clone().expect("a mask");
        let white = mask.pixels().iter().map(|inside| if *inside { [255; 3] } else { [0; 3] }).collect();
        sample.frame1 = Image::from_pixels(90, 100, white).expect("its size");
        let after = apply(moving_only(AugmentConfig::dense([60, 70])), sample, Key::new(seed));
        let (mask, opposite) = (after.mask.expect("a mask"), after.occlusion.expect("a mask"));
        for (index, pixel) in after.frame1.pixels().iter().enumerate() {
            // They may differ where rounding is near one half.
            if pixel[0].abs_diff(127) > 2 {
                prop_assert_eq!(mask.pixels()[index], pixel[0] > 127, "pixel {}", index);
                prop_assert_eq!(opposite.pixels()[index], pixel[0] < 127, "pixel {}", index);
            }
        }
    }

    #[test]
    fn any_frame_gives_a_crop(seed in any::<u64>(), width in 1_usize..90, height in 1_usize..90, sparse in any::<bool>()) {
        let crop = [32, 40];
        let config = if sparse { AugmentConfig::sparse(crop) } else { AugmentConfig::dense(crop) };
        let sample = apply(config, moving(width, height), Key::new(seed));
        let sizes = [
            sample.frame1.size(),
            sample.frame2.size(),
            sample.flow.expect("a flow").size(),
            sample.mask.expect("a mask").size(),
            sample.occlusion.expect("a mask").size(),
        ];
        prop_assert_eq!(sizes, [Size::new(32, 40); 5]);
    }

    /// Pixels encode their position: the crop is a window of the frame, and all parts are cropped alike.
    #[test]
    fn a_crop_is_a_window(seed in any::<u64>()) {
        let place = |x: usize, y: usize| [x as u8, y as u8, 7];
        let frame = Image::from_fn(80, 70, place);
        let sample = Sample {
            frame1: frame.clone(),
            frame2: frame,
            flow: Some(FlowField::from_fn(80, 70, |x, y| [x as f32, y as f32])),
            mask: None,
            occlusion: None,
        };
        let cut = apply(AugmentConfig::crop_only([30, 20]), sample, Key::new(seed));
        let [left, top, _] = cut.frame1.get(0, 0);
        prop_assert!(left <= 50 && top <= 50);
        prop_assert_eq!(&cut.frame1, &cut.frame2);
        let flow = cut.flow.expect("a flow");
        for (y, x) in (0..20).flat_map(|y| (0..30).map(move |x| (y, x))) {
            let here = place(x + usize::from(left), y + usize::from(top));
            prop_assert_eq!(cut.frame1.get(x, y), here);
            prop_assert_eq!(flow.get(x, y), [f32::from(here[0]), f32::from(here[1])]);
        }
    }
}

#[test]
fn mirroring_twice_gives_the_sample_back() {
    let config =
        AugmentConfig { horizontal_flip: 1.0, vertical_flip: 1.0, ..AugmentConfig::crop_only([50, 40]) };
    for truth in [TruthDensity::Dense, TruthDensity::Sparse] {
        let augmentation =
            Augmentation::new(AugmentConfig { truth, ..config.clone() }).expect("a configuration");
        let once = augmentation.apply(moving(50, 40), Key::new(1)).expect("a sample");
        let [u, v] = once.flow.as_ref().expect("a flow").get(0, 0);
        let mirrored = motion(49, 39);
        assert_eq!([-u, -v], mirrored, "mirrored at both axes");
        assert_eq!(augmentation.apply(once, Key::new(2)).expect("a sample"), moving(50, 40));
    }
}

#[test]
fn the_same_key_gives_the_same_sample_in_any_order() {
    let augmentation = Augmentation::new(AugmentConfig::dense([64, 48])).expect("a configuration");
    let of = |number: u32| augmentation.apply(moving(100, 90), Key::new(3).frame(number)).expect("a sample");
    let in_order: Vec<Sample> = (0..8).map(of).collect();
    let mut at_once: Vec<(u32, Sample)> =
        (0..8).into_par_iter().rev().map(|number| (number, of(number))).collect();
    at_once.sort_by_key(|(number, _)| *number);
    for (expected, (number, found)) in in_order.iter().zip(&at_once) {
        assert_eq!(expected, found, "{number}");
    }
    let different = |key: Key| augmentation.apply(moving(100, 90), key).expect("a sample") != in_order[0];
    assert!(in_order[1..].iter().all(|sample| *sample != in_order[0]));
    assert!(different(Key::new(4)) && different(Key::new(3).scene(1)));
}

/// Frequencies of each change over many keys; the random numbers drawn are always the same.
#[test]
fn changes_happen_as_often_as_configured() {
    let before = moving(60, 50);
    let count = |config: AugmentConfig, happened: &dyn Fn(&Sample) -> bool| {
        let augmentation = Augmentation::new(config).expect("a configuration");
        (0..300)
            .filter(|n| happened(&augmentation.apply(before.clone(), Key::new(*n)).expect("a sample")))
            .count()
    };
    let still = AugmentConfig::crop_only([60, 50]);
    let mirrored = |axis: usize| {
        move |sample: &Sample| {
            sample.flow.as_ref().is_some_and(|flow| flow.get(30, 25)[axis] * motion(30, 25)[axis] < 0.0)
        }
    };
    let halves = AugmentConfig { horizontal_flip: 0.5, ..still.clone() };
    assert!((120..180).contains(&count(halves, &mirrored(0))));
    let tenths = AugmentConfig { vertical_flip: 0.1, ..still.clone() };
    assert!((15..50).contains(&count(tenths, &mirrored(1))));
    let scaled = AugmentConfig { scale_probability: 0.8, log2_scale: [0.5, 0.6], ..still.clone() };
    let shifts =
        AugmentConfig { shift_probability: 0.3, max_shift: 1000, ..AugmentConfig::crop_only([30, 20]) };
    let differ = |sample: &Sample| {
        let (flow, frame1) = (sample.flow.as_ref().expect("a flow"), sample.frame1.get(0, 0));
        !(0..31).any(|x| (0..31).any(|y| before.frame1.get(x, y) == frame1 && flow.get(0, 0) == motion(x, y)))
    };
    assert!((60..120).contains(&count(shifts, &differ)));
    let grew = |sample: &Sample| sample.flow.as_ref().is_some_and(|flow| flow.get(0, 0) != motion(0, 0));
    assert!((215..265).contains(&count(scaled, &grew)));
    let hidden = AugmentConfig { eraser_probability: 0.5, ..still.clone() };
    assert!((120..180).contains(&count(hidden, &|sample| sample.frame2 != before.frame2)));
    assert_eq!(count(still, &|sample| *sample != before), 0, "a crop of the frame's size changes nothing");
}

#[test]
fn both_frames_change_colour_alike_unless_asymmetric() {
    let mut same = moving(60, 50);
    same.frame2 = same.frame1.clone();
    let alike = |asymmetric_probability: f32, key: Key| {
        let config = AugmentConfig {
            eraser_probability: 0.0,
            asymmetric_probability,
            ..AugmentConfig::dense([40, 30])
        };
        let after = apply(config, same.clone(), key);
        after.frame1 == after.frame2
    };
    assert!((0..10).all(|n| alike(0.0, Key::new(n))));
    assert!((0..10).all(|n| !alike(1.0, Key::new(n))));
}

/// One or two rectangles of the mean colour on frame 2, with sides within the limits or clipped at the border.
#[test]
fn the_eraser_hides_parts_of_frame_2() {
    let before = moving(200, 160);
    let mut sums = [0_u64; 3];
    for pixel in before.frame2.pixels() {
        (0..3).for_each(|c| sums[c] += u64::from(pixel[c]));
    }
    let mean = sums.map(|sum| (sum / (200 * 160)) as u8);
    let config = AugmentConfig {
        eraser_probability: 1.0,
        eraser_sides: [20, 30],
        ..AugmentConfig::crop_only([200, 160])
    };
    for n in 0..20 {
        let after = apply(config.clone(), before.clone(), Key::new(n));
        assert_eq!(after.frame1, before.frame1);
        assert_eq!(after.flow, before.flow, "what is hidden still moves");
        let changed: Vec<usize> =
            (0..200 * 160).filter(|i| after.frame2.pixels()[*i] != before.frame2.pixels()[*i]).collect();
        assert!(changed.iter().all(|i| after.frame2.pixels()[*i] == mean));
        assert!(!changed.is_empty() && changed.len() <= 2 * 30 * 30, "{}", changed.len());
    }
}

#[test]
fn unknown_flow_stays_unknown_and_spreads_no_further_than_interpolation() {
    // The flow encodes its position.
    let mut flow = FlowField::from_fn(60, 50, |x, y| [x as f32 + 1.0, y as f32 + 1.0]);
    flow.set(30, 25, [f32::NAN; 2]);
    let sample = Sample { flow: Some(flow), ..moving(60, 50) };
    let twice = AugmentConfig {
        scale_probability: 1.0,
        log2_scale: [1.0, 1.0],
        stretch_probability: 0.0,
        ..AugmentConfig::crop_only([110, 90])
    };
    let dense = apply(twice.clone(), sample.clone(), Key::new(5)).flow.expect("a flow");
    let unknown = dense.pixels().iter().filter(|pixel| pixel[0].is_nan()).count();
    assert_eq!(unknown, 16, "at twice the size each pixel reaches four by four");

    let sparse = apply(AugmentConfig { truth: TruthDensity::Sparse, ..twice }, sample, Key::new(5));
    let sparse = sparse.flow.expect("a flow");
    let mut sources: Vec<[u32; 2]> = Vec::new();
    for [u, v] in sparse.pixels().iter().filter(|pixel| !pixel[0].is_nan()) {
        let source = [u / 2.0, v / 2.0];
        assert!(source.iter().all(|place| place.fract() == 0.0), "a known flow, scaled: {source:?}");
        sources.push(source.map(|place| place as u32));
    }
    assert_eq!(sources.len(), 55 * 45 - 1, "each known pixel of the crop, and no other");
    assert!(!sources.contains(&[31, 26]), "the unknown one");
    let columns = |y: u32| sources.iter().filter(|source| source[1] == y).count();
    assert!((0..=50).map(columns).all(|count| [0, 54, 55].contains(&count)));
}

#[test]
fn invalid_settings_are_reported() {
    let message = |config: AugmentConfig| Augmentation::new(config).expect_err("wrong").to_string();
    let dense = || AugmentConfig::dense([64, 48]);
    assert_eq!(
        message(AugmentConfig { hue: 0.7, ..dense() }),
        "augmentation.hue = 0.7: expected a part of the colour circle from 0 to 0.5"
    );
    assert!(
        message(AugmentConfig { crop: [0, 5], ..dense() })
            .starts_with("augmentation.crop = [0, 5]: expected")
    );
    assert!(
        message(AugmentConfig { log2_scale: [1.0, 0.0], ..dense() })
            .starts_with("augmentation.log2_scale = [1, 0]:")
    );
    assert!(
        message(AugmentConfig { scale_probability: f32::NAN, ..dense() })
            .contains("a probability from 0 to 1")
    );
    assert!(
        message(AugmentConfig { eraser_sides: [0, 9], ..dense() })
            .starts_with("augmentation.eraser_sides = [0, 9]:")
    );
    assert!(
        message(AugmentConfig { brightness: -1.0, ..dense() }).starts_with("augmentation.brightness = -1:")
    );
    assert!(
        message(AugmentConfig { max_log2_stretch: 9.0, ..dense() })
            .starts_with("augmentation.max_log2_stretch = 9:")
    );

    let augmentation = Augmentation::new(dense()).expect("a configuration");
    let refused = |sample: Sample| augmentation.apply(sample, Key::new(0)).expect_err("wrong").to_string();
    let uneven = Sample { mask: Some(Mask::new(3, 3)), ..moving(20, 10) };
    assert_eq!(
        refused(uneven),
        "frame 1 is 20x10 and the mask 3x3 (WIDTHxHEIGHT): they must have the same size"
    );
    assert_eq!(refused(moving(0, 10)), "the frames are 0x10 (WIDTHxHEIGHT): expected at least one pixel");
}

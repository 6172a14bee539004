//! Properties that hold for any frames.

use srflow_classical::{Farneback, FarnebackParameters, TvL1, TvL1Parameters};
use srflow_core::random::Key;
use srflow_core::{FlowEstimator, FlowField, Image, Size, forward_interpolate};

fn estimators() -> Vec<Box<dyn FlowEstimator>> {
    let farneback = |parameters| Box::new(Farneback::new(parameters).unwrap()) as Box<dyn FlowEstimator>;
    let tvl1 = |parameters| Box::new(TvL1::new(parameters).unwrap()) as Box<dyn FlowEstimator>;
    vec![
        farneback(FarnebackParameters::default()),
        farneback(FarnebackParameters { gaussian: true, winsize: 20, poly_n: 7, ..Default::default() }),
        tvl1(TvL1Parameters::default()),
        tvl1(TvL1Parameters { gamma: 0.3, median_filtering: 3, scale_step: 0.5, ..Default::default() }),
    ]
}

/// A smooth texture of several waves, seen through a window whose top left corner is at `(left, top)`.
fn texture(width: usize, height: usize, (left, top): (f32, f32)) -> Image {
    let mut random = Key::new(5).stream("texture");
    let waves: Vec<[f32; 3]> = (0..12)
        .map(|_| [random.uniform(-0.35, 0.35), random.uniform(-0.35, 0.35), random.uniform(0.0, 6.0)])
        .collect();
    Image::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 + left, y as f32 + top);
        let sum: f32 = waves.iter().map(|[fx, fy, phase]| libm::sinf(fx * x + fy * y + phase)).sum();
        [(127.5 + 25.0 * sum).clamp(0.0, 255.0).round() as u8; 3]
    })
}

fn noise(width: usize, height: usize, seed: u64) -> Image {
    let mut random = Key::new(seed).stream("noise");
    Image::from_fn(width, height, |_, _| [random.below(256) as u8; 3])
}

/// Mean distance in pixels between `flow` and one vector, `margin` pixels away from the border.
fn mean_distance(flow: &FlowField, [u, v]: [f32; 2], margin: usize) -> f32 {
    let inner = flow.crop(margin, margin, flow.width() - 2 * margin, flow.height() - 2 * margin);
    let sum: f32 = inner.pixels().iter().map(|pixel| (pixel[0] - u).hypot(pixel[1] - v)).sum();
    sum / inner.pixels().len() as f32
}

#[test]
fn a_constant_image_does_not_move() {
    for estimator in estimators() {
        for level in [0, 77, 255] {
            let frame = Image::filled(90, 70, [level; 3]);
            let flow = estimator.estimate(&frame, &frame).unwrap();
            let largest = flow.pixels().iter().flatten().fold(0.0_f32, |a, b| a.max(b.abs()));
            assert!(largest < 1e-4, "{}: {largest} px at level {level}", estimator.name());
        }
    }
}

#[test]
fn a_translated_texture_moves_by_the_translation() {
    for estimator in estimators() {
        for (u, v) in [(0.0, 0.0), (1.5, -0.75), (-4.0, 3.0)] {
            let (first, second) = (texture(160, 120, (0.0, 0.0)), texture(160, 120, (-u, -v)));
            let flow = estimator.estimate(&first, &second).unwrap();
            let distance = mean_distance(&flow, [u, v], 16);
            assert!(distance < 0.1, "{}: {distance} px from ({u}, {v})", estimator.name());
        }
    }
}

#[test]
fn any_size_gives_finite_flow_of_that_size() {
    let sizes =
        [(0, 0), (0, 5), (1, 1), (1, 40), (3, 200), (200, 3), (2, 2), (7, 9), (33, 31), (64, 17), (100, 100)];
    for estimator in estimators() {
        for (width, height) in sizes {
            let flow = estimator.estimate(&noise(width, height, 1), &noise(width, height, 2)).unwrap();
            assert_eq!(flow.size(), Size { width, height });
            assert!(
                flow.pixels().iter().flatten().all(|x| x.is_finite()),
                "{} {width}x{height}",
                estimator.name()
            );
        }
    }
}

#[test]
fn frames_of_different_sizes_are_an_error() {
    for estimator in estimators() {
        let error = estimator.estimate(&noise(20, 30, 1), &noise(30, 20, 1)).unwrap_err();
        let expected = "the frames differ in size: the first is 20x30, the second 30x20 (WIDTHxHEIGHT)";
        assert_eq!(error.to_string(), expected);
        let frame = noise(20, 30, 1);
        let error = estimator.estimate_from(&frame, &frame, &FlowField::new(20, 31)).unwrap_err();
        assert!(error.to_string().contains("the second 20x31"), "{error}");
    }
}

#[test]
fn an_initial_flow_leads_where_the_pyramid_does_not_reach() {
    let [u, v] = [-30.0, 17.0];
    let first = noise(200, 150, 3);
    let second = Image::from_fn(200, 150, |x, y| {
        let (x, y) = (x as f32 - u, y as f32 - v);
        if x < 200.0 && y >= 0.0 { first.get(x as usize, y as usize) } else { [128; 3] }
    });
    let farneback = Farneback::new(FarnebackParameters { levels: 0, ..Default::default() }).unwrap();
    let tvl1 = TvL1::new(TvL1Parameters { nscales: 2, ..Default::default() }).unwrap();
    for estimator in [&farneback as &dyn FlowEstimator, &tvl1] {
        let from_zero = estimator.estimate(&first, &second).unwrap();
        let initial = FlowField::filled(200, 150, [u + 0.4, v - 0.4]);
        let from_near = estimator.estimate_from(&first, &second, &initial).unwrap().flow;
        assert!(mean_distance(&from_zero, [u, v], 40) > 10.0, "{}", estimator.name());
        let distance = mean_distance(&from_near, [u, v], 40);
        assert!(distance < 0.1, "{}: {distance} px", estimator.name());
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (first, second) = (texture(500, 230, (0.0, 0.0)), texture(500, 230, (2.3, -1.1)));
    for estimator in estimators() {
        let with_threads = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let flow = pool.install(|| estimator.estimate(&first, &second)).unwrap();
            flow.pixels().iter().flatten().map(|value| value.to_bits()).collect::<Vec<u32>>()
        };
        let one = with_threads(1);
        for threads in [2, 3, 7] {
            assert!(with_threads(threads) == one, "{}, {threads} threads", estimator.name());
        }
    }
}

#[test]
fn a_parameter_out_of_range_is_named() {
    let wrong = [
        (FarnebackParameters { pyr_scale: 1.0, ..Default::default() }, "pyr_scale"),
        (FarnebackParameters { pyr_scale: f64::NAN, ..Default::default() }, "pyr_scale"),
        (FarnebackParameters { winsize: 0, ..Default::default() }, "winsize"),
        (FarnebackParameters { poly_n: 0, ..Default::default() }, "poly_n"),
        (FarnebackParameters { poly_sigma: 1e-4, ..Default::default() }, "poly_sigma"),
        (FarnebackParameters { poly_sigma: f64::INFINITY, ..Default::default() }, "poly_sigma"),
    ];
    for (parameters, name) in wrong {
        assert_eq!(Farneback::new(parameters).unwrap_err().parameter, name);
    }
    let wrong = [
        (TvL1Parameters { tau: 0.0, ..Default::default() }, "tau"),
        (TvL1Parameters { lambda: f64::NAN, ..Default::default() }, "lambda"),
        (TvL1Parameters { theta: -1.0, ..Default::default() }, "theta"),
        (TvL1Parameters { nscales: 0, ..Default::default() }, "nscales"),
        (TvL1Parameters { epsilon: -0.1, ..Default::default() }, "epsilon"),
        (TvL1Parameters { scale_step: 1.0, ..Default::default() }, "scaleStep"),
        (TvL1Parameters { median_filtering: 4, ..Default::default() }, "medianFiltering"),
    ];
    for (parameters, name) in wrong {
        assert_eq!(TvL1::new(parameters).unwrap_err().parameter, name);
    }
}

#[test]
fn a_video_gives_the_flow_of_its_pairs() {
    let frames: Vec<Image> = (0..4).map(|time| texture(70, 90, (-1.5 * time as f32, time as f32))).collect();
    for estimator in estimators() {
        let pairs: Vec<FlowField> =
            frames.windows(2).map(|pair| estimator.estimate(&pair[0], &pair[1]).unwrap()).collect();
        let along = |portions: [&[Image]; 3], warm_start| -> Vec<FlowField> {
            let mut sequence = estimator.sequence(warm_start);
            let estimates = portions.into_iter().flat_map(|frames| sequence.push(frames).unwrap());
            estimates.map(|estimate| estimate.flow).collect()
        };
        assert_eq!(along([&frames[..1], &[], &frames[1..]], false), pairs, "{}", estimator.name());
        // From the flow of the pair before.
        let mut warm = vec![pairs[0].clone()];
        for pair in frames.windows(2).skip(1) {
            let start = forward_interpolate(&warm[warm.len() - 1]);
            warm.push(estimator.estimate_from(&pair[0], &pair[1], &start).unwrap().flow);
        }
        assert_eq!(along([&frames[..2], &frames[2..3], &frames[3..]], true), warm, "{}", estimator.name());

        let mut sequence = estimator.sequence(false);
        let second = sequence.push_pair([&frames[1], &frames[2]]).unwrap();
        assert_eq!(second.flow, pairs[1]);
        assert_eq!(sequence.push(&frames[3..]).unwrap()[0].flow, pairs[2]);
        // A frame of another size has no flow to it, and begins another video.
        assert!(sequence.push(&[texture(71, 90, (0.0, 0.0))]).is_err());
        assert!(sequence.push(&frames[..1]).unwrap().is_empty());
        assert_eq!(sequence.push(&frames[1..2]).unwrap()[0].flow, pairs[0]);
    }
}

//! Metrics against those of ptlflow (`tools/golden/files.py`), and against a slow implementation.

use std::collections::BTreeMap;
use std::path::PathBuf;

use proptest::prelude::*;
use srflow_core::{FlowField, Mask, MeanMetrics, Metrics, ScoreError, score};
use srflow_files::{read_flow, read_mask};

fn data(name: &str) -> PathBuf {
    PathBuf::from("tests/data").join(name)
}

/// ptlflow sums in `f32`.
fn assert_near(ours: &Metrics, golden: &Metrics, what: &str) {
    let pairs = [
        ("epe", ours.epe, golden.epe),
        ("px1", ours.px1, golden.px1),
        ("px3", ours.px3, golden.px3),
        ("px5", ours.px5, golden.px5),
        ("f1_all", ours.f1_all, golden.f1_all),
        ("wauc", ours.wauc, golden.wauc),
    ];
    for (name, ours, golden) in pairs {
        assert!(
            (ours - golden).abs() <= 1e-6 * golden.abs().max(1.0),
            "{what}: {name} is {ours}, not {golden}"
        );
    }
    assert_eq!(ours.valid_pixels, golden.valid_pixels, "{what}");
}

#[test]
fn metrics_are_those_of_ptlflow() {
    #[derive(serde::Deserialize)]
    struct Golden {
        whole: Vec<Metrics>,
        masked: Vec<Metrics>,
        mean: Metrics,
        mean_masked: Metrics,
    }
    let golden: Golden = serde_json::from_slice(&std::fs::read(data("metrics.json")).unwrap()).unwrap();
    let (mut mean, mut mean_masked) = (MeanMetrics::default(), MeanMetrics::default());
    for index in 0..golden.whole.len() {
        let prediction = read_flow(&data(&format!("prediction{index}.npy"))).unwrap();
        let truth = read_flow(&data(&format!("truth{index}.npy"))).unwrap();
        let mask = read_mask(&data(&format!("mask{index}.png"))).unwrap();
        let whole = score(&prediction, &truth, None).unwrap();
        let masked = score(&prediction, &truth, Some(&mask)).unwrap();
        assert_near(&whole.unwrap(), &golden.whole[index], &format!("image {index}"));
        assert_near(&masked.unwrap(), &golden.masked[index], &format!("image {index} in its mask"));
        mean.add(whole.as_ref());
        mean_masked.add(masked.as_ref());
    }
    assert_near(&mean.mean().unwrap(), &golden.mean, "mean");
    assert_near(&mean_masked.mean().unwrap(), &golden.mean_masked, "mean in the masks");
}

#[test]
fn json_has_the_documented_keys() {
    let flow = FlowField::filled(7, 11, [1.0, 2.0]);
    let metrics = score(&flow, &flow, None).unwrap().unwrap();
    let json: BTreeMap<String, f64> = serde_json::from_value(serde_json::to_value(metrics).unwrap()).unwrap();
    let keys: Vec<&str> = json.keys().map(String::as_str).collect();
    assert_eq!(keys, ["epe", "f1_all", "px1", "px3", "px5", "valid_pixels", "wauc"]);
    assert_eq!((json["epe"], json["px1"], json["f1_all"], json["wauc"]), (0.0, 1.0, 0.0, 100.0));
}

#[test]
fn an_image_without_valid_pixels_takes_no_part_in_the_mean() {
    let flow = FlowField::filled(3, 2, [1.0, 0.0]);
    let unknown = FlowField::filled(3, 2, [f32::NAN; 2]);
    let nothing = score(&flow, &unknown, None).unwrap();
    assert_eq!(nothing, None);
    assert_eq!(score(&flow, &flow, Some(&Mask::new(3, 2))).unwrap(), None);
    let mut mean = MeanMetrics::default();
    assert_eq!(mean.mean(), None);
    mean.add(nothing.as_ref());
    mean.add(score(&FlowField::filled(3, 2, [3.0, 0.0]), &flow, None).unwrap().as_ref());
    let of_one = mean.mean().unwrap();
    assert_eq!((of_one.epe, of_one.px1, of_one.px3, of_one.valid_pixels), (2.0, 0.0, 1.0, 6));
    assert_eq!((mean.images(), mean.images_without_valid_pixels()), (1, 1));
}

#[test]
fn a_prediction_that_is_not_finite_is_named_where_it_is_scored() {
    let truth = FlowField::new(4, 3);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
        let mut prediction = truth.clone();
        prediction.set(2, 1, [0.0, bad]);
        let error = score(&prediction, &truth, None).unwrap_err();
        assert!(matches!(error, ScoreError::NotFinite { x: 2, y: 1, .. }), "{error}");
        let elsewhere = Mask::from_fn(4, 3, |x, _| x != 2);
        assert_eq!(score(&prediction, &truth, Some(&elsewhere)).unwrap().unwrap().valid_pixels, 9);
    }
}

#[test]
fn sizes_must_agree() {
    let error = score(&FlowField::new(4, 3), &FlowField::new(3, 4), None).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the prediction is 4x3 and the truth 3x4 (WIDTHxHEIGHT): they must have the same size"
    );
    let mask = Mask::new(1, 1);
    assert!(score(&FlowField::new(2, 2), &FlowField::new(2, 2), Some(&mask)).is_err());
}

/// The metrics as in `flow_metrics.py`: one threshold after another over all pixels.
fn slow_twin(prediction: &FlowField, truth: &FlowField) -> Option<Metrics> {
    let length = |[u, v]: [f32; 2]| (u * u + v * v).sqrt();
    let valid = |[u, v]: &[f32; 2]| u.abs() < 10_000.0 && v.abs() < 10_000.0;
    let pixels = prediction.pixels().iter().zip(truth.pixels()).filter(|(_, truth)| valid(truth));
    let errors: Vec<(f32, f32)> =
        pixels.map(|(p, t)| (length([p[0] - t[0], p[1] - t[1]]), length(*t))).collect();
    let count = errors.len() as f64;
    let fraction = |holds: &dyn Fn(&(f32, f32)) -> bool| {
        errors.iter().filter(|error| holds(error)).count() as f64 / count
    };
    let (mut area, mut weights) = (0.0, 0.0);
    for i in 1..=100 {
        let weight = 1.0 - f64::from(i - 1) / 100.0;
        let threshold = (f64::from(i) / 20.0) as f32;
        area += weight * fraction(&|(epe, _)| *epe <= threshold);
        weights += weight;
    }
    (!errors.is_empty()).then(|| Metrics {
        epe: errors.iter().map(|(epe, _)| f64::from(*epe)).sum::<f64>() / count,
        px1: fraction(&|(epe, _)| *epe < 1.0),
        px3: fraction(&|(epe, _)| *epe < 3.0),
        px5: fraction(&|(epe, _)| *epe < 5.0),
        f1_all: 100.0 * fraction(&|(epe, truth)| *epe > 3.0 && *epe > 0.05 * truth),
        wauc: 100.0 * area / weights,
        valid_pixels: errors.len() as u64,
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Errors at and next to every threshold: multiples of 1/20 and their neighbours.
    #[test]
    fn scoring_in_blocks_matches_scoring_pixel_by_pixel(
        errors in prop::collection::vec((0_u32..120, -1_i32..=1, 0_usize..4), 1..400),
    ) {
        let lengths = [0.0, 7.0, 60.0, 20_000.0];
        let truth: Vec<[f32; 2]> = errors.iter().map(|(_, _, kind)| [0.0, lengths[*kind]]).collect();
        let predicted = errors.iter().zip(&truth).map(|((step, ulp, _), truth)| {
            let on = (f64::from(*step) / 20.0) as f32;
            [f32::from_bits(on.to_bits().saturating_add_signed(*ulp)), truth[1]]
        });
        let prediction = FlowField::from_pixels(errors.len(), 1, predicted.collect()).unwrap();
        let truth = FlowField::from_pixels(errors.len(), 1, truth).unwrap();
        match (score(&prediction, &truth, None).unwrap(), slow_twin(&prediction, &truth)) {
            (Some(fast), Some(slow)) => {
                let of = |m: &Metrics| [m.epe, m.px1, m.px3, m.px5, m.f1_all, m.wauc];
                for (fast, slow) in of(&fast).into_iter().zip(of(&slow)) {
                    prop_assert!((fast - slow).abs() < 1e-11 * slow.max(1.0), "{fast} and {slow}");
                }
                prop_assert_eq!(fast.valid_pixels, slow.valid_pixels);
            }
            (fast, slow) => prop_assert_eq!(fast, slow),
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let prediction =
        FlowField::from_fn(700, 301, |x, y| [(x * y % 97) as f32 * 0.013, (x % 31) as f32 * 0.1]);
    let truth = FlowField::new(700, 301);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| score(&prediction, &truth, None)).unwrap().unwrap()
    };
    let one = with(1);
    for threads in [2, 3, 7] {
        assert_eq!(with(threads).epe.to_bits(), one.epe.to_bits());
    }
}

//! Evaluation over small datasets on disk whose errors are known.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Mutex;

use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image, Labels, Mask, Metrics, Size,
};
use srflow_data::flow::{DatasetSpec, FlowDataset};
use srflow_eval::{
    EvaluateError, Evaluation, Event, FlowFiles, Method, OnFailure, Region, SCORES, Settings, evaluate,
};
use srflow_files::{write_flow, write_image_png, write_labels_png, write_mask_png};

const SIZE: Size = Size::new(40, 24);

/// Reads the truth that [`write_pair`] encodes in the red channel and adds an error: `left` in the left half of the frame it
/// sees, `right` in the other.
struct Knowing {
    left: [f32; 2],
    right: [f32; 2],
}

impl FlowEstimator for Knowing {
    fn name(&self) -> &str {
        "knowing"
    }

    fn estimate(&self, frame1: &Image, _frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(FlowField::from_fn(frame1.width(), frame1.height(), |x, y| {
            let error = if x < frame1.width() / 2 { self.left } else { self.right };
            [f32::from(frame1.get(x, y)[0]) / 4.0 + error[0], error[1]]
        }))
    }
}

/// A pair whose true flow is `(x / 4, 0)` at column `x`, unknown in the first row; the head is the right half, the left
/// quarter is occluded.
fn write_pair(dir: &Path, name: &str) {
    let file = |ending: &str| dir.join(format!("{name}_{ending}"));
    let Size { width, height } = SIZE;
    let frame = Image::from_fn(width, height, |x, y| [x as u8, y as u8, 7]);
    write_image_png(&file("img1.png"), &frame).unwrap();
    write_image_png(&file("img2.png"), &frame).unwrap();
    let unknown = |y: usize| if y == 0 { f32::NAN } else { 0.0 };
    let truth = FlowField::from_fn(width, height, |x, y| [x as f32 / 4.0 + unknown(y), unknown(y)]);
    write_flow(&file("flow.flo"), &truth).unwrap();
    write_mask_png(&file("mask.png"), &Mask::from_fn(width, height, |x, _| x >= width / 2)).unwrap();
    write_mask_png(&file("occlusion.png"), &Mask::from_fn(width, height, |x, _| x < width / 4)).unwrap();
}

fn dataset(dir: &Path, pairs: usize) -> FlowDataset {
    std::fs::create_dir_all(dir).unwrap();
    (0..pairs).for_each(|i| write_pair(dir, &format!("pair{i}")));
    open(dir)
}

fn open(dir: &Path) -> FlowDataset {
    FlowDataset::open(&DatasetSpec { kind: "folder".into(), dir: dir.to_owned() }, None).unwrap()
}

fn run(
    dataset: &FlowDataset,
    method: &dyn FlowEstimator,
    settings: Settings,
) -> Result<Evaluation, EvaluateError> {
    evaluate(dataset, &[Method::Estimator(method)], settings, &mut |_| {})
}

fn epe(evaluation: &Evaluation, method: usize, region: Region) -> f64 {
    evaluation.methods[method].region(region).unwrap().epe
}

#[test]
fn a_shifted_truth_has_exactly_its_shift_as_error() {
    let dir = tempfile::tempdir().unwrap();
    let shifted = Knowing { left: [1.5, 2.0], right: [1.5, 2.0] };
    let evaluation = run(&dataset(dir.path(), 3), &shifted, Settings::default()).unwrap();
    assert_eq!(evaluation.pairs, 3);
    let metrics = evaluation.methods[1].whole.as_ref().unwrap();
    assert!((metrics.epe - 2.5).abs() < 1e-6, "{metrics:?}");
    assert_eq!((metrics.px1, metrics.px3, metrics.px5, metrics.f1_all), (0.0, 1.0, 1.0, 0.0));
    // The first row has no truth.
    assert_eq!(metrics.valid_pixels, 3 * (SIZE.width * (SIZE.height - 1)) as u64);
    // All pixels lie within 2.5 px, none within 2.45 px.
    let within = &evaluation.methods[1].within;
    assert_eq!((within[48], within[49]), (0.0, 1.0));
}

#[test]
fn the_baseline_comes_first_and_has_the_length_of_the_flow() {
    let dir = tempfile::tempdir().unwrap();
    let exact = Knowing { left: [0.0; 2], right: [0.0; 2] };
    let evaluation = run(&dataset(dir.path(), 2), &exact, Settings::default()).unwrap();
    assert!(evaluation.methods[0].baseline && evaluation.methods[0].name == "zero");
    let mean_length = (0..SIZE.width).map(|x| x as f64 / 4.0).sum::<f64>() / SIZE.width as f64;
    assert!((epe(&evaluation, 0, Region::Whole) - mean_length).abs() < 1e-6);
    assert_eq!(epe(&evaluation, 1, Region::Whole), 0.0);
}

#[test]
fn a_method_worse_than_zero_flow_on_every_pair_has_a_note() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(dir.path(), 2);
    for (error, expected) in [(20.0, 1), (1.0, 0)] {
        let wrong = Knowing { left: [error, 0.0], right: [error, 0.0] };
        let tables = run(&dataset, &wrong, Settings::default()).unwrap().tables();
        let notes = &tables[0].notes;
        assert_eq!(notes.len(), expected, "{notes:?}");
        assert!(
            notes.iter().all(|note| note.starts_with("knowing: worse than zero flow on every pair")),
            "{notes:?}"
        );
    }
}

#[test]
fn regions_count_their_own_pixels() {
    let dir = tempfile::tempdir().unwrap();
    let wrong_on_the_left = Knowing { left: [0.0, 3.0], right: [0.0, 0.0] };
    let evaluation = run(&dataset(dir.path(), 2), &wrong_on_the_left, Settings::default()).unwrap();
    assert!((epe(&evaluation, 1, Region::Whole) - 1.5).abs() < 1e-6);
    assert_eq!(epe(&evaluation, 1, Region::Head), 0.0);
    assert!((epe(&evaluation, 1, Region::Visible) - 1.0).abs() < 1e-6); // a third of what is not occluded
    assert_eq!(evaluation.tables().len(), 3);
}

/// The region map of the head in the right half: hair above, neck below, an eye and a mouth in the skin between. Its rim is the columns
/// 20 to 22.
fn region_map() -> Labels {
    Labels::from_fn(SIZE.width, SIZE.height, |x, y| match (x, y) {
        (..20, _) => 0,
        (_, ..4) => 4,
        (_, 20..) => 5,
        (28..32, 8..10) => 2,
        (28..34, 14..16) => 3,
        _ => 1,
    })
}

fn dataset_with_regions(dir: &Path, pairs: usize) -> FlowDataset {
    dataset(dir, pairs);
    for pair in 0..pairs {
        write_labels_png(&dir.join(format!("pair{pair}_regions.png")), &region_map()).unwrap();
    }
    open(dir)
}

/// The truth of [`write_pair`], with an error of 2 px at some pixels.
struct WrongAt<F>(F);

impl<F: Fn(usize, usize) -> bool + Send + Sync> FlowEstimator for WrongAt<F> {
    fn name(&self) -> &str {
        "wrong"
    }

    fn estimate(&self, frame1: &Image, _frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(FlowField::from_fn(frame1.width(), frame1.height(), |x, y| {
            // The frames say where they were before they were cropped.
            let [column, row, _] = frame1.get(x, y);
            let wrong = (self.0)(column.into(), row.into());
            [f32::from(column) / 4.0, if wrong { 2.0 } else { 0.0 }]
        }))
    }
}

#[test]
fn an_error_in_one_region_is_in_its_scores_alone() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset_with_regions(dir.path(), 1);
    let map = region_map();
    let is_in = |region: Region, x: usize, y: usize| match region {
        Region::Background => x < 20,
        Region::Rim => (20..23).contains(&x),
        part => {
            x >= 23 && map.get(x, y) as usize == 1 + Region::OF_MAPS.iter().position(|r| *r == part).unwrap()
        }
    };
    // Of the head, the crop contains the columns 26 to 33: no rim.
    for crop in [None, Some(Size::new(8, 24))] {
        let settings = Settings { regions: true, crop, ..Settings::default() };
        for wrong in Region::OF_MAPS {
            let evaluation = run(&dataset, &WrongAt(|x, y| is_in(wrong, x, y)), settings).unwrap();
            let scores = &evaluation.methods[1].regions;
            let shown = Region::OF_MAPS
                .iter()
                .filter(|region| crop.is_none() || !matches!(region, Region::Rim | Region::Background));
            assert!(scores.keys().eq(shown), "{crop:?}: {:?}", scores.keys());
            for (region, metrics) in scores {
                let expected = if *region == wrong { 2.0 } else { 0.0 };
                assert_eq!(metrics.epe, expected, "{region} with an error in {wrong}");
            }
        }
    }
}

#[test]
fn regions_of_a_map_make_up_the_whole() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset_with_regions(dir.path(), 2);
    let method = Knowing { left: [0.3, 1.0], right: [3.0, 2.0] };
    let settings = Settings { regions: true, ..Settings::default() };
    let evaluation = run(&dataset, &method, settings).unwrap();
    for scores in evaluation.methods.iter().flat_map(|method| &method.pairs) {
        let whole = scores.whole.as_ref().unwrap();
        assert_eq!(scores.regions.len(), Region::OF_MAPS.len());
        let pixels: u64 = scores.regions.values().map(|metrics| metrics.valid_pixels).sum();
        assert_eq!(pixels, whole.valid_pixels);
        let sum = |value: fn(&Metrics) -> f64| -> f64 {
            scores.regions.values().map(|metrics| value(metrics) * metrics.valid_pixels as f64).sum()
        };
        for (key, .., value) in SCORES {
            let difference = sum(value) / pixels as f64 - value(whole);
            assert!(difference.abs() < 1e-9, "{key}: {difference}");
        }
    }
    let without = run(&dataset, &method, Settings::default()).unwrap();
    assert!(without.methods.iter().all(|method| method.regions.is_empty()));
    assert_eq!(without.methods[1].whole, evaluation.methods[1].whole);
    assert!(!serde_json::to_string(&without).unwrap().contains("regions"));

    let titles: Vec<String> = evaluation.tables().into_iter().map(|table| table.title).collect();
    assert_eq!(titles.len(), 3 + Region::OF_MAPS.len() + 2, "{titles:?}");
    let json = serde_json::to_string(&evaluation).unwrap();
    assert_eq!(serde_json::from_str::<Evaluation>(&json).unwrap(), evaluation);
    assert_eq!(evaluation.csv().lines().count(), 1 + 2 * (3 + Region::OF_MAPS.len()));
    let [epe, relative] = &evaluation.by_region()[..] else { panic!("two tables") };
    let mouth = epe.columns.iter().position(|column| column.key == "mouth").unwrap();
    let (error, length) = (epe.rows[1].value(mouth).unwrap(), epe.rows[0].value(mouth).unwrap());
    assert!((error - 13.0_f64.sqrt()).abs() < 1e-6 && (length - 30.5 / 4.0).abs() < 1e-6, "{error} {length}");
    assert_eq!(relative.rows[1].value(mouth), Some(error / length));
    assert_eq!(relative.rows[0].value(mouth), Some(1.0));
}

#[test]
fn pairs_without_a_region_map_cannot_be_scored_by_region() {
    let dir = tempfile::tempdir().unwrap();
    dataset_with_regions(dir.path(), 3);
    std::fs::remove_file(dir.path().join("pair2_regions.png")).unwrap();
    let exact = Knowing { left: [0.0; 2], right: [0.0; 2] };
    let settings = Settings { regions: true, ..Settings::default() };
    let error = run(&open(dir.path()), &exact, settings).unwrap_err().to_string();
    assert!(error.contains("1 of 3 pairs") && error.contains("srflow render --regions"), "{error}");
    assert!(run(&open(dir.path()), &exact, Settings { limit: Some(2), ..settings }).is_ok(), "pairs 0 and 1");
    write_labels_png(&dir.path().join("pair2_regions.png"), &Labels::new(3, 3)).unwrap();
    let error = run(&open(dir.path()), &exact, settings).unwrap_err().to_string();
    assert!(error.contains("pair2") && error.contains("40x24") && error.contains("3x3"), "{error}");
}

#[test]
fn small_motion_is_scored_on_the_head() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(dir.path(), 1);
    let method = Knowing { left: [9.0, 0.0], right: [0.0, 0.5] };
    let settings = Settings { small_motion: Some(6.0), ..Settings::default() };
    let evaluation = run(&dataset, &method, settings).unwrap();
    // The columns 20 to 23 move by 5 to 5.75 px.
    let metrics = &evaluation.methods[1].regions[&Region::SmallMotion];
    assert_eq!((metrics.epe, metrics.valid_pixels), (0.5, 4 * (SIZE.height as u64 - 1)));
    let [_, relative] = &evaluation.by_region()[..] else { panic!("two tables") };
    assert!((relative.rows[1].value(0).unwrap() - 0.5 / 5.375).abs() < 1e-6);
    assert!(
        evaluation.tables().iter().any(|table| table.title.contains("small motion (true flow under 6 px)"))
    );
    let none = run(&dataset, &method, Settings { small_motion: Some(0.5), ..settings }).unwrap();
    assert!(none.methods[1].regions.is_empty() && none.by_region().is_empty(), "the head moves faster");
}

#[test]
fn a_crop_is_centred_on_the_head_and_keeps_frames_and_truth_together() {
    let dir = tempfile::tempdir().unwrap();
    let exact = Knowing { left: [0.0; 2], right: [0.0; 2] };
    let settings = Settings { crop: Some(Size::new(10, 6)), ..Settings::default() };
    let mut seen = Vec::new();
    let evaluation =
        evaluate(&dataset(dir.path(), 1), &[Method::Estimator(&exact)], settings, &mut |event| {
            if let Event::Scored(pair) = event {
                seen.push((pair.sample.frame1.size(), pair.sample.frame1.get(0, 0), pair.truth.get(0, 0)));
            }
        })
        .unwrap();
    // The head covers columns 20 to 39 and all rows: its middle is (29.5, 11.5).
    assert_eq!(seen, [(Size::new(10, 6), [25, 9, 7], [6.25, 0.0])]);
    assert_eq!(epe(&evaluation, 1, Region::Whole), 0.0);

    let too_large = Settings { crop: Some(Size::new(1200, 1600)), ..Settings::default() };
    let error = run(&open(dir.path()), &exact, too_large).unwrap_err().to_string();
    assert!(error.contains("pair0") && error.contains("1200x1600") && error.contains("40x24"), "{error}");
}

#[test]
fn a_broken_pair_stops_the_run_or_is_left_out_of_every_row() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(dir.path(), 3);
    std::fs::write(dir.path().join("pair1_img2.png"), b"not a picture").unwrap();
    let exact = Knowing { left: [0.0; 2], right: [0.0; 2] };
    let error = run(&dataset, &exact, Settings::default()).unwrap_err().to_string();
    assert!(error.contains("pair1") && error.contains("pair1_img2.png"), "{error}");

    let keep_going = Settings { on_failure: OnFailure::LeaveOut, ..Settings::default() };
    let evaluation = run(&dataset, &exact, keep_going).unwrap();
    assert_eq!((evaluation.pairs, evaluation.failures.len()), (2, 1));
    assert_eq!(evaluation.failures[0].pair, "pair1");
    for method in &evaluation.methods {
        let names: Vec<&str> = method.pairs.iter().map(|pair| pair.pair.as_str()).collect();
        assert_eq!(names, ["pair0", "pair2"]);
    }
}

/// Records how many pairs it got at once, and fails on frames whose first pixel is [`REFUSED`].
struct Counting(Mutex<Vec<usize>>);

const REFUSED: [u8; 3] = [9, 8, 7];

impl FlowEstimator for Counting {
    fn name(&self) -> &str {
        "counting"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_pairs(&[[frame1, frame2]])?.remove(0).flow)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        self.0.lock().unwrap().push(pairs.len());
        let flow = |[frame1, _]: &[&Image; 2]| match frame1.get(0, 0) {
            REFUSED => {
                Err(EstimateError::Unsupported { method: "counting".into(), reason: "refused".into() })
            }
            _ => Ok(Knowing { left: [0.25, 0.0], right: [0.5, 0.0] }.estimate(frame1, frame1)?.into()),
        };
        pairs.iter().map(flow).collect()
    }
}

/// Also next to pairs of another size, pairs that cannot be read, and pairs without a flow.
#[test]
fn scores_do_not_depend_on_how_many_pairs_are_estimated_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let pairs = dataset(dir.path(), 9);
    std::fs::write(dir.path().join("pair1_img2.png"), b"not a picture").unwrap();
    for name in ["pair4_img1.png", "pair4_img2.png"] {
        write_image_png(&dir.path().join(name), &Image::filled(SIZE.width, SIZE.height, REFUSED)).unwrap();
    }
    for (name, ending) in [("pair6", "mask.png"), ("pair6", "occlusion.png")] {
        std::fs::remove_file(dir.path().join(format!("{name}_{ending}"))).unwrap();
    }
    for name in ["pair6_img1.png", "pair6_img2.png"] {
        write_image_png(&dir.path().join(name), &Image::new(16, 8)).unwrap();
    }
    write_flow(&dir.path().join("pair6_flow.flo"), &FlowField::new(16, 8)).unwrap();
    let run = |batch: usize| {
        let counting = Counting(Mutex::default());
        let settings = Settings {
            on_failure: OnFailure::LeaveOut,
            batch: NonZeroUsize::new(batch),
            ..Settings::default()
        };
        let mut evaluation = run(&open(pairs.dir()), &counting, settings).unwrap();
        let scores = evaluation.methods.iter_mut().flat_map(|method| &mut method.pairs);
        scores.for_each(|pair| pair.seconds = None);
        (evaluation, counting.0.into_inner().unwrap())
    };
    let (alone, counts) = run(1);
    assert_eq!((alone.pairs, counts), (7, vec![1; 8]));
    let failed: Vec<&str> = alone.failures.iter().map(|failure| failure.pair.as_str()).collect();
    assert_eq!(failed, ["pair1", "pair4"]);
    // A batch that contains a failing pair is estimated pair by pair.
    for (batch, expected) in [(2, vec![1, 2, 2, 1, 1, 1, 2]), (20, vec![5, 1, 1, 1, 1, 1, 1, 2])] {
        let (together, counts) = run(batch);
        assert_eq!(counts, expected, "batch {batch}");
        assert_eq!(together, alone, "batch {batch}");
    }
}

/// One iteration in the first call, two in the second, and so on.
struct Iterating(Mutex<f32>);

impl FlowEstimator for Iterating {
    fn name(&self) -> &str {
        "iterating"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_pairs(&[[frame1, frame2]])?.remove(0).flow)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let estimate = |[frame1, _]: &[&Image; 2]| {
            let mut iterations = self.0.lock().unwrap();
            *iterations += 1.0;
            let flow = FlowField::new(frame1.width(), frame1.height());
            FlowEstimate { iterations: Some(*iterations), ..flow.into() }
        };
        Ok(pairs.iter().map(estimate).collect())
    }
}

#[test]
fn the_mean_number_of_iterations_is_in_the_tables_if_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(dir.path(), 4);
    let run = |iterations| {
        let settings = Settings { iterations, ..Settings::default() };
        run(&dataset, &Iterating(Mutex::new(0.0)), settings).unwrap()
    };
    let evaluation = run(true);
    let numbers: Vec<_> = evaluation.methods[1].pairs.iter().map(|pair| pair.iterations).collect();
    assert_eq!(numbers, [1.0, 2.0, 3.0, 4.0].map(Some));
    assert_eq!((evaluation.methods[0].iterations, evaluation.methods[1].iterations), (None, Some(2.5)));
    let table = evaluation.table(Region::Whole).unwrap();
    assert_eq!(table.columns.last().unwrap().header, "iterations");
    assert_eq!([0, 1].map(|row| table.rows[row].values.last().copied().unwrap()), [None, Some(2.5)]);
    let fields = |csv: &str| -> Vec<String> {
        csv.lines().map(|line| line.rsplit(',').next().unwrap().to_owned()).collect()
    };
    let scores = fields(&evaluation.csv());
    assert!(scores[0] == "mean_iterations" && scores[1].is_empty() && scores.last().unwrap() == "2.5");
    let pairs = fields(&evaluation.pairs_csv());
    assert!(pairs[0] == "iterations" && pairs[1].is_empty() && pairs.last().unwrap() == "4");
    let json = serde_json::to_string(&evaluation).unwrap();
    assert_eq!(serde_json::from_str::<Evaluation>(&json).unwrap(), evaluation);

    let without = run(false);
    assert_eq!(without.table(Region::Whole).unwrap().columns.len(), table.columns.len() - 1);
    assert!(!serde_json::to_string(&without).unwrap().contains("iterations"));
    assert!(!(without.csv() + &without.pairs_csv()).contains("iterations"));
}

/// Moves everything by as many pixels as it has seen pairs of a video.
struct Remembering;

struct Seen(u8);

impl FlowEstimator for Remembering {
    fn name(&self) -> &str {
        "remembering"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(Seen(0).push_pair([frame1, frame2])?.flow)
    }

    fn remembers(&self) -> bool {
        true
    }

    fn sequence(&self, _: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(Seen(0))
    }
}

impl FlowSequence for Seen {
    fn push(&mut self, _: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        unreachable!("pairs are pushed")
    }

    fn push_pair(&mut self, [frame1, _]: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        self.0 += 1;
        Ok(FlowField::filled(frame1.width(), frame1.height(), [f32::from(self.0), 0.0]).into())
    }
}

#[test]
fn a_method_that_remembers_sees_scenes_in_order_and_starts_anew_in_each() {
    let dir = tempfile::tempdir().unwrap();
    for (scene, frames) in [("anna", 4), ("ben", 3)] {
        for folder in ["frames", "flow"] {
            std::fs::create_dir_all(dir.path().join(folder).join(scene)).unwrap();
        }
        for number in 0..frames {
            let path = |folder: &str, end: &str| dir.path().join(format!("{folder}/{scene}/{number}.{end}"));
            write_image_png(&path("frames", "png"), &Image::new(SIZE.width, SIZE.height)).unwrap();
            if number + 1 < frames {
                write_flow(&path("flow", "flo"), &FlowField::new(SIZE.width, SIZE.height)).unwrap();
            }
        }
    }
    let seen = |settings: Settings| -> Vec<f64> {
        let evaluation = run(&open(dir.path()), &Remembering, settings).unwrap();
        evaluation.methods[1].pairs.iter().map(|pair| pair.whole.as_ref().unwrap().epe).collect()
    };
    assert_eq!(seen(Settings::default()), [1.0, 2.0, 3.0, 1.0, 2.0]);
    assert_eq!(
        seen(Settings { batch: NonZeroUsize::new(3), ..Settings::default() }),
        [1.0, 2.0, 3.0, 1.0, 2.0]
    );
    assert_eq!(
        seen(Settings { crop: Some(Size::new(16, 8)), ..Settings::default() }),
        [1.0, 2.0, 3.0, 1.0, 2.0]
    );
    assert_eq!(seen(Settings { limit: Some(2), ..Settings::default() }), [1.0, 1.0], "pairs apart");
}

#[test]
fn an_estimator_that_gives_no_numbers_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let broken = Knowing { left: [f32::NAN, 0.0], right: [0.0; 2] };
    let error = run(&dataset(dir.path(), 1), &broken, Settings::default()).unwrap_err().to_string();
    assert!(error.contains("knowing") && error.contains("pair0") && error.contains("finite"), "{error}");
}

#[test]
fn a_dataset_without_ground_truth_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let frames = dir.path().join("frames");
    std::fs::create_dir(&frames).unwrap();
    for i in 0..3 {
        write_image_png(&frames.join(format!("{i}.png")), &Image::new(8, 8)).unwrap();
    }
    let exact = Knowing { left: [0.0; 2], right: [0.0; 2] };
    let error = run(&open(dir.path()), &exact, Settings::default()).unwrap_err().to_string();
    assert!(error.contains("none of its 2 pairs has a true flow"), "{error}");
}

#[test]
fn results_survive_json_and_csv() {
    let dir = tempfile::tempdir().unwrap();
    let method = Knowing { left: [0.1, 0.7], right: [0.3, 0.2] };
    let evaluation = run(&dataset(dir.path(), 2), &method, Settings::default()).unwrap();
    let json = serde_json::to_string(&evaluation).unwrap();
    assert_eq!(serde_json::from_str::<Evaluation>(&json).unwrap(), evaluation);

    let csv = evaluation.csv();
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let columns: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
    assert_eq!(columns[..8], ["method", "region", "epe", "px1", "px3", "px5", "f1_all", "wauc"]);
    let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(records.len(), 2 * 3); // methods times regions
    let head = records.iter().find(|record| &record[0] == "knowing" && &record[1] == "head").unwrap();
    let expected = evaluation.methods[1].head.unwrap();
    assert_eq!(head[2].parse::<f64>().unwrap(), expected.epe);
    assert_eq!(head[7].parse::<f64>().unwrap(), expected.wauc);
    assert_eq!(evaluation.pairs_csv().lines().count(), 1 + 2 * 3 * 2);
}

/// Flow files named after the pairs score like the method that wrote them, whole or cropped.
#[test]
fn flow_files_score_as_the_method_that_wrote_them() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir.path().join("pairs"), 3);
    let method = Knowing { left: [0.5, 0.25], right: [0.5, 0.25] };
    let crop = Settings { crop: Some(Size::new(21, 15)), ..Settings::default() };
    for (settings, written) in [(Settings::default(), None), (crop, None), (crop, crop.crop)] {
        let files = dir.path().join("flows");
        std::fs::create_dir_all(&files).unwrap();
        let mut estimated = evaluate(&dataset, &[Method::Estimator(&method)], settings, &mut |event| {
            // Of a crop, the file holds the whole frame or the window alone.
            let Event::Scored(pair) = event else { return };
            let flow = match written {
                Some(_) => pair.estimates[1].flow.clone(),
                None => {
                    let frame = srflow_files::read_image(
                        &dir.path().join("pairs").join(format!("{}_img1.png", pair.name)),
                    );
                    method.estimate(&frame.unwrap(), &Image::new(1, 1)).unwrap()
                }
            };
            write_flow(&files.join(format!("{}.npz", pair.name)), &flow).unwrap();
        })
        .unwrap();
        let found = FlowFiles::find("knowing".into(), &files, &dataset, settings.limit).unwrap();
        let read = evaluate(&dataset, &[Method::Files(&found)], settings, &mut |_| {}).unwrap();
        estimated.methods[1].pairs.iter_mut().for_each(|pair| pair.seconds = None);
        assert_eq!(estimated.methods[1], read.methods[1]);
        assert_eq!(read.methods[1].median_seconds(), None);
    }
}

#[test]
fn flow_files_that_do_not_fit_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir.path().join("pairs"), 3);
    let files = dir.path().join("flows");
    std::fs::create_dir(&files).unwrap();
    let find = |limit| FlowFiles::find("theirs".into(), &files, &dataset, limit);
    write_flow(&files.join("pair1.flo"), &FlowField::new(SIZE.width, SIZE.height)).unwrap();
    let error = find(None).unwrap_err().to_string();
    assert!(
        error.contains("2 of 3 pairs") && error.contains("pair0, pair2") && error.contains("pair0.flo"),
        "{error}"
    );
    write_flow(&files.join("pair0.npy"), &FlowField::new(7, 5)).unwrap();
    let found = find(Some(1)).expect("the pair that is scored has its file");
    let error = evaluate(
        &dataset,
        &[Method::Files(&found)],
        Settings { limit: Some(1), ..Settings::default() },
        &mut |_| {},
    );
    let error = error.unwrap_err().to_string();
    assert!(error.contains("pair0.npy") && error.contains("40x24") && error.contains("7x5"), "{error}");
    write_flow(&files.join("pair0.pfm"), &FlowField::new(7, 5)).unwrap();
    let error = find(Some(1)).unwrap_err().to_string();
    assert!(error.contains("pair0.npy") && error.contains("pair0.pfm"), "{error}");
}

/// Of the problems of a pair, that of the first method counts, and the methods after it do not get the pair.
#[test]
fn a_pair_whose_flow_cannot_be_scored_goes_to_no_further_method() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dataset(&dir.path().join("pairs"), 3);
    let files = dir.path().join("flows");
    std::fs::create_dir(&files).unwrap();
    for pair in 0..3 {
        let flow = FlowField::filled(SIZE.width, SIZE.height, [if pair == 1 { f32::NAN } else { 0.5 }; 2]);
        write_flow(&files.join(format!("pair{pair}.npy")), &flow).unwrap();
    }
    let theirs = FlowFiles::find("theirs".into(), &files, &dataset, None).unwrap();
    for (read_ahead, batch, estimated) in [(false, 3, vec![2]), (true, 1, vec![1, 1])] {
        let counting = Counting(Mutex::default());
        let methods = [Method::Files(&theirs), Method::Estimator(&counting)];
        let settings = Settings {
            on_failure: OnFailure::LeaveOut,
            batch: NonZeroUsize::new(batch),
            read_ahead,
            ..Settings::default()
        };
        let evaluation = evaluate(&dataset, &methods, settings, &mut |_| {}).unwrap();
        assert_eq!(counting.0.into_inner().unwrap(), estimated);
        assert_eq!((evaluation.pairs, evaluation.failures.len()), (2, 1));
        let reason = &evaluation.failures[0].reason;
        assert!(reason.contains("the flow of theirs could not be scored"), "{reason}");
    }
}

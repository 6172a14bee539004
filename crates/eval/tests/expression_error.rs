//! The flow of the expression is scored without the motion of the head, on clips whose errors are known.

use std::path::Path;

use srflow_core::{EstimateError, FlowEstimator, FlowField, Image, Size};
use srflow_data::flow::{DatasetSpec, FlowDataset};
use srflow_eval::{EvaluateError, ExpressionError, Method, Settings, evaluate};
use srflow_files::{write_flow, write_image_png};

const SIZE: Size = Size::new(80, 60);

/// Whether the expression moves this pixel.
fn moves(x: usize, y: usize) -> bool {
    (20..50).contains(&x) && (10..40).contains(&y)
}

/// The flow of the head, and of the whole: the expression moves less than half of the face by a pixel.
fn flows() -> [FlowField; 2] {
    let head = |x: usize, y: usize| {
        let (x, y) = (x as f32 / 80.0, y as f32 / 60.0);
        [2.0 + 0.3 * x - 0.2 * y, -1.0 + 0.1 * x + 0.25 * y]
    };
    let whole = |x, y| if moves(x, y) { [head(x, y)[0] + 0.6, head(x, y)[1] - 0.8] } else { head(x, y) };
    [FlowField::from_fn(SIZE.width, SIZE.height, head), FlowField::from_fn(SIZE.width, SIZE.height, whole)]
}

/// A set of two clips in the form of `srflow mer synth`.
fn set(dir: &Path) -> FlowDataset {
    let [_, whole] = flows();
    let expression =
        FlowField::from_fn(SIZE.width, SIZE.height, |x, y| if moves(x, y) { [0.6, -0.8] } else { [0.0; 2] });
    let mut rows = "clip,subject,onset,apex,offset,class\n".to_owned();
    for clip in ["a", "b"] {
        std::fs::create_dir(dir.join(clip)).unwrap();
        let frame = Image::new(SIZE.width, SIZE.height);
        (1..4).for_each(|n| write_image_png(&dir.join(format!("{clip}/{n}.png")), &frame).unwrap());
        write_flow(&dir.join(format!("{clip}_flow.flo")), &whole).unwrap();
        write_flow(&dir.join(format!("{clip}_expression_flow.flo")), &expression).unwrap();
        rows += &format!("{clip},s,1,2,3,positive\n");
    }
    std::fs::write(dir.join("clips.csv"), rows).unwrap();
    open(dir)
}

fn open(dir: &Path) -> FlowDataset {
    FlowDataset::open(&DatasetSpec { kind: "clips".into(), dir: dir.to_owned() }, None).unwrap()
}

/// Gives this flow for every pair.
struct Fixed(FlowField);

impl FlowEstimator for Fixed {
    fn name(&self) -> &str {
        "fixed"
    }

    fn estimate(&self, frame1: &Image, _frame2: &Image) -> Result<FlowField, EstimateError> {
        let size = frame1.size();
        // The window of a crop of the middle.
        let (left, top) = ((SIZE.width - size.width) / 2, (SIZE.height - size.height) / 2);
        Ok(self.0.crop(left, top, size.width, size.height))
    }
}

fn asked() -> Settings<'static> {
    Settings { expression_error: true, ..Settings::default() }
}

fn run(dataset: &FlowDataset, flow: FlowField, settings: Settings) -> Vec<ExpressionError> {
    let method = Fixed(flow);
    let found = evaluate(dataset, &[Method::Estimator(&method)], settings, &mut |_| {}).unwrap();
    found.methods.iter().map(|method| method.expression_error.unwrap()).collect()
}

fn changed(change: impl Fn(usize, usize) -> [f32; 2]) -> FlowField {
    let [_, whole] = flows();
    FlowField::from_fn(SIZE.width, SIZE.height, |x, y| {
        let ([u, v], [du, dv]) = (whole.get(x, y), change(x, y));
        [u + du, v + dv]
    })
}

#[test]
fn an_error_that_the_head_could_have_is_none_of_the_expression() {
    let folder = tempfile::tempdir().unwrap();
    let set = set(folder.path());
    let share = 30.0 * 30.0 / (80.0 * 60.0);

    let [zero, exact] = run(&set, changed(|_, _| [0.0; 2]), asked())[..] else { panic!("two methods") };
    assert_eq!((exact.flow_epe, exact.ratio), (0.0, None));
    assert!(exact.expression_epe < 2e-3 && exact.floor_epe == exact.expression_epe, "{exact:?}");
    assert!((zero.expression_epe - share).abs() < 1e-6, "zero flow misses all of it: {zero:?}");

    let moved = run(&set, changed(|x, _| [0.3, 0.005 * x as f32]), asked())[1];
    assert!(moved.flow_epe > 0.3 && moved.expression_epe < 2e-3, "{moved:?}");

    let wrong = run(&set, changed(|x, y| if moves(x, y) { [-0.6, 0.0] } else { [0.0; 2] }), asked())[1];
    assert!((wrong.flow_epe - 0.6 * share).abs() < 1e-6, "{wrong:?}");
    assert!((wrong.ratio.unwrap() - 1.0).abs() < 0.02, "{wrong:?}");
}

#[test]
fn a_crop_keeps_flow_and_expression_together() {
    let folder = tempfile::tempdir().unwrap();
    let set = set(folder.path());
    let found = run(&set, changed(|_, _| [0.0; 2]), Settings { crop: Some(Size::new(76, 56)), ..asked() });
    assert!(found[1].flow_epe == 0.0 && found[1].expression_epe < 2e-3, "{found:?}");
}

#[test]
fn only_sets_with_the_parts_are_scored_and_only_when_asked() {
    let folder = tempfile::tempdir().unwrap();
    let set = set(folder.path());
    let method = Fixed(changed(|_, _| [0.1, 0.0]));
    let run =
        |set: &FlowDataset, settings| evaluate(set, &[Method::Estimator(&method)], settings, &mut |_| {});
    let with = run(&set, asked()).unwrap();
    let table = with.expression_error().unwrap();
    assert!(table.title.contains("flow of the expression in the face (0.00"), "{}", table.title);
    assert_eq!(table.rows[0].values[2], None, "the baseline has no ratio");
    assert_eq!(table.rows[1].values[2], with.methods[1].expression_error.unwrap().ratio);
    let without = run(&set, Settings::default()).unwrap();
    assert_eq!((without.expression_error(), with.tables().len() - without.tables().len()), (None, 1));
    assert!(without.methods.iter().all(|method| method.expression_error.is_none()));

    std::fs::remove_file(folder.path().join("b_expression_flow.flo")).unwrap();
    let error = run(&open(folder.path()), asked()).unwrap_err();
    assert!(matches!(error, EvaluateError::NoExpressionFlow { lacking: 1, pairs: 2, .. }), "{error}");
    let said = error.to_string();
    assert!(said.contains("1 of 2 pairs") && said.contains("`srflow render --decompose`"), "{said}");

    write_flow(&folder.path().join("b_expression_flow.flo"), &FlowField::new(3, 3)).unwrap();
    let error = run(&open(folder.path()), asked()).unwrap_err().to_string();
    assert!(
        error.contains("b_expression_flow.flo: expected 80x60") && error.contains("found 3x3"),
        "{error}"
    );
}

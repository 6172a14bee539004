use super::tensor::Warp;
use super::*;
use crate::MapShape;
use crate::operation::tests::Case;
use crate::test_values::values;

const SHAPE: MapShape = MapShape { batch: 2, channels: 3, height: 5, width: 7 };

/// Samples inside, across every border and, every ninth, far outside; at last on whole pixels, where slopes to the left and
/// to the right differ.
pub(crate) fn cases() -> Vec<Case> {
    let case = |shape: MapShape, reach: f32| {
        Case::of_kernels(
            &format!("warp, {shape:?}"),
            Warp,
            [&shape.dims(), &shape.with_channels(2).dims()],
            move |x| reference::warp(&x[0], &x[1], &shape),
            move |x, grad| reference::warp_backward(&x[0], &x[1], grad, &shape).into(),
        )
        .change(1, move |i, x| if i % 9 == 3 { 1e9 * x } else { reach * x })
    };
    let larger = MapShape::from([2, 5, 17, 23]);
    let whole = case(SHAPE, 4.0).change(1, |_, x| x.round()).without_slopes();
    vec![case(SHAPE, 4.0), case(larger, 12.0), whole]
}

#[test]
fn no_flow_changes_nothing_and_a_flow_of_nan_harms_nothing_else() {
    let image = values(SHAPE.elements(), 1);
    let mut flow = vec![0.0; SHAPE.with_channels(2).elements()];
    assert_eq!(warp(&image, &flow, &SHAPE), image);
    flow[0] = f32::NAN;
    assert_eq!(warp(&image, &flow, &SHAPE)[1..35], image[1..35]);
}

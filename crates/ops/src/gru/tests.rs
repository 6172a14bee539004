use super::tensor::{Reset, Update};
use super::*;
use crate::operation::tests::Case;

/// Two numbers; odd sizes; images of several pieces of work.
pub(crate) fn cases() -> Vec<Case> {
    let sizes = [[1, 1, 1, 2], [2, 3, 5, 7], [2, 16, 25, 60]];
    sizes.into_iter().map(MapShape::from).flat_map(|shape| [of_reset(shape), of_update(shape)]).collect()
}

fn gates_of(shape: MapShape) -> [usize; 4] {
    shape.with_channels(2 * shape.channels).dims()
}

fn of_reset(shape: MapShape) -> Case {
    Case::of(
        &format!("reset, {shape:?}"),
        Reset,
        [&gates_of(shape), &shape.dims()],
        move |x| reference::reset(&x[0], &x[1], &shape),
        move |x, grad| reference::reset_backward(&x[0], &x[1], grad, &shape).into(),
    )
}

fn of_update(shape: MapShape) -> Case {
    let hidden = shape.dims();
    Case::of(
        &format!("update, {shape:?}"),
        Update,
        [&gates_of(shape), &hidden, &hidden],
        move |x| reference::update(&x[0], &x[1], &x[2], &shape),
        move |x, grad| reference::update_backward(&x[0], &x[1], &x[2], grad, &shape).into(),
    )
}

#[test]
fn no_images_give_nothing() {
    let shape = MapShape::from([0, 3, 2, 2]);
    assert!(reset(&[], &[], &shape).is_empty() && update(&[], &[], &[], &shape).is_empty());
    assert!(reset_backward(&[], &[], &[], &shape).iter().all(Vec::is_empty));
    assert!(update_backward(&[], &[], &[], &[], &shape).iter().all(Vec::is_empty));
}

use super::tensor::{Reset, Update};
use super::*;
use crate::operation::tests::Case;

/// Two numbers; odd sizes; images of several pieces of work.
pub(crate) fn cases() -> Vec<Case> {
    let sizes = [[1, 1, 1, 2], [2, 3, 5, 7], [2, 16, 25, 60]];
    sizes.into_iter().flat_map(|size| [of_reset(size), of_update(size)]).collect()
}

fn of_reset([batch, channels, height, width]: [usize; 4]) -> Case {
    let size = GruSize { batch, channels, pixels: height * width };
    Case::of(
        &format!("reset, {size:?}"),
        Reset,
        [&[batch, 2 * channels, height, width], &[batch, channels, height, width]],
        move |x| reference::reset(&x[0], &x[1], size),
        move |x, grad| reference::reset_backward(&x[0], &x[1], grad, size).into(),
    )
}

fn of_update([batch, channels, height, width]: [usize; 4]) -> Case {
    let size = GruSize { batch, channels, pixels: height * width };
    let hidden = [batch, channels, height, width];
    Case::of(
        &format!("update, {size:?}"),
        Update,
        [&[batch, 2 * channels, height, width], &hidden, &hidden],
        move |x| reference::update(&x[0], &x[1], &x[2], size),
        move |x, grad| reference::update_backward(&x[0], &x[1], &x[2], grad, size).into(),
    )
}

#[test]
fn no_images_give_nothing() {
    let size = GruSize { batch: 0, channels: 3, pixels: 4 };
    assert!(reset(&[], &[], size).is_empty() && update(&[], &[], &[], size).is_empty());
    assert!(reset_backward(&[], &[], &[], size).iter().all(Vec::is_empty));
    assert!(update_backward(&[], &[], &[], &[], size).iter().all(Vec::is_empty));
}

use super::tensor::SpaceToDepth;
use super::*;
use crate::operation::tests::Case;

pub(crate) fn cases() -> Vec<Case> {
    let case = |(dims, side): ([usize; 4], usize)| {
        let shape = MapShape::from(dims);
        Case::of(
            &format!("space to depth {dims:?}, {side}"),
            SpaceToDepth { shape, side },
            [&dims],
            move |x| reference::space_to_depth(&x[0], shape, side),
            move |_, grad| vec![reference::depth_to_space(grad, shape, side)],
        )
    };
    [([2, 3, 4, 10], 2), ([1, 2, 9, 6], 3), ([2, 1, 3, 2], 1)].into_iter().map(case).collect()
}

use super::tensor::Resize;
use super::*;
use crate::operation::tests::Case;
use crate::test_values::{values, wide};

const GRIDS: [Grids; 3] = [Grids::CornersOnCorners, Grids::EdgesOnEdges, Grids::FirstOnFirst];

pub(crate) fn cases() -> Vec<Case> {
    // Larger, smaller, larger in one direction alone, and from a single row.
    let sizes =
        [([2, 3, 4, 5], [8, 15]), ([1, 2, 9, 8], [4, 3]), ([1, 2, 3, 6], [7, 6]), ([2, 1, 1, 4], [5, 2])];
    let case = |(dims, size): ([usize; 4], [usize; 2]), grids| {
        let shape = MapShape::from(dims);
        Case::of(
            &format!("resize {dims:?} to {size:?}, {grids:?}"),
            Resize { shape, size, grids },
            [&dims],
            move |x| reference::resize(&x[0], shape, size, grids),
            move |_, grad| vec![reference::resize_backward(grad, shape, size, grids)],
        )
    };
    sizes.into_iter().flat_map(|sizes| GRIDS.map(|grids| case(sizes, grids))).collect()
}

#[test]
fn nothing_becomes_nothing() {
    for dims in [[0, 2, 3, 4], [1, 0, 3, 4], [1, 2, 0, 4]] {
        let shape = MapShape::from(dims);
        let size = if shape.pixels() == 0 { [0, 4] } else { [5, 5] };
        assert!(resize(&[], shape, size, Grids::EdgesOnEdges).is_empty());
        assert!(resize_backward(&[], shape, size, Grids::EdgesOnEdges).is_empty());
    }
}

#[test]
fn a_size_that_stays_keeps_every_bit() {
    let shape = MapShape::from([1, 2, 3, 5]);
    let input = values(shape.elements(), 1);
    for grids in GRIDS {
        assert_eq!(wide(&resize(&input, shape, [3, 5], grids)), wide(&input), "{grids:?}");
    }
}

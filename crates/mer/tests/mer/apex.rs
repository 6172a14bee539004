//! Spotting the apex: the ratio of differences and the cells that it is measured in.

use srflow_core::Plane;
use srflow_face::{FacePoints, FrameCrop};
use srflow_mer::{Cell, cells, difference_ratio};

#[test]
fn the_ratio_is_greatest_where_the_difference_is_and_motion_is_not() {
    let plane = |value: f32| Plane::filled(8, 8, value);
    let ratio = |onset, before, now, cells: &[Cell]| {
        difference_ratio(&plane(onset), &plane(before), &plane(now), cells)
    };
    assert_eq!(ratio(10.0, 14.0, 14.0, &[]), 5.0);
    assert_eq!(ratio(10.0, 13.0, 14.0, &[]), 2.5);
    assert_eq!(ratio(10.0, 14.0, 14.0, &[[[0, 2], [0, 2]], [[7, 90], [7, 90]], [[50, 60], [0, 2]]]), 5.0);
}

#[test]
fn only_the_cells_count() {
    let onset = Plane::new(8, 8);
    let now = Plane::from_fn(8, 8, |x, _| if x < 2 { 3.0 } else { 0.0 });
    let ratio = |cells: &[Cell]| difference_ratio(&onset, &now, &now, cells);
    assert_eq!(ratio(&[[[0, 2], [0, 8]]]), 4.0);
    assert_eq!(ratio(&[[[4, 8], [0, 8]]]), 1.0);
    assert_eq!(ratio(&[[[0, 2], [0, 1]], [[4, 8], [0, 8]]]), 2.5, "each cell counts the same");
}

#[test]
fn cells_lie_about_the_parts_of_the_face() {
    let mut points = [[0.0; 2]; 68];
    for (index, point) in [
        (48, [80.0, 150.0]),
        (54, [120.0, 150.0]),
        (8, [100.0, 190.0]),
        (31, [90.0, 120.0]),
        (35, [110.0, 120.0]),
    ] {
        points[index] = point;
    }
    points[36] = [70.0, 80.0];
    points[45] = [130.0, 80.0];
    points[19] = [75.0, 60.0];
    points[24] = [125.0, 60.0];
    let face = FacePoints { eyes: [[75.0, 80.0], [125.0, 80.0]], dlib: Some(Box::new(points)) };
    let cells = cells(&face, &FrameCrop::Whole);
    assert_eq!(cells[0], [[70, 90], [140, 160]], "the left corner of the mouth");
    assert_eq!(cells[2], [[90, 110], [170, 190]], "the chin");
    assert_eq!(cells[4], [[110, 130], [120, 140]], "right of the nose");
    assert_eq!(cells[5], [[50, 70], [70, 90]], "outside of the left eye");
    assert_eq!(cells[8], [[70, 90], [50, 70]], "the left brow");
    assert_eq!(cells.len(), 10);
}

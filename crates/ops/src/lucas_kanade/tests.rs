use super::*;
use crate::operation::tests::Case;

const OF: LucasKanade = LucasKanade { radii: [1, 3], noise: 0.05, reach: 2.0 };

pub(crate) fn cases() -> Vec<Case> {
    let case = |dims: [usize; 4]| {
        let shape = MapShape::from(dims);
        Case::of(
            &format!("Lucas-Kanade {dims:?}"),
            OF,
            [&dims, &dims],
            move |x| reference::forward(&OF, &x[0], &x[1], shape),
            |_, _| Vec::new(),
        )
    };
    vec![case([2, 3, 10, 12]), case([1, 1, 4, 18]), case([1, 2, 2, 2])]
}

/// Waves that move by a known part of a pixel.
#[test]
fn a_small_motion_is_found_where_brightness_determines_it() {
    let shape = MapShape::from([1, 1, 32, 32]);
    let frame = |u: f32, v: f32, upright: bool| -> Vec<f32> {
        let brightness = |i: usize| {
            let (x, y) = ((i % 32) as f32 - u, (i / 32) as f32 - v);
            (0.5 * x).sin() + if upright { 0.0 } else { (0.4 * y).cos() }
        };
        (0..32 * 32).map(brightness).collect()
    };
    let of = LucasKanade { noise: 1e-4, ..OF };
    let centre = |found: &[f32], output: usize| found[(output * 16 + 8) * 16 + 8];
    let found = of.forward(&frame(0.0, 0.0, false), &frame(0.12, -0.2, false), shape);
    for window in [0, PER_WINDOW] {
        // The slope of a wave by differences is sin(w) / w of the true one.
        assert!((centre(&found, window) - 0.12).abs() < 0.01, "{}", centre(&found, window));
        assert!((centre(&found, window + 1) + 0.2).abs() < 0.015, "{}", centre(&found, window + 1));
        assert!(centre(&found, window + 2) > 0.99 && centre(&found, window + 3) > 0.99);
    }
    let found = of.forward(&frame(0.0, 0.0, true), &frame(0.12, -0.2, true), shape);
    assert!((centre(&found, 0) - 0.12).abs() < 0.01);
    assert_eq!([centre(&found, 1), centre(&found, 3)], [0.0, 0.0], "nothing shows a vertical motion");
}

use super::tensor::ConvexUpsample;
use super::*;
use crate::operation::tests::Case;
use crate::test_values::values;

pub(crate) fn cases() -> Vec<Case> {
    let case = |batch, [height, width]: [usize; 2], factor: usize, scale: f32| {
        let shape = UpsampleShape { batch, coarse: [height, width], factor };
        let mask = [batch, NEIGHBOURS * factor * factor, height, width];
        let wide_scale = f64::from(scale);
        Case::of(
            &format!("{shape:?}, scale {scale}"),
            ConvexUpsample { scale, factor },
            [&[batch, 2, height, width], &mask],
            move |x| reference::convex_upsample(&x[0], &x[1], wide_scale, &shape),
            move |x, grad| reference::convex_upsample_backward(&x[0], &x[1], wide_scale, grad, &shape).into(),
        )
    };
    vec![case(2, [3, 5], 4, 0.25), case(1, [1, 2], 8, 0.25), case(2, [3, 4], 4, 5.0), case(2, [5, 7], 8, 2.0)]
}

#[test]
fn constant_flow_stays_constant_inside() {
    let shape = UpsampleShape { batch: 1, coarse: [4, 4], factor: 8 };
    let flow = [vec![1.5; 16], vec![-0.25; 16]].concat();
    let out = convex_upsample(&flow, &values(shape.mask_len(), 3), 1.0, &shape);
    for y in 8..24 {
        for x in 8..24 {
            assert!((out[y * 32 + x] - 12.0).abs() < 1e-5);
            assert!((out[1024 + y * 32 + x] + 2.0).abs() < 1e-5);
        }
    }
}

use super::tensor::NegativeLogLikelihood;
use super::*;
use crate::operation::tests::Case;
use crate::test_values::{assert_close, wide};

const RANGE: LogScaleRange = LogScaleRange { low: -0.75, high: 0.75 };

pub(crate) fn cases() -> Vec<Case> {
    let case = |dims: [usize; 4]| {
        let pixels = dims[2] * dims[3];
        Case::of(
            &format!("likelihood {dims:?}"),
            NegativeLogLikelihood(RANGE),
            [&dims; 3],
            move |x| reference::negative_log_likelihood([&x[0], &x[1], &x[2]], pixels, RANGE),
            move |x, grad| {
                reference::negative_log_likelihood_backward([&x[0], &x[1], &x[2]], grad, pixels, RANGE).into()
            },
        )
        .change(0, |_, difference| 2.0 * difference)
    };
    vec![case([2, 2, 5, 7]), case([1, 2, 70, 65])]
}

/// Where `exp` of the numbers themselves would be 0 or infinite.
#[test]
fn large_numbers_do_not_overflow() {
    let (difference, weights, scales) = ([300.0, -1e4], [200.0, -200.0], [9.0, -4.0]);
    let range = LogScaleRange { low: -5.0, high: 10.0 };
    let found = negative_log_likelihood(&difference, &weights, &scales, 1, range);
    // The narrow distribution has no share: ln(2 b) + |d| / b.
    let expected = difference.map(|d: f32| {
        let scale = 9.0_f64.exp();
        (2.0 * scale).ln() + f64::from(d.abs()) / scale
    });
    assert_close("far away", &found, &expected, 1e-6);
    let gradients = negative_log_likelihood_backward(&difference, &weights, &scales, &[1.0, 1.0], 1, range);
    assert!(gradients.iter().flatten().all(|x| x.is_finite()), "{gradients:?}");
}

/// Training starts there.
#[test]
fn a_scale_at_the_end_of_its_range_still_has_a_gradient() {
    let [_, _, of_scales] =
        negative_log_likelihood_backward(&[0.1, 0.2], &[0.0; 2], &[0.0; 2], &[1.0; 2], 1, RANGE);
    let of_definition = reference::negative_log_likelihood_backward(
        [&wide(&[0.1, 0.2]), &[0.0; 2], &[0.0; 2]],
        &[1.0; 2],
        1,
        RANGE,
    );
    assert!(of_scales.iter().all(|x| *x > 0.1), "{of_scales:?}");
    assert_close("at the end", &of_scales, &of_definition[2], 1e-6);
    assert!(negative_log_likelihood(&[], &[], &[], 3, RANGE).is_empty());
}

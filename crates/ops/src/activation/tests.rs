use burn::backend::Flex;

use super::composed::activate_tensor_backward;
use super::tensor::ActivatedSum;
use super::*;
use crate::flex::CpuTensor;
use crate::operation::tests::{ACTIVATIONS, Case};
use crate::test_values::assert_within;

/// Their definition is [`Activation::reference`].
pub(crate) fn cases() -> Vec<Case> {
    let case = |activation: Activation| {
        let sums = |x: &[Vec<f64>]| -> Vec<f64> { x[0].iter().zip(&x[1]).map(|(a, b)| a + b).collect() };
        let shape: &[usize] = &[2, 5, 40, 101];
        Case::of(
            &format!("{activation:?}"),
            ActivatedSum(activation),
            [shape, shape],
            move |x| sums(x).into_iter().map(|sum| activation.reference(sum)).collect(),
            move |x, grad| {
                let slopes = sums(x).into_iter().map(|sum| activation.reference_derivative(sum));
                let gradient: Vec<f64> = grad.iter().zip(slopes).map(|(grad, slope)| grad * slope).collect();
                vec![gradient.clone(), gradient]
            },
        )
        .change(0, |_, x| 4.0 * x)
    };
    ACTIVATIONS.map(case).into()
}

#[test]
fn the_derivative_by_other_operations_is_that_of_the_definition() {
    let x: Vec<f32> = (-400..=400).map(|i| i as f32 * 0.01 + 0.001).collect();
    for activation in ACTIVATIONS {
        let kept = match activation.keeps() {
            Keeps::Output => x.iter().map(|&x| activation.reference(f64::from(x)) as f32).collect(),
            Keeps::Sum | Keeps::Nothing => x.clone(),
        };
        let [kept, grad] = [kept, vec![2.0; x.len()]].map(|values| CpuTensor::new(values, [x.len()]));
        let found = activate_tensor_backward::<Flex>(grad.into(), kept.into(), activation);
        let expected: Vec<f64> =
            x.iter().map(|&x| 2.0 * activation.reference_derivative(f64::from(x))).collect();
        assert_within(&format!("{activation:?}"), CpuTensor::from(found).slice(), &expected, 5e-6);
    }
}

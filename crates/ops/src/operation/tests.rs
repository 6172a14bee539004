//! Every operation, by one test body: its definition's gradients against the slopes of that definition; then outputs and
//! gradients against the definition, in f64, whether they are computed by the kernel on any number of threads, by the
//! composition of Burn's operations or by another device, which `SRFLOW_TEST_DEVICE` names; see docs/guides/gpu.md.

use std::sync::LazyLock;

use burn::tensor::{Device, TensorData};

use super::*;
use crate::precision::{Precision, precisions, with_precision};
use crate::test_values::{assert_close, values, wide, with_threads};

/// A test for each operation: the cases beside its definition.
macro_rules! operations {
    ($($name:ident: $cases:path,)*) => {
        $(#[test]
        fn $name() {
            $cases().iter().for_each(Case::check);
        })*
    };
}

operations! {
    activated_sum: crate::activation::tests::cases,
    attention: crate::attention::tests::cases,
    windowed_attention: crate::attention::tests::windowed_cases,
    batch_norm: crate::batch_norm::tests::cases,
    conv2d: crate::conv2d::tests::cases,
    conv_transpose2d: crate::conv_transpose2d::tests::cases,
    correlation_lookup: crate::correlation::tests::cases,
    depthwise: crate::depthwise::tests::cases,
    gru: crate::gru::tests::cases,
    instance_norm: crate::instance_norm::tests::cases,
    laplace_mixture: crate::laplace_mixture::tests::cases,
    layer_norm: crate::layer_norm::tests::cases,
    lucas_kanade: crate::lucas_kanade::tests::cases,
    max_pool: crate::max_pool::tests::cases,
    pointwise_chain: crate::pointwise::tests::cases,
    resize: crate::resize::tests::cases,
    space_to_depth: crate::space_to_depth::tests::cases,
    convex_upsample: crate::upsample::tests::cases,
    warp: crate::warp::tests::cases,
}

/// Which loses digits to the products' factors alone: exact sums of products of convolutions show that these are added in `f32`. The
/// weights of attention are rounded, to 11 bits or 8.
#[test]
fn devices_multiply_16_bits_and_add_up_in_f32() {
    let Some(device) = DEVICE.as_ref() else {
        eprintln!("skipped: gpu: SRFLOW_TEST_DEVICE names no device");
        return;
    };
    for precision in precisions(device).into_iter().filter(|precision| *precision != Precision::F32) {
        for case in crate::conv2d::tests::cases_of_16_bits() {
            case.check_at(device, precision, TOLERANCE);
        }
        let tolerance = if precision == Precision::F16 { 2e-3 } else { 2e-2 };
        for case in
            crate::attention::tests::cases().into_iter().chain(crate::attention::tests::windowed_cases())
        {
            case.check_at(device, precision, tolerance);
        }
    }
}

pub(crate) const ACTIVATIONS: [Activation; 6] = [
    Activation::Identity,
    Activation::Relu,
    Activation::LeakyRelu,
    Activation::Gelu,
    Activation::Tanh,
    Activation::Sigmoid,
];

/// Of the largest number of a tensor. A rounding in f32 is 6e-8 of a number. Sums of some hundred products, and differences
/// of numbers that nearly agree, cost one or two digits; so do positions some tens of pixels from the origin.
const TOLERANCE: f64 = 1e-5;

type Function = Box<dyn Fn(Vec<DispatchTensor>) -> Tensor<4> + Sync>;
type Forward = Box<dyn Fn(&[Vec<f64>]) -> Vec<f64> + Sync>;
type Backward = Box<dyn Fn(&[Vec<f64>], &[f64]) -> Vec<Vec<f64>> + Sync>;

/// Sample inputs of an operation, and what it makes of them.
pub(crate) struct Case {
    name: String,
    shapes: Vec<Vec<usize>>,
    inputs: Vec<Vec<f32>>,
    kernel: Function,
    composed: Option<Function>,
    /// The definition.
    forward: Forward,
    /// The definition of the gradients, from that of the output; inputs at the end that it leaves out have none.
    backward: Backward,
    has_slopes: bool,
}

impl Case {
    /// Inputs in -1..1.
    pub(crate) fn new(
        name: &str,
        shapes: &[&[usize]],
        function: impl Fn(Vec<DispatchTensor>) -> Tensor<4> + Sync + 'static,
        forward: impl Fn(&[Vec<f64>]) -> Vec<f64> + Sync + 'static,
        backward: impl Fn(&[Vec<f64>], &[f64]) -> Vec<Vec<f64>> + Sync + 'static,
    ) -> Self {
        let inputs = shapes.iter().zip(1..).map(|(shape, seed)| values(shape.iter().product(), seed));
        Self {
            name: name.to_owned(),
            inputs: inputs.collect(),
            shapes: shapes.iter().map(|shape| shape.to_vec()).collect(),
            kernel: Box::new(function),
            composed: None,
            forward: Box::new(forward),
            backward: Box::new(backward),
            has_slopes: true,
        }
    }

    /// Of an operation that has kernels for every device.
    pub(crate) fn of_kernels<O: Operation<N> + Sync, const N: usize>(
        name: &str,
        operation: O,
        shapes: [&[usize]; N],
        forward: impl Fn(&[Vec<f64>]) -> Vec<f64> + Sync + 'static,
        backward: impl Fn(&[Vec<f64>], &[f64]) -> Vec<Vec<f64>> + Sync + 'static,
    ) -> Self {
        let kernel = move |inputs| apply(operation.clone(), array(inputs));
        Self::new(name, &shapes, kernel, forward, backward)
    }

    /// Of an operation that is composed of others on devices without a kernel.
    pub(crate) fn of<O: Operation<N> + Sync, const N: usize>(
        name: &str,
        operation: O,
        shapes: [&[usize]; N],
        forward: impl Fn(&[Vec<f64>]) -> Vec<f64> + Sync + 'static,
        backward: impl Fn(&[Vec<f64>], &[f64]) -> Vec<Vec<f64>> + Sync + 'static,
    ) -> Self {
        let composed = Composed(operation.clone());
        Self::of_kernels(name, operation, shapes, forward, backward)
            .or(move |inputs| apply(composed.clone(), array(inputs)))
    }

    /// What computes the same by other operations.
    pub(crate) fn or(self, composed: impl Fn(Vec<DispatchTensor>) -> Tensor<4> + Sync + 'static) -> Self {
        Self { composed: Some(Box::new(composed)), ..self }
    }

    pub(crate) fn change(mut self, input: usize, change: impl Fn(usize, f32) -> f32) -> Self {
        self.inputs[input].iter_mut().enumerate().for_each(|(i, x)| *x = change(i, *x));
        self
    }

    /// For inputs where the slopes to both sides differ.
    pub(crate) fn without_slopes(self) -> Self {
        Self { has_slopes: false, ..self }
    }

    fn check(&self) {
        let inputs: Vec<Vec<f64>> = self.inputs.iter().map(|values| wide(values)).collect();
        let expected = (self.forward)(&inputs);
        assert!(expected.iter().any(|x| x.abs() > 0.1), "{}: outputs that show a difference", self.name);
        let grad = values(expected.len(), 77);
        let gradients = (self.backward)(&inputs, &wide(&grad));
        if self.has_slopes {
            self.check_slopes(&inputs, &gradients, &wide(&grad));
        }
        let cpu = Device::flex();
        let mut ways = vec![("kernel", &self.kernel, &cpu)];
        ways.extend(self.composed.as_ref().map(|composed| ("composed", composed, &cpu)));
        ways.extend(DEVICE.as_ref().map(|device| ("device", &self.kernel, device)));
        let all: Vec<usize> = (0..gradients.len()).collect();
        for (way, function, device) in ways {
            let what = format!("{}, {way}", self.name);
            let plain = function(self.tensors(device, &[]).1);
            assert_close(&format!("{what}: output"), &numbers(plain), &expected, TOLERANCE);
            // Of all inputs together, and of each alone.
            for wanted in std::iter::once(&all[..]).chain(all.chunks(1)) {
                let (tracked, found) = self.gradients(function, device, wanted, &grad);
                assert_close(&format!("{what}: output with gradients"), &tracked, &expected, TOLERANCE);
                for (input, found) in found.into_iter().enumerate() {
                    assert_eq!(found.is_some(), wanted.contains(&input), "{what}: gradient of input {input}");
                    let what = format!("{what}: gradient of input {input} of {wanted:?}");
                    found.iter().for_each(|found| assert_close(&what, found, &gradients[input], TOLERANCE));
                }
            }
        }
        let [one, three] = [1, 3].map(|threads| {
            with_threads(threads, || self.gradients(&self.kernel, &Device::flex(), &all, &grad))
        });
        assert!(one == three, "{}: the same on any number of threads", self.name);
    }

    /// Holds what `device` computes at a precision of 16 bits to the definition, within a share of the largest number for the output
    /// and for gradients. Inputs and the gradient of the output are made numbers of 16 bits, so that nothing is lost where only they are
    /// multiplied and sums are `f32`.
    fn check_at(mut self, device: &Device, precision: Precision, tolerance: f64) {
        // Numbers that each type of 16 bits has.
        let short = |x: f32| (x * 64.0).round() / 64.0;
        self.inputs.iter_mut().flatten().for_each(|x| *x = short(*x));
        let inputs: Vec<Vec<f64>> = self.inputs.iter().map(|values| wide(values)).collect();
        let expected = (self.forward)(&inputs);
        let mut grad: Vec<f32> = values(expected.len(), 77).into_iter().map(short).collect();
        grad[0] = 1.0;
        let gradients = (self.backward)(&inputs, &wide(&grad));
        let what = format!("{}, {}", self.name, precision.name());
        with_precision(precision, || {
            let plain = (self.kernel)(self.tensors(device, &[]).1);
            assert_close(&format!("{what}: output"), &numbers(plain), &expected, tolerance);
            // The gradient's scale must not matter, as small as it may be.
            for scale in [1.0, 2.0_f32.powi(-30)] {
                let all: Vec<usize> = (0..gradients.len()).collect();
                let grad: Vec<f32> = grad.iter().map(|x| x * scale).collect();
                let (_, found) = self.gradients(&self.kernel, device, &all, &grad);
                for (input, (found, expected)) in found.into_iter().zip(&gradients).enumerate() {
                    let found: Vec<f32> = found.expect("wanted").iter().map(|x| x / scale).collect();
                    assert_close(&format!("{what}: gradient of input {input}"), &found, expected, tolerance);
                }
            }
        });
    }

    /// Leaves of a graph, flat, and the inputs made of them.
    fn tensors(&self, device: &Device, wanted: &[usize]) -> (Vec<Tensor<1>>, Vec<DispatchTensor>) {
        let inputs = self.inputs.iter().zip(&self.shapes).enumerate();
        let tensors = inputs.map(|(number, (values, shape))| {
            let flat = Tensor::<1>::from_data(TensorData::new(values.clone(), [values.len()]), device);
            let flat = if wanted.contains(&number) { flat.require_grad() } else { flat };
            let input = match shape[..] {
                [len] => flat.clone().reshape([len]).into_dispatch(),
                [batch, channels, height, width] => {
                    flat.clone().reshape([batch, channels, height, width]).into_dispatch()
                }
                _ => unreachable!("operations take vectors and maps"),
            };
            (flat, input)
        });
        tensors.unzip()
    }

    /// The output, and gradients of the wanted inputs from `grad`, that of the output.
    fn gradients(
        &self,
        function: &Function,
        device: &Device,
        wanted: &[usize],
        grad: &[f32],
    ) -> (Vec<f32>, Vec<Option<Vec<f32>>>) {
        let device = device.clone().autodiff();
        let (leaves, inputs) = self.tensors(&device, wanted);
        let out = function(inputs);
        if wanted.is_empty() {
            return (numbers(out), vec![None; leaves.len()]);
        }
        let grad = Tensor::from_data(TensorData::new(grad.to_vec(), out.dims()), &device);
        let grads = (out.clone() * grad).sum().backward();
        let gradients = leaves.iter().map(|leaf| leaf.grad(&grads).map(numbers));
        (numbers(out), gradients.collect())
    }

    /// Holds the definition's gradients to central differences of the definition, each input moved along directions that
    /// change all its elements.
    fn check_slopes(&self, inputs: &[Vec<f64>], gradients: &[Vec<f64>], grad: &[f64]) {
        // About the cube root of f64's precision, where rounding and curvature together do the least harm.
        const STEP: f64 = 1e-5;
        let product = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        for (number, seed) in (0..gradients.len()).flat_map(|number| (100..103).map(move |s| (number, s))) {
            let gradient = &gradients[number];
            let direction = wide(&values(gradient.len(), seed));
            let moved = |by: f64| {
                let mut inputs = inputs.to_vec();
                inputs[number].iter_mut().zip(&direction).for_each(|(x, along)| *x += by * along);
                (self.forward)(&inputs)
            };
            let differences: Vec<f64> =
                moved(STEP).iter().zip(moved(-STEP)).map(|(after, before)| after - before).collect();
            let slope = product(grad, &differences) / (2.0 * STEP);
            let (along, size) = (product(gradient, &direction), product(gradient, gradient).sqrt());
            let what = format!("{}: slope along input {number}", self.name);
            assert!(size > 1e-3, "{what}: it matters");
            assert!((along - slope).abs() < 1e-6 * size, "{what}: {along} for {slope}, of {size}");
        }
    }
}

/// Found once: to ask drivers for their devices takes time.
static DEVICE: LazyLock<Option<Device>> = LazyLock::new(|| {
    let name = std::env::var("SRFLOW_TEST_DEVICE").ok()?;
    Some(crate::device(&name).expect("the device of SRFLOW_TEST_DEVICE"))
});

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().expect("f32")
}

/// The composition as if it were the kernel of the CPU.
#[derive(Debug, Clone)]
pub(crate) struct Composed<O>(pub(crate) O);

impl<O: Operation<N>, const N: usize> Composition<N> for Composed<O> {}

impl<O: Operation<N>, const N: usize> Operation<N> for Composed<O> {
    fn activation(&mut self) -> Option<&mut Activation> {
        self.0.activation()
    }

    fn saved_inputs<T>(inputs: &[T; N]) -> &[T] {
        O::saved_inputs(inputs)
    }

    fn saved_outputs<T>(outputs: &[T]) -> &[T] {
        O::saved_outputs(outputs)
    }

    fn cpu(&self, inputs: [CpuTensor; N]) -> Vec<CpuTensor> {
        let outputs = self.0.composed::<Flex>(inputs.map(CpuTensor::into));
        outputs.into_iter().map(CpuTensor::from).collect()
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; N] {
        let gradients = self.0.composed_backward::<Flex>(back.map(CpuTensor::into));
        gradients.map(|gradient| gradient.map(CpuTensor::from))
    }
}

//! Every operation, by one test body: its outputs against its definition in f64, its gradients against the slopes of that
//! definition, and both the same whether they are computed by the kernel, by the composition of Burn's operations or by
//! another device, which `SRFLOW_TEST_DEVICE` names; see docs/devices.md.

use std::sync::LazyLock;

use burn::tensor::{Device, TensorData};

use super::*;
use crate::test_values::{assert_close, values};

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
    activated_sum: crate::activation::tensor::tests::cases,
    attention: crate::attention::tests::cases,
    batch_norm: crate::batch_norm::tests::cases,
    conv2d: crate::conv2d::tests::cases,
    correlation_lookup: crate::correlation::tests::cases,
    depthwise: crate::depthwise::tests::cases,
    gru: crate::gru::tests::cases,
    instance_norm: crate::instance_norm::tests::cases,
    max_pool: crate::max_pool::tests::cases,
    pointwise_chain: crate::pointwise::tests::cases,
    convex_upsample: crate::upsample::tests::cases,
    warp: crate::warp::tests::cases,
}

pub(crate) const ACTIVATIONS: [Activation; 5] =
    [Activation::Identity, Activation::Relu, Activation::Gelu, Activation::Tanh, Activation::Sigmoid];

type Definition = Box<dyn Fn(&[Vec<f32>]) -> Vec<f32>>;
type Function = Box<dyn Fn(Vec<DispatchTensor>) -> Tensor<4>>;

/// Sample inputs of an operation, and what it makes of them.
pub(crate) struct Case {
    name: String,
    shapes: Vec<Vec<usize>>,
    inputs: Vec<Vec<f32>>,
    /// Inputs that have no gradient.
    constants: Vec<usize>,
    kernel: Function,
    composed: Option<Function>,
    definition: Definition,
    slopes: usize,
}

impl Case {
    /// Inputs in -1..1.
    pub(crate) fn new(
        name: &str,
        shapes: &[&[usize]],
        function: impl Fn(Vec<DispatchTensor>) -> Tensor<4> + 'static,
        definition: impl Fn(&[Vec<f32>]) -> Vec<f32> + 'static,
    ) -> Self {
        let inputs = shapes.iter().zip(1..).map(|(shape, seed)| values(shape.iter().product(), seed));
        Self {
            name: name.to_owned(),
            inputs: inputs.collect(),
            shapes: shapes.iter().map(|shape| shape.to_vec()).collect(),
            constants: Vec::new(),
            kernel: Box::new(function),
            composed: None,
            definition: Box::new(definition),
            slopes: 40,
        }
    }

    /// Of an operation that has kernels for every device.
    pub(crate) fn of_kernels<O: Operation<N>, const N: usize>(
        name: &str,
        operation: O,
        shapes: [&[usize]; N],
        definition: impl Fn(&[Vec<f32>]) -> Vec<f32> + 'static,
    ) -> Self {
        Self::new(name, &shapes, move |inputs| apply(operation.clone(), array(inputs)), definition)
    }

    /// Of an operation that is composed of others on devices without a kernel.
    pub(crate) fn of<O: Operation<N>, const N: usize>(
        name: &str,
        operation: O,
        shapes: [&[usize]; N],
        definition: impl Fn(&[Vec<f32>]) -> Vec<f32> + 'static,
    ) -> Self {
        let composed = Composed(operation.clone());
        Self::of_kernels(name, operation, shapes, definition)
            .or(move |inputs| apply(composed.clone(), array(inputs)))
    }

    /// What computes the same by other operations.
    pub(crate) fn or(self, composed: impl Fn(Vec<DispatchTensor>) -> Tensor<4> + 'static) -> Self {
        Self { composed: Some(Box::new(composed)), ..self }
    }

    pub(crate) fn change(mut self, input: usize, change: impl Fn(usize, f32) -> f32) -> Self {
        self.inputs[input].iter_mut().enumerate().for_each(|(i, x)| *x = change(i, *x));
        self
    }

    pub(crate) fn constant(mut self, input: usize) -> Self {
        self.constants.push(input);
        self
    }

    /// For sizes where the definition takes too long to be computed for every slope.
    pub(crate) fn slopes(self, slopes: usize) -> Self {
        Self { slopes, ..self }
    }

    fn check(&self) {
        let expected = (self.definition)(&self.inputs);
        assert!(expected.iter().any(|x| x.abs() > 0.1), "{}: outputs that show a difference", self.name);
        let weights = values(expected.len(), 77);
        let (cpu, all) = (Device::flex(), vec![true; self.inputs.len()]);
        let mut ways = vec![("kernel", &self.kernel, &cpu)];
        ways.extend(self.composed.as_ref().map(|composed| ("composed", composed, &cpu)));
        ways.extend(DEVICE.as_ref().map(|device| ("device", &self.kernel, device)));
        let mut kernels: Option<Vec<Option<Vec<f32>>>> = None;
        for (way, function, device) in ways {
            let what = format!("{}, {way}", self.name);
            let plain = function(self.tensors(device, &[]).1);
            assert_close(&format!("{what}: output"), &numbers(plain), &expected, 2e-5);
            let (tracked, gradients) = self.gradients(function, device, &all, &weights);
            assert_close(&format!("{what}: output with gradients"), &tracked, &expected, 2e-5);
            match &kernels {
                None => self.check_slopes(&what, &gradients, &weights),
                Some(kernels) => {
                    for (i, (found, expected)) in gradients.iter().zip(kernels).enumerate() {
                        let [found, expected] = [found, expected].map(|x| x.as_deref().unwrap_or_default());
                        assert_close(&format!("{what}: gradient of input {i}"), found, expected, 2e-5);
                    }
                }
            }
            for only in (0..self.inputs.len()).filter(|input| !self.constants.contains(input)) {
                let wanted: Vec<bool> = (0..self.inputs.len()).map(|input| input == only).collect();
                let (_, alone) = self.gradients(function, device, &wanted, &weights);
                let [alone, beside] =
                    [&alone, &gradients].map(|all| all[only].as_deref().unwrap_or_default());
                assert_close(&format!("{what}: gradient of input {only} alone"), alone, beside, 2e-5);
            }
            kernels.get_or_insert(gradients);
        }
    }

    /// Leaves of a graph, flat, and the inputs made of them.
    fn tensors(&self, device: &Device, wanted: &[bool]) -> (Vec<Tensor<1>>, Vec<DispatchTensor>) {
        let inputs = self.inputs.iter().zip(&self.shapes).enumerate();
        let tensors = inputs.map(|(number, (values, shape))| {
            let flat = Tensor::<1>::from_data(TensorData::new(values.clone(), [values.len()]), device);
            let wanted = wanted.get(number) == Some(&true) && !self.constants.contains(&number);
            let flat = if wanted { flat.require_grad() } else { flat };
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

    /// The output, and of the inputs that are wanted the gradient of its sum with these weights.
    fn gradients(
        &self,
        function: &Function,
        device: &Device,
        wanted: &[bool],
        weights: &[f32],
    ) -> (Vec<f32>, Vec<Option<Vec<f32>>>) {
        let device = device.clone().autodiff();
        let (leaves, inputs) = self.tensors(&device, wanted);
        let out = function(inputs);
        let weights = Tensor::from_data(TensorData::new(weights.to_vec(), out.dims()), &device);
        let grads = (out.clone() * weights).sum().backward();
        let gradients = leaves.iter().map(|leaf| leaf.grad(&grads).map(numbers));
        (numbers(out), gradients.collect())
    }

    /// Holds gradients to central differences of the definition, by elements all over each input.
    fn check_slopes(&self, what: &str, gradients: &[Option<Vec<f32>>], weights: &[f32]) {
        let moved = |number: usize, element: usize, by: f32| -> (f64, f64) {
            let mut inputs = self.inputs.clone();
            inputs[number][element] += by;
            let out = (self.definition)(&inputs);
            let sum = out.iter().zip(weights).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
            (f64::from(inputs[number][element]), sum)
        };
        let slope = |number: usize, element: usize, step: f32| {
            let ((x1, y1), (x0, y0)) = (moved(number, element, step), moved(number, element, -step));
            (y1 - y0) / (x1 - x0)
        };
        for (number, gradient) in gradients.iter().enumerate() {
            if self.constants.contains(&number) {
                assert!(gradient.is_none(), "{what}: input {number} has no gradient");
                continue;
            }
            let gradient = gradient.as_ref().expect("a gradient of every other input");
            assert!(gradient.iter().any(|x| x.abs() > 1e-3), "{what}: input {number} matters");
            let scale = gradient.iter().fold(1.0, |scale: f64, x| scale.max(f64::from(x.abs())));
            let (probes, tolerance) = (gradient.len().min(self.slopes), 2e-3 * scale);
            let mut smooth = 0;
            for element in (0..probes).map(|probe| probe * gradient.len() / probes) {
                let (wide, narrow) =
                    (slope(number, element, 1.0 / 256.0), slope(number, element, 1.0 / 1024.0));
                // Otherwise the derivative jumps nearby.
                if (wide - narrow).abs() < tolerance {
                    smooth += 1;
                    let found = f64::from(gradient[element]);
                    let error = (found - narrow).abs();
                    assert!(error < tolerance, "{what}: input {number} [{element}]: {found} for {narrow}");
                }
            }
            assert!(2 * smooth >= probes, "{what}: input {number} has slopes to compare with");
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
struct Composed<O>(O);

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

    fn cpu_backward(&self, back: Backprop<CpuTensor, N>) -> [Option<CpuTensor>; N] {
        let gradients = self.0.composed_backward::<Flex>(back.map(CpuTensor::into));
        gradients.map(|gradient| gradient.map(CpuTensor::from))
    }
}

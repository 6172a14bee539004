//! Convolutional GRUs of RAFT (`update.py`), and of the encoders of RPKNet and DPFlow.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig};
use srflow_ops::concatenate;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::gru::tensor::{reset, update};
use srflow_ops::{Activation, WeightCache};

/// A GRU with 3x3 convolutions.
#[derive(Module, Debug)]
pub(crate) struct ConvGru {
    convz: Conv2d,
    convr: Conv2d,
    convq: Conv2d,
}

/// A GRU with stages of several layers instead of convolutions (`PKConvSLKGRU` of RPKNet, `CGUGRU` of DPFlow).
#[derive(Module, Debug)]
pub(crate) struct StageGru<S: Module> {
    convz: S,
    convr: S,
    convq: S,
}

/// A separable GRU: a step along rows (1x5), then one along columns (5x1).
#[derive(Module, Debug)]
pub(crate) struct SepConvGru {
    convz1: Conv2d,
    convr1: Conv2d,
    convq1: Conv2d,
    convz2: Conv2d,
    convr2: Conv2d,
    convq2: Conv2d,
}

/// The GRU of RAFT or of its small variant. The variant does not appear in the names of parameters.
#[derive(Module, Debug)]
#[expect(clippy::large_enum_variant, reason = "a network has one")]
pub(crate) enum Gru {
    Separable(SepConvGru),
    Square(ConvGru),
}

/// A GRU for one context. The context is constant over the iterations, so its part of the convolutions is computed once.
pub(crate) struct PreparedGru<'a> {
    steps: Vec<PreparedStep<'a>>,
}

struct PreparedStep<'a> {
    /// Any of the three convolutions: they differ only in weight and bias, which are passed separately.
    conv: &'a Conv2d,
    /// Stacked weights of update and reset gate for the hidden state and the input.
    gates_weight: Tensor<4>,
    gates_cache: WeightCache,
    gates_context: Tensor<4>,
    candidate_weight: Tensor<4>,
    candidate_cache: WeightCache,
    candidate_context: Tensor<4>,
}

fn conv(hidden: usize, inputs: usize, kernel: [usize; 2], device: &Device) -> Conv2d {
    Conv2dConfig::new([hidden + inputs, hidden], kernel).init(device)
}

impl ConvGru {
    pub(crate) fn new(hidden: usize, inputs: usize, device: &Device) -> Self {
        let conv = || conv(hidden, inputs, [3, 3], device);
        Self { convz: conv(), convr: conv(), convq: conv() }
    }

    pub(crate) fn prepared(&self, context: &Tensor<4>) -> PreparedGru<'_> {
        PreparedGru { steps: vec![PreparedStep::new([&self.convz, &self.convr, &self.convq], context)] }
    }

    /// The next hidden state from `hidden`, zero by default, and an input with as many channels. If the GRU has more channels,
    /// it uses the first part of its kernels.
    pub(crate) fn step(&self, hidden: Option<Tensor<4>>, input: Tensor<4>) -> Tensor<4> {
        let channels = input.dims()[1];
        let sum = |x: Tensor<4>, convs: &[&Conv2d], activation| {
            let own = x.dims()[1];
            // A kernel's input channels are the hidden state, then the input; a hidden state of zero is skipped.
            let weight =
                |conv: &&Conv2d| conv.weight().narrow(0, 0, channels).narrow(1, 2 * channels - own, own);
            let weights = convs.iter().map(weight).collect();
            let biases: Vec<_> = convs.iter().filter_map(|conv| conv.bias()).collect();
            let biases = biases.into_iter().map(|bias| bias.narrow(0, 0, channels)).collect();
            let epilogue = Epilogue::with(activation).bias(Some(Tensor::cat(biases, 0)));
            self.convz.apply(x, Tensor::cat(weights, 0), &WeightCache::default(), epilogue)
        };
        let Some(hidden) = hidden else {
            let update = sum(input.clone(), &[&self.convz], Activation::Sigmoid);
            return update * sum(input, &[&self.convq], Activation::Tanh);
        };
        let both = concatenate(vec![hidden.clone(), input.clone()]);
        let gates = sum(both, &[&self.convz, &self.convr], Activation::Sigmoid);
        let both = concatenate(vec![reset(gates.clone(), hidden.clone()), input]);
        update(gates, hidden, sum(both, &[&self.convq], Activation::Tanh))
    }
}

impl<S: Module> StageGru<S> {
    pub(crate) fn new(stage: impl Fn() -> S) -> Self {
        Self { convz: stage(), convr: stage(), convq: stage() }
    }

    /// The next hidden state; `sum` gives what a stage makes of hidden state and input, activated.
    pub(crate) fn step(
        &self,
        hidden: Tensor<4>,
        input: &Tensor<4>,
        sum: impl Fn(&S, Tensor<4>, Activation) -> Tensor<4>,
    ) -> Tensor<4> {
        let with = |hidden: &Tensor<4>| concatenate(vec![hidden.clone(), input.clone()]);
        let both = with(&hidden);
        let gates = [&self.convz, &self.convr].map(|stage| sum(stage, both.clone(), Activation::Sigmoid));
        let gates = concatenate(gates.into());
        let candidate = with(&reset(gates.clone(), hidden.clone()));
        update(gates, hidden, sum(&self.convq, candidate, Activation::Tanh))
    }
}

impl SepConvGru {
    pub(crate) fn new(hidden: usize, inputs: usize, device: &Device) -> Self {
        let along_row = || conv(hidden, inputs, [1, 5], device);
        let along_column = || conv(hidden, inputs, [5, 1], device);
        Self {
            convz1: along_row(),
            convr1: along_row(),
            convq1: along_row(),
            convz2: along_column(),
            convr2: along_column(),
            convq2: along_column(),
        }
    }

    /// A GRU whose input is `context` followed by the input of [`PreparedGru::step`].
    pub(crate) fn prepared(&self, context: &Tensor<4>) -> PreparedGru<'_> {
        PreparedGru { steps: self.steps().map(|convs| PreparedStep::new(convs, context)).into() }
    }

    /// [`PreparedGru::step`] for a context that is used once: takes less memory than the prepared GRU.
    pub(crate) fn step(&self, context: &Tensor<4>, hidden: Tensor<4>, input: Tensor<4>) -> Tensor<4> {
        let step = |hidden, convs| PreparedStep::new(convs, context).forward(hidden, input.clone());
        self.steps().into_iter().fold(hidden, step)
    }

    /// The convolutions of update gate, reset gate and candidate, of each step.
    fn steps(&self) -> [[&Conv2d; 3]; 2] {
        [[&self.convz1, &self.convr1, &self.convq1], [&self.convz2, &self.convr2, &self.convq2]]
    }
}

impl Gru {
    /// A GRU whose input is `context` followed by the input of [`PreparedGru::step`].
    pub(crate) fn prepared(&self, context: &Tensor<4>) -> PreparedGru<'_> {
        match self {
            Self::Separable(gru) => gru.prepared(context),
            Self::Square(gru) => gru.prepared(context),
        }
    }
}

impl PreparedGru<'_> {
    /// The next hidden state.
    pub(crate) fn step(&self, mut hidden: Tensor<4>, input: Tensor<4>) -> Tensor<4> {
        for step in &self.steps {
            hidden = step.forward(hidden, input.clone());
        }
        hidden
    }
}

impl<'a> PreparedStep<'a> {
    fn new([update, reset, candidate]: [&'a Conv2d; 3], context: &Tensor<4>) -> Self {
        let [hidden, inputs, _, _] = update.weight().dims();
        let fixed = context.dims()[1];
        // Input channels: the hidden state, the context, the rest.
        let changing = |weight: Tensor<4>| {
            let rest = weight.clone().narrow(1, hidden + fixed, inputs - hidden - fixed);
            Tensor::cat(vec![weight.narrow(1, 0, hidden), rest], 1)
        };
        let of_context = |conv: &Conv2d| {
            let weight = conv.weight().narrow(1, hidden, fixed);
            conv.apply(
                context.clone(),
                weight,
                &WeightCache::default(),
                Epilogue::default().bias(conv.bias()),
            )
        };
        Self {
            conv: update,
            gates_weight: Tensor::cat(vec![changing(update.weight()), changing(reset.weight())], 0),
            gates_cache: WeightCache::default(),
            gates_context: concatenate(vec![of_context(update), of_context(reset)]),
            candidate_weight: changing(candidate.weight()),
            candidate_cache: WeightCache::default(),
            candidate_context: of_context(candidate),
        }
    }

    fn forward(&self, hidden: Tensor<4>, input: Tensor<4>) -> Tensor<4> {
        let sum = |state: Tensor<4>, weight: &Tensor<4>, cache, context: &Tensor<4>, activation| {
            let x = concatenate(vec![state, input.clone()]);
            self.conv.apply(x, weight.clone(), cache, Epilogue::with(activation).residual(context.clone()))
        };
        let gates = sum(
            hidden.clone(),
            &self.gates_weight,
            &self.gates_cache,
            &self.gates_context,
            Activation::Sigmoid,
        );
        let candidate = sum(
            reset(gates.clone(), hidden.clone()),
            &self.candidate_weight,
            &self.candidate_cache,
            &self.candidate_context,
            Activation::Tanh,
        );
        update(gates, hidden, candidate)
    }
}

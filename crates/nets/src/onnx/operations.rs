//! Operations that several networks share, as `srflow_nn` and `srflow_ops` define them.

use std::f32::consts::SQRT_2;

use srflow_ops::Activation;
use srflow_ops::resize::Grids;

use super::graph::{Attribute, Graph, Length, Sides, Value};
use super::proto::DataType;

/// Added to the variance by norms.
const EPSILON: f32 = 1e-5;
/// Pixels that a convex combination is of.
const NEIGHBOURS: i64 = 9;

/// Beyond a map that is sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Beyond {
    Zeros,
    /// The nearest pixel of the map.
    Border,
}

impl Graph {
    /// `activation(conv(x))` with the parameters `NAME.weight` and, if the network has it, `NAME.bias`; padded by half of the kernel.
    /// Height and width must be multiples of `stride`. With one input channel per kernel it is depthwise.
    pub(crate) fn conv(&mut self, name: &str, x: &Value, stride: i64, activation: Activation) -> Value {
        let weight = self.parameter(&format!("{name}.weight"));
        let [outputs, of_group, height, width] = [0, 1, 2, 3].map(|axis| weight.known(axis));
        let groups = x.known(1) / of_group;
        assert!(groups == 1 || (of_group == 1 && outputs == groups), "{name}: dense or depthwise");
        let bias = format!("{name}.bias");
        let bias = self.has(&bias).then(|| self.parameter(&bias));
        let inputs: Vec<&Value> = [x, &weight].into_iter().chain(&bias).collect();
        let [above, beside] = [height / 2, width / 2];
        let attributes = [
            ("kernel_shape", Attribute::Ints(vec![height, width])),
            ("strides", Attribute::Ints(vec![stride; 2])),
            ("pads", Attribute::Ints(vec![above, beside, above, beside])),
            ("group", Attribute::Int(groups)),
        ];
        let [rows, columns] = x.size().map(|side| self.over(&side, stride));
        let shape = vec![x.length(0), outputs.into(), rows, columns];
        let y = self.apply_labelled("Conv", name, &inputs, &attributes, shape);
        self.activated(y, activation)
    }

    pub(crate) fn activated(&mut self, x: Value, activation: Activation) -> Value {
        match activation {
            Activation::Identity => x,
            Activation::Relu => self.each("Relu", &x),
            Activation::Tanh => self.each("Tanh", &x),
            Activation::Sigmoid => self.each("Sigmoid", &x),
            Activation::LeakyRelu => {
                let leak = [("alpha", Attribute::Float(Activation::LEAK))];
                self.apply("LeakyRelu", &[&x], &leak, x.shape())
            }
            // In the order that onnxruntime knows, and computes as one operation.
            Activation::Gelu => {
                let root = self.scalar(SQRT_2);
                let y = self.divide(&x, &root);
                let y = self.each("Erf", &y);
                let y = self.shift(&y, 1.0);
                let y = self.multiply(&x, &y);
                self.scale(&y, 0.5)
            }
        }
    }

    /// Instance norm without parameters. onnxruntime's own operator adds up all pixels in single precision, which in frames of 550x802
    /// is wrong by 1e-4, and moves the flow of RAFT-S by 2e-3 pixels; sums of rows, then of their means, do not.
    pub(crate) fn instance_norm(&mut self, x: &Value) -> Value {
        let mean = self.mean_of_planes(x);
        let centred = self.subtract(x, &mean);
        let squared = self.multiply(&centred, &centred);
        let variance = self.mean_of_planes(&squared);
        let variance = self.shift(&variance, EPSILON);
        let deviation = self.each("Sqrt", &variance);
        self.divide(&centred, &deviation)
    }

    /// The mean of each row, then of those: one pixel per channel.
    fn mean_of_planes(&mut self, x: &Value) -> Value {
        let [batch, channels, height] = [0, 1, 2].map(|axis| x.length(axis));
        let shape = vec![batch.clone(), channels.clone(), height, 1.into()];
        let rows = self.apply("ReduceMean", &[x], &[("axes", Attribute::Ints(vec![3]))], shape);
        let shape = vec![batch, channels, 1.into(), 1.into()];
        self.apply("ReduceMean", &[&rows], &[("axes", Attribute::Ints(vec![2]))], shape)
    }

    /// Batch norm by the running statistics.
    pub(crate) fn batch_norm(&mut self, name: &str, x: &Value) -> Value {
        let [weight, bias, mean, variance] = ["weight", "bias", "running_mean", "running_var"]
            .map(|parameter| self.parameter(&format!("{name}.{parameter}")));
        let epsilon = [("epsilon", Attribute::Float(EPSILON))];
        self.apply_labelled(
            "BatchNormalization",
            name,
            &[x, &weight, &bias, &mean, &variance],
            &epsilon,
            x.shape(),
        )
    }

    /// A map of one channel.
    pub(crate) fn mean_of_channels(&mut self, x: &Value) -> Value {
        self.apply("ReduceMean", &[x], &[("axes", Attribute::Ints(vec![1]))], x.with_channels(1))
    }

    pub(crate) fn clamped(&mut self, x: &Value, low: f32, high: f32) -> Value {
        let [low, high] = [low, high].map(|limit| self.scalar(limit));
        self.apply("Clip", &[x, &low, &high], &[], x.shape())
    }

    /// Means of windows of `side` pixels that do not overlap. An odd row or column at the end is left out.
    pub(crate) fn pooled(&mut self, x: &Value, side: i64) -> Value {
        let attributes =
            [("kernel_shape", Attribute::Ints(vec![side; 2])), ("strides", Attribute::Ints(vec![side; 2]))];
        let [height, width] = x.size().map(|length| self.over(&length, side));
        self.apply("AveragePool", &[x], &attributes, vec![x.length(0), x.length(1), height, width])
    }

    /// Means over 1, 2, 1 pixels along each axis; pixels at the border continue beyond it.
    pub(crate) fn binomial(&mut self, x: &Value) -> Value {
        let window = || {
            [("kernel_shape", Attribute::Ints(vec![2; 2])), ("strides", Attribute::Ints(vec![1; 2]))]
                .into_iter()
        };
        let beyond: Vec<_> = window().chain([("pads", Attribute::Ints(vec![1; 4]))]).collect();
        let window: Vec<_> = window().collect();
        // One row and one column more, which no operation asks for.
        let pairs = self.apply("AveragePool", &[x], &beyond, x.shape());
        self.apply("AveragePool", &[&pairs], &window, x.shape())
    }

    /// Means of windows of this radius around each pixel, which are cut off at the border.
    pub(crate) fn smoothed(&mut self, x: &Value, radius: i64) -> Value {
        let attributes = [
            ("kernel_shape", Attribute::Ints(vec![2 * radius + 1; 2])),
            ("pads", Attribute::Ints(vec![radius; 4])),
            ("count_include_pad", Attribute::Int(0)),
        ];
        self.apply("AveragePool", &[x], &attributes, x.shape())
    }

    /// A map at `factor` times the size.
    pub(crate) fn enlarged(&mut self, x: &Value, factor: i64, grids: Grids) -> Value {
        let grids = match grids {
            Grids::CornersOnCorners => "align_corners",
            Grids::EdgesOnEdges => "half_pixel",
            Grids::FirstOnFirst => "asymmetric",
        };
        let attributes =
            [("mode", Attribute::Text("linear")), ("coordinate_transformation_mode", Attribute::Text(grids))];
        self.resized(x, factor, &attributes)
    }

    /// Each pixel `factor` times along each axis.
    pub(crate) fn repeated(&mut self, x: &Value, factor: i64) -> Value {
        let attributes = [
            ("mode", Attribute::Text("nearest")),
            ("coordinate_transformation_mode", Attribute::Text("asymmetric")),
            ("nearest_mode", Attribute::Text("floor")),
        ];
        self.resized(x, factor, &attributes)
    }

    fn resized(&mut self, x: &Value, factor: i64, attributes: &[(&'static str, Attribute)]) -> Value {
        let scales = self.constant(&[1.0, 1.0, factor as f32, factor as f32], &[4]);
        let [height, width] = x.size().map(|side| self.times(&side, &factor.into()));
        let shape = vec![x.length(0), x.length(1), height, width];
        self.apply("Resize", &[x, &Value::omitted(), &scales], attributes, shape)
    }

    /// 1 where `a` is greater than `b`, else 0.
    pub(crate) fn greater(&mut self, a: &Value, b: &Value) -> Value {
        let greater = self.pairs("Greater", a, b);
        self.apply("Cast", &[&greater], &[("to", Attribute::Int(DataType::Float as i64))], a.shape())
    }

    /// `one` where `share` is 1, `other` where it is 0.
    pub(crate) fn blended(&mut self, share: &Value, one: &Value, other: &Value) -> Value {
        let more = self.subtract(one, other);
        let more = self.multiply(&more, share);
        self.add(other, &more)
    }

    /// Columns and rows of the pixels that a flow `[1, 2, height, width]` points to.
    pub(crate) fn targets(&mut self, flow: &Value) -> Value {
        let [height, width] = flow.size();
        let columns = self.count(&width);
        let rows = self.count(&height);
        let rows = self.reshape(&rows, vec![height, 1.into()]);
        let [u, v] = [0, 1].map(|component| self.channels(flow, component, 1));
        let (x, y) = (self.add(&u, &columns), self.add(&v, &rows));
        self.concat(&[&x, &y], 1)
    }

    /// Twice the inverse of the distance from the first to the last column, and from the first to the last row: `[2]`, by which
    /// [`sampled`](Self::sampled) counts. Both lengths must be above 1.
    pub(crate) fn sampling_scale(&mut self, [height, width]: [Length; 2]) -> Value {
        if let (Length::Known(height), Length::Known(width)) = (&height, &width) {
            return self.constant(&[*width, *height].map(|side| 2.0 / (side - 1) as f32), &[2]);
        }
        let [columns, rows] = [width, height].map(|side| self.minus(&side, &1.into()));
        let distances = self.numbers(&[columns, rows]);
        let two = self.scalar(2.0);
        self.divide(&two, &distances)
    }

    /// A map `[batch, channels, height, width]` at positions `[batch, rows, columns, 2]`, x then y, which are -1 in the centre of the
    /// first pixel and 1 in that of the last; bilinear.
    pub(crate) fn sampled(&mut self, x: &Value, positions: &Value, beyond: Beyond) -> Value {
        let beyond = match beyond {
            Beyond::Zeros => "zeros",
            Beyond::Border => "border",
        };
        let attributes = [
            ("mode", Attribute::Text("bilinear")),
            ("padding_mode", Attribute::Text(beyond)),
            ("align_corners", Attribute::Int(1)),
        ];
        let shape = vec![x.length(0), x.length(1), positions.length(1), positions.length(2)];
        self.apply("GridSample", &[x, positions], &attributes, shape)
    }

    /// `factor` times a flow `[1, 2, height, width]` at `factor` times the size: each pixel is a convex combination of 3x3 neighbours, with
    /// the softmax of `scores` (`[1, 9 factor^2, height, width]`) as weights. Beyond the border the flow is zero.
    pub(crate) fn convex_upsampled(&mut self, flow: &Value, scores: &Value, factor: i64) -> Value {
        let [height, width] = flow.size();
        let pixels = self.times(&height, &width);
        let parts = factor * factor;
        let flow = self.scale(flow, factor as f32);
        let flow = self.transpose(&flow, &[1, 0, 2, 3]);
        let around = self.neighbours(&flow);
        let around = self.reshape(&around, vec![2.into(), NEIGHBOURS.into(), 1.into(), pixels.clone()]);
        let weights = self.reshape(scores, vec![NEIGHBOURS.into(), parts.into(), pixels]);
        let weights = self.softmax(&weights, 0);
        let weighted = self.multiply(&around, &weights);
        let sum = self.sum(&weighted, 1);
        let [rows, columns] = [&height, &width].map(|side| self.times(side, &factor.into()));
        let sum = self.reshape(&sum, vec![1.into(), (2 * parts).into(), height, width]);
        let attributes = [("blocksize", Attribute::Int(factor)), ("mode", Attribute::Text("CRD"))];
        let shape = vec![1.into(), 2.into(), rows, columns];
        self.apply("DepthToSpace", &[&sum], &attributes, shape)
    }

    /// The 3x3 pixels around each, zero outside: nine channels from one.
    fn neighbours(&mut self, x: &Value) -> Value {
        self.convolved_by(x, &identity(NEIGHBOURS as usize), [9, 3], 1)
    }

    /// Maps of the pixels of squares of `side` pixels: channel `c` becomes the `side^2` channels from `c side^2` on.
    pub(crate) fn space_to_depth(&mut self, x: &Value, side: i64) -> Value {
        let parts = side * side;
        let kernels = identity(parts as usize).repeat(x.known(1) as usize);
        self.convolved_by(x, &kernels, [parts, side], side)
    }

    /// Half of the differences of the neighbours in a row, and in a column, of a map of one channel; beyond the border that of the
    /// nearest pixel.
    pub(crate) fn slopes(&mut self, x: &Value) -> [Value; 2] {
        let size = x.size().map(|side| self.plus(&side, &2.into()));
        let padded = self.extended(x, &Sides::all(1), size);
        let along = [0.0, 0.0, 0.0, -0.5, 0.0, 0.5, 0.0, 0.0, 0.0];
        let down = [0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0];
        let kernels = self.constant(&[along, down].concat(), &[2, 1, 3, 3]);
        let slopes = self.apply("Conv", &[&padded, &kernels], &[], x.with_channels(2));
        [0, 1].map(|direction| self.channels(&slopes, direction, 1))
    }

    /// Each channel by `outputs` kernels of `side` pixels of its own, which are `kernels`; padded so that a stride of 1 keeps the size.
    fn convolved_by(&mut self, x: &Value, kernels: &[f32], [outputs, side]: [i64; 2], stride: i64) -> Value {
        let channels = x.known(1);
        let kernels = self.constant(kernels, &[channels * outputs, 1, side, side]);
        let pad = if stride == 1 { side / 2 } else { 0 };
        let attributes = [
            ("strides", Attribute::Ints(vec![stride; 2])),
            ("pads", Attribute::Ints(vec![pad; 4])),
            ("group", Attribute::Int(channels)),
        ];
        let [height, width] = x.size().map(|length| self.over(&length, stride));
        let shape = vec![x.length(0), (channels * outputs).into(), height, width];
        self.apply("Conv", &[x, &kernels], &attributes, shape)
    }
}

/// The identity matrix.
fn identity(size: usize) -> Vec<f32> {
    (0..size * size).map(|at| if at % (size + 1) == 0 { 1.0 } else { 0.0 }).collect()
}

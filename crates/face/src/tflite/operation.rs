//! The operations of MediaPipe's networks for faces.

use srflow_ops::conv2d::{Epilogue, conv2d};
use srflow_ops::convolution::Conv2dShape;
use srflow_ops::depthwise::depthwise;

use super::flatbuffer::Table;
use super::{MAX_NUMBERS, Parameters, Problem, unknown};

/// Widens weights.
pub(super) const DEQUANTIZE: i32 = 6;

/// What stands between two operations.
#[derive(Debug, Clone)]
pub(super) enum Value {
    /// Planes of channels, rows, columns.
    Map { shape: [usize; 3], numbers: Vec<f32> },
    /// Rows of as many numbers, where TFLite's order matters.
    Rows { width: usize, numbers: Vec<f32> },
}

impl Value {
    pub(super) fn map(shape: [usize; 3], numbers: Vec<f32>) -> Result<Self, String> {
        let expected: usize = shape.iter().product();
        if numbers.len() != expected {
            return Err(format!("expected {expected} numbers, found {}", numbers.len()));
        }
        Ok(Self::Map { shape, numbers })
    }

    pub(super) fn len(&self) -> usize {
        match self {
            Self::Map { numbers, .. } | Self::Rows { numbers, .. } => numbers.len(),
        }
    }

    /// In TFLite's order: rows, columns, channels.
    pub(super) fn rows(&self) -> Vec<f32> {
        match self {
            Self::Rows { numbers, .. } => numbers.clone(),
            Self::Map { shape: [channels, height, width], numbers } => {
                let pixels = height * width;
                let at = |index: usize| numbers[(index % channels) * pixels + index / channels];
                (0..numbers.len()).map(at).collect()
            }
        }
    }
}

/// How the edges of a map are treated.
#[derive(Debug, Clone, Copy)]
pub(super) enum Edges {
    /// Zeros are added until the output has a pixel for each stride; of an odd number the last one follows.
    Same,
    /// The kernel stays inside.
    Valid,
}

/// Of a convolution or a maximum.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    edges: Edges,
    /// Height and width.
    kernel: [usize; 2],
    /// Down and across.
    stride: [usize; 2],
}

#[derive(Debug, Clone)]
pub(super) enum Operation {
    /// Weights by output, input, row, column.
    Convolution {
        window: Window,
        outputs: usize,
        weights: Vec<f32>,
        bias: Vec<f32>,
    },
    /// Weights by channel, row, column.
    Depthwise {
        window: Window,
        weights: Vec<f32>,
        bias: Vec<f32>,
    },
    Maximum(Window),
    Add,
    Relu,
    /// A slope below zero for each channel.
    PRelu(Vec<f32>),
    /// Zeros before and after channels, rows, columns.
    Pad([[usize; 2]; 3]),
    /// To rows of as many numbers.
    Reshape {
        width: usize,
    },
    Concatenate,
}

/// Reads the operation of this code, see `BuiltinOperator` in the schema.
pub(super) fn read(code: i32, options: Option<Table>, parameters: &Parameters) -> Result<Operation, Problem> {
    // All fields of absent options have their defaults.
    let int = |number, default| options.map_or(Ok(default), |options| options.int(number, default));
    let byte = |number| options.map_or(Ok(0), |options| options.byte(number));
    let size = |value: i32| {
        usize::try_from(value)
            .ok()
            .filter(|size| (1..=64).contains(size))
            .ok_or_else(|| unknown(format!("expected windows and strides of 1 to 64 pixels, found {value}")))
    };
    let window = |kernel: [usize; 2]| -> Result<Window, Problem> {
        let edges = if byte(0)? == 0 { Edges::Same } else { Edges::Valid };
        Ok(Window { edges, kernel, stride: [size(int(2, 0)?)?, size(int(1, 0)?)?] })
    };
    let plain = |activation: u8| match activation {
        0 => Ok(()),
        other => Err(unknown(format!("expected no activation inside of an operation, found number {other}"))),
    };
    let dense = |down: usize| match (int(down, 1)?, int(down + 1, 1)?) {
        (1, 1) => Ok(()),
        _ => Err(unknown("expected convolutions without dilation")),
    };
    let bias = |channels: usize| -> Result<Vec<f32>, Problem> {
        match parameters.constant(2)?.1 {
            bias if bias.len() == channels => Ok(bias.to_vec()),
            bias => {
                Err(unknown(format!("expected a bias for each of {channels} channels, found {}", bias.len())))
            }
        }
    };
    Ok(match code {
        0 => {
            plain(byte(0)?)?;
            Operation::Add
        }
        2 => {
            plain(byte(1)?)?;
            if int(0, 0)? != 1 {
                return Err(unknown(format!(
                    "expected rows that follow each other, found axis {}",
                    int(0, 0)?
                )));
            }
            Operation::Concatenate
        }
        3 => {
            plain(byte(3)?)?;
            dense(4)?;
            let (shape, weights) = parameters.constant(1)?;
            let &[outputs, height, width, inputs] = shape else {
                return Err(unknown(format!("expected weights of four axes, found {shape:?}")));
            };
            let taps = height * width;
            let at = |index: usize| {
                let (output, input, tap) = (index / (inputs * taps), index / taps % inputs, index % taps);
                weights[(output * taps + tap) * inputs + input]
            };
            Operation::Convolution {
                window: window([height, width])?,
                outputs,
                weights: (0..weights.len()).map(at).collect(),
                bias: bias(outputs)?,
            }
        }
        4 => {
            plain(byte(4)?)?;
            dense(5)?;
            let (shape, weights) = parameters.constant(1)?;
            let &[1, height, width, channels] = shape else {
                return Err(unknown(format!("expected 1 x height x width x channels, found {shape:?}")));
            };
            let taps = height * width;
            let at = |index: usize| weights[index % taps * channels + index / taps];
            Operation::Depthwise {
                window: window([height, width])?,
                weights: (0..weights.len()).map(at).collect(),
                bias: bias(channels)?,
            }
        }
        17 => {
            plain(byte(5)?)?;
            Operation::Maximum(window([size(int(4, 0)?)?, size(int(3, 0)?)?])?)
        }
        19 => Operation::Relu,
        22 => {
            // The shape is an input in new files, an option in old ones.
            let output = match (parameters.inputs.len(), options) {
                (1, Some(options)) => options.ints(0)?,
                _ => parameters.whole(1)?,
            };
            match output.last().map(|width| usize::try_from(*width)) {
                Some(Ok(width @ 1..)) => Operation::Reshape { width },
                _ => return Err(unknown(format!("expected the shape of rows, found {output:?}"))),
            }
        }
        34 => {
            let zeros = parameters.whole(1)?;
            let zeros: Option<Vec<usize>> = zeros
                .iter()
                .map(|count| usize::try_from(*count).ok().filter(|count| *count < 4096))
                .collect();
            let Some(&[0, 0, above, below, left, right, before, after]) = zeros.as_deref() else {
                return Err(unknown("expected zeros around rows, columns and channels"));
            };
            Operation::Pad([[before, after], [above, below], [left, right]])
        }
        54 => Operation::PRelu(parameters.constant(1)?.1.to_vec()),
        other => {
            return Err(unknown(format!(
                "operation {other} of TFLite: expected those of MediaPipe's short-range detector and face mesh \
                 without attention"
            )));
        }
    })
}

impl Operation {
    pub(super) fn run(&self, inputs: &[&Value]) -> Result<Value, String> {
        match (self, inputs) {
            (Self::Convolution { window, outputs, weights, bias }, [Value::Map { shape, numbers }]) => {
                let channels = shape[0];
                if weights.len() != outputs * channels * window.kernel[0] * window.kernel[1] {
                    return Err(format!("expected weights for {channels} channels"));
                }
                let (shape, numbers) = window.padded(*shape, numbers, 0.0)?;
                let shape = Conv2dShape {
                    batch: 1,
                    in_channels: channels,
                    out_channels: *outputs,
                    groups: 1,
                    input: [shape[1], shape[2]],
                    kernel: window.kernel,
                    stride: window.stride,
                    padding: [0, 0],
                };
                let [height, width] = checked([*outputs, shape.output()[0], shape.output()[1]])?;
                let epilogue = Epilogue { bias: Some(bias), ..Epilogue::default() };
                Value::map([*outputs, height, width], conv2d(&numbers, weights, &epilogue, &shape))
            }
            (Self::Depthwise { window, weights, bias }, [Value::Map { shape, numbers }]) => {
                let channels = shape[0];
                if weights.len() != channels * window.kernel[0] * window.kernel[1] || bias.len() != channels {
                    return Err(format!("expected weights for {channels} channels"));
                }
                let (padded, numbers) = window.padded(*shape, numbers, 0.0)?;
                let shape = Conv2dShape {
                    batch: 1,
                    in_channels: channels,
                    out_channels: channels,
                    groups: channels,
                    input: [padded[1], padded[2]],
                    kernel: window.kernel,
                    stride: [1, 1],
                    padding: [0, 0],
                };
                checked([channels, shape.output()[0], shape.output()[1]])?;
                let epilogue = Epilogue { bias: Some(bias), ..Epilogue::default() };
                let every = depthwise(&numbers, weights, &epilogue, &shape);
                let [height, width] = shape.output();
                Ok(strided([channels, height, width], &every, window.stride))
            }
            (Self::Maximum(window), [Value::Map { shape, numbers }]) => {
                let (padded, numbers) = window.padded(*shape, numbers, f32::NEG_INFINITY)?;
                Ok(maxima(padded, &numbers, *window))
            }
            (Self::Add, [Value::Map { shape, numbers }, Value::Map { shape: other, numbers: added }]) => {
                if shape != other {
                    return Err(format!("expected maps of one shape, found {shape:?} and {other:?}"));
                }
                let sums = numbers.iter().zip(added).map(|(a, b)| a + b);
                Value::map(*shape, sums.collect())
            }
            (Self::Relu, [Value::Map { shape, numbers }]) => {
                Value::map(*shape, numbers.iter().map(|x| x.max(0.0)).collect())
            }
            (Self::PRelu(slopes), [Value::Map { shape, numbers }]) => {
                if slopes.len() != shape[0] {
                    return Err(format!(
                        "expected a slope for each of {} channels, found {}",
                        shape[0],
                        slopes.len()
                    ));
                }
                let planes = numbers.chunks((shape[1] * shape[2]).max(1)).zip(slopes);
                let sloped = |x: &f32, slope: f32| if *x < 0.0 { x * slope } else { *x };
                let all = planes.flat_map(|(plane, slope)| plane.iter().map(move |x| sloped(x, *slope)));
                Value::map(*shape, all.collect())
            }
            (Self::Pad(zeros), [Value::Map { shape, numbers }]) => {
                let (shape, numbers) = surrounded(*shape, numbers, *zeros, 0.0)?;
                Value::map(shape, numbers)
            }
            (Self::Reshape { width }, [value]) => {
                if value.len() % width != 0 {
                    return Err(format!("expected rows of {width}, found {} numbers", value.len()));
                }
                Ok(Value::Rows { width: *width, numbers: value.rows() })
            }
            (Self::Concatenate, parts) => {
                let mut all = Vec::new();
                let mut common = None;
                for part in parts {
                    match part {
                        Value::Rows { width, numbers } if *common.get_or_insert(*width) == *width => {
                            all.extend_from_slice(numbers);
                        }
                        _ => return Err("expected rows of one width".to_owned()),
                    }
                }
                Ok(Value::Rows { width: common.unwrap_or(1), numbers: all })
            }
            _ => Err("expected a map for each input".to_owned()),
        }
    }
}

/// Height and width of a map of sane size.
fn checked(shape: [usize; 3]) -> Result<[usize; 2], String> {
    let len = shape.iter().try_fold(1_usize, |len, size| len.checked_mul(*size));
    match len {
        Some(1..=MAX_NUMBERS) => Ok([shape[1], shape[2]]),
        _ => Err(format!("expected a map of at most {MAX_NUMBERS} numbers, found {shape:?}")),
    }
}

impl Window {
    /// The map with what the edges need around it.
    fn padded(
        &self,
        shape: [usize; 3],
        numbers: &[f32],
        value: f32,
    ) -> Result<([usize; 3], Vec<f32>), String> {
        let sides = [0, 1].map(|axis| match self.edges {
            Edges::Valid => [0, 0],
            Edges::Same => {
                let (size, kernel, stride) = (shape[axis + 1], self.kernel[axis], self.stride[axis]);
                let needed = (size.div_ceil(stride).saturating_sub(1) * stride + kernel).saturating_sub(size);
                [needed / 2, needed - needed / 2]
            }
        });
        let padded = surrounded(shape, numbers, [[0, 0], sides[0], sides[1]], value)?;
        let [_, height, width] = padded.0;
        if self.kernel[0] > height || self.kernel[1] > width {
            let [down, across] = self.kernel;
            return Err(format!("expected a map for a window of {across}x{down}, found {width}x{height}"));
        }
        Ok(padded)
    }
}

fn surrounded(
    [channels, height, width]: [usize; 3],
    numbers: &[f32],
    [depth, rows, columns]: [[usize; 2]; 3],
    value: f32,
) -> Result<([usize; 3], Vec<f32>), String> {
    let larger = |size: usize, sides: [usize; 2]| size.saturating_add(sides[0]).saturating_add(sides[1]);
    let shape = [larger(channels, depth), larger(height, rows), larger(width, columns)];
    checked(shape)?;
    let mut out = vec![value; shape.iter().product()];
    for (row, line) in numbers.chunks(width.max(1)).enumerate() {
        let (channel, y) = (row / height, row % height);
        let start = ((channel + depth[0]) * shape[1] + y + rows[0]) * shape[2] + columns[0];
        out[start..start + width].copy_from_slice(line);
    }
    Ok((shape, out))
}

/// Every stride-th pixel of a map.
fn strided([channels, height, width]: [usize; 3], numbers: &[f32], [down, across]: [usize; 2]) -> Value {
    let shape = [channels, height.div_ceil(down), width.div_ceil(across)];
    let rows = numbers.chunks(width.max(1)).enumerate().filter(|(row, _)| row % height % down == 0);
    let numbers = rows.flat_map(|(_, row)| row.iter().step_by(across)).copied().collect();
    Value::Map { shape, numbers }
}

fn maxima([channels, height, width]: [usize; 3], numbers: &[f32], window: Window) -> Value {
    let ([kh, kw], [sh, sw]) = (window.kernel, window.stride);
    let (out_height, out_width) = ((height - kh) / sh + 1, (width - kw) / sw + 1);
    let mut out = Vec::with_capacity(channels * out_height * out_width);
    for plane in numbers.chunks(height * width) {
        for (y, x) in (0..out_height).flat_map(|y| (0..out_width).map(move |x| (y * sh, x * sw))) {
            let rows = (y..y + kh).flat_map(|row| &plane[row * width + x..row * width + x + kw]);
            out.push(rows.copied().fold(f32::NEG_INFINITY, f32::max));
        }
    }
    Value::Map { shape: [channels, out_height, out_width], numbers: out }
}

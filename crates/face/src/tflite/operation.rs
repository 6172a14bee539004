//! The operations of MediaPipe's networks for faces and persons, as files have them.

use std::ops::Range;

use srflow_core::excerpt;
use srflow_ops::resize::Grids;

use super::element_wise::{Binary, NewShape, Reduction, Unary};
use super::flatbuffer::Table;
use super::map::{MapAxis, shape_of};
use super::{Parameters, Problem, unknown};

/// Widens weights.
pub(super) const DEQUANTIZE: i32 = 6;
/// An operation that is not TensorFlow's, known by its name.
const CUSTOM: i32 = 32;
/// The edges of convolutions and maxima are added in memory, so that windows are bounded; pixels, also of strides.
const LARGEST_WINDOW: usize = 64;
/// An average may be that of a whole map; pixels, also of strides.
const LARGEST_AVERAGE: usize = 4096;

/// How the edges of a map are treated.
#[derive(Debug, Clone, Copy)]
pub(super) enum Edges {
    /// Zeros are added until the output has a pixel for each stride; of an odd number the last one follows. Of a transposed
    /// convolution as much is cut off.
    Same,
    /// The kernel stays inside.
    Valid,
}

/// Of a convolution, a maximum or an average.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    pub(super) edges: Edges,
    /// Height and width.
    pub(super) kernel: [usize; 2],
    /// Down and across.
    pub(super) stride: [usize; 2],
}

/// A convolution or its transpose.
#[derive(Debug, Clone)]
pub(super) struct Convolution {
    pub(super) window: Window,
    pub(super) outputs: usize,
    pub(super) weights: Vec<f32>,
    /// A number for each output.
    pub(super) bias: Vec<f32>,
    /// Whether negative sums become 0.
    pub(super) relu: bool,
}

#[derive(Debug, Clone)]
pub(super) enum Operation {
    /// Weights by output, input, row, column.
    Convolution(Convolution),
    /// Weights by input, output, row, column.
    Transposed(Convolution),
    /// Weights by channel, row, column.
    Depthwise(Convolution),
    Maximum(Window),
    /// Of the pixels inside of the map.
    Average(Window),
    Unary(Unary),
    Binary(Binary),
    /// A slope below zero for each channel.
    PRelu(Vec<f32>),
    /// To height and width, by linear interpolation.
    Resize {
        size: [usize; 2],
        grids: Grids,
    },
    /// Zeros before and after channels, rows, columns.
    Pad([[usize; 2]; 3]),
    Reduce(Reduction),
    /// Exchanges columns and channels.
    Transpose,
    /// Parts of channels, rows, columns.
    Slice([Range<usize>; 3]),
    Reshape(NewShape),
    /// Along channels, rows or columns.
    Concatenate {
        axis: usize,
    },
}

impl Operation {
    /// Whether numbers of the file may be its inputs, as those of other arrays.
    pub(super) fn takes_constants(&self) -> bool {
        matches!(self, Self::Binary(_) | Self::Concatenate { .. })
    }
}

/// Which operation it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Code<'a> {
    /// See `BuiltinOperator` in the schema.
    pub(super) number: i32,
    /// Of one that is not TensorFlow's.
    pub(super) name: &'a [u8],
}

/// An operation of a file.
pub(super) struct Stored<'a> {
    pub(super) code: Code<'a>,
    pub(super) options: Option<Table<'a>>,
    /// Of an operation that is not TensorFlow's.
    pub(super) custom_options: &'a [u8],
    pub(super) parameters: Parameters<'a>,
}

impl Stored<'_> {
    pub(super) fn read(&self) -> Result<Operation, Problem> {
        Ok(match self.code.number {
            0 => self.binary(Binary::Add)?,
            1 => {
                self.plain(5)?;
                Operation::Average(self.pooling(LARGEST_AVERAGE)?)
            }
            2 => self.concatenation()?,
            3 => Operation::Convolution(self.convolution()?),
            4 => Operation::Depthwise(self.depthwise()?),
            14 => Operation::Unary(Unary::Logistic),
            17 => {
                self.plain(5)?;
                Operation::Maximum(self.pooling(LARGEST_WINDOW)?)
            }
            18 => self.binary(Binary::Multiply)?,
            19 => Operation::Unary(Unary::Relu),
            22 => self.reshape()?,
            23 => self.resize()?,
            CUSTOM if self.code.name == b"Convolution2DTransposeBias" => {
                Operation::Transposed(self.transposed()?)
            }
            34 => self.pad()?,
            39 => self.transpose()?,
            40 => self.reduction(true)?,
            41 => self.binary(Binary::Subtract)?,
            42 => self.binary(Binary::Divide)?,
            45 => self.slice()?,
            54 => Operation::PRelu(self.parameters.constant(1)?.1.to_vec()),
            59 => Operation::Unary(Unary::Negative),
            74 => self.reduction(false)?,
            75 => Operation::Unary(Unary::SquareRoot),
            76 => Operation::Unary(Unary::InverseRoot),
            99 => Operation::Binary(Binary::SquaredDifference),
            117 => Operation::Unary(Unary::HardSwish),
            other => {
                let found = match other {
                    CUSTOM => format!("operation {}", excerpt(&String::from_utf8_lossy(self.code.name))),
                    _ => format!("operation {other} of TFLite"),
                };
                return Err(unknown(format!(
                    "{found}: expected those of MediaPipe's face landmarker, its short-range detector, face mesh without \
                     attention, and selfie segmentation"
                )));
            }
        })
    }

    // All fields of absent options have their defaults.

    fn int(&self, field: usize, default: i32) -> Result<i32, Problem> {
        Ok(self.options.map_or(Ok(default), |options| options.int(field, default))?)
    }

    fn byte(&self, field: usize) -> Result<u8, Problem> {
        Ok(self.options.map_or(Ok(0), |options| options.byte(field))?)
    }

    /// Whether an operation ends in a ReLU.
    fn relu(&self, activation: usize) -> Result<bool, Problem> {
        match self.byte(activation)? {
            activation @ (0 | 1) => Ok(activation == 1),
            other => Err(unknown(format!(
                "expected no activation or a ReLU inside of an operation, found number {other}"
            ))),
        }
    }

    fn plain(&self, activation: usize) -> Result<(), Problem> {
        match self.byte(activation)? {
            0 => Ok(()),
            other => {
                Err(unknown(format!("expected no activation inside of an operation, found number {other}")))
            }
        }
    }

    fn dense(&self, down: usize) -> Result<(), Problem> {
        match (self.int(down, 1)?, self.int(down + 1, 1)?) {
            (1, 1) => Ok(()),
            _ => Err(unknown("expected convolutions without dilation")),
        }
    }

    /// Of convolutions and of what pools: their first fields are the same.
    fn window(&self, kernel: [usize; 2], largest: usize) -> Result<Window, Problem> {
        let edges = if self.byte(0)? == 0 { Edges::Same } else { Edges::Valid };
        let stride = [extent(self.int(2, 0)?, largest)?, extent(self.int(1, 0)?, largest)?];
        Ok(Window { edges, kernel, stride })
    }

    fn pooling(&self, largest: usize) -> Result<Window, Problem> {
        let kernel = [extent(self.int(4, 0)?, largest)?, extent(self.int(3, 0)?, largest)?];
        self.window(kernel, largest)
    }

    fn bias(&self, channels: usize) -> Result<Vec<f32>, Problem> {
        match self.parameters.constant(2)?.1 {
            bias if bias.len() == channels => Ok(bias.to_vec()),
            bias => {
                Err(unknown(format!("expected a bias for each of {channels} channels, found {}", bias.len())))
            }
        }
    }

    fn convolution(&self) -> Result<Convolution, Problem> {
        let relu = self.relu(3)?;
        self.dense(4)?;
        let ([outputs, height, width, inputs], weights) = self.weights()?;
        let taps = height * width;
        let at = |index: usize| {
            let (output, input, tap) = (index / (inputs * taps), index / taps % inputs, index % taps);
            weights[(output * taps + tap) * inputs + input]
        };
        Ok(Convolution {
            window: self.window([height, width], LARGEST_WINDOW)?,
            outputs,
            weights: (0..weights.len()).map(at).collect(),
            bias: self.bias(outputs)?,
            relu,
        })
    }

    fn depthwise(&self) -> Result<Convolution, Problem> {
        let relu = self.relu(4)?;
        self.dense(5)?;
        let ([1, height, width, channels], weights) = self.weights()? else {
            return Err(unknown("expected as many outputs of a depthwise convolution as inputs"));
        };
        let taps = height * width;
        let at = |index: usize| weights[index % taps * channels + index / taps];
        Ok(Convolution {
            window: self.window([height, width], LARGEST_WINDOW)?,
            outputs: channels,
            weights: (0..weights.len()).map(at).collect(),
            bias: self.bias(channels)?,
            relu,
        })
    }

    /// `mediapipe/util/tflite/operations/transpose_conv_bias.cc`; its options are the `TfLiteTransposeConvParams` of
    /// TFLite's `builtin_op_data.h` as they lie in memory.
    fn transposed(&self) -> Result<Convolution, Problem> {
        let fields = self.custom_options.as_chunks().0.iter().map(|bytes| i32::from_le_bytes(*bytes));
        let (edges, across, down) = match fields.take(3).collect::<Vec<_>>()[..] {
            [1, across, down] => (Edges::Same, across, down),
            [2, across, down] => (Edges::Valid, across, down),
            ref found => {
                return Err(unknown(format!(
                    "expected padding and strides of a convolution, found {found:?}"
                )));
            }
        };
        let ([outputs, height, width, inputs], weights) = self.weights()?;
        let taps = height * width;
        let at = |index: usize| {
            let (input, output, tap) = (index / (outputs * taps), index / taps % outputs, index % taps);
            weights[(output * taps + tap) * inputs + input]
        };
        Ok(Convolution {
            window: Window {
                edges,
                kernel: [height, width],
                stride: [extent(down, LARGEST_WINDOW)?, extent(across, LARGEST_WINDOW)?],
            },
            outputs,
            weights: (0..weights.len()).map(at).collect(),
            bias: self.bias(outputs)?,
            relu: false,
        })
    }

    /// By output, row, column, input.
    fn weights(&self) -> Result<([usize; 4], &[f32]), Problem> {
        let (shape, weights) = self.parameters.constant(1)?;
        match shape.try_into() {
            Ok(shape) => Ok((shape, weights)),
            Err(_) => Err(unknown(format!("expected weights of four axes, found {shape:?}"))),
        }
    }

    fn binary(&self, function: Binary) -> Result<Operation, Problem> {
        self.plain(0)?;
        Ok(Operation::Binary(function))
    }

    /// Axes of this many inputs of the file.
    fn rank(&self) -> usize {
        let first = self.parameters.inputs.first();
        first.map_or(0, |input| self.parameters.tensors[*input].shape.len())
    }

    fn concatenation(&self) -> Result<Operation, Problem> {
        self.plain(1)?;
        let axis = self.int(0, 0)?;
        match MapAxis::of(axis, self.rank()) {
            Some(MapAxis::Of(axis)) => Ok(Operation::Concatenate { axis }),
            _ => Err(unknown(format!(
                "expected rows, columns or channels beside each other, found axis {axis}"
            ))),
        }
    }

    fn reduction(&self, is_mean: bool) -> Result<Operation, Problem> {
        if self.byte(0)? == 0 {
            return Err(unknown("expected sums that keep their axes"));
        }
        let axes = self.parameters.axes()?;
        let along = [0, 1, 2].map(|axis| axes.contains(&MapAxis::Of(axis)));
        Ok(Operation::Reduce(Reduction { along, is_mean }))
    }

    fn transpose(&self) -> Result<Operation, Problem> {
        match self.parameters.whole(1)?[..] {
            [0, 1, 3, 2] => Ok(Operation::Transpose),
            ref order => {
                Err(unknown(format!("expected columns and channels to be exchanged, found {order:?}")))
            }
        }
    }

    /// A part of an array, without gaps.
    fn slice(&self) -> Result<Operation, Problem> {
        let [begin, end, strides] = [1, 2, 3].map(|position| self.parameters.whole(position));
        let (begin, end, strides) = (begin?, end?, strides?);
        let [from_start, to_end, dots, new_axes, fewer_axes] =
            [0, 1, 2, 3, 4].map(|field| self.int(field, 0));
        let (from_start, to_end, fewer_axes) = (from_start?, to_end?, fewer_axes?);
        let rank = self.rank();
        let plain =
            [begin.len(), end.len(), strides.len()] == [rank; 3] && strides.iter().all(|stride| *stride == 1);
        // The first axes may go, but not others: the last are rows, columns, channels.
        if !plain || dots? != 0 || new_axes? != 0 || !matches!(fewer_axes, 0 | 1 | 3 | 7) {
            return Err(unknown("expected a part of an array without gaps and with its axes"));
        }
        let shape =
            self.parameters.inputs.first().map(|input| self.parameters.tensors[*input].shape.as_slice());
        let sizes = shape_of(shape.unwrap_or_default())?;
        let mut parts = sizes.map(|size| 0..size);
        for (place, (begin, end)) in begin.iter().zip(&end).enumerate() {
            let Some(MapAxis::Of(axis)) = MapAxis::of(place as i32, rank) else { continue };
            let size = sizes[axis];
            let at = |bound: i32| match usize::try_from(bound) {
                Ok(bound) => bound.min(size),
                Err(_) => size.saturating_sub(bound.unsigned_abs() as usize),
            };
            let kept = |mask: i32| mask >> place & 1 == 1;
            parts[axis] =
                if kept(from_start) { 0 } else { at(*begin) }..if kept(to_end) { size } else { at(*end) };
            if kept(fewer_axes) && parts[axis].len() != 1 {
                return Err(unknown("expected an axis of size 1 to go"));
            }
        }
        Ok(Operation::Slice(parts))
    }

    fn reshape(&self) -> Result<Operation, Problem> {
        // The shape is an input in new files, an option in old ones.
        let axes = match (self.parameters.inputs.len(), self.options) {
            (1, Some(options)) => options.ints(0)?,
            _ => self.parameters.whole(1)?,
        };
        let sizes: Option<Vec<usize>> = axes
            .iter()
            .map(|size| match size {
                -1 => Some(0),
                size => usize::try_from(*size).ok().filter(|size| *size > 0),
            })
            .collect();
        let unknown_sizes = axes.iter().filter(|size| **size == -1).count();
        match sizes {
            Some(sizes) if unknown_sizes <= 1 && sizes.len() <= 4 && (sizes.len() < 4 || sizes[0] <= 1) => {
                let last = sizes.len().saturating_sub(3);
                let shape = shape_of(&sizes[last..])?;
                Ok(Operation::Reshape(NewShape(shape.map(|size| (size > 0).then_some(size)))))
            }
            _ => Err(unknown(format!("expected the shape of an array, found {axes:?}"))),
        }
    }

    fn resize(&self) -> Result<Operation, Problem> {
        let grids = match (self.byte(2)? != 0, self.byte(3)? != 0) {
            (true, false) => Grids::CornersOnCorners,
            (false, true) => Grids::EdgesOnEdges,
            (false, false) => Grids::FirstOnFirst,
            (true, true) => return Err(unknown("expected corners or edges that are aligned, found both")),
        };
        let size = self.parameters.whole(1)?;
        let sizes = size.iter().map(|size| usize::try_from(*size).ok());
        match sizes.collect::<Option<Vec<_>>>().as_deref() {
            Some(&[height, width]) => Ok(Operation::Resize { size: [height, width], grids }),
            _ => Err(unknown(format!("expected a height and a width, found {size:?}"))),
        }
    }

    fn pad(&self) -> Result<Operation, Problem> {
        let zeros = self.parameters.whole(1)?;
        let zeros: Option<Vec<usize>> =
            zeros.iter().map(|count| usize::try_from(*count).ok().filter(|count| *count < 4096)).collect();
        let Some(&[0, 0, above, below, left, right, before, after]) = zeros.as_deref() else {
            return Err(unknown("expected zeros around rows, columns and channels"));
        };
        Ok(Operation::Pad([[before, after], [above, below], [left, right]]))
    }
}

fn extent(value: i32, largest: usize) -> Result<usize, Problem> {
    usize::try_from(value).ok().filter(|size| (1..=largest).contains(size)).ok_or_else(|| {
        unknown(format!("expected windows and strides of 1 to {largest} pixels, found {value}"))
    })
}

//! The operations of MediaPipe's networks for faces and persons, as files have them.

use srflow_core::excerpt;
use srflow_ops::resize::Grids;

use super::flatbuffer::Table;
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
    Add,
    Multiply,
    Relu,
    /// A slope below zero for each channel.
    PRelu(Vec<f32>),
    /// `x * min(max(x + 3, 0), 6) / 6`.
    HardSwish,
    /// `1 / (1 + exp(-x))`.
    Logistic,
    /// To height and width, by linear interpolation.
    Resize {
        size: [usize; 2],
        grids: Grids,
    },
    /// Zeros before and after channels, rows, columns.
    Pad([[usize; 2]; 3]),
    /// To rows of as many numbers.
    Reshape {
        width: usize,
    },
    Concatenate,
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
            0 => {
                self.plain(0)?;
                Operation::Add
            }
            1 => {
                self.plain(5)?;
                Operation::Average(self.pooling(LARGEST_AVERAGE)?)
            }
            2 => {
                self.plain(1)?;
                match self.int(0, 0)? {
                    1 => Operation::Concatenate,
                    axis => {
                        return Err(unknown(format!(
                            "expected rows that follow each other, found axis {axis}"
                        )));
                    }
                }
            }
            3 => Operation::Convolution(self.convolution()?),
            4 => Operation::Depthwise(self.depthwise()?),
            14 => Operation::Logistic,
            17 => {
                self.plain(5)?;
                Operation::Maximum(self.pooling(LARGEST_WINDOW)?)
            }
            18 => {
                self.plain(0)?;
                Operation::Multiply
            }
            19 => Operation::Relu,
            22 => self.reshape()?,
            23 => self.resize()?,
            CUSTOM if self.code.name == b"Convolution2DTransposeBias" => {
                Operation::Transposed(self.transposed()?)
            }
            34 => self.pad()?,
            54 => Operation::PRelu(self.parameters.constant(1)?.1.to_vec()),
            117 => Operation::HardSwish,
            other => {
                let found = match other {
                    CUSTOM => format!("operation {}", excerpt(&String::from_utf8_lossy(self.code.name))),
                    _ => format!("operation {other} of TFLite"),
                };
                return Err(unknown(format!(
                    "{found}: expected those of MediaPipe's short-range detector, face mesh without attention, and \
                     selfie segmentation"
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
        self.plain(3)?;
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
        })
    }

    fn depthwise(&self) -> Result<Convolution, Problem> {
        self.plain(4)?;
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

    fn reshape(&self) -> Result<Operation, Problem> {
        // The shape is an input in new files, an option in old ones.
        let output = match (self.parameters.inputs.len(), self.options) {
            (1, Some(options)) => options.ints(0)?,
            _ => self.parameters.whole(1)?,
        };
        match output.last().map(|width| usize::try_from(*width)) {
            Some(Ok(width @ 1..)) => Ok(Operation::Reshape { width }),
            _ => Err(unknown(format!("expected the shape of rows, found {output:?}"))),
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

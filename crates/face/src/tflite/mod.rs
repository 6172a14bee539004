//! Networks in TFLite files, as far as MediaPipe's use the format: convolutions, steps between them, weights in half precision.
//!
//! TFLite's arrays are `1 x rows x columns x channels`. Those of fewer axes have these as their last ones.
//!
//! Fields and numbers are those of `tensorflow/lite/schema/schema.fbs`, version 3.

mod compute;
mod element_wise;
mod flatbuffer;
mod map;
mod operation;
#[cfg(test)]
mod tests;

use flatbuffer::{Broken, Bytes, Table};
use half::slice::HalfFloatSliceExt as _;
use map::{Map, MapAxis, shape_of};
use operation::{Code, Operation, Stored};

/// More numbers are in no layer of a network for faces or persons.
const MAX_NUMBERS: usize = 1 << 24;
/// More operations are in no network for faces or persons.
const MAX_OPERATIONS: usize = 4096;

/// A network with one input.
#[derive(Debug, Clone)]
pub(crate) struct Network {
    /// Channels, height and width of the input.
    input: [usize; 3],
    input_slot: usize,
    /// What is known before it runs: numbers of the file that are operands. A slot for each array.
    constants: Vec<Option<Map>>,
    operations: Vec<Step>,
    outputs: Vec<usize>,
    output_lens: Vec<usize>,
}

/// An operation, and where it takes its inputs from and puts its output.
#[derive(Debug, Clone)]
struct Step {
    operation: Operation,
    inputs: Vec<usize>,
    output: usize,
}

/// A tensor of the file.
struct Described<'a> {
    shape: Vec<usize>,
    kind: u8,
    data: &'a [u8],
}

const FLOAT32: u8 = 0;
const FLOAT16: u8 = 1;
const INT32: u8 = 2;

impl Network {
    /// Reads a file, and runs it once so that a file that does not fit together is refused here.
    ///
    /// # Errors
    /// A sentence that says what was expected and what was found.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, String> {
        if bytes.get(4..8) != Some(b"TFL3") {
            return Err("expected a TFLite file (TFL3 from its fifth byte on)".to_owned());
        }
        let mut network = read(bytes).map_err(|problem| match problem {
            Problem::Broken(Broken { at }) => format!("the file is damaged at byte {at}; copy it again"),
            Problem::Unknown(problem) => problem,
        })?;
        let outputs = network.run(&vec![0.0; network.input.iter().product()])?;
        network.output_lens = outputs.iter().map(Vec::len).collect();
        Ok(network)
    }

    /// Numbers of each output.
    pub(crate) fn output_lens(&self) -> &[usize] {
        &self.output_lens
    }

    /// Channels, height and width of the input.
    pub(crate) fn input(&self) -> [usize; 3] {
        self.input
    }

    /// The outputs, in the order of TFLite (rows, columns, channels). The input is in planes, one for each channel.
    ///
    /// # Errors
    /// When the sizes of the network's layers do not fit each other.
    pub(crate) fn run(&self, planes: &[f32]) -> Result<Vec<Vec<f32>>, String> {
        let mut values = self.constants.clone();
        values[self.input_slot] = Some(Map::new(self.input, planes.to_vec())?);
        let mut numbers = 0;
        for (index, Step { operation, inputs, output }) in self.operations.iter().enumerate() {
            let inputs: Option<Vec<&Map>> = inputs.iter().map(|slot| values[*slot].as_ref()).collect();
            let inputs =
                inputs.ok_or_else(|| format!("operation {index}: expected an input that is known"))?;
            let value = operation.run(&inputs).map_err(|problem| format!("operation {index}: {problem}"))?;
            numbers += value.numbers.len();
            if numbers > 4 * MAX_NUMBERS {
                return Err(format!(
                    "expected a network of less than {} numbers between its layers",
                    4 * MAX_NUMBERS
                ));
            }
            values[*output] = Some(value);
        }
        let found: Option<Vec<_>> =
            self.outputs.iter().map(|slot| Some(values[*slot].as_ref()?.rows())).collect();
        found.ok_or_else(|| "expected operations that lead to each output".to_owned())
    }
}

enum Problem {
    Broken(Broken),
    Unknown(String),
}

impl From<Broken> for Problem {
    fn from(broken: Broken) -> Self {
        Self::Broken(broken)
    }
}

fn unknown(problem: impl Into<String>) -> Problem {
    Problem::Unknown(problem.into())
}

fn read(bytes: &[u8]) -> Result<Network, Problem> {
    let model = Bytes(bytes).root()?;
    let codes: Vec<Code> = model
        .tables(1)?
        .iter()
        // Operators up to 126 stand in the first field of old files.
        .map(|code| Ok(Code { number: code.int(3, 0)?.max(i32::from(code.byte(0)?)), name: code.bytes(1)? }))
        .collect::<Result<_, Broken>>()?;
    let buffers = model.tables(4)?;
    let graphs = model.tables(2)?;
    let [graph] = graphs.as_slice() else {
        return Err(unknown(format!("expected one graph, found {}", graphs.len())));
    };
    let tensors: Vec<Described> =
        graph.tables(0)?.iter().map(|tensor| described(tensor, &buffers)).collect::<Result<_, _>>()?;
    let slot = |index: i32| {
        usize::try_from(index).ok().filter(|index| *index < tensors.len()).ok_or_else(|| {
            unknown(format!("expected one of {} tensors, found number {index}", tensors.len()))
        })
    };
    let inputs = graph.ints(1)?;
    let [input] = inputs.as_slice() else {
        return Err(unknown(format!("expected one input, found {}", inputs.len())));
    };
    let input_slot = slot(*input)?;
    let input = shape_of(&tensors[input_slot].shape)?;
    let numbers = input.iter().try_fold(1_usize, |numbers, size| numbers.checked_mul(*size));
    if !numbers.is_some_and(|numbers| (1..=MAX_NUMBERS).contains(&numbers)) {
        let [channels, height, width] = input;
        return Err(unknown(format!(
            "input: expected a small picture, found {width}x{height} of {channels} channels"
        )));
    }
    let operators = graph.tables(3)?;
    if operators.len() > MAX_OPERATIONS {
        let found = operators.len();
        return Err(unknown(format!("expected at most {MAX_OPERATIONS} operations, found {found}")));
    }
    // Weights in half precision pass through operations that widen them.
    let mut constants: Vec<Option<Vec<f32>>> =
        tensors.iter().map(Described::floats).collect::<Result<_, _>>()?;
    let mut operands: Vec<Option<Map>> = vec![None; tensors.len()];
    let mut operations = Vec::new();
    for operator in &operators {
        let code = usize::try_from(operator.int(0, 0)?).ok().and_then(|index| codes.get(index)).copied();
        let code = code.ok_or_else(|| unknown("expected operations that the file lists"))?;
        let inputs: Vec<usize> = operator.ints(1)?.into_iter().map(slot).collect::<Result<_, _>>()?;
        let outputs = operator.ints(2)?;
        let [output] = outputs.as_slice() else {
            return Err(unknown(format!("expected operations of one output, found {}", outputs.len())));
        };
        let output = slot(*output)?;
        if code.number == operation::DEQUANTIZE {
            let widened = inputs.first().and_then(|input| constants[*input].take());
            constants[output] = Some(widened.ok_or_else(|| unknown("expected weights as 16-bit numbers"))?);
            continue;
        }
        let parameters = Parameters { tensors: &tensors, constants: &constants, inputs: &inputs };
        let (options, custom_options) = (operator.table(4)?, operator.bytes(5)?);
        let operation = Stored { code, options, custom_options, parameters }.read()?;
        let mut variables = Vec::new();
        for input in inputs {
            match &constants[input] {
                None if tensors[input].kind == FLOAT32 => variables.push(input),
                Some(numbers) if operation.takes_constants() => {
                    let shape = shape_of(&tensors[input].shape)?;
                    let map = Map::of_rows(shape, numbers).map_err(unknown)?;
                    operands[input] = Some(map);
                    variables.push(input);
                }
                _ => {}
            }
        }
        operations.push(Step { operation, inputs: variables, output });
    }
    let outputs = graph.ints(2)?.into_iter().map(slot).collect::<Result<_, _>>()?;
    Ok(Network { input, input_slot, constants: operands, operations, outputs, output_lens: Vec::new() })
}

fn described<'a>(tensor: &Table<'a>, buffers: &[Table<'a>]) -> Result<Described<'a>, Problem> {
    let shape = tensor.ints(0)?.into_iter().map(|size| usize::try_from(size).unwrap_or(0)).collect();
    let buffer = usize::try_from(tensor.int(2, 0)?).ok().and_then(|index| buffers.get(index));
    let data = buffer.ok_or_else(|| unknown("expected a buffer for each tensor"))?.bytes(0)?;
    if tensor.table(6)?.is_some() {
        return Err(unknown(
            "expected dense weights, found sparse ones: this is another network of MediaPipe's",
        ));
    }
    Ok(Described { shape, kind: tensor.byte(1)?, data })
}

impl Described<'_> {
    /// Numbers that the file holds; `None` for what is computed.
    fn floats(&self) -> Result<Option<Vec<f32>>, Problem> {
        let len: Option<usize> = self.shape.iter().try_fold(1, |len: usize, size| len.checked_mul(*size));
        let size = match self.kind {
            _ if self.data.is_empty() => return Ok(None),
            FLOAT32 => 4,
            FLOAT16 => 2,
            _ => return Ok(None),
        };
        if len.and_then(|len| len.checked_mul(size)) != Some(self.data.len()) {
            let (shape, found) = (&self.shape, self.data.len());
            return Err(unknown(format!("expected numbers for a tensor of {shape:?}, found {found} bytes")));
        }
        Ok(Some(match self.kind {
            FLOAT16 => bytemuck::pod_collect_to_vec::<u8, half::f16>(self.data).to_f32_vec(),
            _ => bytemuck::pod_collect_to_vec(self.data),
        }))
    }
}

/// What an operation is made of.
struct Parameters<'a> {
    tensors: &'a [Described<'a>],
    constants: &'a [Option<Vec<f32>>],
    inputs: &'a [usize],
}

impl Parameters<'_> {
    /// Shape and numbers of an input that the file holds.
    fn constant(&self, position: usize) -> Result<(&[usize], &[f32]), Problem> {
        let found = self.inputs.get(position).and_then(|input| {
            Some((self.tensors[*input].shape.as_slice(), self.constants[*input].as_deref()?))
        });
        let (shape, numbers) =
            found.ok_or_else(|| unknown(format!("expected weights as input {position} of an operation")))?;
        // Widened weights have a shape of their own, which may be another than that of the narrow ones.
        match shape.iter().try_fold(1_usize, |len, size| len.checked_mul(*size)) {
            Some(len) if len == numbers.len() => Ok((shape, numbers)),
            _ => Err(unknown(format!("expected numbers for a tensor of {shape:?}, found {}", numbers.len()))),
        }
    }

    /// The axes of an operation's first input that its second input names.
    fn axes(&self) -> Result<Vec<MapAxis>, Problem> {
        let rank = self.inputs.first().map_or(0, |input| self.tensors[*input].shape.len());
        let axes = self.whole(1)?.into_iter().map(|axis| MapAxis::of(axis, rank));
        axes.collect::<Option<_>>().ok_or_else(|| unknown("expected axes of an array"))
    }

    /// Whole numbers of an input that the file holds.
    fn whole(&self, position: usize) -> Result<Vec<i32>, Problem> {
        let tensor = self.inputs.get(position).map(|input| &self.tensors[*input]);
        match tensor {
            Some(Described { kind: INT32, data, .. }) if data.len() % 4 == 0 => {
                Ok(bytemuck::pod_collect_to_vec(data))
            }
            _ => Err(unknown(format!("expected whole numbers as input {position} of an operation"))),
        }
    }
}

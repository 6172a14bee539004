//! What the operations compute.

use srflow_ops::Activation;
use srflow_ops::MapShape;
use srflow_ops::conv2d::{Epilogue, conv2d, conv2d_backward_input};
use srflow_ops::convolution::Conv2dShape;
use srflow_ops::depthwise::depthwise;
use srflow_ops::resize::resize;

use super::element_wise::{concatenated, reshaped, sliced, transposed};
use super::map::{Map, checked};
use super::operation::{Convolution, Edges, Operation, Window};

/// More additions are in no average of a network for persons.
const MAX_ADDITIONS: usize = 1 << 30;

impl Operation {
    pub(super) fn run(&self, inputs: &[&Map]) -> Result<Map, String> {
        match (self, inputs) {
            (Self::Convolution(convolution), [map]) => convolution.convolved(map.shape, &map.numbers),
            (Self::Transposed(convolution), [map]) => convolution.transposed(map.shape, &map.numbers),
            (Self::Depthwise(convolution), [map]) => convolution.depthwise(map.shape, &map.numbers),
            (Self::Maximum(window), [map]) => {
                let (padded, numbers) = window.padded(map.shape, &map.numbers, f32::NEG_INFINITY)?;
                Ok(maxima(padded, &numbers, *window))
            }
            (Self::Average(window), [map]) => averages(map.shape, &map.numbers, *window),
            (Self::Unary(function), [map]) => Ok(function.of_map(map)),
            (Self::Binary(function), [a, b]) => function.of_maps(a, b),
            (Self::PRelu(slopes), [map]) => sloped(map.shape, &map.numbers, slopes),
            (Self::Resize { size, grids }, [map]) => {
                checked(map.shape)?;
                let [channels, height, width] = map.shape;
                let resized = [channels, size[0], size[1]];
                checked(resized)?;
                let shape = MapShape { batch: 1, channels, height, width };
                Map::new(resized, resize(&map.numbers, shape, *size, *grids))
            }
            (Self::Pad(zeros), [map]) => {
                let (shape, numbers) = surrounded(map.shape, &map.numbers, *zeros, 0.0)?;
                Map::new(shape, numbers)
            }
            (Self::Reduce(reduction), [map]) => Ok(reduction.of_map(map)),
            (Self::Transpose, [map]) => Ok(transposed(map)),
            (Self::Slice(parts), [map]) => sliced(map, parts),
            (Self::Reshape(shape), [map]) => reshaped(map, shape),
            (Self::Concatenate { axis }, parts) => concatenated(parts, *axis),
            (_, inputs) => Err(format!("expected another number of inputs, found {}", inputs.len())),
        }
    }
}

fn sloped(shape: [usize; 3], numbers: &[f32], slopes: &[f32]) -> Result<Map, String> {
    if slopes.len() != shape[0] {
        return Err(format!("expected a slope for each of {} channels, found {}", shape[0], slopes.len()));
    }
    let planes = numbers.chunks((shape[1] * shape[2]).max(1)).zip(slopes);
    let sloped = |x: &f32, slope: f32| if *x < 0.0 { x * slope } else { *x };
    let all = planes.flat_map(|(plane, slope)| plane.iter().map(move |x| sloped(x, *slope)));
    Map::new(shape, all.collect())
}

impl Convolution {
    fn check(&self, channels: usize, outputs: usize) -> Result<(), String> {
        let [height, width] = self.window.kernel;
        match self.weights.len() == channels * outputs * height * width {
            true => Ok(()),
            false => Err(format!("expected weights for {channels} channels")),
        }
    }

    fn epilogue(&self) -> Epilogue<'_> {
        let activation = if self.relu { Activation::Relu } else { Activation::Identity };
        Epilogue { bias: Some(&self.bias), activation, ..Epilogue::default() }
    }

    /// Of a map whose edges are those that the window needs.
    fn shape(&self, channels: usize, input: [usize; 2]) -> Conv2dShape {
        Conv2dShape {
            batch: 1,
            in_channels: channels,
            out_channels: self.outputs,
            groups: 1,
            input,
            kernel: self.window.kernel,
            stride: self.window.stride,
            padding: [0, 0],
        }
    }

    fn convolved(&self, shape: [usize; 3], numbers: &[f32]) -> Result<Map, String> {
        let channels = shape[0];
        self.check(channels, self.outputs)?;
        let ([_, height, width], numbers) = self.window.padded(shape, numbers, 0.0)?;
        let shape = self.shape(channels, [height, width]);
        let [height, width] = checked([self.outputs, shape.output()[0], shape.output()[1]])?;
        Map::new([self.outputs, height, width], conv2d(&numbers, &self.weights, &self.epilogue(), &shape))
    }

    fn depthwise(&self, shape: [usize; 3], numbers: &[f32]) -> Result<Map, String> {
        let channels = shape[0];
        self.check(channels, 1)?;
        let ([_, height, width], numbers) = self.window.padded(shape, numbers, 0.0)?;
        let shape = self.shape(channels, [height, width]);
        let shape = Conv2dShape { groups: channels, stride: [1, 1], ..shape };
        let [height, width] = checked([channels, shape.output()[0], shape.output()[1]])?;
        let every = depthwise(&numbers, &self.weights, &self.epilogue(), &shape);
        Ok(strided([channels, height, width], &every, self.window.stride))
    }

    /// Each pixel adds its multiple of the kernel to the output, which is the gradient of a convolution; then the edges are cut off.
    fn transposed(&self, shape: [usize; 3], numbers: &[f32]) -> Result<Map, String> {
        checked(shape)?;
        let [channels, height, width] = shape;
        self.check(channels, self.outputs)?;
        let Window { edges, kernel, stride } = self.window;
        let whole = [0, 1].map(|axis| (shape[axis + 1] - 1) * stride[axis] + kernel[axis]);
        let cut = [0, 1].map(|axis| match edges {
            Edges::Valid => 0,
            Edges::Same => kernel[axis].saturating_sub((shape[axis + 1] - 1) % stride[axis] + 1),
        });
        checked([self.outputs, whole[0], whole[1]])?;
        let convolution =
            Conv2dShape { in_channels: self.outputs, out_channels: channels, ..self.shape(channels, whole) };
        debug_assert_eq!(convolution.output(), [height, width]);
        let sums = conv2d_backward_input(numbers, &self.weights, &convolution);
        let inside = [0, 1].map(|axis| cut[axis] / 2..whole[axis] - (cut[axis] - cut[axis] / 2));
        let [rows, columns] = &inside;
        let mut out = Vec::with_capacity(self.outputs * rows.len() * columns.len());
        for (plane, bias) in sums.chunks(whole[0] * whole[1]).zip(&self.bias) {
            let rows = rows.clone().map(|row| &plane[row * whole[1]..][columns.clone()]);
            out.extend(rows.flatten().map(|sum| sum + bias));
        }
        Map::new([self.outputs, rows.len(), columns.len()], out)
    }
}

impl Window {
    /// Pixels that the edges need before and after rows and columns.
    fn sides(&self, [_, height, width]: [usize; 3]) -> Result<[[usize; 2]; 2], String> {
        let size = [height, width];
        let sides = [0, 1].map(|axis| match self.edges {
            Edges::Valid => [0, 0],
            Edges::Same => {
                let (size, kernel, stride) = (size[axis], self.kernel[axis], self.stride[axis]);
                let needed = (size.div_ceil(stride).saturating_sub(1) * stride + kernel).saturating_sub(size);
                [needed / 2, needed - needed / 2]
            }
        });
        if [0, 1].iter().any(|axis| self.kernel[*axis] > larger(size[*axis], sides[*axis])) {
            let [down, across] = self.kernel;
            return Err(format!("expected a map for a window of {across}x{down}, found {width}x{height}"));
        }
        Ok(sides)
    }

    /// The map with what the edges need around it.
    fn padded(
        &self,
        shape: [usize; 3],
        numbers: &[f32],
        value: f32,
    ) -> Result<([usize; 3], Vec<f32>), String> {
        let [rows, columns] = self.sides(shape)?;
        surrounded(shape, numbers, [[0, 0], rows, columns], value)
    }
}

fn larger(size: usize, sides: [usize; 2]) -> usize {
    size.saturating_add(sides[0]).saturating_add(sides[1])
}

fn surrounded(
    [channels, height, width]: [usize; 3],
    numbers: &[f32],
    [depth, rows, columns]: [[usize; 2]; 3],
    value: f32,
) -> Result<([usize; 3], Vec<f32>), String> {
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
fn strided([channels, height, width]: [usize; 3], numbers: &[f32], [down, across]: [usize; 2]) -> Map {
    let shape = [channels, height.div_ceil(down), width.div_ceil(across)];
    let rows = numbers.chunks(width.max(1)).enumerate().filter(|(row, _)| row % height % down == 0);
    let numbers = rows.flat_map(|(_, row)| row.iter().step_by(across)).copied().collect();
    Map { shape, numbers }
}

fn maxima([channels, height, width]: [usize; 3], numbers: &[f32], window: Window) -> Map {
    let ([kh, kw], [sh, sw]) = (window.kernel, window.stride);
    let (out_height, out_width) = ((height - kh) / sh + 1, (width - kw) / sw + 1);
    let mut out = Vec::with_capacity(channels * out_height * out_width);
    for plane in numbers.chunks(height * width) {
        for (y, x) in (0..out_height).flat_map(|y| (0..out_width).map(move |x| (y * sh, x * sw))) {
            let rows = (y..y + kh).flat_map(|row| &plane[row * width + x..row * width + x + kw]);
            out.push(rows.copied().fold(f32::NEG_INFINITY, f32::max));
        }
    }
    Map { shape: [channels, out_height, out_width], numbers: out }
}

fn averages(shape: [usize; 3], numbers: &[f32], window: Window) -> Result<Map, String> {
    checked(shape)?;
    let sides = window.sides(shape)?;
    // The pixels of each output along an axis.
    let [rows, columns] = [0, 1].map(|axis| {
        let (size, kernel, stride) = (shape[axis + 1], window.kernel[axis], window.stride[axis]);
        let first = 0..=larger(size, sides[axis]) - kernel;
        let inside = move |first: usize| {
            first.saturating_sub(sides[axis][0])..(first + kernel - sides[axis][0]).min(size)
        };
        first.step_by(stride).map(inside).collect::<Vec<_>>()
    });
    let taps = |ranges: &[std::ops::Range<usize>]| ranges.iter().map(ExactSizeIterator::len).sum::<usize>();
    let additions = shape[0].saturating_mul(taps(&rows)).saturating_mul(taps(&columns));
    if additions > MAX_ADDITIONS {
        return Err(format!("expected averages of at most {MAX_ADDITIONS} additions, found {additions}"));
    }
    let mut out = Vec::with_capacity(shape[0] * rows.len() * columns.len());
    for plane in numbers.chunks(shape[1] * shape[2]) {
        for (rows, columns) in rows.iter().flat_map(|rows| columns.iter().map(move |columns| (rows, columns)))
        {
            let sums = rows.clone().map(|row| plane[row * shape[2]..][columns.clone()].iter().sum::<f32>());
            out.push(sums.sum::<f32>() / (rows.len() * columns.len()) as f32);
        }
    }
    Map::new([shape[0], rows.len(), columns.len()], out)
}

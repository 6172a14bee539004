//! The definition: plain loops, sums in f64.

use super::{Conv2dShape, Epilogue};

/// Calls `visit(out_channel, in_channel, tap, input_index, output_index)` for each product of the convolution;
/// both indices are those of the whole buffers.
fn each_product(shape: &Conv2dShape, mut visit: impl FnMut(usize, usize, usize, usize, usize)) {
    let s = shape;
    let [height, width] = s.input;
    let [out_height, out_width] = s.output();
    for n in 0..s.batch {
        for o in 0..s.out_channels {
            for y in 0..out_height {
                for x in 0..out_width {
                    let output = ((n * s.out_channels + o) * out_height + y) * out_width + x;
                    for c in 0..s.in_channels {
                        for tap in 0..s.taps() {
                            let row = y * s.stride[0] + tap / s.kernel[1];
                            let column = x * s.stride[1] + tap % s.kernel[1];
                            let (Some(row), Some(column)) =
                                (row.checked_sub(s.padding[0]), column.checked_sub(s.padding[1]))
                            else {
                                continue;
                            };
                            if row < height && column < width {
                                let input = ((n * s.in_channels + c) * height + row) * width + column;
                                visit(o, c, tap, input, output);
                            }
                        }
                    }
                }
            }
        }
    }
}

fn to_f32(sums: Vec<f64>) -> Vec<f32> {
    sums.into_iter().map(|x| x as f32).collect()
}

/// See [`super::conv2d`].
pub fn conv2d(input: &[f32], weight: &[f32], epilogue: &Epilogue, shape: &Conv2dShape) -> Vec<f32> {
    let mut sums = vec![0.0; shape.output_len()];
    each_product(shape, |o, c, tap, input_index, output_index| {
        let weight = weight[(o * shape.in_channels + c) * shape.taps() + tap];
        sums[output_index] += f64::from(weight) * f64::from(input[input_index]);
    });
    let [height, width] = shape.output();
    finish(sums, epilogue, height * width)
}

/// Applies the epilogue to planes of `pixels` elements.
pub(crate) fn finish(sums: Vec<f64>, epilogue: &Epilogue, pixels: usize) -> Vec<f32> {
    let finish = |(i, sum): (usize, f64)| {
        let bias = epilogue.bias.map_or(0.0, |bias| bias[i / pixels % bias.len()]);
        let residual = epilogue.residual.map_or(0.0, |residual| residual[i]);
        epilogue.activation.reference(sum + f64::from(bias) + f64::from(residual)) as f32
    };
    sums.into_iter().enumerate().map(finish).collect()
}

/// See [`super::conv2d_backward_input`].
pub fn conv2d_backward_input(grad: &[f32], weight: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    let mut out = vec![0.0; shape.input_len()];
    each_product(shape, |o, c, tap, input_index, output_index| {
        let weight = weight[(o * shape.in_channels + c) * shape.taps() + tap];
        out[input_index] += f64::from(weight) * f64::from(grad[output_index]);
    });
    to_f32(out)
}

/// See [`super::conv2d_backward_weight`].
pub fn conv2d_backward_weight(input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    let mut out = vec![0.0; shape.weight_len()];
    each_product(shape, |o, c, tap, input_index, output_index| {
        out[(o * shape.in_channels + c) * shape.taps() + tap] +=
            f64::from(input[input_index]) * f64::from(grad[output_index]);
    });
    to_f32(out)
}

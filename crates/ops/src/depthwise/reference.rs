//! The definition: plain loops, sums in f64.

use super::DepthwiseShape;
use crate::conv2d::Epilogue;
use crate::conv2d::reference::finish;

/// Calls `visit(weight_index, input_index, output_index)` for each product of the convolution.
fn each_product(shape: &DepthwiseShape, mut visit: impl FnMut(usize, usize, usize)) {
    let [height, width] = shape.input;
    let [out_height, out_width] = shape.output();
    let [kernel_height, kernel_width] = shape.kernel;
    for plane in 0..shape.batch * shape.channels {
        for output in 0..out_height * out_width {
            for tap in 0..kernel_height * kernel_width {
                let row = (output / out_width + tap / kernel_width).checked_sub(shape.padding[0]);
                let column = (output % out_width + tap % kernel_width).checked_sub(shape.padding[1]);
                if let (Some(row), Some(column)) = (row, column)
                    && row < height
                    && column < width
                {
                    visit(
                        plane % shape.channels * kernel_height * kernel_width + tap,
                        (plane * height + row) * width + column,
                        plane * out_height * out_width + output,
                    );
                }
            }
        }
    }
}

fn to_f32(sums: Vec<f64>) -> Vec<f32> {
    sums.into_iter().map(|x| x as f32).collect()
}

/// See [`super::depthwise`].
pub fn depthwise(input: &[f32], weight: &[f32], epilogue: &Epilogue, shape: &DepthwiseShape) -> Vec<f32> {
    let [height, width] = shape.output();
    let mut sums = vec![0.0; shape.output_len()];
    each_product(shape, |w, i, o| sums[o] += f64::from(weight[w]) * f64::from(input[i]));
    finish(sums, epilogue, height * width)
}

/// See [`super::depthwise_backward_input`].
pub fn depthwise_backward_input(grad: &[f32], weight: &[f32], shape: &DepthwiseShape) -> Vec<f32> {
    let mut out = vec![0.0; shape.input_len()];
    each_product(shape, |w, i, o| out[i] += f64::from(weight[w]) * f64::from(grad[o]));
    to_f32(out)
}

/// See [`super::depthwise_backward_weight`].
pub fn depthwise_backward_weight(input: &[f32], grad: &[f32], shape: &DepthwiseShape) -> Vec<f32> {
    let mut out = vec![0.0; shape.weight_len()];
    each_product(shape, |w, i, o| out[w] += f64::from(input[i]) * f64::from(grad[o]));
    to_f32(out)
}

//! Maps one after another in their channels. Burn copies them on one core, which at full size took a tenth of a small network's time.

use burn::tensor::Tensor;
use srflow_simd::fill_pieces;

use crate::flex::CpuTensor;

/// `Tensor::cat` of maps `[batch, channels, height, width]` along their channels, on all cores where they are on the CPU and outside a
/// graph. Panics when there are none, or their other sizes differ.
pub fn concatenate(maps: Vec<Tensor<4>>) -> Tensor<4> {
    let size = |map: &Tensor<4>| {
        let [batch, _, height, width] = map.dims();
        [batch, height, width]
    };
    let fit = maps.windows(2).all(|pair| size(&pair[0]) == size(&pair[1]));
    let parts: Option<Vec<CpuTensor>> = maps.iter().map(CpuTensor::of).collect();
    let Some(parts) = parts.filter(|parts| fit && parts.len() > 1) else { return Tensor::cat(maps, 1) };

    let [batch, height, width] = size(&maps[0]);
    let parts: Vec<(usize, &[f32])> =
        parts.iter().map(|part| (part.map_shape().channels, part.slice())).collect();
    let channels: usize = parts.iter().map(|(channels, _)| channels).sum();
    let pixels = height * width;
    let plane = |image: usize, mut channel: usize| {
        for &(channels, values) in &parts {
            if channel < channels {
                return &values[(image * channels + channel) * pixels..][..pixels];
            }
            channel -= channels;
        }
        unreachable!("channel {channel} more than there are")
    };
    let values = fill_pieces(
        batch * channels * pixels,
        pixels,
        || (),
        |(), number, out| out.write_copy_of_slice(plane(number / channels, number % channels)),
    );
    CpuTensor::new(values, [batch, channels, height, width]).into_tensor()
}

#[cfg(test)]
mod tests {
    use crate::golden::numbers;
    use burn::tensor::{Device, TensorData};

    use super::*;
    use crate::test_values::values;

    fn maps(dims: [usize; 4], device: &Device) -> Tensor<4> {
        Tensor::from_data(TensorData::new(values(dims.iter().product(), dims[1] as u32), dims), device)
    }

    #[test]
    fn it_is_burns_concatenation_on_the_cpu_and_in_a_graph() {
        for device in [Device::flex(), Device::flex().autodiff()] {
            for channels in [vec![3, 1, 5], vec![4], vec![0, 2], vec![2, 2]] {
                let parts: Vec<_> =
                    channels.iter().map(|&channels| maps([2, channels, 5, 7], &device)).collect();
                let expected = Tensor::cat(parts.clone(), 1);
                let found = concatenate(parts);
                assert_eq!(found.dims(), expected.dims(), "{channels:?}");
                assert_eq!(numbers(found), numbers(expected), "{channels:?}");
            }
        }
    }

    #[test]
    fn parts_of_tensors_are_read_from_where_they_begin() {
        let whole = maps([2, 6, 4, 3], &Device::flex());
        let parts =
            vec![whole.clone().narrow(1, 2, 3), whole.swap_dims(2, 3).swap_dims(2, 3).narrow(1, 0, 2)];
        assert_eq!(numbers(concatenate(parts.clone())), numbers(Tensor::cat(parts, 1)));
    }

    #[test]
    fn gradients_reach_every_part() {
        let device = Device::flex().autodiff();
        let parts = [2, 3].map(|channels| maps([1, channels, 2, 2], &device).require_grad());
        let weights = maps([1, 5, 2, 2], &device);
        let gradients = (concatenate(parts.to_vec()) * weights.clone()).sum().backward();
        let found = parts.map(|part| numbers(part.grad(&gradients).expect("it is used"))).concat();
        assert_eq!(found, numbers(weights));
    }

    #[test]
    #[should_panic(expected = "different shapes")]
    fn maps_of_other_sizes_are_refused() {
        concatenate(vec![maps([1, 2, 3, 4], &Device::flex()), maps([1, 2, 4, 3], &Device::flex())]);
    }
}

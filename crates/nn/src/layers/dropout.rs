use burn::tensor::{Tensor, TensorData};
use srflow_core::random::Stream;

/// Dropout with probability one half: sets random values to zero and doubles the others. Without a stream, returns `x`.
///
/// The mask does not come from the backend's generator, so it does not depend on what other threads draw.
pub fn dropout<const D: usize>(x: Tensor<D>, stream: Option<&mut Stream>) -> Tensor<D> {
    let Some(stream) = stream else { return x };
    let shape = x.shape();
    let mut mask = Vec::with_capacity(shape.num_elements());
    while mask.len() < shape.num_elements() {
        let bits = stream.bits();
        let values = (0..32).map(|bit| if bits >> bit & 1 == 1 { 2.0_f32 } else { 0.0 });
        mask.extend(values.take(shape.num_elements() - mask.len()));
    }
    let mask = Tensor::from_data(TensorData::new(mask, shape), &x.device());
    x * mask
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;
    use srflow_core::random::Key;

    use super::*;

    #[test]
    fn half_of_the_values_are_dropped_and_the_others_doubled() {
        let x = Tensor::<2>::ones([100, 101], &Device::flex());
        let mut stream = Key::new(1).stream("test");
        let dropped = dropout(x.clone(), Some(&mut stream));
        let values: Vec<f32> = dropped.into_data().try_to_vec().unwrap();
        assert!(values.iter().all(|&value| value == 0.0 || value == 2.0));
        let kept = values.iter().filter(|&&value| value > 0.0).count();
        assert!((4_800..5_300).contains(&kept), "{kept} of 10100");
        let kept: Vec<f32> = dropout(x, None).into_data().try_to_vec().unwrap();
        assert!(kept.iter().all(|&value| value == 1.0));
    }
}

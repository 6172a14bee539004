//! Converts names and memory order of TensorFlow and Keras to those of PyTorch.

/// Suffixes of optimizer slots and moving averages of a variable.
const OF_OPTIMIZERS: [&str; 8] =
    ["Adam", "Adam_1", "Momentum", "RMSProp", "RMSProp_1", "Adagrad", "Adadelta", "ExponentialMovingAverage"];

/// Name in PyTorch, such as `net.conv1.weight` for `net/conv1/kernel` (or `kernel:0`); `None` for optimizer state.
pub(in crate::checkpoint) fn reference_name(name: &str) -> Option<String> {
    let (owner, last) = name.rsplit_once('/').unwrap_or(("", name));
    let last = last.split_once(':').map_or(last, |(last, _)| last);
    if OF_OPTIMIZERS.contains(&last) || ["beta1_power", "beta2_power"].contains(&last) {
        return None;
    }
    let last = match last {
        "kernel" | "gamma" => "weight",
        "beta" => "bias",
        "moving_mean" => "running_mean",
        "moving_variance" => "running_var",
        other => other,
    };
    let owner = owner.replace('/', ".");
    Some(if owner.is_empty() { last.to_owned() } else { format!("{owner}.{last}") })
}

/// Shape in PyTorch: a kernel `[height, width, inputs, outputs]` becomes `[outputs, inputs, height, width]`, that of a transposed
/// convolution `[height, width, outputs, inputs]` becomes `[inputs, outputs, height, width]`; matrices are transposed.
pub(in crate::checkpoint) fn reference_shape(stored: &[usize]) -> Vec<usize> {
    match *stored {
        [height, width, third, fourth] => vec![fourth, third, height, width],
        [inputs, outputs] => vec![outputs, inputs],
        _ => stored.to_vec(),
    }
}

/// Reorders the values of a tensor, each of `number` bytes, to the order of [`reference_shape`].
pub(in crate::checkpoint) fn reference_order(bytes: Vec<u8>, stored: &[usize], number: usize) -> Vec<u8> {
    let (taps, third, fourth) = match *stored {
        [height, width, third, fourth] => (height * width, third, fourth),
        [inputs, outputs] => (1, inputs, outputs),
        _ => return bytes,
    };
    if bytes.is_empty() {
        return bytes;
    }
    let mut ordered = Vec::with_capacity(bytes.len());
    for (o, i) in (0..fourth).flat_map(|o| (0..third).map(move |i| (o, i))) {
        for tap in 0..taps {
            let at = ((tap * third + i) * fourth + o) * number;
            ordered.extend_from_slice(&bytes[at..at + number]);
        }
    }
    ordered
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_pytorchs() {
        let cases = [
            ("net1/features/conv1/kernel", Some("net1.features.conv1.weight")),
            ("conv1/bias:0", Some("conv1.bias")),
            ("a/bn/moving_variance", Some("a.bn.running_var")),
            ("a/bn/gamma", Some("a.bn.weight")),
            ("step", Some("step")),
            ("a/kernel/Adam_1", None),
            ("beta1_power", None),
        ];
        for (name, expected) in cases {
            assert_eq!(reference_name(name).as_deref(), expected, "{name}");
        }
    }

    #[test]
    fn kernels_are_transposed() {
        let stored = [1, 2, 3, 2]; // [height, width, inputs, outputs]
        assert_eq!(reference_shape(&stored), [2, 3, 1, 2]);
        let bytes: Vec<u8> = (0..12).collect();
        // First output, first input: both taps, values 0 and 6.
        assert_eq!(reference_order(bytes, &stored, 1), [0, 6, 2, 8, 4, 10, 1, 7, 3, 9, 5, 11]);
        assert_eq!(reference_order(vec![0, 1, 2, 3, 4, 5], &[3, 2], 1), [0, 2, 4, 1, 3, 5]);
        assert_eq!(reference_order(vec![7, 8, 9], &[3], 1), [7, 8, 9]);
    }
}

//! Devices by name.

use burn::tensor::Device;
#[cfg(feature = "cube")]
use burn::tensor::DeviceType;
use srflow_simd::{DeviceError, DeviceName};

#[cfg(all(feature = "cube", not(any(feature = "cuda", feature = "vulkan"))))]
compile_error!("the feature `cube` is the common part of `cuda` and `vulkan`: turn on one of these");

/// A device of this machine: `cpu`, `cuda` or `vulkan`, or one of several as `cuda:1`; by default the first. Vulkan's devices are
/// ordered discrete, integrated, virtual, software.
pub fn device(name: &str) -> Result<Device, DeviceError> {
    let name = DeviceName::parse(name)?;
    let devices = match name.kind {
        #[cfg(feature = "cuda")]
        "cuda" => Device::enumerate(DeviceType::Cuda).into_vec(),
        #[cfg(feature = "vulkan")]
        "vulkan" => Device::enumerate(DeviceType::Vulkan).into_vec(),
        _ => vec![Device::flex()],
    };
    name.pick(devices)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_is_always_there_and_there_is_one() {
        assert_eq!(device("cpu"), Ok(Device::flex()));
        assert_eq!(device("cpu:0"), Ok(Device::flex()));
        let error = device("cpu:1").expect_err("one processor").to_string();
        assert!(error.contains("1 cpu devices"), "{error}");
    }
}

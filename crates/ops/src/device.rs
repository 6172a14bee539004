//! Devices by name.

use burn::tensor::Device;
#[cfg(feature = "cube")]
use burn::tensor::DeviceType;

#[cfg(all(feature = "cube", not(any(feature = "cuda", feature = "vulkan"))))]
compile_error!("the feature `cube` is the common part of `cuda` and `vulkan`: turn on one of these");

/// Every kind of device, and whether this build supports it.
const KINDS: [(&str, bool); 3] =
    [("cpu", true), ("cuda", cfg!(feature = "cuda")), ("vulkan", cfg!(feature = "vulkan"))];

/// Why a device is not available.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// Unknown name.
    #[error(
        "unknown device {name:?}: expected one of {}, optionally with a number, as in cuda:1",
        KINDS.map(|(kind, _)| kind).join(", ")
    )]
    Unknown { name: String },
    /// This build does not support this kind of device.
    #[error(
        "this build does not support {kind}, only {}: build with `--features {kind}`",
        device_kinds().join(", ")
    )]
    NotBuilt { kind: &'static str },
    /// The machine does not have this device.
    #[error("{name}: the drivers list {found} {kind} devices on this machine; cpu is always available")]
    NotFound {
        name: String,
        kind: &'static str,
        /// Number of devices of this kind.
        found: usize,
    },
}

/// The kinds of devices that this build supports: `cpu`, then those enabled as features.
pub fn device_kinds() -> Vec<&'static str> {
    KINDS.into_iter().filter(|&(_, built)| built).map(|(kind, _)| kind).collect()
}

/// A device of this machine: `cpu`, `cuda` or `vulkan`, or one of several as `cuda:1`; by default the first. Vulkan's devices are
/// ordered discrete, integrated, virtual, software.
pub fn device(name: &str) -> Result<Device, DeviceError> {
    let unknown = || DeviceError::Unknown { name: name.to_owned() };
    let (kind, number) = name.split_once(':').unwrap_or((name, "0"));
    let number: usize = number.parse().map_err(|_| unknown())?;
    let (kind, built) = KINDS.into_iter().find(|(known, _)| *known == kind).ok_or_else(unknown)?;
    if !built {
        return Err(DeviceError::NotBuilt { kind });
    }
    let devices = devices(kind);
    let found = devices.len();
    devices.into_iter().nth(number).ok_or_else(|| DeviceError::NotFound {
        name: name.to_owned(),
        kind,
        found,
    })
}

fn devices(kind: &str) -> Vec<Device> {
    match kind {
        #[cfg(feature = "cuda")]
        "cuda" => Device::enumerate(DeviceType::Cuda).into_vec(),
        #[cfg(feature = "vulkan")]
        "vulkan" => Device::enumerate(DeviceType::Vulkan).into_vec(),
        _ => vec![Device::flex()],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_is_always_there_and_there_is_one() {
        assert_eq!(device("cpu"), Ok(Device::flex()));
        assert_eq!(device("cpu:0"), Ok(Device::flex()));
        let error = device("cpu:1").expect_err("one processor");
        assert_eq!(error, DeviceError::NotFound { name: "cpu:1".into(), kind: "cpu", found: 1 });
    }

    #[test]
    fn other_names_are_told_what_there_is() {
        for name in ["", "gpu", "cuda:", "cuda:first", "cpu:-1", "CPU"] {
            let error = device(name).expect_err(name);
            assert!(error.to_string().contains("cpu, cuda, vulkan"), "{error}");
        }
    }

    #[test]
    fn a_kind_that_was_not_built_names_its_feature() {
        for (kind, built) in KINDS {
            if !built {
                let message = device(kind).expect_err(kind).to_string();
                assert!(message.contains(&format!("--features {kind}")), "{message}");
            }
        }
    }
}

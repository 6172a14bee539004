//! Devices by name: `cpu`, `cuda` or `vulkan`, or one of several as `cuda:1`.

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

/// A name of a kind that this build supports.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceName {
    /// One of [`device_kinds`].
    pub kind: &'static str,
    name: String,
    number: usize,
}

impl DeviceName {
    /// # Errors
    /// When the name is not of the form `KIND` or `KIND:NUMBER`, or this build does not support the kind.
    pub fn parse(name: &str) -> Result<Self, DeviceError> {
        let unknown = || DeviceError::Unknown { name: name.to_owned() };
        let (kind, number) = name.split_once(':').unwrap_or((name, "0"));
        let number = number.parse().map_err(|_| unknown())?;
        let (kind, built) = KINDS.into_iter().find(|(known, _)| *known == kind).ok_or_else(unknown)?;
        if built {
            Ok(Self { kind, name: name.to_owned(), number })
        } else {
            Err(DeviceError::NotBuilt { kind })
        }
    }

    /// The named one of this machine's devices of the kind, in the order in which they are numbered.
    ///
    /// # Errors
    /// When there are too few.
    pub fn pick<D>(self, devices: Vec<D>) -> Result<D, DeviceError> {
        let found = devices.len();
        let Self { kind, name, number } = self;
        devices.into_iter().nth(number).ok_or(DeviceError::NotFound { name, kind, found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_device_has_the_number_0() {
        let pick = |name| DeviceName::parse(name).and_then(|name| name.pick(vec!["first", "second"]));
        assert_eq!((pick("cpu"), pick("cpu:0"), pick("cpu:1")), (Ok("first"), Ok("first"), Ok("second")));
        let error = pick("cpu:2").expect_err("there are two");
        assert_eq!(error, DeviceError::NotFound { name: "cpu:2".into(), kind: "cpu", found: 2 });
    }

    #[test]
    fn other_names_are_answered_with_the_kinds() {
        for name in ["", "gpu", "cuda:", "cuda:first", "cpu:-1", "CPU"] {
            let error = DeviceName::parse(name).expect_err(name);
            assert!(error.to_string().contains("cpu, cuda, vulkan"), "{error}");
        }
    }

    #[test]
    fn a_kind_that_was_not_built_names_its_feature() {
        for (kind, built) in KINDS {
            if !built {
                let message = DeviceName::parse(kind).expect_err(kind).to_string();
                assert!(message.contains(&format!("--features {kind}")), "{message}");
            }
        }
    }
}

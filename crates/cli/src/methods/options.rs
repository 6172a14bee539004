//! Methods of programs that use this crate as a library, with the options of the command line.

use std::ffi::OsString;

use srflow_core::FlowEstimator;

use super::{Method, MethodParameters, MethodSpec, estimator};
use crate::library::parsed;
use crate::usage::UsageError;

/// A method as `srflow flow --method METHOD` takes it, with the options of that command, as in `--tile=auto`. Without a name, the one
/// that the command takes.
///
/// # Errors
/// [`UsageError`] when there is no such method or option, or its value is wrong; otherwise when weights cannot be loaded.
pub fn estimator_of(
    method: Option<&str>,
    options: impl IntoIterator<Item = OsString>,
) -> anyhow::Result<Box<dyn FlowEstimator>> {
    let spec = match method {
        Some(method) => method.parse().map_err(UsageError)?,
        None => MethodSpec::from(Method::DEFAULT),
    };
    let parameters: MethodParameters = parsed("srflow flow", options)?;
    estimator(&spec, &parameters)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_those_of_the_command_line() {
        let of =
            |method: &str, options: &[&str]| estimator_of(Some(method), options.iter().map(OsString::from));
        assert_eq!(estimator_of(None, []).unwrap().name(), "srflow");
        assert_eq!(of("tvl1", &["--warps=2", "--refine"]).unwrap().name(), "tvl1");
        for (method, options, message) in [
            ("pwc", &[][..], "unknown method `pwc`; the methods are farneback, tvl1, srflow"),
            ("tvl1", &["--wraps=2"], "unexpected argument '--wraps' found"),
            ("tvl1", &["--warps=x"], "invalid value 'x' for '--warps <N>'"),
            ("tvl1", &["--iters=2"], "--iters is for networks"),
            ("raft", &[], "raft needs weights"),
        ] {
            let error = of(method, options).err().unwrap();
            assert!(error.is::<UsageError>(), "{error}");
            assert!(error.to_string().starts_with(message), "{error}");
            assert!(!error.to_string().contains("Usage"), "{error}");
        }
    }
}

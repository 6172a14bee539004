//! Methods of programs that use this crate as a library, with the options of the command line.

use clap::{Parser, error::ErrorKind};
use srflow_field::FlowEstimator;

use super::{Method, MethodParameters, MethodSpec, estimator};
use crate::usage::UsageError;

/// The options of a method alone.
#[derive(Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Options {
    #[command(flatten)]
    parameters: MethodParameters,
}

/// A method as `srflow flow --method METHOD` takes it, with the options of that command, as in `--tile=auto`. Without a name, the one
/// that the command takes.
///
/// # Errors
/// [`UsageError`] when there is no such method or option, or its value is wrong; otherwise when weights cannot be loaded.
pub fn estimator_of(
    method: Option<&str>,
    options: impl IntoIterator<Item = String>,
) -> anyhow::Result<Box<dyn FlowEstimator>> {
    let spec = match method {
        Some(method) => method.parse().map_err(UsageError)?,
        None => MethodSpec::from(Method::DEFAULT),
    };
    let options = Options::try_parse_from(options).map_err(|error| UsageError(in_short(&error)))?;
    estimator(&spec, &options.parameters)
}

/// What is wrong, without the usage of a command.
fn in_short(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let text = text.split("\n\nUsage:").next().unwrap_or(&text);
    let text = text.split("\n\nFor more information").next().unwrap_or(text);
    let text = text.strip_prefix("error: ").unwrap_or(text).trim_end();
    match error.kind() {
        ErrorKind::UnknownArgument => format!("{text}; `srflow flow --help` lists the options of methods"),
        _ => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_those_of_the_command_line() {
        let of = |method: &str, options: &[&str]| {
            estimator_of(Some(method), options.iter().map(ToString::to_string))
        };
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

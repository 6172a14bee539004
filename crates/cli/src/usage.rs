//! Errors in the arguments, in the words of the command line.

use srflow::{Error, ErrorKind};

/// Whether the arguments are wrong: the program then exits with code 2.
pub fn is_wrong_usage(error: &anyhow::Error) -> bool {
    error.downcast_ref::<Error>().is_some_and(|error| error.kind() == ErrorKind::Setting)
        || srflow::error::is_wrong_settings(error)
}

/// The error with settings as options: `` `stop_after` `` becomes `--stop-after` where the command has that option.
pub fn in_options(error: &anyhow::Error, options: &[String]) -> String {
    let setting = error.downcast_ref::<Error>().and_then(Error::setting);
    let text = match setting.or_else(|| error.chain().find_map(|cause| cause.downcast_ref())) {
        Some(setting) => format!("`{}` {}: expected {}", setting.name(), setting.found, setting.expected),
        None => srflow::error::in_words(error),
    };
    options.iter().fold(text, |text, option| {
        text.replace(&format!("`{}`", option.replace('-', "_")), &format!("--{option}"))
    })
}

//! Settings in the words of the command line: their options, their defaults, and errors in them.

use clap::{ArgMatches, Command};
use serde_json::Value;
use srflow::{Error, ErrorKind};

/// Whether the arguments are wrong: the program then exits with code 2.
pub fn is_wrong_usage(error: &anyhow::Error) -> bool {
    error.downcast_ref::<Error>().is_some_and(|error| error.kind() == ErrorKind::Setting)
        || srflow::error::is_wrong_settings(error)
}

/// The words of the command that was given, without the program's.
pub fn path(matches: &ArgMatches) -> Vec<String> {
    std::iter::successors(matches.subcommand(), |(_, matches)| matches.subcommand())
        .map(|(name, _)| name.to_owned())
        .collect()
}

/// The long options of the command at `path`, without hyphens in front.
pub fn options(command: &Command, path: &[String]) -> Vec<String> {
    let leaf = path.iter().try_fold(command, |command, name| command.find_subcommand(name));
    let arguments = leaf.into_iter().flat_map(Command::get_arguments);
    arguments.filter_map(|argument| argument.get_long().map(str::to_owned)).collect()
}

/// The command line with other defaults for the command at `path`.
pub fn with_defaults(command: Command, path: &[String], defaults: &Value) -> Command {
    let Some((name, rest)) = path.split_first() else {
        return command.mut_args(|argument| match defaults.get(argument.get_id().as_str()) {
            Some(Value::String(text)) => argument.default_value(text.clone()),
            Some(Value::Number(number)) => argument.default_value(number.to_string()),
            Some(Value::Array(values)) => {
                let texts: Vec<String> = values.iter().map(Value::to_string).collect();
                argument.default_value(texts.join(","))
            }
            _ => argument,
        });
    };
    command.mut_subcommand(name, |command| with_defaults(command, rest, defaults))
}

/// The error with settings as options: `` `stop_after` `` becomes `--stop-after` where the command has that option.
pub fn in_options(error: &anyhow::Error, options: &[String]) -> String {
    let setting = error.downcast_ref::<Error>().and_then(Error::setting);
    let text = match setting.or_else(|| error.chain().find_map(|cause| cause.downcast_ref())) {
        Some(setting) => format!("`{}` {}: expected {}", setting.name(), setting.found, setting.expected),
        None => srflow::error::in_words(error),
    };
    with_options(text, options)
}

/// The text with settings as options.
pub fn with_options(text: String, options: &[String]) -> String {
    options.iter().fold(text, |text, option| {
        text.replace(&format!("`{}`", option.replace('-', "_")), &format!("--{option}"))
    })
}

//! The Python package has a function for each job, with its settings as keywords. `SRFLOW_WRITE_REFERENCE=1` writes them.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use clap::builder::ValueParser;
use clap::{Arg, ArgAction, Command, value_parser};

const FILE: &str = "../python/srflow/jobs.py";

/// Up to the functions.
const BEGINNING: &str = r#""""Every job of the command `srflow` as a function; its settings are keywords.

`callback` is called with progress: a dict with `done` and `total`, and what the job adds, such as `bytes` or `loss`. When it raises an
exception, or on Ctrl-C, the job stops in order and the exception is raised; the same call continues. Each function returns a
`Report`: a dict as the command prints with `--json`, whose keys are attributes too.

Written from the settings of the jobs by a test, crates/cli/tests/srflow/python_jobs.rs.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Callable, Sequence

from . import _srflow
from ._report import Report

if TYPE_CHECKING:
    Path = str | os.PathLike[str]
    Callback = Callable[[dict[str, Any]], object]


def _run(job: str, settings: dict[str, Any]) -> Report:
    callback = settings.pop("callback")
    return Report(*_srflow.run_job(job, settings, callback))


def _listed(values: Any) -> Any:
    one = isinstance(values, str | os.PathLike | int | float)
    return [values] if one else None if values is None else list(values)
"#;

#[test]
fn the_jobs_of_the_python_package_are_current() {
    let module = module();
    if std::env::var_os("SRFLOW_WRITE_REFERENCE").is_some() {
        fs::write(FILE, &module).unwrap();
    }
    let current = fs::read_to_string(FILE).is_ok_and(|text| text == module);
    assert!(current, "{FILE} is out of date: run this test with SRFLOW_WRITE_REFERENCE=1");
}

fn module() -> String {
    let mut text = BEGINNING.to_owned();
    let mut names: Vec<String> = Vec::new();
    for entry in srflow::JOBS {
        let name = entry.name.replace([' ', '-'], "_");
        text += &function(&name, entry.name, &(entry.command)());
        names.push(format!("\"{name}\""));
    }
    names.sort();
    writeln!(text, "\n\n__all__ = [{}]", names.join(", ")).unwrap();
    text
}

fn function(name: &str, job: &str, command: &Command) -> String {
    let shown = command.get_arguments().filter(|argument| !argument.is_hide_set());
    let (required, optional): (Vec<&Arg>, Vec<&Arg>) = shown.partition(|argument| argument.is_required_set());
    // A job's configuration and output may go without a name.
    let (positional, optional): (Vec<&Arg>, Vec<&Arg>) =
        optional.into_iter().partition(|argument| ["config", "out"].contains(&argument.get_id().as_str()));
    let mut text = format!("\n\ndef {name}(\n");
    for argument in &required {
        writeln!(text, "    {}: {},", argument.get_id(), kind(argument)).unwrap();
    }
    for argument in &positional {
        text += &with_default(argument);
    }
    text += "    *,\n";
    for argument in &optional {
        text += &with_default(argument);
    }
    text += "    callback: Callback | None = None,\n) -> Report:\n";
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    write!(text, "    \"\"\"{}.\n\n    Args:\n", in_docstring(&about)).unwrap();
    let all = || required.iter().chain(&positional).chain(&optional);
    for argument in all() {
        let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
        writeln!(text, "        {}: {}.", keyword(argument), in_docstring(&help)).unwrap();
    }
    text += "        callback: Called with progress.\n    \"\"\"\n";
    let renamed = all().filter(|argument| keyword(argument) != argument.get_id().as_str());
    text += "    settings = locals()\n";
    let lists = all().filter(|argument| kind(argument).contains("Sequence"));
    let lists: Vec<String> = lists.map(|argument| format!("\"{}\"", keyword(argument))).collect();
    if !lists.is_empty() {
        let comma = if lists.len() == 1 { "," } else { "" };
        writeln!(text, "    for name in ({}{comma}):", lists.join(", ")).unwrap();
        text += "        settings[name] = _listed(settings[name])\n";
    }
    for argument in renamed {
        let (name, keyword) = (argument.get_id(), keyword(argument));
        writeln!(text, "    settings[\"{name}\"] = settings.pop(\"{keyword}\")").unwrap();
    }
    writeln!(text, "    return _run({job:?}, settings)").unwrap();
    text
}

fn with_default(argument: &Arg) -> String {
    let (kind, default) = (kind(argument), default(argument));
    let kind = if default == "None" { format!("{kind} | None") } else { kind };
    format!("    {}: {kind} = {default},\n", keyword(argument))
}

fn in_docstring(help: &str) -> String {
    let text = help.split_whitespace().collect::<Vec<_>>().join(" ");
    text.replace('\\', "\\\\").replace("\"\"\"", "'''").trim_end_matches('.').to_owned()
}

/// The name of a setting in Python, whose own words get an underscore.
fn keyword(argument: &Arg) -> String {
    let name = argument.get_id().as_str();
    if ["class", "from", "import", "lambda"].contains(&name) { format!("{name}_") } else { name.to_owned() }
}

fn is_list(argument: &Arg) -> bool {
    matches!(argument.get_action(), ArgAction::Append)
        || argument.get_num_args().is_some_and(|count| count.max_values() > 1)
}

fn kind(argument: &Arg) -> String {
    if matches!(argument.get_action(), ArgAction::SetTrue) {
        return "bool".to_owned();
    }
    let parsers: [(ValueParser, &str); 9] = [
        (value_parser!(u8).into(), "int"),
        (value_parser!(u16).into(), "int"),
        (value_parser!(u32).into(), "int"),
        (value_parser!(u64).into(), "int"),
        (value_parser!(usize).into(), "int"),
        (value_parser!(srflow_head::Look).into(), "int"),
        (value_parser!(f32).into(), "float"),
        (value_parser!(f64).into(), "float"),
        (value_parser!(PathBuf), "Path"),
    ];
    let own = argument.get_value_parser().type_id();
    let known = parsers.iter().find(|(parser, _)| parser.type_id() == own).map(|(_, kind)| *kind);
    let one = known.unwrap_or("str");
    match argument.get_id().as_str() {
        "set" => "dict[str, Any]".to_owned(),
        // An option whose value may be left out.
        _ if argument.get_num_args().is_some_and(|count| count.min_values() == 0) => format!("bool | {one}"),
        _ if is_list(argument) => format!("{one} | Sequence[{one}]"),
        _ => one.to_owned(),
    }
}

fn default(argument: &Arg) -> String {
    let kind = kind(argument);
    let value = argument.get_default_values().first().map(|value| value.to_string_lossy().into_owned());
    match (kind.as_str(), value) {
        ("bool", _) => "False".to_owned(),
        ("int" | "float", Some(value)) => value,
        ("str" | "Path", Some(value)) => format!("{value:?}"),
        _ => "None".to_owned(),
    }
}

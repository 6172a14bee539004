//! docs/reference/commands.md lists every command and option. `SRFLOW_WRITE_REFERENCE=1` writes it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;

use clap::{Arg, Command};

const PAGE: &str = "../../docs/reference/commands.md";

#[test]
fn the_reference_of_commands_is_current() {
    let page = reference();
    if std::env::var_os("SRFLOW_WRITE_REFERENCE").is_some() {
        fs::create_dir_all("../../docs/reference").unwrap();
        fs::write(PAGE, &page).unwrap();
    }
    let current = fs::read_to_string(PAGE).is_ok_and(|text| text == page);
    assert!(current, "{PAGE} is out of date: run this test with SRFLOW_WRITE_REFERENCE=1");
}

fn reference() -> String {
    let mut root = srflow_cli::command();
    root.build();
    let mut page = String::from(
        "# Commands and options\n\nEvery command of `srflow` with all of its options, as `srflow COMMAND --help` shows them. Sizes are \
         WIDTHxHEIGHT.\n\n",
    );
    let mut commands = Vec::new();
    collect(&root, &mut commands);
    page += "| command | purpose |\n|---|---|\n";
    for command in &commands {
        let name = name(command);
        writeln!(page, "| [`{name}`](#{}) | {} |", name.replace(' ', "-"), in_cell(&purpose(command)))
            .unwrap();
    }
    page += "\n## Options of every command\n\n";
    table(&mut page, root.get_arguments().filter(|argument| argument.is_global_set()));
    page += &epilogue(&root);
    let mut printed = BTreeMap::new();
    for command in commands {
        section(&mut page, command, &mut printed);
    }
    while page.contains("\n\n\n") {
        page = page.replace("\n\n\n", "\n\n");
    }
    page.trim_end().to_owned() + "\n"
}

/// The commands below this one, each followed by its own.
fn collect<'a>(command: &'a Command, commands: &mut Vec<&'a Command>) {
    for child in command.get_subcommands().filter(|child| child.get_name() != "help") {
        commands.push(child);
        collect(child, commands);
    }
}

fn name(command: &Command) -> &str {
    command.get_bin_name().expect("the command is built")
}

fn purpose(command: &Command) -> String {
    command.get_about().map(ToString::to_string).unwrap_or_default()
}

/// One command. Options under a heading that an earlier command has too are not printed again: `printed` has the name of that command.
fn section(page: &mut String, command: &Command, printed: &mut BTreeMap<String, String>) {
    write!(page, "\n## {}\n\n", name(command)).unwrap();
    let about = command.get_long_about().or(command.get_about()).map(ToString::to_string).unwrap_or_default();
    for paragraph in about.split("\n\n") {
        let paragraph = escaped(paragraph);
        let end = if paragraph.ends_with(['.', ':', '?']) { "" } else { "." };
        write!(page, "{paragraph}{end}\n\n").unwrap();
    }
    let usage = command.clone().render_usage().to_string();
    write!(page, "```text\n{}\n```\n\n", usage.trim_start_matches("Usage: ")).unwrap();
    let own = |argument: &&Arg| {
        !argument.is_global_set()
            && !argument.is_hide_set()
            && !["help", "version"].contains(&argument.get_id().as_str())
    };
    let mut headings: Vec<Option<&str>> = Vec::new();
    for heading in command.get_arguments().filter(own).map(Arg::get_help_heading) {
        if !headings.contains(&heading) {
            headings.push(heading);
        }
    }
    for heading in headings {
        let mut options = String::new();
        table(
            &mut options,
            command.get_arguments().filter(own).filter(|argument| argument.get_help_heading() == heading),
        );
        let Some(heading) = heading else {
            *page += &options;
            continue;
        };
        if let Some(first) = printed.get(&options) {
            let anchor = first.replace(' ', "-");
            write!(page, "**{heading}**: those of [`{first}`](#{anchor}).\n\n").unwrap();
        } else {
            write!(page, "**{heading}**\n\n{options}").unwrap();
            printed.insert(options, name(command).to_owned());
        }
    }
    *page += &epilogue(command);
}

fn table<'a>(page: &mut String, arguments: impl Iterator<Item = &'a Arg>) {
    *page += "| option | value | default | meaning |\n|---|---|---|---|\n";
    for argument in arguments {
        let names: Vec<String> = [
            argument.get_short().map(|short| format!("`-{short}`")),
            argument.get_long().map(|long| format!("`--{long}`")),
        ]
        .into_iter()
        .flatten()
        .collect();
        let takes_values = argument.get_num_args().is_some_and(|count| count.takes_values());
        let several = argument.get_num_args().is_some_and(|count| count.max_values() > 1)
            || matches!(argument.get_action(), clap::ArgAction::Append);
        let mut value = String::new();
        if takes_values {
            let names: Vec<&str> =
                argument.get_value_names().unwrap_or_default().iter().map(|name| name.as_str()).collect();
            value = format!("`{}`{}", names.join(" ").replace('|', "\\|"), if several { " ..." } else { "" });
        }
        let option = if names.is_empty() { std::mem::take(&mut value) } else { names.join(", ") };
        let (meaning, default_in_help) = meaning(argument, takes_values);
        let defaults: Vec<_> =
            argument.get_default_values().iter().map(|value| value.to_string_lossy()).collect();
        let default = if takes_values && !argument.is_hide_default_value_set() && !defaults.is_empty() {
            format!("`{}`", defaults.join(" ").replace('|', "\\|"))
        } else if argument.is_required_set() {
            "required".to_owned()
        } else {
            default_in_help
        };
        writeln!(page, "| {option} | {value} | {default} | {meaning} |").unwrap();
    }
    page.push('\n');
}

/// The help, and the default that it ends with in brackets where the parser knows of none.
fn meaning(argument: &Arg, takes_values: bool) -> (String, String) {
    let help = argument.get_long_help().or(argument.get_help()).map(ToString::to_string).unwrap_or_default();
    let (help, default) = match help.rsplit_once("[default: ") {
        Some((help, default)) if default.ends_with(']') => (help.trim_end(), default.trim_end_matches(']')),
        _ => (help.as_str(), ""),
    };
    let mut meaning = in_cell(help);
    let values = if takes_values { argument.get_possible_values() } else { Vec::new() };
    let values: Vec<String> = values
        .iter()
        .filter(|value| !value.is_hide_set())
        .map(|value| {
            let help =
                value.get_help().map(|help| format!(": {}", in_cell(&help.to_string()))).unwrap_or_default();
            format!("`{}`{help}", value.get_name())
        })
        .collect();
    if !values.is_empty() && !argument.is_hide_possible_values_set() {
        let apart = if values.iter().any(|value| value.contains(':')) { "; " } else { ", " };
        write!(meaning, " ({})", values.join(apart)).unwrap();
    }
    let default = match default {
        "" => String::new(),
        value if !value.contains(' ') => format!("`{}`", value.replace('|', "\\|")),
        words => in_cell(words),
    };
    (meaning, default)
}

/// What follows the options in the help: indented lines are commands, the rest are paragraphs.
fn epilogue(command: &Command) -> String {
    let help = command
        .get_after_long_help()
        .or(command.get_after_help())
        .map(ToString::to_string)
        .unwrap_or_default();
    let mut page = String::new();
    let mut lines = help.lines().peekable();
    while let Some(line) = lines.next() {
        if line.starts_with("  ") {
            let mut block = vec![line];
            while let Some(next) = lines.next_if(|next| next.starts_with("  ")) {
                block.push(next);
            }
            let kind =
                if block.iter().any(|line| line.trim_start().starts_with("srflow ")) { "sh" } else { "text" };
            let indent = block.iter().map(|line| line.len() - line.trim_start().len()).min().unwrap_or(0);
            let block: Vec<&str> = block.into_iter().map(|line| &line[indent..]).collect();
            write!(page, "```{kind}\n{}\n```\n\n", block.join("\n")).unwrap();
        } else if !line.trim().is_empty() {
            let mut paragraph = line.to_owned();
            while let Some(next) = lines.next_if(|next| !next.starts_with("  ") && !next.trim().is_empty()) {
                write!(paragraph, " {next}").unwrap();
            }
            write!(page, "{}\n\n", escaped(&paragraph)).unwrap();
        }
    }
    page
}

/// Text on one line, for a cell of a table.
fn in_cell(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    escaped(&words.join(" ")).replace('|', "\\|")
}

/// Markdown that shows `text` unchanged, except that backticks mark code.
fn escaped(text: &str) -> String {
    let paired = text.matches('`').count().is_multiple_of(2);
    let mut escaped = String::new();
    let mut in_code = false;
    let mut before = ' ';
    let mut characters = text.chars().peekable();
    while let Some(character) = characters.next() {
        in_code ^= paired && character == '`';
        let special = match character {
            '\\' | '*' | '<' => true,
            '`' => !paired,
            // An underscore within a word is no markup.
            '_' => {
                !(before.is_alphanumeric() && characters.peek().is_some_and(|next| next.is_alphanumeric()))
            }
            _ => false,
        };
        if special && !in_code {
            escaped.push('\\');
        }
        escaped.push(character);
        before = character;
    }
    escaped
}

#[test]
fn help_is_escaped_outside_of_code() {
    assert_eq!(escaped("a<b> is `x|<y>`, *"), r"a\<b> is `x|<y>`, \*");
    assert_eq!(in_cell("one\n two `a|b`"), r"one two `a\|b`");
    assert_eq!(escaped("a ` b, snake_case, _po_"), r"a \` b, snake_case, \_po\_");
}

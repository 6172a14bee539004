//! Text for users is plain technical English: the documents and the help contain none of the phrases below.

use std::fs;
use std::path::{Path, PathBuf};

/// Phrases, in lower case, and what to write in their place.
const BANNED: [(&str, &str); 34] = [
    ("a folder of its name each", "one folder per input, named after it"),
    ("anew", "again"),
    ("anybody's", "your own, other people's"),
    ("as it comes", "unchanged, out of the box"),
    ("as they come", "unchanged, in order"),
    ("at hand", "available, installed"),
    ("beside other work", "while other jobs run"),
    ("beside that other work", "while other jobs run"),
    ("by themselves", "automatically, alone"),
    ("can tell, and", "is informative"),
    ("everything true known", "with ground truth"),
    ("face decides for all", "applies to the whole clip"),
    ("films a", "renders a"),
    ("further off than", "less accurate than"),
    ("gives one's own", "use your own"),
    ("hardly", "barely changes, almost no"),
    ("has the same bits", "is bit-identical"),
    ("have the same bits", "are bit-identical"),
    ("in turn with", "interleaved with"),
    ("is far off", "is inaccurate"),
    ("made meanwhile", "generated during training"),
    ("meanwhile", "during, at the same time"),
    (", of which", "split the sentence"),
    ("one's own", "your own"),
    ("than no rule", "than always taking the middle frame"),
    ("that it brings", "that come with it, built-in"),
    ("the program before", "the previous build"),
    ("the whole road", "end to end"),
    ("told", "recorded, reported, predicted"),
    ("what is there", "what exists, the files in the folder"),
    ("what there is", "what exists"),
    ("which says", "which records, which names"),
    ("whose weights it brings", "built-in"),
    ("with the same bits", "bit-identical"),
];

/// The lines of `text` that hold `phrase` as whole words, also where it is broken over two lines: their numbers.
fn lines_with(text: &str, phrase: &str) -> Vec<usize> {
    // Of the same length, so that positions are those of the text.
    let flat = text.replace(['\n', '\t'], " ").to_ascii_lowercase();
    let is_word = |character: Option<char>| character.is_some_and(char::is_alphanumeric);
    let starts_a_word =
        |at: usize| !phrase.starts_with(char::is_alphanumeric) || !is_word(flat[..at].chars().next_back());
    let whole = |at: usize| starts_a_word(at) && !is_word(flat[at + phrase.len()..].chars().next());
    let places = flat.match_indices(phrase).map(|(at, _)| at).filter(|at| whole(*at));
    places.map(|at| text[..at].matches('\n').count() + 1).collect()
}

fn markdown_below(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of documents") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            markdown_below(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            files.push(path);
        }
    }
}

/// The documents and the help of every command, each with a name.
fn texts() -> Vec<(String, String)> {
    let root = Path::new("../..");
    let mut files: Vec<PathBuf> = fs::read_dir(root)
        .expect("the workspace")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect();
    assert!(files.len() > 3, "README.md, ARCHITECTURE.md, CHANGELOG.md and others");
    markdown_below(&root.join("docs"), &mut files);
    for name in fs::read_dir(root.join("crates")).expect("the crates") {
        files.extend(Some(name.expect("an entry").path().join("README.md")).filter(|path| path.exists()));
    }
    // The reference is made of the help.
    files.retain(|path| !path.ends_with("docs/reference/commands.md"));
    files.sort();
    let read = |path: PathBuf| (path.display().to_string(), fs::read_to_string(&path).expect("a document"));
    let mut texts: Vec<_> = files.into_iter().map(read).collect();
    help(&mut srflow_cli::command(), "srflow", &mut texts);
    texts
}

fn help(command: &mut clap::Command, name: &str, texts: &mut Vec<(String, String)>) {
    texts.push((format!("{name} --help"), command.render_long_help().to_string()));
    for child in command.get_subcommands_mut() {
        let name = format!("{name} {}", child.get_name());
        help(child, &name, texts);
    }
}

#[test]
fn text_for_users_holds_no_banned_phrase() {
    let mut found = Vec::new();
    for (name, text) in texts() {
        for (phrase, instead) in BANNED {
            for line in lines_with(&text, phrase) {
                let shown = text.lines().nth(line - 1).unwrap_or_default().trim();
                found.push(format!("{name}:{line}: \"{phrase}\" (write: {instead}): {shown}"));
            }
        }
    }
    assert!(found.is_empty(), "{} banned phrases:\n{}", found.len(), found.join("\n"));
}

#[test]
fn phrases_are_found_as_whole_words_and_over_line_breaks() {
    assert_eq!(lines_with("He was told.\nUntold.", "told"), [1]);
    assert_eq!(lines_with("each of which\nare five, of\nwhich two, of which", ", of which"), [2, 3]);
}

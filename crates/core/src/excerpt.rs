//! Makes untrusted text from files and names safe to display.

use std::borrow::Cow;

/// Maximum number of characters of a file's text in a message.
const LONGEST: usize = 240;

/// Text from a file, for one line of a message: control characters, line breaks, and characters that hide or reorder text are
/// escaped (`\u{1b}`), and long text is truncated (`...`).
pub fn excerpt(text: &str) -> String {
    let mut shown = String::new();
    let mut chars = text.chars();
    for c in chars.by_ref().take(LONGEST) {
        match c {
            '\n' => shown.push_str("\\n"),
            '\r' => shown.push_str("\\r"),
            '\t' => shown.push_str("\\t"),
            c if is_unprintable(c) => shown.extend(c.escape_unicode()),
            c => shown.push(c),
        }
    }
    if chars.next().is_some() {
        shown.push_str("...");
    }
    shown
}

/// Up to `most` names for a message, each as by [`excerpt`], and the number of the rest.
pub fn excerpts<'a>(names: impl IntoIterator<Item = &'a str>, most: usize) -> String {
    let mut names = names.into_iter();
    let shown: Vec<String> = names.by_ref().take(most).map(excerpt).collect();
    match names.count() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Text for a terminal: escaped as by [`excerpt`], but with line breaks and tabs, and never truncated.
pub fn printable(text: &str) -> Cow<'_, str> {
    let steers = |c: char| is_unprintable(c) && !matches!(c, '\n' | '\t');
    if !text.contains(steers) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if steers(c) { shown.extend(c.escape_unicode()) } else { shown.push(c) }
    }
    Cow::Owned(shown)
}

/// Control characters, line and paragraph separators, and Unicode's invisible ones: bidirectional marks
/// (<https://trojansource.codes>), zero-width characters, and tag characters.
pub fn is_unprintable(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{ad}'
                | '\u{61c}'
                | '\u{180e}'
                | '\u{200b}'..='\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e0fff}'
        )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped() {
        let evil = "a\x1b[2J\u{9b}31m\u{202e}b\u{2066}\u{7f}\r\n\0\u{200b}ö";
        assert_eq!(excerpt(evil), "a\\u{1b}[2J\\u{9b}31m\\u{202e}b\\u{2066}\\u{7f}\\r\\n\\u{0}\\u{200b}ö");
        assert!(!excerpt(evil).chars().any(is_unprintable));
        assert_eq!(printable("two\nlines\tand \x1b[0m"), "two\nlines\tand \\u{1b}[0m");
        assert!(matches!(printable("plain, e\u{301} and 顔\n"), Cow::Borrowed(_)));
    }

    #[test]
    fn long_text_is_truncated() {
        let shown = excerpt(&"ö".repeat(10_000));
        assert!(shown.ends_with("ö...") && shown.chars().count() == LONGEST + 3);
        assert_eq!(excerpt(&"ö".repeat(LONGEST)), "ö".repeat(LONGEST));
    }

    #[test]
    fn lists_count_the_omitted_items() {
        assert_eq!(excerpts(["a", "b\x07"], 2), "a, b\\u{7}");
        assert_eq!(excerpts(["a", "b", "c", "d"], 2), "a, b and 2 more");
        assert_eq!(excerpts([], 2), "");
    }
}

use std::fmt::Display;

use srflow_core::printable;

/// Rewrites the message of a JSON or TOML parser without the names of Rust's types: `expected usize` becomes `expected a whole
/// number from 0`, `missing field` becomes `missing key`. What was found, and where, stays unchanged.
pub fn parse_error_in_words(error: &impl Display) -> String {
    const LONGEST: usize = 1000; // it may contain a long line of the file
    let whole = error.to_string();
    let mut message: String = printable(whole.trim_end()).chars().take(LONGEST).collect();
    for (theirs, words) in [
        ("expected value at line", "a value that is not JSON, such as NaN or Infinity, at line"),
        ("missing field ", "missing key "),
        ("unknown field ", "unknown key "),
        ("duplicate field ", "duplicate key "),
        ("unknown variant ", "unknown value "),
        ("invalid type: ", ""),
        ("invalid value: ", ""),
        ("data did not match any variant of untagged enum", "expected enum"),
    ] {
        message = message.replace(theirs, words);
    }
    const EXPECTED: &str = "expected ";
    let mut parts = message.split(EXPECTED);
    let mut words = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let ends = [",", "\n", " at line "].iter().filter_map(|end| part.find(end)).min();
        let (what, rest) = part.split_at(ends.unwrap_or(part.len()));
        words.push_str(EXPECTED);
        words.push_str(&expected_in_words(what));
        words.push_str(rest);
    }
    words
}

/// The expectation of serde in users' terms.
fn expected_in_words(what: &str) -> String {
    let first = what.split(' ').next().unwrap_or_default();
    match first {
        "u8" | "u16" | "u32" | "u64" | "u128" | "usize" => "a whole number from 0".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "i128" | "isize" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "struct" | "internally" => "keys with values".to_owned(),
        "enum" | "variant" => "one of the known names".to_owned(),
        _ => match what {
            "a map" => "keys with values".to_owned(),
            "a sequence" => "a list".to_owned(),
            "a string" | "a borrowed string" => "a text".to_owned(),
            "a boolean" => "true or false".to_owned(),
            _ => what.replace("an array of length", "a list of").replace("a tuple of size", "a list of"),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_names_of_types_become_words() {
        for (theirs, ours) in [
            (
                "invalid type: string \"many\", expected usize at line 3 column 5",
                "string \"many\", expected a whole number from 0 at line 3 column 5",
            ),
            (
                "invalid value: integer `-1`, expected u32\nin `training.batch`\n",
                "integer `-1`, expected a whole number from 0\nin `training.batch`",
            ),
            ("invalid type: map, expected f64", "map, expected a number"),
            ("invalid type: null, expected struct Arguments", "null, expected keys with values"),
            (
                "invalid length 1, expected struct Best with 2 elements at line 1 column 9",
                "invalid length 1, expected keys with values at line 1 column 9",
            ),
            ("invalid length 3, expected an array of length 2", "invalid length 3, expected a list of 2"),
            ("invalid length 1, expected a tuple of size 2", "invalid length 1, expected a list of 2"),
            ("data did not match any variant of untagged enum OneOrMore", "expected one of the known names"),
            ("missing field `width` at line 2 column 1", "missing key `width` at line 2 column 1"),
            ("unknown field `lr`, expected one of `a`, `b`", "unknown key `lr`, expected one of `a`, `b`"),
            (
                "expected value at line 1 column 9",
                "a value that is not JSON, such as NaN or Infinity, at line 1 column 9",
            ),
            ("expected `,` or `}` at line 1 column 4", "expected `,` or `}` at line 1 column 4"),
        ] {
            assert_eq!(parse_error_in_words(&theirs), ours);
        }
    }
}

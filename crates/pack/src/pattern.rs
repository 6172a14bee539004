//! Names of several tars in one: `train-{000000..000009}.tar`, as WebDataset writes them.

/// Most tars that a pattern may stand for.
const MOST: u64 = 1 << 20;

/// The names that a text with at most one `{FIRST..LAST}` stands for.
///
/// # Errors
/// What was expected, and what was found.
pub fn expand(text: &str) -> Result<Vec<String>, String> {
    let Some((before, rest)) = text.split_once('{') else { return Ok(vec![text.to_owned()]) };
    let parsed = || {
        let (ends, after) = rest.split_once('}')?;
        let (first, last) = ends.split_once("..")?;
        let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        if after.contains('{') || !is_number(first) || !is_number(last) {
            return None;
        }
        let (from, to) = (first.parse::<u64>().ok()?, last.parse::<u64>().ok()?);
        let width = first.len();
        (from <= to && to - from < MOST)
            .then(|| (from..=to).map(|number| format!("{before}{number:0width$}{after}")).collect())
    };
    parsed().ok_or_else(|| {
        format!("expected one range of at most {MOST} numbers, such as train-{{000000..000009}}.tar")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_expanded() {
        assert_eq!(expand("a.tar").unwrap(), ["a.tar"]);
        assert_eq!(expand("a-{08..10}.tar").unwrap(), ["a-08.tar", "a-09.tar", "a-10.tar"]);
        for wrong in ["a-{1..}.tar", "a-{2..1}", "a-{0..99999999999}", "{0..1}{0..1}", "a{", "{-1..2}"] {
            assert!(expand(wrong).is_err(), "{wrong}");
        }
    }
}

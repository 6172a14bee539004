//! What the columns of a figure show, as words: `frame1`, `truth`, `flow:tvl1`, `flow+error`.

use std::fmt;
use std::str::FromStr;

use srflow_core::{excerpt, named};

/// A kind of panel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Frame1,
    Frame2,
    Overlay,
    Truth,
    Flow,
    Error,
    Strain,
}

named!(Kind, "what a panel shows", {
    Frame1 => "frame1",
    Frame2 => "frame2",
    Overlay => "overlay",
    Truth => "truth",
    Flow => "flow",
    Error => "error",
    Strain => "strain",
});

impl Kind {
    /// Whether the panel shows something of a method.
    fn is_of_method(self) -> bool {
        matches!(self, Self::Flow | Self::Error | Self::Strain)
    }
}

/// The flow that a panel shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    Truth,
    /// Number of the method.
    Method(usize),
}

/// What a panel shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    Frame1,
    Frame2,
    /// The mean of both frames.
    Overlay,
    /// Flow in the colours of its directions.
    Flow(Source),
    /// End-point error of a method.
    Error(usize),
    /// Optical strain of a flow.
    Strain(Source),
}

impl Content {
    /// Whether it takes the true flow.
    pub fn needs_truth(self) -> bool {
        matches!(self, Self::Error(_) | Self::Flow(Source::Truth) | Self::Strain(Source::Truth))
    }

    /// The method whose flow it takes.
    pub fn method(self) -> Option<usize> {
        match self {
            Self::Flow(Source::Method(method))
            | Self::Error(method)
            | Self::Strain(Source::Method(method)) => Some(method),
            _ => None,
        }
    }
}

/// A column as it is typed: panels joined by `+`, from top to bottom.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    words: Vec<(Kind, Option<String>)>,
}

impl Column {
    /// Whether it shows something of a method.
    pub fn shows_methods(&self) -> bool {
        let of_method = |(kind, name): &(Kind, Option<String>)| {
            kind.is_of_method() && name.as_deref() != Some(Kind::Truth.name())
        };
        self.words.iter().any(of_method)
    }
}

srflow_core::serialize_as_text!(Column);

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (kind, name)) in self.words.iter().enumerate() {
            let plus = if place == 0 { "" } else { "+" };
            match name {
                Some(name) => write!(f, "{plus}{kind}:{name}")?,
                None => write!(f, "{plus}{kind}")?,
            }
        }
        Ok(())
    }
}

impl FromStr for Column {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let kind_of = |word: &str| word.split(':').next().unwrap_or_default().parse::<Kind>();
        let mut words: Vec<String> = Vec::new();
        for part in text.split('+') {
            // The name of a method may contain `+`.
            match words.last_mut() {
                Some(last) if last.contains(':') && kind_of(part).is_err() => *last += &format!("+{part}"),
                _ => words.push(part.to_owned()),
            }
        }
        let word = |word: String| {
            let kind = kind_of(&word).map_err(|error| excerpt(&error))?;
            match word.split_once(':') {
                None => Ok((kind, None)),
                Some((_, "")) => Err(format!("`{word}` ends without the name of a method")),
                Some((_, name)) if kind.is_of_method() => Ok((kind, Some(name.to_owned()))),
                Some(_) => Err(format!("`{}` is of no method: write `{kind}`", excerpt(&word))),
            }
        };
        Ok(Self { words: words.into_iter().map(word).collect::<Result<_, _>>()? })
    }
}

/// What is wrong with the names in columns.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ColumnError {
    #[error("`{kind}:{}` names no method of the figure; its methods are {known}", excerpt(.name))]
    Unknown { kind: &'static str, name: String, known: String },
    #[error("`{0}` is one column for each method, and the figure has none: name methods, or leave it out")]
    NoMethod(&'static str),
    #[error("`error:truth`: the error of the truth is 0 everywhere; leave it out")]
    ErrorOfTruth,
}

/// The panels of each column, from top to bottom. A column with `flow`, `error` or `strain` and no name becomes one for each method.
///
/// # Errors
/// When a name is not one of `methods`, or there is none for such a column.
pub fn resolve(columns: &[Column], methods: &[String]) -> Result<Vec<Vec<Content>>, ColumnError> {
    let mut resolved = Vec::new();
    for Column { words } in columns {
        let repeated = words.iter().find(|(kind, name)| kind.is_of_method() && name.is_none());
        let each = match repeated {
            Some((kind, _)) if methods.is_empty() => return Err(ColumnError::NoMethod(kind.name())),
            Some(_) => methods.len(),
            None => 1,
        };
        for method in 0..each {
            let content =
                |(kind, name): &(Kind, Option<String>)| content(*kind, name.as_deref(), method, methods);
            resolved.push(words.iter().map(content).collect::<Result<_, _>>()?);
        }
    }
    Ok(resolved)
}

/// `method` is the one whose turn it is, for words without a name.
fn content(
    kind: Kind,
    name: Option<&str>,
    method: usize,
    methods: &[String],
) -> Result<Content, ColumnError> {
    let source = match name {
        None => Source::Method(method),
        Some(name) => match methods.iter().position(|known| known == name) {
            Some(method) => Source::Method(method),
            None if name == Kind::Truth.name() => Source::Truth,
            None => {
                let known = match methods {
                    [] => "none".to_owned(),
                    _ => methods.iter().map(|name| excerpt(name)).collect::<Vec<_>>().join(", "),
                };
                return Err(ColumnError::Unknown { kind: kind.name(), name: name.to_owned(), known });
            }
        },
    };
    Ok(match (kind, source) {
        (Kind::Frame1, _) => Content::Frame1,
        (Kind::Frame2, _) => Content::Frame2,
        (Kind::Overlay, _) => Content::Overlay,
        (Kind::Truth, _) => Content::Flow(Source::Truth),
        (Kind::Flow, source) => Content::Flow(source),
        (Kind::Error, Source::Method(method)) => Content::Error(method),
        (Kind::Error, Source::Truth) => return Err(ColumnError::ErrorOfTruth),
        (Kind::Strain, source) => Content::Strain(source),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(texts: &[&str], methods: &[&str]) -> Result<Vec<Vec<Content>>, ColumnError> {
        let columns: Vec<Column> = texts.iter().map(|text| text.parse().unwrap()).collect();
        let methods: Vec<String> = methods.iter().map(|name| (*name).to_owned()).collect();
        resolve(&columns, &methods)
    }

    #[test]
    fn a_column_without_a_name_is_one_for_each_method() {
        use Content::{Error, Flow, Frame1, Strain};
        let of = Source::Method;
        assert_eq!(
            columns(&["truth+frame1", "flow+error", "strain:b", "strain:truth"], &["a", "b"]).unwrap(),
            [
                vec![Flow(Source::Truth), Frame1],
                vec![Flow(of(0)), Error(0)],
                vec![Flow(of(1)), Error(1)],
                vec![Strain(of(1))],
                vec![Strain(Source::Truth)],
            ]
        );
    }

    #[test]
    fn names_may_contain_the_signs_of_columns() {
        let found = columns(&["flow:CCMR++error:CCMR+", "error:Ours: 3"], &["CCMR+", "Ours: 3"]).unwrap();
        assert_eq!(found[0], [Content::Flow(Source::Method(0)), Content::Error(0)]);
        assert_eq!(found[1], [Content::Error(1)]);
    }

    #[test]
    fn wrong_columns_are_refused_with_what_would_be_right() {
        for (text, part) in [
            ("", "is not what a panel shows"),
            ("frame3", "expected one of frame1, frame2, overlay"),
            ("flow:", "ends without the name"),
            ("frame1:tvl1", "write `frame1`"),
            ("frame1+", "is not what a panel shows"),
        ] {
            let error = text.parse::<Column>().unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
        let error = columns(&["flow:c"], &["a", "b"]).unwrap_err().to_string();
        assert!(error.contains("flow:c") && error.contains("a, b"), "{error}");
        assert_eq!(columns(&["error"], &[]), Err(ColumnError::NoMethod("error")));
        assert_eq!(columns(&["error:truth"], &["a"]), Err(ColumnError::ErrorOfTruth));
    }
}

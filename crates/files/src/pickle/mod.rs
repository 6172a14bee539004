//! Python pickles as data: parsed into values, never executed.
//!
//! `pickletools.py` in Python's library lists the operations. Where Python would call something, only the name and the
//! arguments are kept.

mod machine;
mod value;

use std::sync::Arc;

use srflow_core::excerpt;

use crate::FileProblem;
use machine::Machine;
pub use value::{Id, Value};

/// A parsed pickle.
#[derive(Debug)]
pub struct Pickle {
    bytes: Arc<Vec<u8>>,
    /// Every value; those inside others are referred to by index, so that shared and deeply nested values cost nothing.
    values: Vec<Value>,
    root: Id,
    end: usize,
}

impl Pickle {
    /// Parses the pickle that starts at byte `start`.
    ///
    /// # Errors
    /// When it is truncated, broken or has too many operations.
    pub fn parse(bytes: Arc<Vec<u8>>, start: usize) -> Result<Self, FileProblem> {
        let (values, root, end) = Machine::new(&bytes, start).run()?;
        Ok(Self { bytes, values, root, end })
    }

    /// The whole.
    pub fn root(&self) -> Id {
        self.root
    }

    /// The byte after the pickle.
    pub fn end(&self) -> usize {
        self.end
    }

    /// A value of this pickle.
    pub fn value(&self, value: Id) -> Option<&Value> {
        self.values.get(value)
    }

    /// All values, in the order of the file.
    pub fn values(&self) -> impl Iterator<Item = &Value> {
        self.values.iter()
    }

    /// Keys and values of a dictionary, or of an object that is one, such as `collections.OrderedDict`. Of equal keys the last
    /// one counts.
    pub fn entries(&self, dictionary: Id) -> &[(Id, Id)] {
        match self.value(dictionary) {
            Some(Value::Dict(entries) | Value::Object { entries, .. }) => entries,
            _ => &[],
        }
    }

    /// The value of this name in a dictionary.
    pub fn entry(&self, dictionary: Id, name: &str) -> Option<Id> {
        let mut entries = self.entries(dictionary).iter().rev();
        entries.find(|(key, _)| self.is_text(*key, name)).map(|(_, value)| *value)
    }

    pub fn is_text(&self, value: Id, text: &str) -> bool {
        self.raw(value).is_some_and(|bytes| bytes == text.as_bytes())
    }

    pub fn text(&self, value: Id) -> Option<String> {
        self.raw(value).map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }

    /// The bytes of text or of a byte string.
    pub fn raw(&self, value: Id) -> Option<&[u8]> {
        match self.value(value)? {
            Value::Bytes(bytes) => Some(bytes),
            Value::Slice(start, end) => self.bytes.get(*start..*end),
            _ => None,
        }
    }

    pub fn integer(&self, value: Id) -> Option<i64> {
        match self.value(value)? {
            Value::Int(integer) => Some(*integer),
            Value::Bool(set) => Some(i64::from(*set)),
            _ => None,
        }
    }

    /// The items of a tuple or list.
    pub fn items(&self, value: Id) -> Option<&[Id]> {
        match self.value(value)? {
            Value::Tuple(items) | Value::List(items) => Some(items),
            _ => None,
        }
    }

    /// A tuple or list of sizes.
    pub fn sizes(&self, value: Id) -> Option<Vec<usize>> {
        self.items(value)?.iter().map(|side| usize::try_from(self.integer(*side)?).ok()).collect()
    }

    /// Name of the class or function, arguments and state of an object.
    pub fn object(&self, value: Id) -> Option<(&str, &[Id], Option<Id>)> {
        let Some(Value::Object { class, arguments, state, .. }) = self.value(value) else { return None };
        let (name, arguments) = (self.global(*class)?, self.items(*arguments)?);
        // Protocols 0 and 1 call a function with the class as its first argument.
        match arguments.first().and_then(|first| self.global(*first)) {
            Some(class) if name.ends_with("._reconstructor") => Some((class, &[], *state)),
            _ => Some((name, arguments, *state)),
        }
    }

    /// The name of a class or function.
    pub fn global(&self, value: Id) -> Option<&str> {
        match self.value(value)? {
            Value::Global(name) => Some(name),
            _ => None,
        }
    }

    /// What a value is, for a message.
    pub fn describe(&self, value: Id) -> String {
        match self.value(value) {
            None | Some(Value::Mark) => "nothing".to_owned(),
            Some(Value::None) => "None".to_owned(),
            Some(Value::Bool(_) | Value::Int(_) | Value::Float(_)) => "a number".to_owned(),
            Some(Value::Bytes(_) | Value::Slice(..)) => "text".to_owned(),
            Some(Value::List(items) | Value::Tuple(items)) => format!("a list of {} values", items.len()),
            Some(Value::Dict(entries)) => format!("a dictionary of {} keys", entries.len()),
            Some(Value::Global(name)) => format!("the name {}", excerpt(name)),
            Some(Value::Elsewhere(_)) => "a reference to something outside of the pickle".to_owned(),
            Some(Value::Object { .. }) => match self.object(value) {
                Some((class, ..)) => format!("an object of {}", excerpt(class)),
                None => "an object".to_owned(),
            },
        }
    }
}

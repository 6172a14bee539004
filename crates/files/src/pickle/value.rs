//! Values of a pickle.

/// A value in a [`Pickle`](super::Pickle).
pub type Id = usize;

/// A parsed value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Python's `None`, and integers of more than 64 bits.
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    /// Text, and byte strings of Python 2 that are short and ASCII as well as those of Python 3.
    Bytes(Vec<u8>),
    /// Bytes of the file, for the long byte strings that hold arrays.
    Slice(usize, usize),
    List(Vec<Id>),
    Tuple(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// A class or function, with its module: `numpy.ndarray`.
    Global(String),
    /// What calling the first with the second would give.
    Object {
        class: Id,
        arguments: Id,
        /// Those that were set as if it were a dictionary.
        entries: Vec<(Id, Id)>,
        state: Option<Id>,
    },
    /// What the program keeps outside of the pickle under this key.
    Elsewhere(Id),
    /// Where a collection starts on the stack.
    Mark,
}

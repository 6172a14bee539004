//! Python pickles as data: parsed into values, never executed.
//!
//! FLAME's files are dictionaries of NumPy arrays, arrays wrapped by chumpy, and a SciPy sparse matrix, pickled by Python 2 or 3
//! (`pickletools.py` in Python's library lists the operations). Where Python would call something, only the name and the
//! arguments are kept.

mod machine;

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use srflow_core::{excerpt, excerpts};
use srflow_files::{Array, FileError, FileKind, FileProblem, npy_pickle, read_file};

use machine::Machine;

/// Most operations of a file. Each makes a value of some dozen bytes; FLAME's files have below a thousand.
const MAX_OPERATIONS: usize = 1_000_000;

/// Most values in a row of names and attributes that lead to an array.
const MAX_WRAPPERS: usize = 8;

/// A value in [`Pickle::values`].
type Id = usize;

/// A parsed value.
#[derive(Debug, Clone, PartialEq)]
enum Value {
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
        state: Option<Id>,
    },
    /// Where a collection starts on the stack.
    Mark,
}

/// A file that holds a pickled dictionary.
#[derive(Debug)]
pub(crate) struct Pickle {
    path: PathBuf,
    bytes: Vec<u8>,
    /// Every value; those inside others are referred to by index, so that shared and deeply nested values cost nothing.
    values: Vec<Value>,
    root: Id,
}

/// A sparse matrix: its shape and the entries (row, column, value).
#[derive(Debug, PartialEq)]
pub(crate) struct Matrix {
    pub rows: usize,
    pub columns: usize,
    pub entries: Vec<(usize, usize, f32)>,
}

impl Matrix {
    /// The entries of an array that are not zero.
    ///
    /// # Errors
    /// When it has not two dimensions.
    pub(crate) fn dense(array: &Array) -> Result<Self, FileProblem> {
        let [rows, columns] = array.shape[..] else {
            return Err(field("shape", "two dimensions", format!("{:?}", array.shape)));
        };
        let entries = array.values.iter().enumerate().filter(|(_, value)| **value != 0.0);
        let entries = entries.map(|(i, value)| (i / columns, i % columns, *value)).collect();
        Ok(Self { rows, columns, entries })
    }
}

impl Pickle {
    /// Reads a `.pkl` file, or a `.npy` file of pickled objects.
    ///
    /// # Errors
    /// When the file cannot be read, or is not a pickled dictionary.
    pub(crate) fn open(path: &Path) -> Result<Self, FileError> {
        let bytes = read_file(path, FileKind::Mesh)?;
        Self::parse(path, bytes).map_err(|problem| problem.in_file(path))
    }

    fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, FileProblem> {
        let start = npy_pickle(&bytes)?.map_or(0, |pickle| bytes.len() - pickle.len());
        let (values, root) = Machine::new(&bytes, start).run()?;
        let mut pickle = Self { path: path.to_owned(), bytes, values, root };
        // `np.save` of a dictionary pickles an array that holds it.
        if let Some(items) = pickle.object_items(root)
            && let [only] = items[..]
        {
            pickle.root = only;
        }
        match pickle.values.get(pickle.root) {
            Some(Value::Dict(_)) => Ok(pickle),
            _ => Err(field("pickle", "a dictionary of arrays", pickle.describe(pickle.root))),
        }
    }

    /// The file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The keys of the dictionary that are text.
    pub(crate) fn names(&self) -> Vec<String> {
        let Some(Value::Dict(entries)) = self.values.get(self.root) else { return Vec::new() };
        entries.iter().filter_map(|(key, _)| self.text(*key)).collect()
    }

    /// The array of this name. Arrays in chumpy's wrapper and lists of numbers are arrays too.
    ///
    /// # Errors
    /// When the file has no such array, or it does not hold numbers.
    pub(crate) fn array(&self, name: &str) -> Result<Array, FileError> {
        self.named(name).and_then(|value| self.array_of(value)).map_err(|problem| self.about(problem, name))
    }

    /// The matrix of this name, sparse as pickled by SciPy or dense.
    ///
    /// # Errors
    /// As [`Self::array`], and when the indices of a sparse matrix are wrong.
    pub(crate) fn matrix(&self, name: &str) -> Result<Matrix, FileError> {
        self.named(name).and_then(|value| self.matrix_of(value)).map_err(|problem| self.about(problem, name))
    }

    /// The problem of the value called `name`.
    fn about(&self, problem: FileProblem, name: &str) -> FileError {
        let problem = match problem {
            FileProblem::Field { field, expected, found } => {
                FileProblem::Field { field, expected, found: format!("{found} in `{name}`") }
            }
            other => other,
        };
        problem.in_file(&self.path)
    }

    fn named(&self, name: &str) -> Result<Id, FileProblem> {
        self.entry(self.root, name).ok_or_else(|| {
            let names = self.names();
            let found = format!("the keys {}", excerpts(names.iter().map(String::as_str), 20));
            field("key", format!("one called `{name}`"), found)
        })
    }

    fn entry(&self, dictionary: Id, name: &str) -> Option<Id> {
        let Some(Value::Dict(entries)) = self.values.get(dictionary) else { return None };
        // The last one counts, as in Python.
        entries.iter().rev().find(|(key, _)| self.is_text(*key, name)).map(|(_, value)| *value)
    }

    fn is_text(&self, value: Id, text: &str) -> bool {
        self.raw(value).is_some_and(|bytes| bytes == text.as_bytes())
    }

    fn text(&self, value: Id) -> Option<String> {
        self.raw(value).map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }

    fn raw(&self, value: Id) -> Option<&[u8]> {
        match self.values.get(value)? {
            Value::Bytes(bytes) => Some(bytes),
            Value::Slice(start, end) => self.bytes.get(*start..*end),
            _ => None,
        }
    }

    /// The bytes of an array: a byte string, or one that Python 3 pickled as text for Python 2 (`_codecs.encode`).
    fn array_bytes(&self, value: Id) -> Option<Cow<'_, [u8]>> {
        let Some((class, arguments, _)) = self.object(value) else {
            return self.raw(value).map(Cow::Borrowed);
        };
        let Some(text) = arguments.first() else { return Some(Cow::Borrowed(&[])) }; // bytes() is empty
        let text = self.raw(*text)?;
        match class {
            "_codecs.encode" => {
                let letters = str::from_utf8(text).ok()?.chars();
                letters.map(|letter| u8::try_from(u32::from(letter)).ok()).collect()
            }
            "builtins.bytearray" | "__builtin__.bytearray" => Some(Cow::Borrowed(text)),
            _ => None,
        }
    }

    fn integer(&self, value: Id) -> Option<i64> {
        match self.values.get(value)? {
            Value::Int(integer) => Some(*integer),
            Value::Bool(set) => Some(i64::from(*set)),
            _ => None,
        }
    }

    fn tuple(&self, value: Id) -> Option<&[Id]> {
        match self.values.get(value)? {
            Value::Tuple(items) | Value::List(items) => Some(items),
            _ => None,
        }
    }

    fn shape(&self, value: Id) -> Option<Vec<usize>> {
        self.tuple(value)?.iter().map(|side| usize::try_from(self.integer(*side)?).ok()).collect()
    }

    /// Name of the class or function, arguments and state of an object.
    fn object(&self, value: Id) -> Option<(&str, &[Id], Option<Id>)> {
        let Some(Value::Object { class, arguments, state }) = self.values.get(value) else { return None };
        let (name, arguments) = (self.global(*class)?, self.tuple(*arguments)?);
        // Protocols 0 and 1 call a function with the class as its first argument.
        match arguments.first().and_then(|first| self.global(*first)) {
            Some(class) if name.ends_with("._reconstructor") => Some((class, &[], *state)),
            _ => Some((name, arguments, *state)),
        }
    }

    fn global(&self, value: Id) -> Option<&str> {
        match self.values.get(value)? {
            Value::Global(name) => Some(name),
            _ => None,
        }
    }

    /// Whether a name in a module, e.g. `scipy.sparse.csc.csc_matrix`, ends with this one, whatever the module is called in
    /// this version of the library.
    fn is_called(name: &str, library: &str, last: &str) -> bool {
        name.split('.').next() == Some(library) && name.rsplit('.').next() == Some(last)
    }

    /// The items of an array of objects.
    fn object_items(&self, value: Id) -> Option<Vec<Id>> {
        let (name, _, Some(state)) = self.object(value)? else { return None };
        let items = *self.tuple(state)?.last()?;
        match self.values.get(items)? {
            Value::List(items) if Self::is_called(name, "numpy", "_reconstruct") => Some(items.clone()),
            _ => None,
        }
    }

    fn array_of(&self, mut value: Id) -> Result<Array, FileProblem> {
        for _ in 0..MAX_WRAPPERS {
            let Some((name, arguments, state)) = self.object(value) else {
                return self.listed(value).ok_or_else(|| self.no_array(value));
            };
            if Self::is_called(name, "numpy", "_reconstruct") {
                return self.reconstructed(state).ok_or_else(|| self.no_array(value))?;
            }
            if Self::is_called(name, "numpy", "_frombuffer") {
                return self.of_buffer(arguments).ok_or_else(|| self.no_array(value))?;
            }
            // chumpy.ch.Ch keeps its array as the attribute `x`.
            let inside =
                state.filter(|_| name.starts_with("chumpy.")).and_then(|state| self.entry(state, "x"));
            value = inside.ok_or_else(|| self.no_array(value))?;
        }
        Err(self.no_array(value))
    }

    fn no_array(&self, value: Id) -> FileProblem {
        field("value", "an array of numbers of NumPy or chumpy", self.describe(value))
    }

    /// The state of an array of NumPy: version, shape, type, whether in Fortran order, and bytes.
    fn reconstructed(&self, state: Option<Id>) -> Option<Result<Array, FileProblem>> {
        let state = self.tuple(state?)?;
        let [shape, kind, fortran, bytes] = *state.last_chunk::<4>()?;
        let (shape, kind) = (self.shape(shape)?, self.type_name(kind)?);
        let fortran_order = self.integer(fortran)? != 0;
        Some(Array::from_numpy(&kind, shape, fortran_order, &self.array_bytes(bytes)?))
    }

    /// The arguments of NumPy's `_frombuffer`: bytes, type, shape and order.
    fn of_buffer(&self, arguments: &[Id]) -> Option<Result<Array, FileProblem>> {
        let [bytes, kind, shape, order] = *arguments.first_chunk::<4>()?;
        let (shape, kind) = (self.shape(shape)?, self.type_name(kind)?);
        Some(Array::from_numpy(&kind, shape, self.is_text(order, "F"), &self.array_bytes(bytes)?))
    }

    /// The name of a `numpy.dtype`, e.g. `<f8`: its first argument is the kind, the second item of its state the byte order.
    fn type_name(&self, value: Id) -> Option<String> {
        let (name, arguments, state) = self.object(value)?;
        let kind = self.text(*arguments.first()?).filter(|_| Self::is_called(name, "numpy", "dtype"))?;
        let order = match state {
            Some(state) => self.text(*self.tuple(state)?.get(1)?)?,
            None => "<".to_owned(),
        };
        Some(format!("{order}{kind}"))
    }

    /// A number or a list of numbers as an array.
    fn listed(&self, value: Id) -> Option<Array> {
        let number = |value: Id| match self.values.get(value)? {
            Value::Float(number) => Some(*number as f32),
            _ => self.integer(value).map(|integer| integer as f32),
        };
        if let Some(number) = number(value) {
            return Some(Array { shape: Vec::new(), values: vec![number] });
        }
        let Value::List(items) = self.values.get(value)? else { return None };
        let values: Option<Vec<f32>> = items.iter().map(|item| number(*item)).collect();
        Some(Array { shape: vec![items.len()], values: values? })
    }

    fn matrix_of(&self, value: Id) -> Result<Matrix, FileProblem> {
        let sparse = self
            .object(value)
            .and_then(|(class, _, state)| class.starts_with("scipy.").then_some((class, state?)));
        let Some((class, state)) = sparse else {
            return Matrix::dense(&self.array_of(value)?);
        };
        let by_columns = class.ends_with("csc_matrix") || class.ends_with("csc_array");
        if !by_columns && !class.ends_with("csr_matrix") && !class.ends_with("csr_array") {
            return Err(field("matrix", "a csc_matrix or csr_matrix of SciPy", excerpt(class)));
        }
        let part = |name: &str| {
            let found = self.entry(state, name).ok_or_else(|| field("matrix", format!("`{name}`"), "none"));
            found.and_then(|value| self.array_of(value))
        };
        let shape = self.entry(state, "_shape").and_then(|shape| self.shape(shape));
        let Some([rows, columns]) = shape.as_deref() else {
            return Err(field("matrix", "a shape of two dimensions", format!("{shape:?}")));
        };
        let (rows, columns) = (*rows, *columns);
        let (data, indices, starts) = (part("data")?, part("indices")?, part("indptr")?);
        let (outer, inner) = if by_columns { (columns, rows) } else { (rows, columns) };
        let wrong = || field("matrix", "indices inside its shape", format!("a {rows} x {columns} matrix"));
        if starts.values.len().checked_sub(1) != Some(outer) || indices.values.len() != data.values.len() {
            return Err(wrong());
        }
        let mut entries = Vec::with_capacity(data.values.len());
        for (line, ends) in starts.values.windows(2).enumerate() {
            let (start, end) = (ends[0] as usize, ends[1] as usize);
            let values = data.values.get(start..end).ok_or_else(wrong)?;
            let places = indices.values.get(start..end).ok_or_else(wrong)?;
            for (&value, &place) in values.iter().zip(places) {
                let place = place as usize;
                if place >= inner {
                    return Err(wrong());
                }
                entries.push(if by_columns { (place, line, value) } else { (line, place, value) });
            }
        }
        Ok(Matrix { rows, columns, entries })
    }

    /// What a value is, for a message.
    fn describe(&self, value: Id) -> String {
        match self.values.get(value) {
            None | Some(Value::Mark) => "nothing".to_owned(),
            Some(Value::None) => "None".to_owned(),
            Some(Value::Bool(_) | Value::Int(_) | Value::Float(_)) => "a number".to_owned(),
            Some(Value::Bytes(_) | Value::Slice(..)) => "text".to_owned(),
            Some(Value::List(items) | Value::Tuple(items)) => format!("a list of {} values", items.len()),
            Some(Value::Dict(entries)) => format!("a dictionary of {} keys", entries.len()),
            Some(Value::Global(name)) => format!("the name {}", excerpt(name)),
            Some(Value::Object { class, .. }) => match self.values.get(*class) {
                Some(Value::Global(name)) => format!("an object of {}", excerpt(name)),
                _ => "an object".to_owned(),
            },
        }
    }
}

fn field(field: &'static str, expected: impl Into<String>, found: impl Into<String>) -> FileProblem {
    FileProblem::field(field, expected, found)
}

#[cfg(test)]
mod tests;

//! Python pickles as data: parsed into values, never executed.
//!
//! FLAME's files are dictionaries of NumPy arrays, arrays wrapped by chumpy, and a SciPy sparse matrix, pickled by Python 2 or 3
//! (`pickletools.py` in Python's library lists the operations). Where Python would call something, only the name and the
//! arguments are kept.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use srflow_core::{excerpt, excerpts};
use srflow_files::{Array, FileError, FileKind, FileProblem, npy_pickle, read_file};

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
        let (values, root) = Machine { bytes: &bytes, at: start, ..Machine::default() }.run()?;
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

/// Longer byte strings stay in the file.
const SHORT: usize = 256;

/// The stack machine of a pickle, with lists of data instead of Python's objects.
#[derive(Default)]
struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    values: Vec<Value>,
    stack: Vec<Id>,
    memo: HashMap<u64, Id>,
}

impl Machine<'_> {
    fn run(mut self) -> Result<(Vec<Value>, Id), FileProblem> {
        for _ in 0..MAX_OPERATIONS {
            let operation = self.byte()?;
            if operation == b'.' {
                let root = self.pop()?;
                return Ok((self.values, root));
            }
            self.step(operation)?;
        }
        Err(field("pickle", format!("at most {MAX_OPERATIONS} operations"), "more"))
    }

    fn step(&mut self, operation: u8) -> Result<(), FileProblem> {
        match operation {
            0x80 => _ = self.take(1)?, // PROTO
            0x95 => _ = self.take(8)?, // FRAME
            b'(' => self.push(Value::Mark),
            b'0' => _ = self.pop()?,
            b'1' => _ = self.pop_to_mark()?,
            b'2' => {
                let top = self.pop()?;
                self.stack.extend([top, top]);
            }
            b'N' => self.push(Value::None),
            0x88 => self.push(Value::Bool(true)),
            0x89 => self.push(Value::Bool(false)),
            b'K' => self.push_int::<1>()?,
            b'M' => self.push_int::<2>()?,
            b'J' => {
                let bytes = self.array::<4>()?;
                self.push(Value::Int(i64::from(i32::from_le_bytes(bytes))));
            }
            0x8a => self.push_long(1)?,
            0x8b => self.push_long(4)?,
            b'I' | b'L' => self.push_decimal_int()?,
            b'F' => {
                let text = self.line()?.to_owned();
                let number = text.parse().map_err(|_| self.broken("a number"))?;
                self.push(Value::Float(number));
            }
            b'G' => {
                let bytes = self.array::<8>()?;
                self.push(Value::Float(f64::from_be_bytes(bytes)));
            }
            b'U' | b'C' | 0x8c => self.push_bytes(1)?,
            b'T' | b'B' | b'X' => self.push_bytes(4)?,
            0x8d | 0x8e | 0x96 => self.push_bytes(8)?,
            b'S' | b'V' => self.push_quoted(operation == b'S')?,
            b'c' => {
                let (module, name) = (self.line()?.to_owned(), self.line()?.to_owned());
                self.push_global(&module, &name);
            }
            0x93 => {
                let (name, module) = (self.pop_text()?, self.pop_text()?);
                self.push_global(&module, &name);
            }
            b']' => self.push(Value::List(Vec::new())),
            b')' => self.push(Value::Tuple(Vec::new())),
            b'}' => self.push(Value::Dict(Vec::new())),
            // A set, as a list.
            0x8f => self.push(Value::List(Vec::new())),
            b'l' => self.collect(Value::List)?,
            b't' | 0x91 => self.collect(Value::Tuple)?,
            0x85..=0x87 => {
                let start = self.stack.len().checked_sub(usize::from(operation - 0x84));
                let items = start.map(|start| self.stack.split_off(start));
                let items = items.ok_or_else(|| self.broken("values"))?;
                self.push(Value::Tuple(items));
            }
            b'd' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Dict(pairs(&items)));
            }
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_to_mark()?;
                self.append(&items)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.set(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_to_mark()?;
                self.set(&items)?;
            }
            b'p' => {
                let index = self.line()?.parse().map_err(|_| self.broken("the number of a value"))?;
                self.put(index)?;
            }
            b'q' => {
                let [index] = self.array()?;
                self.put(u64::from(index))?;
            }
            b'r' => {
                let index = u32::from_le_bytes(self.array()?);
                self.put(u64::from(index))?;
            }
            0x94 => self.put(self.memo.len() as u64)?,
            b'g' => {
                let index = self.line()?.parse().map_err(|_| self.broken("the number of a value"))?;
                self.get(index)?;
            }
            b'h' => {
                let [index] = self.array()?;
                self.get(u64::from(index))?;
            }
            b'j' => {
                let index = u32::from_le_bytes(self.array()?);
                self.get(u64::from(index))?;
            }
            // REDUCE and NEWOBJ
            b'R' | 0x81 => {
                let (arguments, class) = (self.pop()?, self.pop()?);
                self.push(Value::Object { class, arguments, state: None });
            }
            0x92 => {
                let (_, arguments, class) = (self.pop()?, self.pop()?, self.pop()?); // keywords are not kept
                self.push(Value::Object { class, arguments, state: None });
            }
            b'i' => {
                let (module, name) = (self.line()?.to_owned(), self.line()?.to_owned());
                let items = self.pop_to_mark()?;
                self.push_global(&module, &name);
                let class = self.pop()?;
                self.push_instance(class, items)?;
            }
            b'o' => {
                let items = self.pop_to_mark()?;
                let (class, arguments) = items.split_first().ok_or_else(|| self.broken("a class"))?;
                self.push_instance(*class, arguments.to_vec())?;
            }
            b'b' => {
                let state = self.pop()?;
                let object = *self.stack.last().ok_or_else(|| self.broken("an object"))?;
                if let Some(Value::Object { state: kept, .. }) = self.values.get_mut(object) {
                    *kept = Some(state);
                }
            }
            other => {
                let found = format!("operation {other:#04x} at byte {}", self.at.saturating_sub(1));
                return Err(field("pickle", "operations of plain data", found));
            }
        }
        Ok(())
    }

    fn broken(&self, expected: &str) -> FileProblem {
        field("pickle", format!("{expected} before byte {}", self.at), "a broken or truncated pickle")
    }

    fn take(&mut self, count: usize) -> Result<&[u8], FileProblem> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let Some(end) = end else {
            let found = format!("{} bytes left: the file is truncated", self.bytes.len() - self.at);
            return Err(field("pickle", format!("{count} bytes at byte {}", self.at), found));
        };
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, FileProblem> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FileProblem> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// A line of text, without its end.
    fn line(&mut self) -> Result<&str, FileProblem> {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|byte| *byte == b'\n').ok_or_else(|| self.broken("a line"))?;
        let line = str::from_utf8(&rest[..end]).map_err(|_| self.broken("a line of text"))?;
        self.at += end + 1;
        Ok(line.trim_end_matches('\r'))
    }

    /// A length of `width` bytes.
    fn length(&mut self, width: usize) -> Result<usize, FileProblem> {
        let mut bytes = [0; 8];
        bytes[..width].copy_from_slice(self.take(width)?);
        usize::try_from(u64::from_le_bytes(bytes)).map_err(|_| self.broken("a length"))
    }

    fn push(&mut self, value: Value) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    fn push_global(&mut self, module: &str, name: &str) {
        self.push(Value::Global(format!("{module}.{name}")));
    }

    fn push_instance(&mut self, class: Id, arguments: Vec<Id>) -> Result<(), FileProblem> {
        self.push(Value::Tuple(arguments));
        let arguments = self.pop()?;
        self.push(Value::Object { class, arguments, state: None });
        Ok(())
    }

    fn push_int<const N: usize>(&mut self) -> Result<(), FileProblem> {
        let integer = self.length(N)?;
        self.push(Value::Int(integer as i64));
        Ok(())
    }

    /// A two's complement integer; larger ones than 64 bits become `None`.
    fn push_long(&mut self, width: usize) -> Result<(), FileProblem> {
        let count = self.length(width)?;
        let bytes = self.take(count)?;
        let value = match bytes.last() {
            _ if bytes.len() > 8 => Value::None,
            None => Value::Int(0),
            Some(last) => {
                let mut whole = if *last >= 0x80 { [0xFF; 8] } else { [0; 8] };
                whole[..bytes.len()].copy_from_slice(bytes);
                Value::Int(i64::from_le_bytes(whole))
            }
        };
        self.push(value);
        Ok(())
    }

    fn push_decimal_int(&mut self) -> Result<(), FileProblem> {
        let text = self.line()?.trim_end_matches('L').to_owned();
        let value = match text.as_str() {
            "01" => Value::Bool(true),
            "00" => Value::Bool(false),
            text => Value::Int(text.parse().map_err(|_| self.broken("an integer"))?),
        };
        self.push(value);
        Ok(())
    }

    fn push_bytes(&mut self, width: usize) -> Result<(), FileProblem> {
        let count = self.length(width)?;
        let start = self.at;
        let bytes = self.take(count)?;
        let value =
            if count <= SHORT { Value::Bytes(bytes.to_vec()) } else { Value::Slice(start, start + count) };
        self.push(value);
        Ok(())
    }

    /// Text of protocol 0: of Python 2 in quotes with Python's escapes, or Unicode with `\u` escapes.
    fn push_quoted(&mut self, quoted: bool) -> Result<(), FileProblem> {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|byte| *byte == b'\n').ok_or_else(|| self.broken("a line"))?;
        let mut line = rest[..end].trim_ascii_end();
        self.at += end + 1;
        if quoted {
            let inside = match line {
                [first, inside @ .., last] if first == last && matches!(first, b'\'' | b'"') => Some(inside),
                _ => None,
            };
            line = inside.ok_or_else(|| self.broken("text in quotes"))?;
        }
        self.push(Value::Bytes(unescaped(line)));
        Ok(())
    }

    fn pop(&mut self) -> Result<Id, FileProblem> {
        self.stack.pop().ok_or_else(|| self.broken("a value"))
    }

    fn pop_text(&mut self) -> Result<String, FileProblem> {
        let value = self.pop()?;
        match self.values.get(value) {
            Some(Value::Bytes(bytes)) => Ok(String::from_utf8_lossy(bytes).into_owned()),
            _ => Err(self.broken("a name")),
        }
    }

    fn pop_to_mark(&mut self) -> Result<Vec<Id>, FileProblem> {
        let is_mark = |id: &Id| self.values.get(*id) == Some(&Value::Mark);
        let mark = self.stack.iter().rposition(is_mark).ok_or_else(|| self.broken("a mark"))?;
        let items = self.stack.split_off(mark + 1);
        self.stack.pop();
        Ok(items)
    }

    fn collect(&mut self, of: fn(Vec<Id>) -> Value) -> Result<(), FileProblem> {
        let items = self.pop_to_mark()?;
        self.push(of(items));
        Ok(())
    }

    /// Adds items to the list on top of the stack; those of other objects are not kept.
    fn append(&mut self, items: &[Id]) -> Result<(), FileProblem> {
        let top = *self.stack.last().ok_or_else(|| self.broken("a list"))?;
        if let Some(Value::List(list)) = self.values.get_mut(top) {
            list.extend_from_slice(items);
        }
        Ok(())
    }

    /// Adds keys and values to the dictionary on top of the stack; those of other objects are not kept.
    fn set(&mut self, items: &[Id]) -> Result<(), FileProblem> {
        let top = *self.stack.last().ok_or_else(|| self.broken("a dictionary"))?;
        if let Some(Value::Dict(entries)) = self.values.get_mut(top) {
            entries.extend(pairs(items));
        }
        Ok(())
    }

    fn put(&mut self, index: u64) -> Result<(), FileProblem> {
        let top = *self.stack.last().ok_or_else(|| self.broken("a value"))?;
        self.memo.insert(index, top);
        Ok(())
    }

    fn get(&mut self, index: u64) -> Result<(), FileProblem> {
        let value = *self.memo.get(&index).ok_or_else(|| self.broken("an earlier value"))?;
        self.stack.push(value);
        Ok(())
    }
}

fn pairs(items: &[Id]) -> Vec<(Id, Id)> {
    items.as_chunks::<2>().0.iter().map(|[key, value]| (*key, *value)).collect()
}

/// Python's escapes in a string literal; unknown ones stay as they are.
fn unescaped(text: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text;
    while let [first, after @ ..] = rest {
        let hex = |digits: usize| {
            let digits = str::from_utf8(after.get(1..1 + digits)?).ok()?;
            u32::from_str_radix(digits, 16).ok()
        };
        let (byte, used) = match (first, after.first()) {
            (b'\\', Some(b'n')) => (b'\n', 2),
            (b'\\', Some(b'r')) => (b'\r', 2),
            (b'\\', Some(b't')) => (b'\t', 2),
            (b'\\', Some(quote @ (b'\\' | b'\'' | b'"'))) => (*quote, 2),
            (b'\\', Some(b'x')) => hex(2).map_or((b'\\', 1), |code| (code as u8, 4)),
            (b'\\', Some(b'u')) => match hex(4).and_then(char::from_u32) {
                Some(letter) => {
                    bytes.extend(letter.to_string().bytes());
                    rest = &rest[6..];
                    continue;
                }
                None => (b'\\', 1),
            },
            (other, _) => (*other, 1),
        };
        bytes.push(byte);
        rest = &rest[used..];
    }
    bytes
}

#[cfg(test)]
mod tests;

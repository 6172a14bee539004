//! FLAME's files: dictionaries of NumPy arrays, arrays wrapped by chumpy, and a SciPy sparse matrix, pickled by Python 2 or 3.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use srflow_core::{excerpt, excerpts};
use srflow_files::pickle::{Id, Pickle, Value};
use srflow_files::{Array, FileError, FileKind, FileProblem, npy_pickle, read_file};

/// Most values in a row of names and attributes that lead to an array.
const MAX_WRAPPERS: usize = 8;

/// A file that holds a pickled dictionary.
#[derive(Debug)]
pub(crate) struct PickledArrays {
    path: PathBuf,
    pickle: Pickle,
    /// The dictionary.
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

impl PickledArrays {
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
        let pickle = Pickle::parse(Arc::new(bytes), start)?;
        let mut file = Self { path: path.to_owned(), root: pickle.root(), pickle };
        // `np.save` of a dictionary pickles an array that holds it.
        if let Some(items) = file.object_items(file.root)
            && let [only] = items[..]
        {
            file.root = only;
        }
        match file.pickle.value(file.root) {
            Some(Value::Dict(_)) => Ok(file),
            _ => Err(field("pickle", "a dictionary of arrays", file.pickle.describe(file.root))),
        }
    }

    /// The file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The keys of the dictionary that are text.
    pub(crate) fn names(&self) -> Vec<String> {
        let entries = self.pickle.entries(self.root).iter();
        entries.filter_map(|(key, _)| self.pickle.text(*key)).collect()
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
        self.pickle.entry(self.root, name).ok_or_else(|| {
            let names = self.names();
            let found = format!("the keys {}", excerpts(names.iter().map(String::as_str), 20));
            field("key", format!("one called `{name}`"), found)
        })
    }

    /// The bytes of an array: a byte string, or one that Python 3 pickled as text for Python 2 (`_codecs.encode`).
    fn array_bytes(&self, value: Id) -> Option<Cow<'_, [u8]>> {
        let Some((class, arguments, _)) = self.pickle.object(value) else {
            return self.pickle.raw(value).map(Cow::Borrowed);
        };
        let Some(text) = arguments.first() else { return Some(Cow::Borrowed(&[])) }; // bytes() is empty
        let text = self.pickle.raw(*text)?;
        match class {
            "_codecs.encode" => {
                let letters = str::from_utf8(text).ok()?.chars();
                letters.map(|letter| u8::try_from(u32::from(letter)).ok()).collect()
            }
            "builtins.bytearray" | "__builtin__.bytearray" => Some(Cow::Borrowed(text)),
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
        let (name, _, Some(state)) = self.pickle.object(value)? else { return None };
        let items = *self.pickle.items(state)?.last()?;
        match self.pickle.value(items)? {
            Value::List(items) if Self::is_called(name, "numpy", "_reconstruct") => Some(items.clone()),
            _ => None,
        }
    }

    fn array_of(&self, mut value: Id) -> Result<Array, FileProblem> {
        for _ in 0..MAX_WRAPPERS {
            let Some((name, arguments, state)) = self.pickle.object(value) else {
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
                state.filter(|_| name.starts_with("chumpy.")).and_then(|state| self.pickle.entry(state, "x"));
            value = inside.ok_or_else(|| self.no_array(value))?;
        }
        Err(self.no_array(value))
    }

    fn no_array(&self, value: Id) -> FileProblem {
        field("value", "an array of numbers of NumPy or chumpy", self.pickle.describe(value))
    }

    /// The state of an array of NumPy: version, shape, type, whether in Fortran order, and bytes.
    fn reconstructed(&self, state: Option<Id>) -> Option<Result<Array, FileProblem>> {
        let state = self.pickle.items(state?)?;
        let [shape, kind, fortran, bytes] = *state.last_chunk::<4>()?;
        let (shape, kind) = (self.pickle.sizes(shape)?, self.type_name(kind)?);
        let fortran_order = self.pickle.integer(fortran)? != 0;
        Some(Array::from_numpy(&kind, shape, fortran_order, &self.array_bytes(bytes)?))
    }

    /// The arguments of NumPy's `_frombuffer`: bytes, type, shape and order.
    fn of_buffer(&self, arguments: &[Id]) -> Option<Result<Array, FileProblem>> {
        let [bytes, kind, shape, order] = *arguments.first_chunk::<4>()?;
        let (shape, kind) = (self.pickle.sizes(shape)?, self.type_name(kind)?);
        Some(Array::from_numpy(&kind, shape, self.pickle.is_text(order, "F"), &self.array_bytes(bytes)?))
    }

    /// The name of a `numpy.dtype`, e.g. `<f8`: its first argument is the kind, the second item of its state the byte order.
    fn type_name(&self, value: Id) -> Option<String> {
        let (name, arguments, state) = self.pickle.object(value)?;
        let kind =
            self.pickle.text(*arguments.first()?).filter(|_| Self::is_called(name, "numpy", "dtype"))?;
        let order = match state {
            Some(state) => self.pickle.text(*self.pickle.items(state)?.get(1)?)?,
            None => "<".to_owned(),
        };
        Some(format!("{order}{kind}"))
    }

    /// A number or a list of numbers as an array.
    fn listed(&self, value: Id) -> Option<Array> {
        let number = |value: Id| match self.pickle.value(value)? {
            Value::Float(number) => Some(*number as f32),
            _ => self.pickle.integer(value).map(|integer| integer as f32),
        };
        if let Some(number) = number(value) {
            return Some(Array { shape: Vec::new(), values: vec![number] });
        }
        let Value::List(items) = self.pickle.value(value)? else { return None };
        let values: Option<Vec<f32>> = items.iter().map(|item| number(*item)).collect();
        Some(Array { shape: vec![items.len()], values: values? })
    }

    fn matrix_of(&self, value: Id) -> Result<Matrix, FileProblem> {
        let sparse = self
            .pickle
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
            let found =
                self.pickle.entry(state, name).ok_or_else(|| field("matrix", format!("`{name}`"), "none"));
            found.and_then(|value| self.array_of(value))
        };
        let shape = self.pickle.entry(state, "_shape").and_then(|shape| self.pickle.sizes(shape));
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
}

fn field(field: &'static str, expected: impl Into<String>, found: impl Into<String>) -> FileProblem {
    FileProblem::field(field, expected, found)
}

#[cfg(test)]
mod tests;

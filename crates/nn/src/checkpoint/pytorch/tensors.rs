//! The tensors that a pickle describes, and their names.

use std::collections::BTreeMap;

use burn::tensor::DType;
use srflow_core::excerpt;
use srflow_files::pickle::{Id, Pickle, Value};

/// Most dictionaries, lists and modules inside one another.
const MAX_DEPTH: usize = 32;
/// Most letters in all names, so that values that are referred to often do not take memory.
const MAX_NAMES: usize = 32 << 20;
/// Most wrappers around a tensor: parameters, subclasses.
const MAX_WRAPPERS: usize = 8;

/// A kind of number: names of the type and of its storage's class, bytes, and the type for numbers that are weights.
type NumberKind = (&'static str, &'static str, u64, Option<DType>);

const NUMBER_KINDS: [NumberKind; 15] = [
    ("float64", "DoubleStorage", 8, Some(DType::F64)),
    ("float32", "FloatStorage", 4, Some(DType::F32)),
    ("float16", "HalfStorage", 2, Some(DType::F16)),
    ("bfloat16", "BFloat16Storage", 2, Some(DType::BF16)),
    ("int64", "LongStorage", 8, None),
    ("int32", "IntStorage", 4, None),
    ("int16", "ShortStorage", 2, None),
    ("int8", "CharStorage", 1, None),
    ("uint8", "ByteStorage", 1, None),
    ("bool", "BoolStorage", 1, None),
    ("complex64", "ComplexFloatStorage", 8, None),
    ("complex128", "ComplexDoubleStorage", 16, None),
    ("qint8", "QInt8Storage", 1, None),
    ("quint8", "QUInt8Storage", 1, None),
    ("qint32", "QInt32Storage", 4, None),
];

/// Where the numbers of a tensor are.
pub(super) struct Described {
    /// Of its storage.
    pub(super) key: String,
    pub(super) dtype: DType,
    pub(super) shape: Vec<usize>,
    /// In numbers, as the offset.
    pub(super) strides: Vec<usize>,
    pub(super) offset: usize,
}

/// What a pickle holds.
pub(super) struct Tensors {
    /// Tensors of floating-point numbers by name, its parts joined by dots.
    pub(super) found: BTreeMap<String, Described>,
    /// Kinds of the other arrays, by name.
    pub(super) others: BTreeMap<String, String>,
}

impl Tensors {
    /// Walks through dictionaries, lists, modules and other objects.
    ///
    /// # Errors
    /// When a tensor is not described as PyTorch does, or the values refer to each other too often.
    pub(super) fn of(pickle: &Pickle) -> Result<Self, String> {
        let tensors = Self { found: BTreeMap::new(), others: BTreeMap::new() };
        let mut walk = Walk { pickle, tensors, path: Vec::new(), left: MAX_NAMES };
        walk.visit("", pickle.root())?;
        Ok(walk.tensors)
    }
}

/// Bytes of each storage that a pickle refers to, by its key.
pub(super) fn storage_sizes(pickle: &Pickle) -> BTreeMap<String, u64> {
    let size = |value: &Value| {
        let Value::Elsewhere(reference) = value else { return None };
        let (key, kind, numbers) = storage_reference(pickle, *reference)?;
        let bytes = kind.map_or(1, |(_, _, bytes, _)| bytes);
        Some((key, numbers.saturating_mul(bytes)))
    };
    pickle.values().filter_map(size).collect()
}

/// Key, kind and numbers of a storage; no kind for the bytes of an `UntypedStorage`.
fn storage_reference(pickle: &Pickle, reference: Id) -> Option<(String, Option<NumberKind>, u64)> {
    let [_, class, key, _, numbers] = *pickle.items(reference)?.first_chunk::<5>()?;
    let class = pickle.global(class)?.rsplit('.').next()?;
    let kind = NUMBER_KINDS.into_iter().find(|(_, storage, ..)| *storage == class);
    Some((pickle.text(key)?, kind, u64::try_from(pickle.integer(numbers)?).ok()?))
}

struct Walk<'a> {
    pickle: &'a Pickle,
    tensors: Tensors,
    /// The values that contain the visited one: a module may refer to its parent.
    path: Vec<Id>,
    left: usize,
}

impl Walk<'_> {
    fn visit(&mut self, name: &str, value: Id) -> Result<(), String> {
        let left = self.left.checked_sub(1 + name.len());
        self.left = left.ok_or("its values refer to each other too often")?;
        if self.path.len() == MAX_DEPTH || self.path.contains(&value) || self.is_array(name, value)? {
            return Ok(());
        }
        self.path.push(value);
        self.visit_inside(name, value)?;
        self.path.pop();
        Ok(())
    }

    fn visit_inside(&mut self, name: &str, value: Id) -> Result<(), String> {
        let pickle = self.pickle;
        for (key, inside) in pickle.entries(value) {
            let key = match pickle.value(*key) {
                Some(Value::Int(number)) => number.to_string(),
                _ => pickle.text(*key).unwrap_or_default(),
            };
            self.visit(&joined(name, &key), *inside)?;
        }
        for (index, inside) in pickle.items(value).unwrap_or_default().iter().enumerate() {
            self.visit(&joined(name, &index.to_string()), *inside)?;
        }
        let Some((class, arguments, state)) = pickle.object(value) else { return Ok(()) };
        if class == "collections.OrderedDict" {
            // Python 2 passes pairs.
            for pair in arguments.first().and_then(|pairs| pickle.items(*pairs)).unwrap_or_default() {
                if let Some([key, inside]) = pickle.items(*pair) {
                    self.visit(&joined(name, &pickle.text(*key).unwrap_or_default()), *inside)?;
                }
            }
            return Ok(()); // its state is about versions of modules
        }
        let Some(state) = state else { return Ok(()) };
        let parts = ["_parameters", "_buffers", "_modules"].map(|part| pickle.entry(state, part));
        if parts == [None; 3] {
            return self.visit(name, state);
        }
        // A whole `nn.Module`, under the names of its state_dict.
        for part in parts.into_iter().flatten() {
            self.visit(name, part)?;
        }
        let temporary = pickle.entry(state, "_non_persistent_buffers_set");
        let temporary =
            temporary.and_then(|set| pickle.object(set)).and_then(|(_, arguments, _)| arguments.first());
        for buffer in temporary.and_then(|names| pickle.items(*names)).unwrap_or_default() {
            let buffer = pickle.text(*buffer).unwrap_or_default();
            self.tensors.found.remove(&joined(name, &buffer));
        }
        Ok(())
    }

    /// Whether a value is an array of any kind, which is kept or counted.
    fn is_array(&mut self, name: &str, mut value: Id) -> Result<bool, String> {
        let pickle = self.pickle;
        let Some(Value::Object { class, arguments, .. }) = pickle.value(value) else { return Ok(false) };
        let (mut class, mut arguments) = (*class, *arguments);
        for _ in 0..MAX_WRAPPERS {
            let (Some(function), Some(items)) = (pickle.global(class), pickle.items(arguments)) else {
                return Ok(false);
            };
            match (function, items) {
                (
                    "torch._utils._rebuild_parameter" | "torch._utils._rebuild_parameter_with_state",
                    [data, ..],
                ) => {
                    value = *data;
                    let Some(Value::Object { class: of_data, arguments: of, .. }) = pickle.value(value)
                    else {
                        break;
                    };
                    (class, arguments) = (*of_data, *of);
                }
                // A subclass of tensors: the function, the class and the function's arguments.
                ("torch._tensor._rebuild_from_type_v2", [of_tensor, _, of, ..]) => {
                    (class, arguments) = (*of_tensor, *of);
                }
                (
                    "torch._utils._rebuild_tensor"
                    | "torch._utils._rebuild_tensor_v2"
                    | "torch._utils._rebuild_tensor_v3",
                    items,
                ) => {
                    let broken = || format!("{}: it is not described as a tensor of PyTorch", shown(name));
                    self.keep(name, items).ok_or_else(broken)?;
                    return Ok(true);
                }
                ("torch._utils._rebuild_meta_tensor_no_storage", _) => {
                    self.leave_out(name, "tensors on the device meta, which have no values".to_owned());
                    return Ok(true);
                }
                (function, _) if function.starts_with("numpy.") && !function.ends_with(".dtype") => {
                    let scalar = function.ends_with(".scalar");
                    self.leave_out(
                        name,
                        if scalar { "numbers of NumPy" } else { "arrays of NumPy" }.to_owned(),
                    );
                    return Ok(true);
                }
                (function, _)
                    if function.starts_with("torch._utils._rebuild")
                        || function.starts_with("torch.storage.") =>
                {
                    self.leave_out(name, format!("objects of {}", excerpt(function)));
                    return Ok(true);
                }
                _ => return Ok(false),
            }
        }
        Err(format!("{}: expected a tensor, found {}", shown(name), pickle.describe(value)))
    }

    /// Keeps the tensor with these arguments: storage, offset, sizes and strides; in the third version the type as the seventh.
    fn keep(&mut self, name: &str, arguments: &[Id]) -> Option<()> {
        let pickle = self.pickle;
        let [storage, offset, sizes, strides] = *arguments.first_chunk::<4>()?;
        let Some(Value::Elsewhere(reference)) = pickle.value(storage) else { return None };
        let (key, kind, _) = storage_reference(pickle, *reference)?;
        let named = arguments.get(6).and_then(|dtype| pickle.global(*dtype));
        let dtype = match (kind, named.and_then(|name| name.strip_prefix("torch."))) {
            (Some((.., Some(dtype))), _) => dtype,
            (Some((kind, ..)), _) => {
                self.leave_out(name, format!("tensors of {kind}"));
                return Some(());
            }
            (None, kind) => match NUMBER_KINDS.into_iter().find(|(name, ..)| Some(*name) == kind) {
                Some((.., Some(dtype))) => dtype,
                _ => {
                    self.leave_out(
                        name,
                        format!("tensors of {}", excerpt(kind.unwrap_or("an unknown type"))),
                    );
                    return Some(());
                }
            },
        };
        // Before 1.6, a storage could be part of another: key, offset and numbers.
        let part = pickle.items(*reference)?.get(5).and_then(|part| pickle.items(*part));
        let part = match part {
            Some([_, offset, _]) => usize::try_from(pickle.integer(*offset)?).ok()?,
            _ => 0,
        };
        let offset = usize::try_from(pickle.integer(offset)?).ok()?.checked_add(part)?;
        let (shape, strides) = (pickle.sizes(sizes)?, pickle.sizes(strides)?);
        self.tensors.found.insert(name.to_owned(), Described { key, dtype, shape, strides, offset });
        Some(())
    }

    fn leave_out(&mut self, name: &str, kind: String) {
        self.tensors.others.insert(name.to_owned(), kind);
    }
}

fn joined(name: &str, key: &str) -> String {
    if name.is_empty() { key.to_owned() } else { format!("{name}.{key}") }
}

fn shown(name: &str) -> String {
    if name.is_empty() { "the whole pickle".to_owned() } else { excerpt(name) }
}

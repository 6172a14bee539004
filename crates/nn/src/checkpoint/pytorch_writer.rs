//! Writes checkpoints for PyTorch and Lightning: a zip file with a pickle that describes the tensors, and their bytes.
//!
//! The pickle uses the part of protocol 2 that `torch.load` accepts with `weights_only=True`: dictionaries, strings, integers,
//! and tensors built by `torch._utils._rebuild_tensor_v2`.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use burn::module::Module;
use srflow_files::{FileError, write_atomically, write_zip};
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

use super::About;
use crate::parameters::{Parameters, parameters};

/// Folder inside the zip file; `torch.save` names it after the file, `torch.load` accepts any name.
const ARCHIVE: &str = "archive";
/// Version of the zip format of `torch.save`.
const FORMAT_VERSION: &str = "3\n";
/// Alignment of tensors that `torch.load` with `mmap=True` requires.
const ALIGNMENT: u16 = 64;
/// Lightning migrates files from the version in them to its own.
const LIGHTNING_VERSION: &str = "2.4.0";

/// Writes the parameters of a network, under the reference's names, to a Lightning checkpoint, which `torch.load`,
/// `load_from_checkpoint` and ptlflow's `get_model(ckpt_path=...)` read. The write is atomic. It adds the tensors besides
/// parameters that `load_state_dict` requires: counters of batch norm, the second name of the norm of a shortcut, and the index
/// table of relative positions. `prefix` is prepended to every name.
///
/// # Errors
/// When the file cannot be written.
pub fn save_pytorch(
    network: &impl Module,
    prefix: &str,
    about: &About,
    path: &Path,
) -> Result<(), FileError> {
    let parameters = parameters(network);
    let mut state = State::new(&parameters);
    for tensor in &mut state.tensors {
        tensor.name.insert_str(0, prefix);
    }
    write_atomically(path, |file| {
        write_zip(file, |zip| {
            let options = SimpleFileOptions::default()
                .compression_method(CompressionMethod::Stored)
                .with_alignment(ALIGNMENT);
            let mut write = |name: &str, bytes: &[u8]| {
                zip.start_file(format!("{ARCHIVE}/{name}"), options)?;
                zip.write_all(bytes)
            };
            write("data.pkl", &state.pickle(about))?;
            write("byteorder", b"little")?;
            for (key, storage) in state.storages.iter().enumerate() {
                write(&format!("data/{key}"), &storage.bytes)?;
            }
            write("version", FORMAT_VERSION.as_bytes())
        })
    })
}

/// Tensors by name, and their storages, which two tensors may share.
struct State<'a> {
    tensors: Vec<Tensor>,
    storages: Vec<Storage<'a>>,
}

struct Tensor {
    name: String,
    shape: Vec<usize>,
    storage: usize,
}

struct Storage<'a> {
    class: &'static str,
    numbers: usize,
    bytes: Cow<'a, [u8]>,
}

impl<'a> State<'a> {
    fn new(parameters: &'a Parameters) -> Self {
        let mut state = Self { tensors: Vec::new(), storages: Vec::new() };
        for (name, data) in parameters {
            let shape = data.shape().to_vec();
            let storage = state.storages.len();
            state.storages.push(Storage {
                class: "FloatStorage",
                numbers: shape.iter().product(),
                bytes: Cow::Borrowed(data.as_bytes()),
            });
            if let Some(module) = name.strip_suffix(".running_mean") {
                state.push_integers(format!("{module}.num_batches_tracked"), Vec::new(), vec![0]);
            }
            if let (Some(module), [rows, _]) = (name.strip_suffix(".rel_height.weight"), &shape[..]) {
                let places = rows.div_ceil(2) as i64;
                let row = |from: i64| (0..places).map(move |to| to - from + places - 1);
                let indices = (0..places).flat_map(row).collect();
                state.push_integers(format!("{module}.rel_ind"), vec![places as usize; 2], indices);
            }
            state.tensors.push(Tensor { name: name.clone(), shape, storage });
        }
        let second = |tensor: &Tensor| {
            let (block, rest) = tensor.name.split_once("downsample.1.")?;
            let norm = if parameters.contains_key(&format!("{block}bn1.weight")) { "bn3" } else { "norm3" };
            let name = format!("{block}{norm}.{rest}");
            Some(Tensor { name, shape: tensor.shape.clone(), storage: tensor.storage })
        };
        let second: Vec<Tensor> = state.tensors.iter().filter_map(second).collect();
        state.tensors.extend(second);
        state
    }

    fn push_integers(&mut self, name: String, shape: Vec<usize>, numbers: Vec<i64>) {
        self.tensors.push(Tensor { name, shape, storage: self.storages.len() });
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        self.storages.push(Storage {
            class: "LongStorage",
            numbers: numbers.len(),
            bytes: Cow::Owned(bytes),
        });
    }

    fn pickle(&self, about: &About) -> Vec<u8> {
        let mut pickle = Pickle(vec![PROTO, 2]);
        pickle.dict(|pickle| {
            pickle.item("epoch", |pickle| pickle.int(0));
            pickle.item("global_step", |pickle| pickle.int(0));
            pickle.item("pytorch-lightning_version", |pickle| pickle.text(LIGHTNING_VERSION));
            let numbers = |pickle: &mut Pickle, numbers: &BTreeMap<String, usize>| {
                for (name, number) in numbers {
                    pickle.item(name, |pickle| pickle.int(*number));
                }
            };
            pickle.item("hyper_parameters", |pickle| {
                pickle.dict(|pickle| numbers(pickle, &about.hyper_parameters));
            });
            // Lightning passes every hyper-parameter to the constructor of the network, so unknown ones are stored separately.
            pickle.item("srflow", |pickle| {
                pickle.dict(|pickle| {
                    pickle.item("network", |pickle| pickle.text(&about.network));
                    numbers(pickle, &about.settings);
                });
            });
            pickle.item("state_dict", |pickle| {
                pickle.call("collections", "OrderedDict", |_| {});
                pickle.items(|pickle| {
                    for tensor in &self.tensors {
                        pickle.item(&tensor.name, |pickle| {
                            pickle.tensor(tensor, &self.storages[tensor.storage]);
                        });
                    }
                });
            });
        });
        pickle.0.push(STOP);
        pickle.0
    }
}

// Opcodes of pickles.
const PROTO: u8 = 0x80;
const STOP: u8 = b'.';
const MARK: u8 = b'(';
const TUPLE: u8 = b't';
const EMPTY_DICT: u8 = b'}';
const SET_ITEMS: u8 = b'u';
const GLOBAL: u8 = b'c';
const REDUCE: u8 = b'R';
const BIN_PERSISTENT_ID: u8 = b'Q';
const BIN_INT: u8 = b'J';
const LONG_1: u8 = 0x8a;
const BIN_UNICODE: u8 = b'X';
const NEW_FALSE: u8 = 0x89;

/// The bytes of a pickle so far.
struct Pickle(Vec<u8>);

impl Pickle {
    fn int(&mut self, number: usize) {
        match i32::try_from(number) {
            Ok(number) => {
                self.0.push(BIN_INT);
                self.0.extend(number.to_le_bytes());
            }
            Err(_) => {
                self.0.extend([LONG_1, 9]); // the last byte for the sign
                self.0.extend((number as u64).to_le_bytes());
                self.0.push(0);
            }
        }
    }

    fn text(&mut self, text: &str) {
        self.0.push(BIN_UNICODE);
        self.0.extend((text.len() as u32).to_le_bytes());
        self.0.extend(text.as_bytes());
    }

    fn global(&mut self, module: &str, name: &str) {
        self.0.push(GLOBAL);
        self.0.extend(format!("{module}\n{name}\n").as_bytes());
    }

    fn tuple(&mut self, items: impl FnOnce(&mut Self)) {
        self.0.push(MARK);
        items(self);
        self.0.push(TUPLE);
    }

    fn call(&mut self, module: &str, name: &str, arguments: impl FnOnce(&mut Self)) {
        self.global(module, name);
        self.tuple(arguments);
        self.0.push(REDUCE);
    }

    fn dict(&mut self, items: impl FnOnce(&mut Self)) {
        self.0.push(EMPTY_DICT);
        self.items(items);
    }

    /// Adds items to the dictionary on the stack.
    fn items(&mut self, items: impl FnOnce(&mut Self)) {
        self.0.push(MARK);
        items(self);
        self.0.push(SET_ITEMS);
    }

    fn item(&mut self, key: &str, value: impl FnOnce(&mut Self)) {
        self.text(key);
        value(self);
    }

    fn tensor(&mut self, tensor: &Tensor, storage: &Storage) {
        self.call("torch._utils", "_rebuild_tensor_v2", |pickle| {
            pickle.tuple(|pickle| {
                pickle.text("storage");
                pickle.global("torch", storage.class);
                pickle.text(&tensor.storage.to_string());
                pickle.text("cpu");
                pickle.int(storage.numbers);
            });
            pickle.0.push(BIN_PERSISTENT_ID);
            pickle.int(0); // offset in the storage
            pickle.tuple(|pickle| tensor.shape.iter().for_each(|&size| pickle.int(size)));
            pickle.tuple(|pickle| {
                let stride = |dim: usize| tensor.shape[dim + 1..].iter().product();
                (0..tensor.shape.len()).for_each(|dim| pickle.int(stride(dim)));
            });
            pickle.0.push(NEW_FALSE); // requires_grad
            pickle.call("collections", "OrderedDict", |_| {}); // hooks
        });
    }
}

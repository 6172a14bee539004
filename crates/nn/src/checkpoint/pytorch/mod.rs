//! PyTorch files: a pickle that describes the tensors, and their storages.
//!
//! Source: `torch/serialization.py` and `torch/_utils.py` of PyTorch 2.

mod hyper_parameters;
mod storages;
mod tensors;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::rc::Rc;
use std::sync::Arc;

use srflow_files::pickle::{Pickle, Value};
use zip::ZipArchive;

use super::{Contents, MAX_CLAIM_RATIO, StoredBytes, StoredTensor};
use storages::Storage;
pub(super) use storages::StridedTensor;
use tensors::{Described, Tensors};

/// Largest pickle. Those of real checkpoints are below a megabyte, as they contain no values.
const MAX_PICKLE_BYTES: u64 = 16 << 20;

/// A file of PyTorch 1.6 and later.
pub(super) fn zip_contents(file: File, len: u64) -> Result<Contents, String> {
    let file = Rc::new(file);
    let mut archive = ZipArchive::new(BufReader::new(&*file)).map_err(|error| error.to_string())?;
    let mut names = archive.file_names().filter_map(|name| name.ok().map(|name| name.into_owned()));
    let name = names.find(|name| name == "data.pkl" || name.ends_with("/data.pkl"));
    drop(names);
    let name = name.ok_or("it has no data.pkl: it is a zip file of another program")?;
    let folder = name.trim_end_matches("data.pkl").to_owned();
    if let Ok(order) = archive.by_name(&format!("{folder}byteorder"))
        && order.size() <= 8
    {
        little_endian(storages::read_entry(order, &file)?.trim_ascii() != b"big")?;
    }
    let most = MAX_PICKLE_BYTES.min(len.saturating_mul(MAX_CLAIM_RATIO));
    let entry = archive.by_name(&name).map_err(|error| error.to_string())?;
    if entry.size() > most {
        return Err(format!("its data.pkl claims {} bytes, more than the limit of {most}", entry.size()));
    }
    let bytes = storages::read_entry(entry, &file)?;
    let pickle = Pickle::parse(Arc::new(bytes), 0).map_err(|problem| problem.to_string())?;
    let mut inflated = 0;
    contents(&pickle, |key| {
        let entry = archive.by_name(&format!("{folder}data/{key}")).map_err(|error| error.to_string())?;
        Storage::of_entry(entry, &file, len, &mut inflated)
    })
}

/// A file of PyTorch before 1.6: pickles of a magic number, a version, the system, the tensors and the keys of their storages,
/// then the storages, each after the number of its elements.
pub(super) fn legacy_contents(file: File, len: u64) -> Result<Contents, String> {
    let file = Rc::new(file);
    let mut bytes = Vec::new();
    (&*file).rewind().map_err(|error| error.to_string())?;
    (&*file).take(MAX_PICKLE_BYTES).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    let bytes = Arc::new(bytes);
    let parse = |start: usize| {
        Pickle::parse(bytes.clone(), start).map_err(|problem| match len > MAX_PICKLE_BYTES {
            true => format!("{problem}, in the first {MAX_PICKLE_BYTES} bytes"),
            false => problem.to_string(),
        })
    };
    let magic = parse(0)?;
    // The magic number has ten bytes. Anything else is a bare pickle.
    if magic.value(magic.root()) != Some(&Value::None) {
        return contents(&magic, |_| Err("it is a pickle without the storages of tensors".into()));
    }
    let system = parse(parse(magic.end())?.end())?;
    let little = system.entry(system.root(), "little_endian").and_then(|set| system.integer(set));
    little_endian(little != Some(0))?;
    let pickle = parse(system.end())?;
    let keys = parse(pickle.end())?;
    let sizes = tensors::storage_sizes(&pickle);
    let mut places = BTreeMap::new();
    let mut at = keys.end() as u64;
    for key in keys.items(keys.root()).unwrap_or_default() {
        let key = keys.text(*key).ok_or("the keys of its storages are not text")?;
        let size = *sizes.get(&key).ok_or("its storages are not those of its tensors")?;
        at = at.saturating_add(size_of::<i64>() as u64);
        let end = at.saturating_add(size);
        if end > len {
            return Err(format!(
                "storage {key} claims {size} bytes at {at}, the file has {len}: it is truncated"
            ));
        }
        places.insert(key, at..end);
        at = end;
    }
    contents(&pickle, |key| match places.get(key) {
        Some(place) => Ok(Storage::in_file(&file, place.clone())),
        None => Err("it is not in the file".into()),
    })
}

fn little_endian(little: bool) -> Result<(), String> {
    if little { Ok(()) } else { Err("its numbers are big-endian, from another kind of processor".into()) }
}

/// The tensors that a pickle describes. `storage` finds the storage of a key.
fn contents(
    pickle: &Pickle,
    mut storage: impl FnMut(&str) -> Result<Storage, String>,
) -> Result<Contents, String> {
    let Tensors { found, others } = Tensors::of(pickle)?;
    let mut storages = BTreeMap::<String, Rc<Storage>>::new();
    let mut tensors = BTreeMap::new();
    for (name, Described { key, dtype, shape, strides, offset }) in found {
        let storage = match storages.get(&key) {
            Some(storage) => storage.clone(),
            None => {
                let found = storage(&key).map_err(|problem| format!("{name}: storage {key}: {problem}"))?;
                storages.entry(key).or_insert(Rc::new(found)).clone()
            }
        };
        let tensor = StridedTensor::new(storage, &shape, strides, offset, dtype.size());
        let bytes = StoredBytes::Pytorch(tensor.map_err(|problem| format!("{name}: {problem}"))?);
        tensors.insert(name, StoredTensor { dtype, shape, bytes });
    }
    let hyper_parameters = hyper_parameters::numbers(pickle);
    Ok(Contents { others, hyper_parameters, ..Contents::from(tensors) })
}

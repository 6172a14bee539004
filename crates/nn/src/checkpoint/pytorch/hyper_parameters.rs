//! The numeric hyper-parameters that Lightning saves, and the settings that srflow saves.

use std::collections::BTreeMap;

use srflow_files::pickle::{Id, Pickle, Value};

/// Keys of the dictionaries of Lightning and of srflow.
const KEYS: [&str; 2] = ["hyper_parameters", "srflow"];
/// Most dictionaries inside one another.
const MAX_DEPTH: usize = 4;

/// Numbers by name, of dictionaries inside the dictionary too: the first one counts. Booleans are not included.
pub(super) fn numbers(pickle: &Pickle) -> BTreeMap<String, f64> {
    let mut numbers = BTreeMap::new();
    let mut left = usize::from(u16::MAX);
    for dictionary in KEYS.into_iter().filter_map(|key| pickle.entry(pickle.root(), key)) {
        collect(pickle, dictionary, MAX_DEPTH, &mut left, &mut numbers);
    }
    numbers
}

/// `left` dictionaries and entries are looked at.
fn collect(
    pickle: &Pickle,
    dictionary: Id,
    depth: usize,
    left: &mut usize,
    numbers: &mut BTreeMap<String, f64>,
) {
    // An `argparse.Namespace` keeps its entries as its state.
    let state = pickle.object(dictionary).and_then(|(_, _, state)| state);
    let entries = [Some(dictionary), state].into_iter().flatten().flat_map(|of| pickle.entries(of));
    for (key, value) in entries {
        let Some(rest) = left.checked_sub(1) else { return };
        *left = rest;
        let number = match pickle.value(*value) {
            Some(Value::Int(integer)) => *integer as f64,
            Some(Value::Float(number)) => *number,
            Some(Value::Dict(_) | Value::Object { .. }) if depth > 1 => {
                collect(pickle, *value, depth - 1, left, numbers);
                continue;
            }
            _ => continue,
        };
        if let Some(name) = pickle.text(*key) {
            numbers.entry(name).or_insert(number);
        }
    }
}

//! Settings as JSON.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::Error;

/// A job, or settings such as [`MethodParameters`](crate::flow::MethodParameters), from their fields as JSON.
/// Fields that are not given have their defaults.
///
/// # Errors
/// [`ErrorKind::Setting`](crate::ErrorKind::Setting), with the name of a field that is unknown, missing or
/// wrong.
pub fn from_json<T: Serialize + DeserializeOwned>(given: &Map<String, Value>) -> Result<T, Error> {
    let settings: T = match read(given) {
        Ok(settings) => settings,
        Err(error) => {
            return Err(match given.keys().find(|name| is_cause::<T>(given, name, &error)) {
                Some(name) => Error::wrong_settings(format!("`{name}`: {error}")),
                None => Error::wrong_settings(error),
            });
        }
    };
    // Serde ignores unknown fields where structs are flattened.
    let known = serde_json::to_value(&settings).map_err(anyhow::Error::from)?;
    let known: Vec<&String> = known.as_object().into_iter().flat_map(Map::keys).collect();
    match given.keys().find(|name| !known.contains(name) && !is_read::<T>(given, name)) {
        None => Ok(settings),
        Some(name) => {
            let known = known.into_iter().map(String::as_str).collect::<Vec<_>>().join(", ");
            Err(Error::wrong_settings(format!("unknown setting `{name}`; the settings are {known}")))
        }
    }
}

fn read<T: DeserializeOwned>(given: &Map<String, Value>) -> Result<T, String> {
    serde_json::from_value(Value::Object(given.clone())).map_err(|error| error.to_string())
}

/// Whether a field of this name is read at all, as one is that has another name in files: what is no value of any field is then refused.
fn is_read<T: DeserializeOwned>(given: &Map<String, Value>, name: &str) -> bool {
    let mut with_nonsense = given.clone();
    with_nonsense.insert(name.to_owned(), serde_json::json!([[{}]]));
    read::<T>(&with_nonsense).is_err()
}

/// Whether the error is due to this field: serde does not name fields of flattened structs.
fn is_cause<T: DeserializeOwned>(given: &Map<String, Value>, name: &str, error: &str) -> bool {
    let mut others = given.clone();
    others.remove(name);
    read::<T>(&others).err().is_none_or(|other| other != error)
}

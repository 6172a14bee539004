//! Keys of a configuration with their values, as settings of a job.

use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};

/// Reads texts `KEY=VALUE`: a list of them, or a map from keys to values.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Given {
        List(Vec<String>),
        Map(Map<String, Value>),
    }
    Ok(match Given::deserialize(deserializer)? {
        Given::List(texts) => texts,
        Given::Map(values) => values.iter().map(|(key, value)| assignment(key, value)).collect(),
    })
}

/// JSON's numbers, lists and truth values are the same in TOML; texts need no quotes.
fn assignment(key: &str, value: &Value) -> String {
    match value {
        Value::String(text) => format!("{key}={text}"),
        value => format!("{key}={value}"),
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_map_and_a_list_are_the_same() {
        let read = |text: &str| super::deserialize(&mut serde_json::Deserializer::from_str(text)).unwrap();
        let list = read(r#"["a.b=0.5", "c=[1,2]", "d=text"]"#);
        assert_eq!(read(r#"{"a.b": 0.5, "c": [1, 2], "d": "text"}"#), list);
    }
}

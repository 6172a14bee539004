//! What results say of the flow method that made them.

use serde::Serialize;

/// A flow method with everything that its flow of two frames depends on.
#[derive(Debug, Clone, Serialize)]
pub struct MethodRecord {
    /// As in tables.
    pub name: String,
    /// As on the command line, such as `skflow`.
    pub method: &'static str,
    /// Their values, in words.
    pub parameters: String,
    /// The file of a network's weights.
    pub weights: Option<String>,
    /// SHA-256 of that file, in hexadecimal digits.
    pub sha256: Option<String>,
    /// A network's refinements of the flow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Where a network is computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
}

impl MethodRecord {
    /// The same for two methods exactly when they give the same flow, under whatever name and wherever their weights lie.
    pub fn identity(&self) -> String {
        let Self { method, parameters, sha256, .. } = self;
        format!("{method} {parameters} {}", sha256.as_deref().unwrap_or_default())
    }

    /// Method, parameters and weights, for people.
    pub fn description(&self) -> String {
        let weights = match (&self.weights, &self.sha256) {
            (Some(weights), Some(sha256)) => format!(", weights {weights} (SHA-256 {sha256})"),
            _ => String::new(),
        };
        format!("{}, {}{weights}", self.method, self.parameters)
    }
}

//! The description of a flow method that results store.

use serde::Serialize;
use serde_json::Value;

/// A flow method with everything that its flow of two frames depends on.
#[derive(Debug, Clone, Serialize)]
pub struct MethodRecord {
    /// Name in tables.
    pub name: String,
    /// Name on the command line, such as `skflow`.
    pub method: &'static str,
    /// Parameters and their values, as text.
    pub parameters: String,
    /// The file of a network's weights.
    pub weights: Option<String>,
    /// SHA-256 of that file, in hexadecimal digits.
    pub sha256: Option<String>,
    /// Refinement iterations of a network, at most.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// The movement of the flow in pixels, below which a network does no more iterations; `None` if it always does all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub still_px: Option<f32>,
    /// The device of a network.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// What the flow depends on: equal for two methods exactly when they compute the same flow, whatever their names and the
    /// paths of their weights.
    #[serde(skip)]
    pub identity: Value,
}

impl MethodRecord {
    /// Method, parameters and weights as text.
    pub fn description(&self) -> String {
        let weights = match (&self.weights, &self.sha256) {
            (Some(weights), Some(sha256)) => format!(", weights {weights} (SHA-256 {sha256})"),
            _ => String::new(),
        };
        format!("{}, {}{weights}", self.method, self.parameters)
    }
}

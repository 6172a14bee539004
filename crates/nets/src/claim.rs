//! The network that the text in a checkpoint file identifies, for networks that names and shapes of parameters do not.

use std::path::Path;

use srflow_nn::{WeightsError, searchable_text};

use crate::table::Architecture;

/// Titles of networks that are not in the table, but whose weights are common.
const OTHERS: [&str; 3] = ["FlowFormer", "VideoFlow", "StreamFlow"];

/// The network that the text in a file of weights identifies.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Claim {
    /// Another network, by title.
    Other(&'static str),
    /// The network itself, or none, if no other network has the same parameters.
    Own,
    /// None, although these other networks have parameters of the same names and shapes.
    Ambiguous(&'static [&'static str]),
}

/// Whether file name and text of the checkpoint at `path` identify `architecture` or another network.
///
/// # Errors
/// When the file cannot be read.
pub fn claim(architecture: Architecture, path: &Path) -> Result<Claim, WeightsError> {
    let text = searchable_text(path)?;
    Ok(claim_in_text(architecture, &text))
}

fn claim_in_text(architecture: Architecture, text: &str) -> Claim {
    let names = |title: &str| text.contains(&normalized(title));
    let facts = architecture.facts();
    let others = facts.lookalikes.iter().chain(&OTHERS);
    if names(facts.name) && !facts.lookalikes.is_empty() {
        return Claim::Own;
    }
    match others.copied().find(|title| names(title)) {
        Some(other) => Claim::Other(other),
        None if facts.lookalikes.is_empty() => Claim::Own,
        None => Claim::Ambiguous(facts.lookalikes),
    }
}

/// Title in the form of [`searchable_text`].
fn normalized(title: &str) -> String {
    title.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_distinguishes_networks_with_the_same_parameters() {
        let claim = |text| claim_in_text(Architecture::SkFlow, text);
        assert_eq!(claim("memflow things  hyper parameters"), Claim::Other("MemFlow"));
        assert_eq!(claim("weights  model streamflow"), Claim::Other("StreamFlow"));
        assert_eq!(claim("skflow memflow"), Claim::Own, "both are named");
        assert_eq!(claim("best"), Claim::Ambiguous(&["MemFlow"]));
        let claim = |text| claim_in_text(Architecture::MemFlow, text);
        assert_eq!(claim("memflow things  hyper parameters"), Claim::Own);
        assert_eq!(claim("skflow things"), Claim::Other("SKFlow"));
        assert_eq!(claim("best"), Claim::Ambiguous(&["SKFlow"]));
        assert_eq!(claim_in_text(Architecture::Raft, "best"), Claim::Own);
        assert_eq!(claim_in_text(Architecture::Raft, "streamflow"), Claim::Other("StreamFlow"));
    }
}

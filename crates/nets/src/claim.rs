//! Whose weights a file says it holds, where parameters do not tell.

use std::path::Path;

use srflow_nn::{WeightsError, words};

use crate::table::Architecture;

/// Networks that are not known here and whose weights people have.
const OTHERS: [&str; 7] = ["FlowFormer", "VideoFlow", "StreamFlow", "UniMatch", "DPFlow", "CCMR", "FlowNet"];

/// What a file of weights says beside its parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Claim {
    /// Of another network, of this title.
    Other(&'static str),
    /// Of the network itself, or of none that has the same parameters.
    Own,
    /// Nothing, although these other networks have parameters of the same names and shapes.
    Silent(&'static [&'static str]),
}

/// Whether name and words of the file are of `architecture`, or of another network.
///
/// # Errors
/// When the file cannot be read.
pub fn claim(architecture: Architecture, path: &Path) -> Result<Claim, WeightsError> {
    let said = words(path)?;
    Ok(claimed(architecture, &said))
}

fn claimed(architecture: Architecture, said: &str) -> Claim {
    let says = |title: &str| said.contains(&plain(title));
    let facts = architecture.facts();
    let others = facts.lookalikes.iter().chain(&OTHERS);
    if says(facts.name) && !facts.lookalikes.is_empty() {
        return Claim::Own;
    }
    match others.copied().find(|title| says(title)) {
        Some(other) => Claim::Other(other),
        None if facts.lookalikes.is_empty() => Claim::Own,
        None => Claim::Silent(facts.lookalikes),
    }
}

/// As [`words`] writes it.
fn plain(title: &str) -> String {
    title.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_of_the_same_parameters_is_told_by_the_files_words() {
        let claim = |said| claimed(Architecture::SkFlow, said);
        assert_eq!(claim("memflow things  hyper parameters"), Claim::Other("MemFlow"));
        assert_eq!(claim("weights  model streamflow"), Claim::Other("StreamFlow"));
        assert_eq!(claim("skflow memflow"), Claim::Own, "both are named");
        assert_eq!(claim("best"), Claim::Silent(&["MemFlow"]));
        let claim = |said| claimed(Architecture::MemFlow, said);
        assert_eq!(claim("memflow things  hyper parameters"), Claim::Own);
        assert_eq!(claim("skflow things"), Claim::Other("SKFlow"));
        assert_eq!(claim("best"), Claim::Silent(&["SKFlow"]));
        assert_eq!(claimed(Architecture::Raft, "best"), Claim::Own);
        assert_eq!(claimed(Architecture::Raft, "streamflow"), Claim::Other("StreamFlow"));
    }
}

//! Which network a file of weights belongs to, and networks with the weights of a file.

use std::fmt;
use std::path::Path;

use burn::tensor::Device;
use srflow_nn::{
    Checkpoint, ParameterInfo, ParametersError, WeightsError, compare, load_from, parameter_infos,
};

use crate::table::{Architecture, Network};
use crate::whose::{Claim, claim};

/// How well parameters fit a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fit {
    pub architecture: Architecture,
    /// Parameters that the network has.
    pub expected: usize,
    /// Those of them that are given in the right shape.
    pub matching: usize,
    /// What is wrong; nothing when the parameters are those of the network, each and no other.
    pub difference: Option<ParametersError>,
}

impl fmt::Display for Fit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { architecture, expected, matching, difference } = self;
        let name = architecture.name();
        match difference {
            None => {
                let names = architecture.facts().names_of_weights();
                write!(f, "they are the parameters of {names}{}", lookalikes(*architecture))
            }
            Some(_) if *matching == 0 => {
                f.write_str("no network known here has parameters of these names and shapes")
            }
            Some(_) => write!(
                f,
                "the nearest network is {name}: {matching} of its {expected} parameters are there in its shape"
            ),
        }
    }
}

/// Networks with the same parameters, for the end of a sentence.
fn lookalikes(architecture: Architecture) -> String {
    match architecture.facts().lookalikes {
        [] => String::new(),
        others => format!(" (or of {}, whose have the same names and shapes)", others.join(", ")),
    }
}

/// How well the parameters fit each network, the best first.
pub fn fits(given: &[ParameterInfo]) -> Vec<Fit> {
    let mut fits = Architecture::ALL.map(|architecture| fit(architecture, given));
    fits.sort_by_key(|fit| {
        let wrong = fit.difference.as_ref().map_or(0, |difference| {
            difference.missing.len() + difference.unknown.len() + difference.misshapen.len()
        });
        (fit.matching == 0, wrong)
    });
    fits.into()
}

fn fit(architecture: Architecture, given: &[ParameterInfo]) -> Fit {
    let renamed = architecture.facts().renamed;
    let named = |info: &ParameterInfo| Some(ParameterInfo { name: renamed(&info.name)?, ..info.clone() });
    let given: Vec<ParameterInfo> = given.iter().filter_map(named).collect();
    let infos = parameter_infos(&architecture.init(&Device::flex()));
    let difference = compare(&infos, &given).err();
    let wrong =
        difference.as_ref().map_or(0, |difference| difference.missing.len() + difference.misshapen.len());
    Fit { architecture, expected: infos.len(), matching: infos.len() - wrong, difference }
}

/// A network of the given architecture with the weights of a checkpoint. When they are another's, the error says which
/// network fits best, or which the file names.
///
/// # Errors
/// Those of [`srflow_nn::load`], and [`WeightsError::OtherNetwork`] where the parameters fit and the file says that it is of another
/// network.
pub fn load_network(
    architecture: Architecture,
    path: &Path,
    device: &Device,
) -> Result<Network, WeightsError> {
    let named = || claim(architecture, path).ok();
    let checkpoint = Checkpoint::open(path)?.renamed(architecture.facts().renamed);
    let network = load_from(architecture.init(device), checkpoint, path).map_err(|error| match error {
        WeightsError::Mismatch { path, difference, .. } => {
            let hint = match named() {
                Some(Claim::Other(other)) => {
                    format!("\n  the file names {other}, which is not among the networks here")
                }
                _ => {
                    let nearest = Checkpoint::open(&path).map(|file| fits(&file.parameters()).swap_remove(0));
                    nearest.map_or_else(|_| String::new(), |nearest| format!("\n  {nearest}"))
                }
            };
            WeightsError::Mismatch { path, difference, hint }
        }
        other => other,
    })?;
    let facts = architecture.facts();
    match named() {
        Some(Claim::Other(other)) if facts.lookalikes.contains(&other) => {
            Err(WeightsError::OtherNetwork { path: path.to_owned(), network: facts.title, other })
        }
        _ => Ok(network),
    }
}

//! Which network a file of weights belongs to, and networks with the weights of a file.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use burn::tensor::Device;
use srflow_nn::{
    Checkpoint, ParameterInfo, ParametersError, WeightsError, compare, load_from, parameter_infos,
};

use crate::settings::Setting;
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

/// How well the parameters of a file fit each network, the best first. Where several have the same parameters, the one that
/// the file names comes before the others.
///
/// # Errors
/// When the file cannot be read or is no checkpoint.
pub fn fits_of_file(path: &Path) -> Result<Vec<Fit>, WeightsError> {
    let mut fits = fits(&Checkpoint::open(path)?.parameters());
    let whole = fits.iter().take_while(|fit| fit.difference.is_none()).count();
    if let Some(own) =
        fits[..whole].iter().position(|fit| matches!(claim(fit.architecture, path), Ok(Claim::Own)))
    {
        fits[..=own].rotate_right(1);
    }
    Ok(fits)
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

/// A network of the given architecture with the weights of a checkpoint, and those of its [settings](Network::settings) that the
/// file holds. When they are another's, the error says which network fits best, or which the file names.
///
/// # Errors
/// Those of [`load_to_train`], and [`WeightsError::OtherNetwork`] where the parameters fit and the file says that it is of another
/// network.
pub fn load_network(
    architecture: Architecture,
    path: &Path,
    device: &Device,
) -> Result<Network, WeightsError> {
    let network = load_to_train(architecture, path, device)?;
    let facts = architecture.facts();
    match claim(architecture, path)? {
        Claim::Other(other) if facts.lookalikes.contains(&other) => {
            Err(WeightsError::OtherNetwork { path: path.to_owned(), network: facts.title, other })
        }
        _ => Ok(network),
    }
}

/// [`load_network`], also with the weights of a network that has the same parameters: training may start from them, as that of
/// MemFlow's authors starts from SKFlow's.
///
/// # Errors
/// Those of [`srflow_nn::load`], also where the file holds a setting out of its range.
pub fn load_to_train(
    architecture: Architecture,
    path: &Path,
    device: &Device,
) -> Result<Network, WeightsError> {
    let named = || claim(architecture, path).ok();
    let checkpoint = Checkpoint::open(path)?.renamed(architecture.facts().renamed);
    let (format, numbers) = (checkpoint.format(), checkpoint.hyper_parameters().clone());
    let mut network =
        load_from(architecture.init(device), checkpoint, path).map_err(|error| match error {
            WeightsError::Mismatch { path, difference, .. } => {
                let hint = match named() {
                    Some(Claim::Other(other)) => {
                        format!("\n  the file names {other}, which is not among the networks here")
                    }
                    _ => {
                        let nearest = fits_of_file(&path).map(|mut fits| fits.swap_remove(0));
                        nearest.map_or_else(|_| String::new(), |nearest| format!("\n  {nearest}"))
                    }
                };
                WeightsError::Mismatch { path, difference, hint }
            }
            other => other,
        })?;
    set_from(&mut network, &numbers).map_err(|problem| WeightsError::Broken {
        path: path.to_owned(),
        format,
        problem,
    })?;
    Ok(network)
}

/// Takes over the settings that a file holds.
fn set_from(network: &mut Network, numbers: &BTreeMap<String, f64>) -> Result<(), String> {
    for Setting { in_files, allowed, value, .. } in network.settings() {
        let Some((name, number)) = in_files.and_then(|name| numbers.get_key_value(name)) else { continue };
        let whole = number.round() as usize; // what is no whole number is next to one, as half of an odd number of tokens
        if !number.is_finite() || *number < 0.0 || !allowed.contains(whole) {
            return Err(format!("its {name} is {number}, expected a number that is {allowed}"));
        }
        *value = whole;
    }
    Ok(())
}

//! Loads networks from files of weights, and finds the network that weights belong to.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use burn::tensor::Device;
use srflow_nn::{
    Checkpoint, ParameterInfo, ParametersError, WeightsError, compare, load_from, parameter_infos,
};

use crate::claim::{Claim, claim};
use crate::save::OWN;
use crate::settings::Setting;
use crate::table::{Architecture, Network};

/// How well parameters fit a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fit {
    pub architecture: Architecture,
    /// Number of parameter tensors of the network.
    pub expected: usize,
    /// Number of those that are given with the right shape.
    pub matching: usize,
    /// Number of those whose shape a tensor of the file has, under whatever name.
    pub same_shape: usize,
    /// Number of tensors in the file.
    pub given: usize,
    /// `None` when the parameters are exactly those of the network.
    pub difference: Option<ParametersError>,
}

impl fmt::Display for Fit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { architecture, expected, matching, same_shape, given, difference } = self;
        let name = architecture.name();
        match difference {
            None => {
                let names = architecture.facts().names_of_weights();
                write!(f, "they are the parameters of {names}{}", lookalikes(*architecture))
            }
            Some(_) if *matching == 0 && 2 * same_shape < *expected.max(given) => {
                f.write_str("no network of srflow has parameters with these names and shapes")
            }
            Some(_) if *matching == 0 => write!(
                f,
                "no network of srflow has parameters with these names; the shapes are closest to those of {name}: \
                 {same_shape} of its {expected} are in the file"
            ),
            Some(_) => {
                let more = match same_shape - matching {
                    0 => String::new(),
                    more => format!(", and {more} in shape only"),
                };
                write!(
                    f,
                    "the closest network is {name}: {matching} of its {expected} parameters match in name and shape{more}"
                )
            }
        }
    }
}

/// Names the networks with the same parameters, at the end of a sentence.
fn lookalikes(architecture: Architecture) -> String {
    match architecture.facts().lookalikes {
        [] => String::new(),
        others => format!(" (or of {}, whose parameters have the same names and shapes)", others.join(", ")),
    }
}

/// How well the parameters of a file fit each network, best first. Among networks with the same parameters, the one that the
/// file [identifies](claim) comes first.
///
/// # Errors
/// When the file cannot be read or is not a checkpoint.
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

/// How well parameters fit each network, best first.
pub fn fits(given: &[ParameterInfo]) -> Vec<Fit> {
    let mut fits = Architecture::ALL.map(|architecture| fit(architecture, given));
    fits.sort_by(|a, b| {
        let inexact = |fit: &Fit| fit.difference.is_some();
        inexact(a).cmp(&inexact(b)).then(b.similarity().total_cmp(&a.similarity()))
    });
    fits.into()
}

impl Fit {
    /// The share of the network that the file has, and the share of the file that the network has, by shape and by name and shape:
    /// a file with other names is still nearest to its network, and so is a part of a file.
    fn similarity(&self) -> f64 {
        let shares = 1.0 / self.expected.max(1) as f64 + 1.0 / self.given.max(1) as f64;
        (self.same_shape + self.matching) as f64 * shares
    }
}

fn fit(architecture: Architecture, given: &[ParameterInfo]) -> Fit {
    let renamed = architecture.facts().renamed;
    let named = |info: &ParameterInfo| Some(ParameterInfo { name: renamed(&info.name)?, ..info.clone() });
    let given: Vec<ParameterInfo> = given.iter().filter_map(named).collect();
    let infos = parameter_infos(&architecture.init(&Device::flex()));
    let difference = compare(&infos, &given).err();
    let wrong =
        difference.as_ref().map_or(0, |difference| difference.missing.len() + difference.misshapen.len());
    Fit {
        architecture,
        expected: infos.len(),
        matching: infos.len() - wrong,
        same_shape: same_shapes(&infos, &given),
        given: given.len(),
        difference,
    }
}

/// Number of tensors in `expected` that can be paired with tensors of the same shape in `given`.
fn same_shapes(expected: &[ParameterInfo], given: &[ParameterInfo]) -> usize {
    let mut left: BTreeMap<&[usize], usize> = BTreeMap::new();
    for info in given {
        *left.entry(&info.shape).or_default() += 1;
    }
    let paired = expected.iter().filter(|info| match left.get_mut(info.shape.as_slice()) {
        Some(count) if *count > 0 => {
            *count -= 1;
            true
        }
        _ => false,
    });
    paired.count()
}

/// Loads a network from a checkpoint, including the [settings](Network::settings) in it. If the weights do not fit, the error
/// names the network that they fit best, or the one that the file identifies.
///
/// # Errors
/// Those of [`load_to_train`], and [`WeightsError::OtherNetwork`] when the parameters fit, but the file identifies another network.
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

/// Like [`load_network`], but also accepts weights of another network with the same parameters, as a start for training: MemFlow's
/// authors start from SKFlow.
///
/// # Errors
/// Those of [`srflow_nn::load`], and when a setting in the file is out of range.
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
                        format!("\n  the file is of {other}, a network that srflow does not have")
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

/// Applies the settings in a file.
fn set_from(network: &mut Network, numbers: &BTreeMap<String, f64>) -> Result<(), String> {
    for Setting { name, in_files, allowed, value, .. } in network.settings() {
        let own = numbers.get_key_value(&format!("{OWN}{name}"));
        let found = own.or_else(|| in_files.and_then(|name| numbers.get_key_value(name)));
        let Some((name, number)) = found else { continue };
        let whole = number.round() as usize; // some files have fractions, such as half of an odd number of tokens
        if !number.is_finite() || *number < 0.0 || !allowed.contains(whole) {
            return Err(format!("its {name} is {number}, expected a number {allowed}"));
        }
        *value = whole;
    }
    Ok(())
}

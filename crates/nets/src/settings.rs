//! Settings of networks besides their parameters, such as the number of groups of a norm.

use std::fmt;
use std::ops::RangeInclusive;

/// An integer that affects the results of a network and may be missing in its file of weights.
#[derive(Debug)]
pub struct Setting<'a> {
    pub name: &'static str,
    /// One line, including the source of the default.
    pub description: &'static str,
    pub allowed: Allowed,
    /// Its name among the hyper-parameters in files of weights, if weights are trained for one value.
    pub in_files: Option<&'static str>,
    pub value: &'a mut usize,
}

/// The allowed values of a setting.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Allowed {
    Range(RangeInclusive<usize>),
    /// In ascending order.
    OneOf(&'static [usize]),
}

/// Errors of changing a setting.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SettingError {
    #[error("{network} has no setting `{name}`; {}", listed(.known))]
    Unknown { network: &'static str, name: String, known: Vec<&'static str> },
    #[error("{network}: expected {name} to be {allowed}, found {found}")]
    NotAllowed { network: &'static str, name: &'static str, allowed: Allowed, found: usize },
}

impl Allowed {
    pub(crate) fn contains(&self, value: usize) -> bool {
        match self {
            Self::Range(range) => range.contains(&value),
            Self::OneOf(values) => values.contains(&value),
        }
    }
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Range(range) => write!(f, "from {} to {}", range.start(), range.end()),
            Self::OneOf(values) => {
                for (number, value) in values.iter().enumerate() {
                    let before = match number {
                        0 => "",
                        _ if number + 1 == values.len() => " or ",
                        _ => ", ",
                    };
                    write!(f, "{before}{value}")?;
                }
                Ok(())
            }
        }
    }
}

fn listed(known: &[&str]) -> String {
    if known.is_empty() { "it has none".to_owned() } else { format!("it has {}", known.join(", ")) }
}

/// Sets the setting called `name`.
pub(crate) fn set(
    network: &'static str,
    settings: Vec<Setting>,
    name: &str,
    value: usize,
) -> Result<(), SettingError> {
    let known = settings.iter().map(|setting| setting.name).collect();
    let Some(setting) = settings.into_iter().find(|setting| setting.name == name) else {
        return Err(SettingError::Unknown { network, name: name.to_owned(), known });
    };
    let Setting { name, allowed, .. } = setting;
    if !allowed.contains(value) {
        return Err(SettingError::NotAllowed { network, name, allowed, found: value });
    }
    *setting.value = value;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_accept_only_known_names_and_allowed_values() {
        let (mut groups, mut length) = (8, 1);
        let mut give = |name: &str, value| {
            let allowed = Allowed::OneOf(&[1, 2, 4, 8]);
            let groups =
                Setting { name: "groups", description: "", allowed, in_files: None, value: &mut groups };
            let allowed = Allowed::Range(1..=16);
            let length =
                Setting { name: "length", description: "", allowed, in_files: None, value: &mut length };
            set("net", vec![groups, length], name, value).map_err(|error| error.to_string())
        };
        assert_eq!(give("groups", 4), Ok(()));
        assert_eq!(give("groups", 3), Err("net: expected groups to be 1, 2, 4 or 8, found 3".into()));
        assert_eq!(give("length", 3), Ok(()));
        assert_eq!(give("length", 17), Err("net: expected length to be from 1 to 16, found 17".into()));
        assert_eq!(give("levels", 2), Err("net has no setting `levels`; it has groups, length".into()));
        assert_eq!((groups, length), (4, 3));
    }
}

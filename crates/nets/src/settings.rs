//! What can be set of a network beside its parameters, such as the number of groups of a norm.

use std::ops::RangeInclusive;

/// A whole number that a network computes with and that its file of weights may not say.
#[derive(Debug)]
pub struct Setting<'a> {
    pub name: &'static str,
    /// One line on what it is, and where its default comes from.
    pub description: &'static str,
    pub range: RangeInclusive<usize>,
    pub value: &'a mut usize,
}

/// Why a setting was not set.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SettingError {
    #[error("{network} has no setting `{name}`; {}", listed(.known))]
    Unknown { network: &'static str, name: String, known: Vec<&'static str> },
    #[error("{network}: expected {name} from {} to {}, found {found}", .range.start(), .range.end())]
    OutOfRange { network: &'static str, name: &'static str, range: RangeInclusive<usize>, found: usize },
}

fn listed(known: &[&str]) -> String {
    if known.is_empty() { "it has none".to_owned() } else { format!("it has {}", known.join(", ")) }
}

/// Gives the setting of that name another value.
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
    let Setting { name, range, .. } = setting;
    if !range.contains(&value) {
        return Err(SettingError::OutOfRange { network, name, range, found: value });
    }
    *setting.value = value;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_is_known_by_its_name_and_keeps_to_its_range() {
        let mut groups = 8;
        let mut give = |name: &str, value| {
            let setting = Setting { name: "groups", description: "", range: 1..=16, value: &mut groups };
            set("rpknet", vec![setting], name, value).map_err(|error| error.to_string())
        };
        assert_eq!(give("groups", 4), Ok(()));
        assert_eq!(give("groups", 17), Err("rpknet: expected groups from 1 to 16, found 17".into()));
        assert_eq!(give("levels", 2), Err("rpknet has no setting `levels`; it has groups".into()));
        assert_eq!(groups, 4);
    }
}

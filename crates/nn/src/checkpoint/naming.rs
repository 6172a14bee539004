//! Maps the names in a file to those of the reference implementation.

use std::collections::BTreeMap;

/// Dictionaries in which training scripts store the weights next to other data, in order of preference: running averages last.
const CONTAINERS: [&str; 12] = [
    "state_dict",
    "model_state_dict",
    "model_state",
    "model",
    "network",
    "net",
    "params",
    "ema_state_dict",
    "state_dict_ema",
    "model_ema",
    "params_ema",
    "ema",
];
/// Prefixes that wrappers add to every name: `DataParallel`, trainers, running averages.
const PREFIXES: [&str; 8] =
    ["module.", "network.", "model.", "net.", "raft.", "flow_net.", "flownet.", "ema_model."];
/// Modules that PyTorch inserts anywhere in a name: `torch.compile`, FSDP, activation checkpoints.
const WRAPPERS: [&str; 3] = ["_orig_mod.", "_fsdp_wrapped_module.", "_checkpoint_wrapped_module."];

/// Tensors under the reference's names.
pub(super) struct Named<T> {
    /// The dictionary that contained them; `None` for the root of the file.
    pub(super) container: Option<&'static str>,
    /// The removed prefix.
    pub(super) prefix: String,
    pub(super) tensors: BTreeMap<String, T>,
}

/// Removes containers, prefixes and duplicates.
pub(super) fn reference_names<T>(found: BTreeMap<String, T>) -> Named<T> {
    let (container, found) = without_container(found);
    let (wrapper, found) = without_wrappers(found);
    let (prefix, found) = without_prefix(found);
    let prefix = wrapper + &prefix;
    Named { container, prefix, tensors: without_duplicates(found) }
}

/// Keeps only the contents of the first container present.
fn without_container<T>(found: BTreeMap<String, T>) -> (Option<&'static str>, BTreeMap<String, T>) {
    for container in CONTAINERS {
        let inside = |name: &str| Some(name.strip_prefix(container)?.strip_prefix('.')?.to_owned());
        let held = found.keys().filter(|name| inside(name).is_some()).count();
        // `model.` or `network.` in front of every name comes from a wrapper.
        let wrapper = held == found.len() && PREFIXES.contains(&format!("{container}.").as_str());
        if held > 0 && !wrapper {
            let kept = found.into_iter().filter_map(|(name, tensor)| Some((inside(&name)?, tensor)));
            return (Some(container), kept.collect());
        }
    }
    (None, found)
}

/// Removes the names of wrapping modules, and returns those that occurred.
fn without_wrappers<T>(found: BTreeMap<String, T>) -> (String, BTreeMap<String, T>) {
    let mut taken = String::new();
    for wrapper in WRAPPERS {
        let inside = |name: &String| name.starts_with(wrapper) || name.contains(&format!(".{wrapper}"));
        if found.keys().any(inside) {
            taken.push_str(wrapper);
        }
    }
    let plain = |name: String| {
        let parts = name.split_inclusive('.').filter(|part| !WRAPPERS.contains(part));
        parts.collect::<String>()
    };
    (taken, found.into_iter().map(|(name, tensor)| (plain(name), tensor)).collect())
}

/// Removes prefixes common to all names.
fn without_prefix<T>(mut found: BTreeMap<String, T>) -> (String, BTreeMap<String, T>) {
    let mut taken = String::new();
    while let Some(prefix) = PREFIXES
        .iter()
        .find(|prefix| !found.is_empty() && found.keys().all(|name| name.starts_with(**prefix)))
    {
        found = found.into_iter().map(|(name, tensor)| (name[prefix.len()..].to_owned(), tensor)).collect();
        taken.push_str(prefix);
    }
    (taken, found)
}

/// Drops the second copy of the norm of a shortcut, which is stored as `downsample.1` and as the last numbered norm of the block.
fn without_duplicates<T>(mut found: BTreeMap<String, T>) -> BTreeMap<String, T> {
    let shortcuts: Vec<(String, String)> = found
        .keys()
        .filter_map(|name| name.split_once("downsample.1."))
        .map(|(block, rest)| (block.to_owned(), rest.to_owned()))
        .collect();
    for (block, rest) in shortcuts {
        // Only the last one: in a block of three convolutions, `norm3` is not a copy.
        let copy = ["norm4", "norm3", "bn3"].map(|norm| format!("{block}{norm}.{rest}"));
        if let Some(copy) = copy.iter().find(|name| found.contains_key(*name)) {
            found.remove(copy);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(names: &[&str]) -> (Option<&'static str>, String, Vec<String>) {
        let found = names.iter().map(|name| (name.to_string(), ())).collect();
        let Named { container, prefix, tensors } = reference_names(found);
        (container, prefix, tensors.into_keys().collect())
    }

    #[test]
    fn containers_and_prefixes_are_removed() {
        let plain = || vec!["cnet.weight".to_string(), "fnet.weight".to_string()];
        assert_eq!(named(&["fnet.weight", "cnet.weight"]), (None, String::new(), plain()));
        assert_eq!(
            named(&["module.model.fnet.weight", "module.model.cnet.weight"]),
            (None, "module.model.".into(), plain())
        );
        assert_eq!(
            named(&[
                "state_dict._orig_mod.fnet.weight",
                "state_dict._orig_mod.cnet.weight",
                "optimizer.0.exp_avg"
            ]),
            (Some("state_dict"), "_orig_mod.".into(), plain())
        );
        assert_eq!(
            named(&["model.fnet.weight", "model.cnet.weight", "ema.fnet.weight"]),
            (Some("model"), String::new(), plain())
        );
        for (container, prefix) in [
            (None, "raft."),
            (Some("ema_state_dict"), "module."),
            (Some("ema_state_dict"), "_fsdp_wrapped_module."),
            (Some("params_ema"), "module.raft."),
        ] {
            let start = container.map_or(String::new(), |container| format!("{container}.")) + prefix;
            let names = ["fnet.weight", "cnet.weight"].map(|name| format!("{start}{name}"));
            assert_eq!(named(&[&names[0], &names[1]]), (container, prefix.to_owned(), plain()));
        }
    }

    #[test]
    fn wrapping_modules_are_removed_anywhere_in_a_name() {
        let names = ["module.fnet._fsdp_wrapped_module.weight", "module.cnet._orig_mod.weight"];
        let plain = vec!["cnet.weight".to_string(), "fnet.weight".to_string()];
        assert_eq!(named(&names), (None, "_orig_mod._fsdp_wrapped_module.module.".into(), plain));
    }

    #[test]
    fn copies_of_shortcut_norms_are_dropped() {
        let kept = |norms: &[&str]| named(&[norms, &["downsample.1.weight"]].concat()).2;
        assert_eq!(kept(&["norm3.weight"]), ["downsample.1.weight"]);
        assert_eq!(kept(&["norm3.weight", "norm4.weight"]), ["downsample.1.weight", "norm3.weight"]);
        assert_eq!(kept(&["bn2.weight", "bn3.weight"]), ["bn2.weight", "downsample.1.weight"]);
    }

    #[test]
    fn a_prefix_of_only_some_names_is_kept() {
        let names = vec!["head.weight".to_string(), "raft.weight".to_string()];
        assert_eq!(named(&["raft.weight", "head.weight"]), (None, String::new(), names));
    }
}

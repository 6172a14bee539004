//! Names of the methods in tables.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use super::{ITERATIONS, Method, MethodSpec};

/// The methods' labels, or their names if they have none. If a network occurs with several weights, their file names are
/// appended, with as many folders as needed to distinguish them; if it occurs with several numbers of iterations, those are.
pub fn labels(specs: &[&MethodSpec]) -> Vec<String> {
    let mut weights_of: HashMap<Method, Vec<&str>> = HashMap::new();
    let mut same: HashMap<(Method, Option<&str>), usize> = HashMap::new();
    for spec in specs.iter().filter(|spec| spec.label.is_none()) {
        let weights = spec.weights.as_deref();
        let seen = same.entry((spec.method, weights)).or_default();
        *seen += 1;
        if *seen == 1 {
            weights_of.entry(spec.method).or_default().extend(weights);
        }
    }
    let several = |method| same.keys().filter(|(of, _)| *of == method).count() > 1;
    let with_iterations = |spec: &MethodSpec, name: String| match spec.iterations {
        Some(iterations)
            if same.get(&(spec.method, spec.weights.as_deref())).is_some_and(|same| *same > 1) =>
        {
            format!("{name}{ITERATIONS}{iterations}")
        }
        _ => name,
    };
    let label = |spec: &&MethodSpec| match (&spec.label, &spec.weights) {
        (Some(label), _) => label.clone(),
        (None, Some(dir)) if spec.method == Method::Files => {
            distinguishing_suffix(dir, &weights_of[&Method::Files], true)
        }
        (None, Some(weights)) if several(spec.method) => {
            let suffix = distinguishing_suffix(weights, &weights_of[&spec.method], false);
            with_iterations(spec, format!("{} ({suffix})", spec.method.name()))
        }
        _ => with_iterations(spec, spec.method.name().to_owned()),
    };
    specs.iter().map(label).collect()
}

/// The shortest suffix of a path that differs for all of these paths, with the extension if they are `folders`; the whole path
/// if there is none.
fn distinguishing_suffix(path: &str, paths: &[&str], folders: bool) -> String {
    let end = |path: &str, parents: usize| {
        let whole = if folders { Path::new(path).to_owned() } else { Path::new(path).with_extension("") };
        let parts: Vec<_> = whole.components().map(|part| part.as_os_str().to_string_lossy()).collect();
        parts[parts.len().saturating_sub(parents + 1)..].join("/")
    };
    let longest = paths.iter().map(|path| Path::new(path).components().count()).max().unwrap_or(0);
    let differ = |folders: &usize| {
        let ends: HashSet<String> = paths.iter().map(|path| end(path, *folders)).collect();
        ends.len() == paths.len()
    };
    (0..longest).find(differ).map_or_else(|| path.to_owned(), |folders| end(path, folders))
}

#[cfg(test)]
mod tests {
    use super::super::distinct;
    use super::*;

    fn names(texts: &[&str]) -> Vec<String> {
        let specs: Vec<MethodSpec> =
            texts.iter().map(|text| super::super::scored_method(text).unwrap()).collect();
        labels(&distinct(&specs))
    }

    #[test]
    fn a_network_with_several_weights_has_them_in_its_name() {
        let found =
            names(&["raft=a/things.ckpt", "raft=b/mine.pth", "gma=things.ckpt", "tvl1", "raft", "tvl1"]);
        assert_eq!(found, ["raft (things)", "raft (mine)", "gma", "tvl1", "raft"]);
        // Training always writes the same file name.
        let found =
            names(&["skflow=runs/a/best.safetensors", "skflow=runs/b/best.safetensors", "skflow=things"]);
        assert_eq!(found, ["skflow (a/best)", "skflow (b/best)", "skflow (things)"]);
        let found = names(&["SRFlowNet:skflow=a/best.safetensors", "skflow=b/best.safetensors", "TV:tvl1"]);
        assert_eq!(found, ["SRFlowNet", "skflow", "TV"]);
        let found =
            names(&["raft=a.pth", "raft=a.pth:iters=4", "srflow:iters=2", "srflow:iters=8", "gma=b:iters=3"]);
        assert_eq!(found, ["raft", "raft:iters=4", "srflow:iters=2", "srflow:iters=8", "gma"]);
        assert_eq!(names(&["files:out/v1.2/", "tvl1", "files:b/ours"]), ["v1.2", "tvl1", "ours"]);
        assert_eq!(names(&["files:a/out", "files:b/out"]), ["a/out", "b/out"]);
        let found = names(&["raft=best.ckpt", "raft=best.pth"]);
        assert_eq!(found, ["raft (best.ckpt)", "raft (best.pth)"]);
    }
}

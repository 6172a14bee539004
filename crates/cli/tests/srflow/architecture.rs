//! The rules on directions: a crate depends only on crates above it in the pipeline of ARCHITECTURE.md, and no file imports one that
//! imports it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// The pipeline, first to last, as ARCHITECTURE.md lists it.
const PIPELINE: [&str; 24] = [
    "srflow-no-clap",
    "srflow-simd",
    "srflow-core",
    "srflow-files",
    "srflow-splat",
    "srflow-head",
    "srflow-avatar",
    "srflow-fetch",
    "srflow-pack",
    "srflow-data",
    "srflow-render",
    "srflow-classical",
    "srflow-report",
    "srflow-eval",
    "srflow-ops",
    "srflow-face",
    "srflow-nn",
    "srflow-nets",
    "srflow-train",
    "srflow-mer",
    "srflow-view",
    "srflow",
    "srflow-cli",
    "srflow-python",
];

fn cargo(arguments: &[&str]) -> Vec<u8> {
    let program = std::env::var_os("CARGO").expect("cargo runs the tests");
    let output = Command::new(program).args(arguments).current_dir("../..").output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// `cargo metadata` for the platform that the tests run on.
pub(crate) fn metadata(more: &[&str]) -> Value {
    let version = String::from_utf8(cargo(&["-vV"])).expect("text");
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).expect("cargo names its host");
    let arguments = [&["metadata", "--format-version", "1", "--filter-platform", host], more].concat();
    serde_json::from_slice(&cargo(&arguments)).expect("cargo metadata is JSON")
}

#[test]
fn crates_depend_only_on_crates_above_them() {
    let metadata = metadata(&["--no-deps", "--offline"]);
    let packages = metadata["packages"].as_array().expect("packages");
    let rank = |name: &str| PIPELINE.iter().position(|&crate_name| crate_name == name);
    assert_eq!(packages.len(), PIPELINE.len(), "PIPELINE and ARCHITECTURE.md list every crate");
    for package in packages {
        let name = package["name"].as_str().expect("name");
        let own = rank(name).unwrap_or_else(|| panic!("{name} is missing in PIPELINE and ARCHITECTURE.md"));
        for dependency in package["dependencies"].as_array().expect("dependencies") {
            let dependency = dependency["name"].as_str().expect("name");
            // Tests of a crate may turn on one of its features.
            if let Some(other) = rank(dependency).filter(|_| dependency != name) {
                assert!(other < own, "{name} must not depend on {dependency}, which comes after it");
            }
        }
    }
}

/// Evaluating and training must not compile the renderer.
#[test]
fn readers_do_not_depend_on_the_renderer() {
    let metadata = metadata(&["--no-deps", "--offline"]);
    let packages = metadata["packages"].as_array().expect("packages");
    let dependencies_of = |name: &str| -> Vec<&str> {
        let package =
            packages.iter().find(|package| package["name"] == name).expect("a crate of the workspace");
        let dependencies = package["dependencies"].as_array().expect("dependencies");
        let normal = dependencies.iter().filter(|dependency| dependency["kind"].is_null());
        normal
            .filter_map(|dependency| dependency["name"].as_str())
            .filter(|name| PIPELINE.contains(name))
            .collect()
    };
    for name in ["srflow-data", "srflow-report", "srflow-eval", "srflow-nets", "srflow-train", "srflow-mer"] {
        let mut reached = vec![name];
        let mut next = 0;
        while let Some(&at) = reached.get(next) {
            next += 1;
            for dependency in dependencies_of(at) {
                if !reached.contains(&dependency) {
                    reached.push(dependency);
                }
            }
        }
        for renderer in ["srflow-splat", "srflow-head", "srflow-avatar", "srflow-render"] {
            assert!(
                !reached.contains(&renderer),
                "{name} must not depend on {renderer}; it reaches {reached:?}"
            );
        }
    }
}

#[test]
fn the_architecture_page_lists_every_crate_in_order() {
    let page = std::fs::read_to_string("../../ARCHITECTURE.md").expect("ARCHITECTURE.md");
    let rows: Vec<&str> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| `srflow"))
        .filter_map(|rest| rest.split('`').next())
        .collect();
    let listed: Vec<String> = rows.iter().map(|rest| format!("srflow{rest}")).collect();
    assert_eq!(listed, PIPELINE);
}

/// Crates whose files must not import each other in circles.
const WITHOUT_CIRCLES: [&str; 12] = [
    "core",
    "files",
    "splat",
    "fetch",
    "pack",
    "data",
    "render",
    "classical",
    "nets",
    "train",
    "mer",
    "view",
];

/// The names of modules from the crate's root.
type Module = Vec<String>;

/// What a module imports: the name in its scope, the path, and whether it only passes the name on.
type Imports = Vec<(String, Vec<String>, bool)>;

#[test]
fn no_file_imports_one_that_imports_it() {
    for crate_name in WITHOUT_CIRCLES {
        let root = Path::new("../../crates").join(crate_name).join("src");
        let mut modules = BTreeMap::new();
        read_modules(&root, &[], &mut modules);
        let edge =
            |(module, imports): (&Module, &Imports)| (module.clone(), imported(&modules, module, imports));
        let edges: BTreeMap<Module, BTreeSet<Module>> = modules.iter().map(edge).collect();
        let circular: Vec<String> = modules
            .keys()
            .filter(|module| reachable(&edges, module).contains(*module))
            .map(|module| module.join("::"))
            .collect();
        assert!(circular.is_empty(), "{crate_name}: these files import each other in circles: {circular:?}");
    }
}

/// Adds the modules of a folder with the `use` lines of their files, without those of tests at the end.
fn read_modules(folder: &Path, module: &[String], modules: &mut BTreeMap<Module, Imports>) {
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        let stem = path.file_stem().expect("a name").to_string_lossy().into_owned();
        let inner = match stem.as_str() {
            "lib" | "mod" => module.to_vec(),
            _ => [module, &[stem]].concat(),
        };
        if path.is_dir() {
            read_modules(&path, &inner, modules);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            let text = fs::read_to_string(&path).expect("a source");
            let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            let without_comments: Vec<&str> =
                text.lines().map(|line| line.split("//").next().unwrap_or_default()).collect();
            let imports: Imports =
                without_comments.join("\n").split(';').flat_map(imports_of_statement).collect();
            modules.insert(inner, imports);
        }
    }
}

/// The imports of what ends with a semicolon: several for `use a::{b, c}`, none where it is no `use`.
fn imports_of_statement(statement: &str) -> Imports {
    let is_use = |line: &&str| {
        let line = line.trim_start();
        line.starts_with("use ") || (line.starts_with("pub") && line.contains(" use "))
    };
    let Some(start) = statement.lines().find(is_use) else { return Imports::new() };
    let at = statement.find(start).unwrap_or_default();
    let Some((visibility, tree)) = statement[at..].split_once("use ") else { return Imports::new() };
    let mut paths = Vec::new();
    expand("", tree, &mut paths);
    let import = |path: String| {
        let (path, alias) = path.split_once(" as ").unwrap_or((&path, ""));
        let mut path: Vec<String> = path.split("::").map(|name| name.trim().to_owned()).collect();
        if path.len() > 1 && path.last().is_some_and(|name| name == "self") {
            path.pop();
        }
        let name = if alias.is_empty() { path.last().cloned().unwrap_or_default() } else { alias.to_owned() };
        (name, path, visibility.trim_start().starts_with("pub"))
    };
    paths.into_iter().map(import).collect()
}

/// The paths of a tree such as `a::{b, c::{d, e}}`.
fn expand(before: &str, tree: &str, paths: &mut Vec<String>) {
    let Some((head, rest)) = tree.split_once('{') else {
        if !tree.trim().is_empty() {
            paths.push(format!("{before}{}", tree.trim()));
        }
        return;
    };
    let before = format!("{before}{}", head.trim());
    let (mut depth, mut start) = (0, 0);
    for (at, c) in rest.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                expand(&before, &rest[start..at], paths);
                start = at + 1;
            }
            _ => {}
        }
    }
}

/// The other modules that a module imports from, those behind names that are passed on.
fn imported(
    modules: &BTreeMap<Module, Imports>,
    module: &[String],
    imports: &[(String, Vec<String>, bool)],
) -> BTreeSet<Module> {
    let used = imports.iter().filter(|(_, _, is_passed_on)| !is_passed_on);
    let homes = used.filter_map(|(_, path, _)| home(modules, module, path, 0));
    homes.filter(|home| home.as_slice() != module).collect()
}

/// The module that defines what `path` names in `module`; `None` for other crates.
fn home(
    modules: &BTreeMap<Module, Imports>,
    module: &[String],
    path: &[String],
    depth: u32,
) -> Option<Module> {
    let mut at = module.to_vec();
    let mut rest = path;
    match path.first()?.as_str() {
        "crate" => (at, rest) = (Module::new(), &path[1..]),
        "self" => rest = &path[1..],
        "super" => {
            while let [first, more @ ..] = rest
                && first == "super"
            {
                at.pop();
                rest = more;
            }
        }
        first if modules.contains_key(&[&at[..], &[first.to_owned()]].concat()) => {}
        _ => return None,
    }
    while let [first, more @ ..] = rest {
        let child = [&at[..], std::slice::from_ref(first)].concat();
        if !modules.contains_key(&child) {
            break;
        }
        (at, rest) = (child, more);
    }
    let passed_on = rest.first().and_then(|name| modules.get(&at)?.iter().find(|(own, _, _)| own == name));
    let further = passed_on
        .filter(|_| depth < 8)
        .and_then(|(_, path, _)| home(modules, &at, &[path, &rest[1..]].concat(), depth + 1));
    Some(further.unwrap_or(at))
}

/// The modules that `module` imports, directly or through others.
fn reachable(edges: &BTreeMap<Module, BTreeSet<Module>>, module: &[String]) -> BTreeSet<Module> {
    let mut reached = BTreeSet::new();
    let mut left = vec![module];
    while let Some(at) = left.pop() {
        for next in edges.get(at).into_iter().flatten() {
            if reached.insert(next.clone()) {
                left.push(next);
            }
        }
    }
    reached
}

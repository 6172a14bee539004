//! `--rows`: the methods of a table in a file, such as those of the paper's tables.

use std::path::{Path, PathBuf};

use crate::clap::Args;
use anyhow::{Context as _, bail};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use srflow_files::{FileKind, parse_error_in_words, read_text};
use srflow_nets::Iterations;

use super::{MethodSpec, scored_method};
use crate::Watch;
use crate::error::in_words;
use crate::networks::weights_file;

macro_rules! tables {
    ($($name:literal),*) => {
        &[$(($name, include_str!(concat!("../../../../configs/", $name, ".toml")))),*]
    };
}

/// Tables that come with the program, each with its text.
const TABLES: &[(&str, &str)] =
    tables!["paper-table-2", "paper-table-3", "paper-table-4", "paper-table-6", "paper-tables-7-to-10"];

fn names() -> String {
    TABLES.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
}

/// Rows of a table from a file.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(next_help_heading = "Rows of a table")]
pub struct RowsArgs {
    #[arg(long, value_name = "FILE|NAME", help = format!("Methods with their names and weights: a TOML file, or one of {}", names()))]
    pub rows: Option<String>,
    /// Folder with the weights of --rows
    #[arg(long, value_name = "DIR", default_value_os_t = Self::default().weights_dir, requires = "rows")]
    weights_dir: PathBuf,
    /// Leave out rows whose weights or networks are missing; the table lists them
    #[arg(long, requires = "rows")]
    skip_missing: bool,
}

impl Default for RowsArgs {
    fn default() -> Self {
        Self { rows: None, weights_dir: ".".into(), skip_missing: false }
    }
}

/// The methods of a table.
#[derive(Debug, Default)]
pub struct Rows {
    pub methods: Vec<MethodSpec>,
    /// For each row that was left out, a sentence.
    pub left_out: Vec<String>,
    /// Names of rows, and of those that each is held against.
    pub improvements: Vec<(String, String)>,
}

/// What a file of rows holds.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RowsFile {
    #[serde(rename = "row")]
    rows: Vec<RowText>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RowText {
    /// What the table calls it.
    name: String,
    /// As after `--method`, without weights.
    method: String,
    /// A file in the folder of weights, or the name of published ones.
    weights: Option<String>,
    #[serde(default, deserialize_with = "iterations")]
    iterations: Option<Iterations>,
    #[serde(default)]
    settings: std::collections::BTreeMap<String, usize>,
    /// The row that this one is held against.
    improves_on: Option<String>,
}

/// A number, or text as after `--iters`.
fn iterations<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Iterations>, D::Error> {
    let text = match toml::Value::deserialize(deserializer)? {
        toml::Value::String(text) => text,
        other => other.to_string(),
    };
    text.parse().map(Some).map_err(D::Error::custom)
}

impl RowsArgs {
    /// The rows, whose weights are all there, and those of `--method` behind them.
    ///
    /// # Errors
    /// When the file cannot be read, or weights are missing: all that are, unless they are to be left out.
    pub fn with(&self, given: &[MethodSpec], watch: &Watch) -> anyhow::Result<Rows> {
        let Some(name) = &self.rows else {
            return Ok(Rows { methods: given.to_vec(), ..Rows::default() });
        };
        let mut rows = self.found(name, parsed(name)?, watch)?;
        rows.methods.extend_from_slice(given);
        if rows.methods.is_empty() {
            bail!("{name}: no row can be computed: {}", rows.left_out.join(" "));
        }
        Ok(rows)
    }

    fn found(&self, file: &str, texts: Vec<RowText>, watch: &Watch) -> anyhow::Result<Rows> {
        let mut rows = Rows::default();
        let mut missing = Vec::new();
        // First what is no matter of the network: nothing is fetched when a file is missing.
        let (mut specs, mut wanted) = (Vec::new(), Vec::new());
        for text in &texts {
            let mut spec = match text.spec() {
                Ok(spec) => spec,
                Err(problem) => {
                    missing.push((text.name.as_str(), problem));
                    continue;
                }
            };
            if let (Some(weights), Some(network)) = (&text.weights, spec.method.network()) {
                match in_folder(&self.weights_dir, weights) {
                    Some(path) => spec.weights = Some(path.display().to_string()),
                    None if srflow_nets::published(Some(network), weights).is_some() => {
                        wanted.push(text.name.as_str());
                    }
                    None => {
                        let place = self.weights_dir.join(weights);
                        missing.push((text.name.as_str(), format!("{} is not there", place.display())));
                        continue;
                    }
                }
            }
            specs.push((text, spec));
        }
        if missing.is_empty() || self.skip_missing {
            for (text, spec) in &mut specs {
                if let (true, Some(weights)) = (wanted.contains(&text.name.as_str()), &spec.weights) {
                    match weights_file(spec.method.network(), weights, watch) {
                        Ok(path) => spec.weights = Some(path.display().to_string()),
                        Err(error) => missing.push((text.name.as_str(), in_words(&error))),
                    }
                }
            }
        }
        if !missing.is_empty() && !self.skip_missing {
            let lines: Vec<String> = missing.iter().map(|(name, why)| format!("\n  {name}: {why}")).collect();
            bail!(
                "{file}: {} of {} rows cannot be computed; put missing weights into {} (`weights_dir`), or set `skip_missing`{}",
                missing.len(),
                texts.len(),
                self.weights_dir.display(),
                lines.concat()
            );
        }
        for (text, spec) in specs {
            if missing.iter().any(|(name, _)| *name == text.name) {
                continue;
            }
            if let Some(other) = &text.improves_on {
                rows.improvements.push((text.name.clone(), other.clone()));
            }
            rows.methods.push(spec);
        }
        rows.left_out = missing
            .iter()
            .map(|(name, _)| format!("{name}: left out, its weights or its network are missing."))
            .collect();
        Ok(rows)
    }
}

impl RowText {
    /// # Errors
    /// What is wrong with it, for people.
    fn spec(&self) -> Result<MethodSpec, String> {
        let method = match &self.weights {
            Some(weights) => format!("{}={weights}", self.method),
            None => self.method.clone(),
        };
        let spec = scored_method(&method)?;
        Ok(MethodSpec {
            label: Some(self.name.clone()),
            iterations: self.iterations.or(spec.iterations),
            settings: self.settings.clone().into_iter().collect(),
            ..spec
        })
    }
}

/// The weights of that name in the folder, under the name of the row's file or of the published one.
fn in_folder(folder: &Path, weights: &str) -> Option<PathBuf> {
    let published = srflow_nets::published(None, weights).map(|(_, published)| published.file_name());
    [Some(weights), published].into_iter().flatten().map(|name| folder.join(name)).find(|path| path.is_file())
}

fn parsed(name: &str) -> anyhow::Result<Vec<RowText>> {
    let known = TABLES.iter().find(|(known, _)| *known == name);
    let text = match known {
        Some((_, text)) => (*text).to_owned(),
        None => read_text(Path::new(name), FileKind::Settings)
            .with_context(|| format!("`rows`: a TOML file, or one of {}", names()))?,
    };
    match toml::from_str::<RowsFile>(&text) {
        Ok(file) => Ok(file.rows),
        Err(error) => bail!("{name}: {}", parse_error_in_words(&error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_of_the_paper_can_be_read() {
        for (name, _) in TABLES {
            let rows = parsed(name).unwrap();
            for row in &rows {
                // Some rows are of networks that are not here yet.
                let Ok(spec) = row.spec() else { continue };
                assert_eq!(spec.label.as_deref(), Some(row.name.as_str()));
                assert_eq!(spec.method.network().is_some(), row.weights.is_some(), "{name}: {}", row.name);
                let other = row.improves_on.as_deref();
                assert!(
                    other.is_none_or(|other| rows.iter().any(|row| row.name == other)),
                    "{name}: {other:?}"
                );
            }
            assert!(rows.iter().any(|row| row.spec().is_ok()), "{name}");
        }
    }

    #[test]
    fn missing_weights_are_named_all_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rows.toml");
        let rows =
            [("Ours", "skflow", "a.ckpt"), ("Theirs", "gma", "b.ckpt"), ("Small", "raft-small", "c.ckpt")];
        let text = rows.map(|(name, method, weights)| {
            format!(
                "[[row]]\nname = \"{name}\"\nmethod = \"{method}\"\nweights = \"{weights}\"\niterations = 3\n"
            )
        });
        std::fs::write(&file, text.concat()).unwrap();
        std::fs::write(folder.path().join("b.ckpt"), "").unwrap();
        let mut args = RowsArgs {
            rows: Some(file.display().to_string()),
            weights_dir: folder.path().to_owned(),
            skip_missing: false,
        };
        let error = args.with(&[], &Watch::SILENT).unwrap_err().to_string();
        assert!(
            error.contains("2 of 3 rows") && error.contains("Ours: ") && error.contains("Small: "),
            "{error}"
        );
        assert!(!error.contains("Theirs"), "{error}");
        args.skip_missing = true;
        let rows = args.with(&[super::super::Method::TvL1.into()], &Watch::SILENT).unwrap();
        let names: Vec<_> = rows.methods.iter().map(|spec| spec.label.as_deref()).collect();
        assert_eq!(names, [Some("Theirs"), None]);
        assert_eq!(rows.methods[0].iterations, Some("3".parse().unwrap()));
        assert_eq!(rows.left_out.len(), 2);
    }
}

//! The arguments that name micro-expression datasets.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::Args;
use srflow_read::micro_expression::{CLIP_KINDS, ClipDataset, ClipSource, check_distinct};

/// Where annotations lie, and what to do about missing frames.
#[derive(Args, Debug, Clone, Default)]
pub struct SourceArgs {
    /// Annotation file that does not lie in its dataset's folder: samm:FILE, casme2:FILE, smic:FILE or clips:FILE
    #[arg(long, value_name = "KIND:FILE")]
    annotations: Vec<String>,
    /// CSV list of SMIC's apex frames [default: smic_apex.csv or data_apex.csv in its folder]
    #[arg(long, value_name = "FILE")]
    apex_list: Option<PathBuf>,
    /// Go on without frames that are missing; clips without onset or apex are dropped
    #[arg(long)]
    pub allow_missing: bool,
}

impl SourceArgs {
    /// The datasets with what the other arguments say of them.
    pub fn complete(&self, mut sources: Vec<ClipSource>) -> anyhow::Result<Vec<ClipSource>> {
        for text in &self.annotations {
            let Some((kind, file)) = text.split_once(':').filter(|(_, file)| !file.is_empty()) else {
                bail!("--annotations {text}: expected KIND:FILE, e.g. samm:SAMM_Micro_FACS_Codes_v2.xlsx");
            };
            let Some(source) = sources.iter_mut().find(|source| source.kind.name == kind) else {
                bail!("--annotations {text}: no dataset of the kind `{kind}` is given");
            };
            source.annotations = Some(file.into());
        }
        for source in &mut sources {
            source.apex_list.clone_from(&self.apex_list);
        }
        Ok(sources)
    }

    /// Opens the datasets.
    ///
    /// # Errors
    /// Those of [`ClipDataset::open`], or when two have the same name.
    pub fn open(&self, sources: Vec<ClipSource>) -> anyhow::Result<Vec<ClipDataset>> {
        let sources = self.complete(sources)?;
        let open = |source: &ClipSource| {
            ClipDataset::open(source, self.allow_missing).with_context(|| format!("reading {source}"))
        };
        let datasets = sources.iter().map(open).collect::<anyhow::Result<Vec<_>>>()?;
        check_distinct(datasets.iter().map(|dataset| dataset.name.as_str()))?;
        Ok(datasets)
    }
}

/// Help of an argument that takes datasets.
pub fn kinds_help() -> String {
    let kinds: Vec<String> =
        CLIP_KINDS.iter().map(|kind| format!("  {:<22} {}", kind.to_string(), kind.about)).collect();
    format!("Kinds of dataset:\n{}", kinds.join("\n"))
}

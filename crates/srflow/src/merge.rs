//! Joining the parts of a dataset that several processes made.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_render::merge::{Merged, Request, merge};

use crate::clap::Args;
use crate::output::{ensure_folder, write_line};
use crate::rendering::Made;
use crate::{Job, Report, Watch, WhenStopped};

/// Join the parts of a dataset that were made with --shard
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow render --out part-1 --shard 1/2
  srflow render --out part-2 --shard 2/2
  srflow merge part-1 part-2 --out srflow

Parts are folders of `srflow render`, `srflow shapes`, `srflow mer synth` or `srflow mer synth-long` with the same arguments, seed and version. Files are hard links \
to those of the parts, which takes no space, or copies where the parts are on another disk. What parts alone cannot have is \
written: statistics, tables, the hashes of all files. Nothing in the parts is changed. Running the same command again continues \
an interrupted merge.")]
pub struct MergeJob {
    /// Folders of the parts
    #[arg(required = true, value_name = "PART")]
    pub parts: Vec<PathBuf>,
    /// Folder of the whole dataset: new, from an earlier merge, or one of the parts
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Copy files instead of linking them
    #[arg(long)]
    #[serde(default)]
    pub copy: bool,
    /// Merge even if pairs or clips are missing; a later merge can add them
    #[arg(long)]
    #[serde(default)]
    pub partial: bool,
}

impl Job for MergeJob {
    const NAME: &'static str = "merge";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = MergeReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<MergeReport> {
        ensure_folder(&self.out)?;
        let count = Made::default();
        let merged = merge(Request {
            parts: &self.parts,
            out: &self.out,
            copy: self.copy,
            partial: self.partial,
            on_event: &|event| count.report(event, "pairs or clips", watch),
        })?;
        Ok(MergeReport { dataset: self.out.clone(), parts: self.parts.len(), merged })
    }
}

/// What [`MergeJob`] has joined.
#[derive(Debug, Clone, Serialize)]
pub struct MergeReport {
    pub dataset: PathBuf,
    #[serde(skip)]
    parts: usize,
    #[serde(flatten)]
    merged: Merged,
}

impl Report for MergeReport {}

impl fmt::Display for MergeReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { dataset, parts, merged } = self;
        let Merged {
            kind,
            units,
            merged,
            linked,
            copied,
            missing,
            missing_names,
            doubled,
            doubled_names,
            complete,
        } = merged;
        writeln!(
            f,
            "{merged} of {units} {kind} merged from {parts} parts: {linked} files linked, {copied} copied"
        )?;
        if *doubled > 0 {
            let names = some(doubled_names, *doubled);
            writeln!(f, "{doubled} {kind} are in several parts, with the same bytes: {names}")?;
        }
        if *missing > 0 {
            writeln!(f, "{missing} {kind} are missing: {}", some(missing_names, *missing))?;
        }
        if *complete {
            write_line(f, format_args!("{} is complete", dataset.display()))?;
        }
        Ok(())
    }
}

/// The names, and that there are more.
fn some(names: &[String], all: u64) -> String {
    let more = if all > names.len() as u64 { " ..." } else { "" };
    format!("{}{more}", names.join(", "))
}

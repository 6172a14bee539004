use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use srflow_render::merge::{Merged, Request, merge};

use crate::Context;
use crate::interrupt::Continuable;
use crate::output::{ensure_folder, print_json};
use crate::rendering::Progress;

/// Bring the parts of a dataset together that were made with --shard
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow render --out part-1 --shard 1/2
  srflow render --out part-2 --shard 2/2
  srflow merge part-1 part-2 --out srflow

Parts are folders of `srflow render`, `srflow shapes` or `srflow mer synth` with the same arguments, seed and version. Files are hard links \
to those of the parts, which takes no space, or copies where the parts are on another disk. What parts alone cannot have is \
written: statistics, tables, the hashes of all files. Nothing in the parts is changed. Run the same command again to continue \
an interrupted merge. docs/guides/clusters.md shows whole jobs.")]
pub struct Merge {
    /// Folders of the parts
    #[arg(required = true, value_name = "PART")]
    parts: Vec<PathBuf>,
    /// Folder of the whole dataset: a new one, one of an earlier merge, or one of the parts
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Copy files rather than link them
    #[arg(long)]
    copy: bool,
    /// Merge although pairs or clips are missing; the dataset is complete when a later merge, or the command that made the
    /// parts, adds them
    #[arg(long)]
    partial: bool,
}

pub fn run(args: Merge, context: &Context) -> anyhow::Result<()> {
    ensure_folder(&args.out)?;
    let progress = Progress::new("pairs or clips");
    let continuable = Continuable::counted(&progress.bar, "pairs or clips");
    let merged = merge(Request {
        parts: &args.parts,
        out: &args.out,
        copy: args.copy,
        partial: args.partial,
        on_event: &|event| progress.show(event),
    });
    drop(continuable);
    progress.bar.finish_and_clear();
    let merged = merged?;
    if context.json {
        let mut value = json!(merged);
        value["dataset"] = json!(args.out);
        return print_json(&value);
    }
    print(&args, &merged)
}

fn print(args: &Merge, merged: &Merged) -> anyhow::Result<()> {
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
    let parts = args.parts.len();
    say!("{merged} of {units} {kind} merged from {parts} parts: {linked} files linked, {copied} copied")?;
    if *doubled > 0 {
        say!(
            "{doubled} {kind} are in several parts, with the same bytes: {}",
            some(doubled_names, *doubled)
        )?;
    }
    if *missing > 0 {
        say!("{missing} {kind} are missing: {}", some(missing_names, *missing))?;
    }
    if *complete {
        say!("{} is complete", args.out.display())?;
    }
    Ok(())
}

/// The names, and that there are more.
fn some(names: &[String], all: u64) -> String {
    let more = if all > names.len() as u64 { " ..." } else { "" };
    format!("{}{more}", names.join(", "))
}

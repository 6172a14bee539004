use std::path::PathBuf;

use clap::Args;
use srflow_read::manifest::Manifest;
use srflow_render::check::{self, CheckReport};

use super::render::print_statistics;
use crate::Context;
use crate::progress::bar;

/// Open every file of a dataset and report problems
#[derive(Args)]
#[command(after_help = "\
Example:
  srflow check srflow --json

Opens every file, compares it with dataset.json, and compares dataset.json with its own arguments. Frame 2 is warped \
back by the flow: on the head, where a pixel is visible in both frames, the difference to frame 1 must be small. The exit \
code is 1 when there is a problem.")]
pub struct Check {
    /// Folder of a dataset written by `srflow render`
    #[arg(value_name = "DIR")]
    dir: PathBuf,
}

/// Most problems listed as text; --json lists all.
const LISTED: usize = 50;

pub fn run(args: Check, context: &Context) -> anyhow::Result<()> {
    let pairs = Manifest::read(&args.dir)?.pairs();
    let bar = bar(pairs, "{wide_bar} {pos}/{len} pairs, {eta} left");
    let report = check::check(&args.dir, &|| bar.inc(1));
    bar.finish_and_clear();
    let report = report?;
    if context.json {
        crate::output::print_json(&report)?;
    } else {
        print_report(&report)?;
    }
    match report.problems.len() {
        0 => Ok(()),
        1 => anyhow::bail!("{}: 1 problem", args.dir.display()),
        count => anyhow::bail!("{}: {count} problems", args.dir.display()),
    }
}

fn print_report(report: &CheckReport) -> anyhow::Result<()> {
    for problem in report.problems.iter().take(LISTED) {
        say!("{}: {}", problem.file.display(), problem.what)?;
    }
    if report.problems.len() > LISTED {
        say!("... and {} more; --json lists all", report.problems.len() - LISTED)?;
    }
    say!("{} of {} pairs are intact", report.sound, report.pairs)?;
    say!(
        "Difference between the frames on the head: {:.3} levels of 255, {:.3} with frame 2 warped back by the flow",
        report.residual.unwarped,
        report.residual.warped
    )?;
    print_statistics(&report.statistics)
}

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use clap::Args;
use serde::Serialize;
use srflow_read::manifest::Manifest;
use srflow_render::check::{CheckReport, Problem, Rerendered, check, check_hashes, check_rerendered};

use crate::Context;
use crate::progress::{Lines, bar};

/// Open every file of a dataset and report problems
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow check srflow --json
  srflow check srflow --hashes
  srflow check srflow --rerender 5

Opens every file, compares it with dataset.json, and compares dataset.json with its own arguments. Frame 2 is warped \
back by the flow: on the head, where a pixel is visible in both frames, the difference to frame 1 must be small. With --hashes \
and --rerender, only those checks are made. The exit code is 1 when there is a problem.")]
pub struct Check {
    /// Folder of a dataset written by `srflow render`; with --hashes also by `srflow shapes` or `srflow mer synth`
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// Compare every file with its hash in SHA256SUMS instead, which `sha256sum -c SHA256SUMS` does too
    #[arg(long)]
    hashes: bool,
    /// Render N pairs again instead, drawn at random, and compare the bytes of their files; for datasets that need no other files
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    rerender: Option<u64>,
    /// Seed that draws the pairs of --rerender [default: from the clock]
    #[arg(long, value_name = "N", requires = "rerender")]
    seed: Option<u64>,
}

/// Most problems listed as text; --json lists all.
const LISTED: usize = 50;

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    content: Option<CheckReport>,
    /// Files compared with their hashes.
    #[serde(skip_serializing_if = "Option::is_none")]
    hashed_files: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rerendered: Option<Rerendered>,
    /// Those of hashes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    hash_problems: Vec<Problem>,
}

pub fn run(args: Check, context: &Context) -> anyhow::Result<()> {
    let lines = Lines::new();
    let mut report =
        Report { content: None, hashed_files: None, rerendered: None, hash_problems: Vec::new() };
    if args.hashes {
        let bar = bar(0, "{wide_bar} {pos}/{len} files hashed, {eta} left");
        let result = check_hashes(&args.dir, &|files, all| {
            bar.set_length(all);
            bar.set_position(files);
            lines.now_and_then(&bar, "files hashed");
        });
        bar.finish_and_clear();
        let (files, problems) = result?;
        (report.hashed_files, report.hash_problems) = (Some(files), problems);
    }
    if let Some(count) = args.rerender {
        let clock =
            || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        let pairs = Manifest::read(&args.dir)?.pairs();
        let bar = bar(count.min(pairs), "{wide_bar} {pos}/{len} pairs rendered, {eta} left");
        let result = check_rerendered(&args.dir, count, args.seed.unwrap_or_else(clock), &|| {
            bar.inc(1);
            lines.now_and_then(&bar, "pairs rendered");
        });
        bar.finish_and_clear();
        report.rerendered = Some(result?);
    }
    if !args.hashes && args.rerender.is_none() {
        let bar = bar(Manifest::read(&args.dir)?.pairs(), "{wide_bar} {pos}/{len} pairs, {eta} left");
        let result = check(&args.dir, &|| {
            bar.inc(1);
            lines.now_and_then(&bar, "pairs");
        });
        bar.finish_and_clear();
        report.content = Some(result?);
    }
    if context.json {
        crate::output::print_json(&report)?;
    } else {
        print_report(&report)?;
    }
    match report.problems().count() {
        0 => Ok(()),
        1 => anyhow::bail!("{}: 1 problem", args.dir.display()),
        count => anyhow::bail!("{}: {count} problems", args.dir.display()),
    }
}

impl Report {
    fn problems(&self) -> impl Iterator<Item = &Problem> {
        let of_content = self.content.iter().flat_map(|content| &content.problems);
        let of_rerendered = self.rerendered.iter().flat_map(|rerendered| &rerendered.problems);
        of_content.chain(&self.hash_problems).chain(of_rerendered)
    }
}

fn print_report(report: &Report) -> anyhow::Result<()> {
    for problem in report.problems().take(LISTED) {
        say!("{}: {}", problem.file.display(), problem.what)?;
    }
    let problems = report.problems().count();
    if problems > LISTED {
        say!("... and {} more; --json lists all", problems - LISTED)?;
    }
    if let Some(files) = report.hashed_files {
        let wrong = report.hash_problems.len();
        say!("{files} files compared with their hashes, {wrong} problems")?;
    }
    if let Some(Rerendered { seed, pairs, equal_files, problems }) = &report.rerendered {
        say!(
            "{} pairs rendered again, drawn by --seed {seed}: {equal_files} files have the same bytes, {} have not",
            pairs.len(),
            problems.len()
        )?;
    }
    let Some(content) = &report.content else { return Ok(()) };
    say!("{} of {} pairs are intact", content.sound, content.pairs)?;
    say!(
        "Difference between the frames on the head: {:.3} levels of 255, {:.3} with frame 2 warped back by the flow",
        content.residual.unwarped,
        content.residual.warped
    )?;
    crate::output::print_text(&srflow::render::StatisticsText(&content.statistics).to_string())
}

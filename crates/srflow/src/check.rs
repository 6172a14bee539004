//! Checking a dataset: its files, its flow, its hashes.

use std::fmt;
use std::num::NonZeroU64;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use srflow_data::manifest::Manifest;
use srflow_render::check::{CheckReport, Problem, Rerendered, check, check_hashes, check_rerendered};

use crate::clap::Args;
use crate::output::write_line;
use crate::render::write_statistics;
use crate::{Job, Report, Watch};

/// Open every file of a dataset and report problems
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow check srflow --json
  srflow check srflow --hashes
  srflow check srflow --rerender 5

Opens every file, compares it with dataset.json, and compares dataset.json with its own arguments. Frame 2 is warped \
back by the flow: on the head, where a pixel is visible in both frames, the difference to frame 1 must be small. With --hashes \
and --rerender, only those checks are made. The exit code is 1 when there is a problem.")]
pub struct CheckJob {
    /// Folder of a dataset written by `srflow render`; with --hashes also by `srflow shapes`, `srflow mer synth` or `synth-long`
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
    /// Only compare every file with its hash, as `sha256sum -c SHA256SUMS` does
    #[arg(long)]
    #[serde(default)]
    pub hashes: bool,
    /// Only render N random pairs again and compare bytes; for datasets that need no other files
    #[arg(long, value_name = "N")]
    #[serde(default)]
    pub rerender: Option<NonZeroU64>,
    /// Seed that draws the pairs of --rerender [default: from the clock]
    #[arg(long, value_name = "N", requires = "rerender")]
    #[serde(default)]
    pub seed: Option<u64>,
}

impl Job for CheckJob {
    const NAME: &'static str = "check";

    type Report = Checked;

    fn work(&self, watch: &Watch) -> anyhow::Result<Checked> {
        let mut checked = Checked {
            dir: self.dir.clone(),
            content: None,
            hashed_files: None,
            rerendered: None,
            hash_problems: Vec::new(),
        };
        if self.hashes {
            let hashed = watch.count("files hashed", 0);
            let (files, problems) = check_hashes(&self.dir, &|files, all| {
                hashed.set_total(all);
                hashed.set(files);
            })?;
            (checked.hashed_files, checked.hash_problems) = (Some(files), problems);
        }
        if let Some(count) = self.rerender.map(NonZeroU64::get) {
            let clock =
                || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
            let pairs = Manifest::read(&self.dir)?.pairs();
            let rendered = watch.count("pairs rendered", count.min(pairs));
            let seed = self.seed.unwrap_or_else(clock);
            checked.rerendered = Some(check_rerendered(&self.dir, count, seed, &|| rendered.inc())?);
        }
        if !self.hashes && self.rerender.is_none() {
            let pairs = watch.count("pairs", Manifest::read(&self.dir)?.pairs());
            checked.content = Some(check(&self.dir, &|| pairs.inc())?);
        }
        Ok(checked)
    }
}

/// What [`CheckJob`] found: one part for each check.
#[derive(Debug, Clone, Serialize)]
pub struct Checked {
    #[serde(skip)]
    dir: PathBuf,
    /// The files, and how well the flow explains the frames.
    #[serde(flatten)]
    pub content: Option<CheckReport>,
    /// Files compared with their hashes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hashed_files: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rerendered: Option<Rerendered>,
    /// Problems with hashes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hash_problems: Vec<Problem>,
}

impl Checked {
    /// All problems, of every check.
    pub fn problems(&self) -> impl Iterator<Item = &Problem> {
        let content = self.content.iter().flat_map(|content| &content.problems);
        let rerendered = self.rerendered.iter().flat_map(|rerendered| &rerendered.problems);
        content.chain(&self.hash_problems).chain(rerendered)
    }
}

impl Report for Checked {
    fn failure(&self) -> Option<String> {
        match self.problems().count() {
            0 => None,
            1 => Some(format!("{}: 1 problem", self.dir.display())),
            count => Some(format!("{}: {count} problems", self.dir.display())),
        }
    }
}

/// Most problems listed as text; JSON lists all.
const LISTED: usize = 50;

impl fmt::Display for Checked {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for problem in self.problems().take(LISTED) {
            write_line(f, format_args!("{}: {}", problem.file.display(), problem.what))?;
        }
        let problems = self.problems().count();
        if problems > LISTED {
            writeln!(f, "... and {} more; --json lists all", problems - LISTED)?;
        }
        if let Some(files) = self.hashed_files {
            let wrong = self.hash_problems.len();
            writeln!(f, "{files} files compared with their hashes, {wrong} problems")?;
        }
        if let Some(Rerendered { seed, pairs, equal_files, problems }) = &self.rerendered {
            writeln!(
                f,
                "{} pairs rendered again, drawn by --seed {seed}: {equal_files} files have the same bytes, {} have not",
                pairs.len(),
                problems.len()
            )?;
        }
        let Some(content) = &self.content else { return Ok(()) };
        writeln!(f, "{} of {} pairs are intact", content.sound, content.pairs)?;
        writeln!(
            f,
            "Difference between the frames on the head: {:.3} levels of 255, {:.3} with frame 2 warped back by the flow",
            content.residual.unwarped, content.residual.warped
        )?;
        write_statistics(f, &content.statistics)
    }
}

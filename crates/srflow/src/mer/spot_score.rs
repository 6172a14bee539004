//! Scores of spotted intervals.

use std::collections::BTreeSet;
use std::fmt;
use std::path::PathBuf;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::intervals::{INTERVAL_KINDS, IntervalSource, Intervals};
use srflow_mer::spotting::{
    Analysis, CountingRule, PredictedTypes, SpottingScores, TypeScores, retyped, score_intervals,
};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::write_line;
use crate::{Job, Report, Watch};

/// Score spotted intervals against the truth, as the Micro-Expression Grand Challenges do
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = after_help())]
pub struct SpotScoreJob {
    /// Spotted intervals: CSV files with the columns video, onset, offset, type
    #[arg(required = true, value_name = "PREDICTIONS.csv")]
    pub predictions: Vec<PathBuf>,
    /// True intervals: CSV files, or annotations of datasets (see below)
    #[arg(long, required = true, num_args = 1.., value_name = "[KIND:]FILE")]
    pub truth: Vec<IntervalSource>,
    /// Rule of counting (see below)
    #[arg(long, value_name = "RULE", default_value_t)]
    #[serde(default)]
    pub rule: CountingRule,
    /// Type of a prediction: given in the file, by its duration (at most 0.5 s is micro), or also by its rise (at most 8/30 s
    /// to the apex)
    #[arg(long, value_name = "HOW", default_value_t)]
    #[serde(default)]
    pub types: PredictedTypes,
    /// Frames per second, for `--types` [default: the dataset's]
    #[arg(long, value_name = "RATE")]
    #[serde(default)]
    pub fps: Option<f64>,
}

fn after_help() -> String {
    let kinds: String =
        INTERVAL_KINDS.iter().map(|kind| format!("  {:<15} {}\n", kind.name, kind.about)).collect();
    format!(
        "\
Examples:
  srflow mer spot-score events.csv --truth long/events.csv
  srflow mer spot-score cas.csv samm.csv --truth casme-squared:CASFE.xlsx samm-long:SAMM_LongVideos_V2_Release.xlsx

Kinds of truth:
{kinds}
Rules of counting:
  strict          one prediction for one expression of its type, best overlap first (recommended)
  any-type        the same without regard to types
  exclusive       strict, but the last frame does not belong to an interval
  megc2020        expressions that any prediction of their type overlaps, as MEGC 2020's baseline
  of-fd           expressions that any prediction overlaps, as the code of MEGC 2021's winner

Intervals match if they share at least half of the frames that either has. F1 pools all videos. With emotions in both \
files, STRS is printed, too."
    )
}

impl Job for SpotScoreJob {
    const NAME: &'static str = "mer spot-score";

    type Report = SpotScoreReport;

    fn work(&self, _: &Watch) -> anyhow::Result<SpotScoreReport> {
        if self.fps.is_some_and(|fps| !(fps > 0.0 && fps.is_finite())) {
            wrong_settings!("`fps` must be a positive number");
        }
        let mut truths = Vec::new();
        let mut known = BTreeSet::new();
        let mut rates = Vec::new();
        for source in &self.truth {
            let Intervals { intervals, notes, fps } = source.read()?;
            notes.iter().for_each(|note| log::warn!("{source}: {note}"));
            let names: BTreeSet<String> = intervals.iter().map(|interval| interval.video.clone()).collect();
            if let Some(video) = known.intersection(&names).next() {
                wrong_settings!("{source}: a file before it has a video {video}, too; give each file once");
            }
            known.extend(names);
            rates.extend(fps);
            truths.extend(intervals);
        }
        let mut predictions = Vec::new();
        for path in &self.predictions {
            let source = IntervalSource { kind: &INTERVAL_KINDS[0], path: path.clone() };
            predictions.extend(source.read()?.intervals);
        }
        if self.types != PredictedTypes::Given {
            rates.dedup();
            let fps = match (self.fps, rates.as_slice()) {
                (Some(fps), _) => fps,
                (None, [fps]) => *fps,
                (None, []) => wrong_settings!("`types` {} needs `fps`", self.types),
                (None, _) => wrong_settings!("the datasets have several frame rates: score them one by one"),
            };
            retyped(&mut predictions, self.types, fps);
        }
        let unknown: BTreeSet<&str> = predictions
            .iter()
            .map(|interval| interval.video.as_str())
            .filter(|video| !known.contains(*video))
            .collect();
        if !predictions.is_empty()
            && predictions.iter().all(|interval| unknown.contains(interval.video.as_str()))
        {
            let expected = known.first().map_or("", String::as_str);
            let found = unknown.first().copied().unwrap_or_default();
            return Err(anyhow::anyhow!(
                "no video of the predictions is one of the truth's, such as `{expected}`: call them alike"
            ))
            .context(format!("video `{found}`"));
        }
        if !unknown.is_empty() {
            log::warn!(
                "{} videos of the predictions have no expression in the truth: what is spotted in them counts as wrong",
                unknown.len()
            );
        }
        Ok(SpotScoreReport { types: self.types, scores: score_intervals(&truths, &predictions, self.rule) })
    }
}

/// The scores.
#[derive(Debug, Clone, Serialize)]
pub struct SpotScoreReport {
    pub types: PredictedTypes,
    #[serde(flatten)]
    pub scores: SpottingScores,
}

impl Report for SpotScoreReport {}

impl fmt::Display for SpotScoreReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let SpottingScores { rule, videos, micro, macros, overall, analysis } = &self.scores;
        writeln!(f, "{videos} videos, rule {rule}")?;
        writeln!(
            f,
            "{:<8} {:>6} {:>10} {:>6}  {:>9} {:>6}  {:>6}  95 % interval",
            "", "found", "predicted", "truth", "precision", "recall", "F1"
        )?;
        for (name, scores) in [("micro", micro), ("macro", macros), ("overall", overall)] {
            let TypeScores { counts, precision, recall, f1, f1_interval } = scores;
            if counts.predicted + counts.truths == 0 {
                writeln!(f, "{name:<8} {:>6} {:>10} {:>6}", 0, 0, 0)?;
                continue;
            }
            writeln!(
                f,
                "{name:<8} {:>6} {:>10} {:>6}  {precision:>9.4} {recall:>6.4}  {f1:.4}  {:.4} to {:.4}",
                counts.found, counts.predicted, counts.truths, f1_interval.low, f1_interval.high
            )?;
        }
        if let Some(Analysis { clips, classes, precision, recall, f1, uf1, strs }) = analysis {
            write_line(f, format_args!("emotions of {clips} found expressions: {}", classes.join(", ")))?;
            writeln!(
                f,
                "precision {precision:.4}, recall (UAR) {recall:.4}, F1 of the two {f1:.4}, UF1 {uf1:.4}, STRS {strs:.4}"
            )?;
        }
        Ok(())
    }
}

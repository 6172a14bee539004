use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use srflow_mer::{ApexErrors, ApexRule, apex_errors, spot_apexes};
use srflow_read::micro_expression::{ApexRow, Clip, ClipSource, write_apex_list};

use super::sources::{SourceArgs, kinds_help};
use crate::Context;
use crate::face::FaceArgs;
use crate::methods::{self, Method, MethodParameters, MethodSpec};
use crate::output::{ensure_extension, ensure_free};
use crate::progress::bar;

/// Spot apex frames, and compare them with the annotated ones
#[derive(Args)]
#[command(after_help = format!("\
Examples:
  srflow mer apex smic:/data/SMIC --rule ratio --landmarks smic68.csv --out smic_apex.csv
  srflow mer apex samm:/data/SAMM casme2:/data/CASME2 --rule strain --method farneback

`ratio` picks the frame that differs most from the onset and least from the previous frame; `strain` the one to which the \
flow strains the face most. --out writes a list for --apex-list.

{}", kinds_help()))]
pub struct Apex {
    /// Datasets
    #[arg(required = true, value_name = "KIND:DIR")]
    datasets: Vec<ClipSource>,
    /// Rule: ratio or strain
    #[arg(long, value_name = "RULE", default_value_t = ApexRule::Strain)]
    rule: ApexRule,
    /// How to estimate the flow, for the rule `strain`
    #[arg(long, value_name = "METHOD", default_value = Method::DEFAULT.name(), help = method_help())]
    method: MethodSpec,
    /// Write the apex frames as a CSV list
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Overwrite an existing list
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    sources: SourceArgs,
    #[command(flatten)]
    face: FaceArgs,
    #[command(flatten)]
    parameters: MethodParameters,
}

fn method_help() -> String {
    format!("For the rule `strain`. {}", Method::help())
}

#[derive(Serialize)]
struct SpottedApexes {
    rule: &'static str,
    face: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    method: Option<String>,
    clips: Vec<SpottedClip>,
    /// Error in frames over the clips with an annotated apex, per dataset.
    errors: BTreeMap<String, ApexErrors>,
}

#[derive(Serialize)]
struct SpottedClip {
    dataset: String,
    subject: String,
    clip: String,
    onset: u64,
    offset: u64,
    annotated: Option<u64>,
    spotted: u64,
}

pub fn run(args: Apex, context: &Context) -> anyhow::Result<()> {
    args.out.as_ref().map_or(Ok(()), |path| ensure_extension(path, "csv"))?;
    ensure_free(&args.out, args.force)?;
    let estimator = methods::estimator(&args.method, &args.parameters, &crate::run::WATCH)?;
    let datasets = args.sources.open(args.datasets)?;
    let clips: Vec<&Clip> = datasets.iter().flat_map(|dataset| &dataset.clips).collect();
    let landmarks = || args.out.as_deref().unwrap_or("apexes".as_ref()).with_extension("landmarks.csv");
    let face = args.face.of_clips(clips.iter().copied(), landmarks, args.force, &crate::run::WATCH)?;
    let bar = bar(clips.len() as u64, "{bar:30} {pos}/{len} clips, {eta} left");
    let spotted = spot_apexes(&clips, args.rule, &face, estimator.as_ref(), &|| bar.inc(1));
    bar.finish_and_clear();
    let spotted = spotted?;
    if let Some(path) = &args.out {
        let rows: Vec<ApexRow> =
            clips.iter().zip(&spotted).map(|(clip, apex)| ApexRow { clip, apex: *apex }).collect();
        write_apex_list(path, &rows)?;
    }

    let pairs = || clips.iter().copied().zip(spotted.iter().copied());
    let mut errors = BTreeMap::new();
    for dataset in &datasets {
        let of_dataset = pairs().filter(|(clip, _)| clip.dataset == dataset.name);
        errors.extend(apex_errors(of_dataset).map(|errors| (dataset.name.clone(), errors)));
    }
    let spotted = SpottedApexes {
        rule: args.rule.name(),
        face: face.to_string(),
        method: (args.rule == ApexRule::Strain).then(|| estimator.name().to_owned()),
        clips: pairs().map(|(clip, spotted)| spotted_clip(clip, spotted)).collect(),
        errors,
    };
    if context.json {
        return crate::output::print_json(&spotted);
    }
    print(&spotted)
}

fn spotted_clip(clip: &Clip, spotted: u64) -> SpottedClip {
    let a = &clip.annotation;
    SpottedClip {
        dataset: clip.dataset.clone(),
        subject: a.subject.clone(),
        clip: a.clip.clone(),
        onset: a.onset,
        offset: a.offset,
        annotated: a.apex,
        spotted,
    }
}

fn print(spotted: &SpottedApexes) -> anyhow::Result<()> {
    for clip in &spotted.clips {
        let annotated = clip.annotated.map_or(String::new(), |apex| format!(", annotated {apex}"));
        say!(
            "{}/{}/{}: apex {}{annotated}, onset {}, offset {}",
            clip.dataset,
            clip.subject,
            clip.clip,
            clip.spotted,
            clip.onset,
            clip.offset
        )?;
    }
    for (dataset, errors) in &spotted.errors {
        say!(
            "{dataset}: mean error {:.2} frames over {} clips by {} ({}), against {:.2} frames for the middle of the \
            clip",
            errors.mean_absolute,
            errors.clips,
            spotted.rule,
            spotted.face,
            errors.of_the_middle
        )?;
    }
    Ok(())
}

//! Apex frames, spotted and compared with the annotated ones.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::{ApexRow, Clip, ClipSource, write_apex_list};
use srflow_files::write_atomically;
use srflow_mer::{
    ApexErrors, ApexRule, FeatureSettings, HeadMotion, Preparation, ResizeOrder, SpottedApex, apex_errors,
    spot_apexes,
};

use super::SourceArgs;
use crate::clap::Args;
use crate::face::FaceArgs;
use crate::methods::{self, MethodParameters, MethodSpec};
use crate::output::{ensure_extension, ensure_free, write_line};
use crate::{Job, Report, Watch};

/// Spot apex frames, and compare them with the annotated ones
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = format!("\
Examples:
  srflow mer apex smic:/data/SMIC --face detect --out smic_apex.csv
  srflow mer apex samm:/data/SAMM casme2:/data/CASME2 --method farneback --curves curves.csv

`course` fits a rise and fall between onset and offset to the flow; `strain` picks the frame to which the flow strains \
the face most; `ratio` the one that differs most from the onset and least from the previous frame. --out writes a list \
for --apex-list.

{}", super::sources::kinds_help()))]
pub struct ApexJob {
    /// Datasets
    #[arg(required = true, value_name = "KIND:DIR")]
    pub datasets: Vec<ClipSource>,
    /// Rule: course, strain or ratio
    #[arg(long, value_name = "RULE", default_value_t)]
    #[serde(default)]
    pub rule: ApexRule,
    /// How to estimate the flow, for the rules `course` and `strain`
    #[arg(long, value_name = "METHOD", default_value_t, help = method_help())]
    #[serde(default)]
    pub method: MethodSpec,
    /// Resize to 112x112: the frames before estimating the flow, or the flow after [default: after]
    #[arg(long, value_name = "ORDER")]
    #[serde(default)]
    pub resize: Option<ResizeOrder>,
    /// The head's motion in the flow: keep or subtract
    #[arg(long, value_name = "WHAT", default_value_t)]
    #[serde(default)]
    pub head_motion: HeadMotion,
    /// Write the rule's curve of every frame as CSV
    #[arg(long, value_name = "FILE")]
    #[serde(default)]
    pub curves: Option<PathBuf>,
    /// Write the apex frames as a CSV list
    #[arg(short, long, value_name = "FILE")]
    #[serde(default)]
    pub out: Option<PathBuf>,
    /// Overwrite existing files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub sources: SourceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

fn method_help() -> String {
    format!("For the rules `course` and `strain`. {}", methods::Method::help())
}

impl ApexJob {
    /// Spots the apexes of these datasets by the rule `course`.
    pub fn new(datasets: Vec<ClipSource>) -> Self {
        Self {
            datasets,
            rule: ApexRule::default(),
            method: MethodSpec::default(),
            resize: None,
            head_motion: HeadMotion::default(),
            curves: None,
            out: None,
            force: false,
            sources: SourceArgs::default(),
            face: FaceArgs::default(),
            parameters: MethodParameters::default(),
        }
    }
}

impl Job for ApexJob {
    const NAME: &'static str = "mer apex";

    type Report = ApexReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<ApexReport> {
        let outputs = || [&self.out, &self.curves].into_iter().flatten();
        outputs().try_for_each(|path| ensure_extension(path, "csv"))?;
        ensure_free(outputs(), self.force)?;
        let estimator = methods::estimator(&self.method, &self.parameters, watch)?;
        let (datasets, _frames) = self.sources.open(&self.datasets, true, watch)?;
        let clips: Vec<&Clip> = datasets.iter().flat_map(|dataset| &dataset.clips).collect();
        let landmarks = || self.out.as_deref().unwrap_or("apexes".as_ref()).with_extension("landmarks.csv");
        let face = self.face.of_clips(clips.iter().copied(), landmarks, self.force, watch)?;
        let done = watch.count("clips", clips.len() as u64);
        let default = FeatureSettings::default();
        let features = FeatureSettings {
            resize: self.resize.unwrap_or(default.resize),
            head_motion: self.head_motion,
            ..default
        };
        let preparation = Preparation { face, features };
        let curves = spot_apexes(&clips, self.rule, &preparation, estimator.as_ref(), &|| done.inc())?;
        let spotted: Vec<u64> = curves.iter().map(|apex| apex.frame).collect();
        if let Some(path) = &self.curves {
            write_curves(path, &clips, &curves)?;
        }
        if let Some(path) = &self.out {
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
        Ok(ApexReport {
            rule: self.rule,
            preparation: match self.rule {
                ApexRule::Ratio => preparation.face.to_string(),
                ApexRule::Strain | ApexRule::Course => preparation.to_string(),
            },
            method: (self.rule != ApexRule::Ratio).then(|| estimator.name().to_owned()),
            clips: pairs().map(|(clip, spotted)| SpottedClip::new(clip, spotted)).collect(),
            errors,
        })
    }
}

/// Writes the curve of each clip, a row for every frame after the onset.
fn write_curves(path: &Path, clips: &[&Clip], curves: &[SpottedApex]) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record(["dataset", "subject", "clip", "frame", "value"])?;
        for (clip, curve) in clips.iter().zip(curves) {
            let Clip { dataset, annotation, .. } = clip;
            for (frame, value) in &curve.scores {
                table.write_record([
                    dataset.as_str(),
                    &annotation.subject,
                    &annotation.clip,
                    &frame.to_string(),
                    &format!("{value:.6}"),
                ])?;
            }
        }
        table.flush()
    })?)
}

/// The spotted apexes.
#[derive(Debug, Clone, Serialize)]
pub struct ApexReport {
    pub rule: ApexRule,
    /// How the face was cropped and the flow prepared.
    pub preparation: String,
    /// The flow method, for the rules `course` and `strain`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<String>,
    pub clips: Vec<SpottedClip>,
    /// Error in frames over the clips with an annotated apex, by dataset.
    pub errors: BTreeMap<String, ApexErrors>,
}

/// The apex of a clip. All are numbers of frames.
#[derive(Debug, Clone, Serialize)]
pub struct SpottedClip {
    pub dataset: String,
    pub subject: String,
    pub clip: String,
    pub onset: u64,
    pub offset: u64,
    pub annotated: Option<u64>,
    pub spotted: u64,
}

impl SpottedClip {
    fn new(clip: &Clip, spotted: u64) -> Self {
        let a = &clip.annotation;
        Self {
            dataset: clip.dataset.clone(),
            subject: a.subject.clone(),
            clip: a.clip.clone(),
            onset: a.onset,
            offset: a.offset,
            annotated: a.apex,
            spotted,
        }
    }
}

impl Report for ApexReport {}

impl fmt::Display for ApexReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for SpottedClip { dataset, subject, clip, onset, offset, annotated, spotted } in &self.clips {
            let annotated = annotated.map_or(String::new(), |apex| format!(", annotated {apex}"));
            write_line(
                f,
                format_args!(
                    "{dataset}/{subject}/{clip}: apex {spotted}{annotated}, onset {onset}, offset {offset}"
                ),
            )?;
        }
        for (dataset, errors) in &self.errors {
            let ApexErrors { clips, mean_absolute, of_the_middle } = errors;
            write_line(
                f,
                format_args!(
                    "{dataset}: mean error {mean_absolute:.2} frames over {clips} clips by {} ({}), against \
                     {of_the_middle:.2} frames for the middle of the clip",
                    self.rule, self.preparation
                ),
            )?;
        }
        Ok(())
    }
}

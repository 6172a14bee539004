//! What micro-expression datasets hold.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use serde::{Deserialize, Serialize, Serializer};
use srflow_data::micro_expression::{
    Annotation, Classes, ClipDataset, ClipSource, DropReason, Dropped, Labels, MissingFrames, check_distinct,
    count_classes, published_counts,
};

use super::SourceArgs;
use super::sources::folder_for_frames;
use crate::clap::Args;
use crate::output::write_line;
use crate::{Job, Report, Watch};

/// List micro-expression datasets: labels, counts, dropped rows with reasons, missing frames
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[command(after_help = format!("\
Examples:
  srflow mer data samm:/data/SAMM casme2-cropped:/data/CASME2 smic:/data/SMIC
  srflow mer data samm:/data/SAMM --labels-only --clips
  srflow mer data casme2:/data/CASME2 --classes casme2-5

Frames are found by their number, from onset to offset. docs/reference/micro-expression-files.md describes the folders.

{}", super::sources::kinds_help()))]
pub struct DataJob {
    /// Datasets
    #[arg(required = true, value_name = "KIND:DIR")]
    pub datasets: Vec<ClipSource>,
    #[command(flatten)]
    #[serde(flatten)]
    pub sources: SourceArgs,
    /// Read only the annotations; do not look for frames
    #[arg(long)]
    #[serde(default)]
    pub labels_only: bool,
    /// List every clip
    #[arg(long)]
    #[serde(default)]
    pub clips: bool,
}

impl Job for DataJob {
    const NAME: &'static str = "mer data";

    type Report = DataReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<DataReport> {
        let sources = self.sources.complete(&self.datasets)?;
        let classes = self.sources.classes()?;
        let datasets = sources
            .into_iter()
            .map(|source| self.list(source, watch))
            .collect::<anyhow::Result<Vec<ListedDataset>>>()?;
        check_distinct(datasets.iter().map(|dataset| dataset.name.as_str()))?;
        let composite = Counts::sum(&classes, datasets.iter().map(|dataset| &dataset.counts));
        let subjects = datasets.iter().map(|dataset| dataset.subjects).sum();
        let Self { labels_only, clips, .. } = *self;
        Ok(DataReport { datasets, composite, subjects, labels_only, clips })
    }
}

impl DataJob {
    fn list(&self, mut source: ClipSource, watch: &Watch) -> anyhow::Result<ListedDataset> {
        if self.labels_only {
            let labels = Labels::read(&source).with_context(|| format!("reading {source}"))?;
            return Ok(ListedDataset::new(source, "", labels, Vec::new()));
        }
        let frames = folder_for_frames()?;
        let dataset = self.sources.open_one(&mut source, frames.path(), watch)?;
        let ClipDataset { name, form, file, clips, dropped, notes, missing, .. } = dataset;
        let annotations: Vec<Annotation> = clips.into_iter().map(|clip| clip.annotation).collect();
        let labels = Labels { dataset: name, file, annotations, dropped, notes };
        Ok(ListedDataset::new(source, form, labels, missing))
    }
}

/// The listed datasets.
#[derive(Debug, Clone, Serialize)]
pub struct DataReport {
    pub datasets: Vec<ListedDataset>,
    /// All datasets together.
    pub composite: Counts,
    pub subjects: usize,
    #[serde(skip)]
    labels_only: bool,
    #[serde(skip)]
    clips: bool,
}

/// A dataset: its clips, and what is dropped or missing.
#[derive(Debug, Clone, Serialize)]
pub struct ListedDataset {
    pub name: String,
    /// The published form, e.g. cropped.
    #[serde(skip_serializing_if = "str::is_empty")]
    pub form: &'static str,
    pub dir: PathBuf,
    /// The annotation file.
    pub annotations: Option<PathBuf>,
    pub counts: Counts,
    /// Whether the counts are those of the paper; `None` where it lists none.
    pub as_published: Option<bool>,
    pub subjects: usize,
    /// Clips without an annotated apex.
    pub without_apex: usize,
    /// Clips kept and dropped, by the dataset's original label.
    pub labels: BTreeMap<String, LabelCounts>,
    pub clips: Vec<ListedClip>,
    pub dropped: Vec<Dropped>,
    /// What was repaired in the annotations.
    pub notes: Vec<String>,
    pub missing_frames: u64,
    #[serde(serialize_with = "clips_with_gaps")]
    pub missing: Vec<MissingFrames>,
    #[serde(skip)]
    source: ClipSource,
    #[serde(skip)]
    published: Option<Counts>,
}

/// Clips of one original label.
#[derive(Debug, Clone, Default, Serialize)]
pub struct LabelCounts {
    /// By class.
    pub kept: BTreeMap<String, usize>,
    pub dropped: usize,
}

/// Numbers of clips.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// By class.
    #[serde(flatten)]
    pub classes: BTreeMap<String, usize>,
    pub total: usize,
}

/// A clip; onset, apex and offset are numbers of frames.
#[derive(Debug, Clone, Serialize)]
pub struct ListedClip {
    pub subject: String,
    pub clip: String,
    pub class: String,
    /// The dataset's original label.
    pub label: String,
    pub action_units: String,
    pub onset: u64,
    pub apex: Option<u64>,
    pub offset: u64,
}

#[derive(Serialize)]
struct ClipWithGaps<'a> {
    subject: &'a str,
    clip: &'a str,
    folder: &'a Path,
    frames: u64,
    ranges: &'a [(u64, u64)],
    dropped: bool,
}

fn clips_with_gaps<S: Serializer>(missing: &[MissingFrames], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(missing.iter().map(|clip| ClipWithGaps {
        subject: &clip.subject,
        clip: &clip.clip,
        folder: &clip.folder,
        frames: clip.count(),
        ranges: &clip.numbers,
        dropped: clip.dropped,
    }))
}

impl Counts {
    fn new(classes: &Classes, counts: &[usize]) -> Self {
        let classes = classes.names().iter().cloned().zip(counts.iter().copied()).collect();
        Self { classes, total: counts.iter().sum() }
    }

    fn sum<'a>(classes: &Classes, counts: impl Iterator<Item = &'a Self> + Clone) -> Self {
        let of_class = |class: &String| counts.clone().map(|counts| counts.classes[class]).sum();
        Self::new(classes, &classes.names().iter().map(of_class).collect::<Vec<usize>>())
    }

    /// `3 clips: 1 negative, 2 positive`, in the order of the classes.
    fn in_words(&self, classes: &Classes) -> String {
        let each: Vec<String> =
            classes.names().iter().map(|class| format!("{} {class}", self.classes[class])).collect();
        format!("{} clips: {}", self.total, each.join(", "))
    }
}

impl ListedDataset {
    fn new(source: ClipSource, form: &'static str, labels: Labels, missing: Vec<MissingFrames>) -> Self {
        let Labels { dataset: name, file, annotations, dropped, notes } = labels;
        let classes = &source.classes;
        let class = |annotation: &Annotation| classes.names()[annotation.class].clone();
        let counts = Counts::new(classes, &count_classes(classes, &annotations));
        let published = published_counts(classes, &name).map(|counts| Counts::new(classes, &counts));

        let mut labels: BTreeMap<String, LabelCounts> = BTreeMap::new();
        for annotation in &annotations {
            let label = labels.entry(annotation.label.clone()).or_default();
            *label.kept.entry(class(annotation)).or_default() += 1;
        }
        for row in &dropped {
            labels.entry(row.label.clone()).or_default().dropped += 1;
        }
        let subjects: BTreeSet<&str> = annotations.iter().map(|a| a.subject.as_str()).collect();
        let clip = |a: &Annotation| ListedClip {
            subject: a.subject.clone(),
            clip: a.clip.clone(),
            class: class(a),
            label: a.label.clone(),
            action_units: a.action_units.clone(),
            onset: a.onset,
            apex: a.apex,
            offset: a.offset,
        };
        Self {
            name,
            form,
            dir: source.dir.clone(),
            annotations: file,
            as_published: published.as_ref().map(|published| *published == counts),
            counts,
            subjects: subjects.len(),
            without_apex: annotations.iter().filter(|annotation| annotation.apex.is_none()).count(),
            labels,
            clips: annotations.iter().map(clip).collect(),
            dropped,
            notes,
            missing_frames: missing.iter().map(MissingFrames::count).fold(0, u64::saturating_add),
            missing,
            published,
            source,
        }
    }

    fn write(&self, f: &mut fmt::Formatter, labels_only: bool, clips: bool) -> fmt::Result {
        let Self { name, source, subjects, missing_frames, .. } = self;
        let classes = &source.classes;
        let form = if self.form.is_empty() { String::new() } else { format!(" ({})", self.form) };
        write_line(f, format_args!("{name}{form}, {source}"))?;
        if let Some(file) = &self.annotations {
            write_line(f, format_args!("  annotations  {}", file.display()))?;
        }
        let published = match &self.published {
            Some(published) if *published == self.counts => ", as published".to_owned(),
            Some(published) => format!(" (published: {})", published.in_words(classes)),
            None => String::new(),
        };
        let kept = self.counts.in_words(classes);
        write_line(f, format_args!("  kept         {kept}, {subjects} subjects{published}"))?;
        for (label, counts) in &self.labels {
            let mut parts: Vec<String> =
                counts.kept.iter().map(|(class, clips)| format!("{clips} {class}")).collect();
            if counts.dropped > 0 {
                parts.push(format!("{} dropped", counts.dropped));
            }
            write_line(f, format_args!("    {label:<12} {}", parts.join(", ")))?;
        }
        if self.without_apex > 0 {
            writeln!(f, "  no apex      {} clips; `srflow mer apex` spots them", self.without_apex)?;
        }
        for note in &self.notes {
            write_line(f, format_args!("  note         {note}"))?;
        }
        write_dropped(f, &self.dropped)?;
        let unusable = [DropReason::ApexUnknown, DropReason::ApexNotAfterOnset];
        let unusable = self.dropped.iter().filter(|row| unusable.contains(&row.reason)).count();
        if unusable > 0 && !source.published_list() {
            let total = self.counts.total + unusable;
            writeln!(
                f,
                "  apexes       {unusable} cannot be used; with spotted ones (`srflow mer apex`) {total} clips"
            )?;
        }
        if !labels_only {
            writeln!(f, "  missing      {missing_frames} frames of {} clips", self.missing.len())?;
            for clip in &self.missing {
                write_line(f, format_args!("    {clip}{}", if clip.dropped { ": dropped" } else { "" }))?;
            }
        }
        if clips {
            for ListedClip { subject, clip, class, onset, apex, offset, action_units, .. } in &self.clips {
                let apex = apex.map_or("?".to_owned(), |apex| apex.to_string());
                write_line(
                    f,
                    format_args!("    {subject}/{clip} {class} {onset}-{apex}-{offset} {action_units}"),
                )?;
            }
        }
        writeln!(f)
    }
}

/// Dropped rows, grouped by reason.
fn write_dropped(f: &mut fmt::Formatter, dropped: &[Dropped]) -> fmt::Result {
    let mut by_reason: BTreeMap<DropReason, Vec<&Dropped>> = BTreeMap::new();
    for row in dropped {
        by_reason.entry(row.reason).or_default().push(row);
    }
    for (reason, rows) in by_reason {
        writeln!(f, "  dropped      {}: {reason}", rows.len())?;
        for rows in rows.chunks(4) {
            let names: Vec<String> =
                rows.iter().map(|row| format!("{}/{} ({})", row.subject, row.clip, row.label)).collect();
            write_line(f, format_args!("    {}", names.join(", ")))?;
        }
    }
    Ok(())
}

impl Report for DataReport {}

impl fmt::Display for DataReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for dataset in &self.datasets {
            dataset.write(f, self.labels_only, self.clips)?;
        }
        if let [first, _, ..] = &self.datasets[..] {
            let composite = self.composite.in_words(&first.source.classes);
            write_line(f, format_args!("composite: {composite}, {} subjects", self.subjects))?;
        }
        Ok(())
    }
}

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_read::micro_expression::{
    Annotation, Classes, ClipDataset, ClipSource, DropReason, Dropped, Labels, MissingFrames, check_distinct,
    count_classes, published_counts,
};

use super::sources::{SourceArgs, kinds_help};
use crate::Context;

/// List micro-expression datasets: labels, counts, dropped rows with reasons, missing frames
#[derive(Args)]
#[command(after_help = format!("\
Examples:
  srflow mer data samm:/data/SAMM casme2-cropped:/data/CASME2 smic:/data/SMIC
  srflow mer data samm:/data/SAMM --labels-only --clips
  srflow mer data casme2:/data/CASME2 --classes casme2-5

Frames are found by their number, from onset to offset. docs/reference/micro-expression-files.md describes the folders.

{}", kinds_help()))]
pub struct Data {
    /// Datasets
    #[arg(required = true, value_name = "KIND:DIR")]
    datasets: Vec<ClipSource>,
    #[command(flatten)]
    sources: SourceArgs,
    /// Read only the annotations; do not look for frames
    #[arg(long)]
    labels_only: bool,
    /// List every clip
    #[arg(long)]
    clips: bool,
}

#[derive(Serialize)]
struct Listed {
    datasets: Vec<ListedDataset>,
    composite: Counts,
    subjects: usize,
}

#[derive(Serialize)]
struct ListedDataset {
    name: String,
    #[serde(skip_serializing_if = "str::is_empty")]
    form: &'static str,
    dir: PathBuf,
    annotations: Option<PathBuf>,
    counts: Counts,
    /// Whether the counts are those of the paper; none where it lists none.
    as_published: Option<bool>,
    subjects: usize,
    without_apex: usize,
    /// Clips kept and dropped, by the dataset's original label.
    labels: BTreeMap<String, LabelCounts>,
    clips: Vec<ListedClip>,
    dropped: Vec<Dropped>,
    missing_frames: u64,
    missing: Vec<ClipWithGaps>,
}

#[derive(Serialize, Default)]
struct LabelCounts {
    /// By class.
    kept: BTreeMap<String, usize>,
    dropped: usize,
}

#[derive(Serialize)]
struct Counts {
    /// By class.
    #[serde(flatten)]
    classes: BTreeMap<String, usize>,
    total: usize,
}

#[derive(Serialize)]
struct ListedClip {
    subject: String,
    clip: String,
    class: String,
    label: String,
    action_units: String,
    onset: u64,
    apex: Option<u64>,
    offset: u64,
}

#[derive(Serialize)]
struct ClipWithGaps {
    subject: String,
    clip: String,
    folder: PathBuf,
    frames: u64,
    ranges: Vec<(u64, u64)>,
    dropped: bool,
}

/// The listing of one dataset; its classes are those of the source.
struct Listing {
    source: ClipSource,
    name: String,
    form: &'static str,
    file: Option<PathBuf>,
    annotations: Vec<Annotation>,
    dropped: Vec<Dropped>,
    missing: Vec<MissingFrames>,
}

pub fn run(args: Data, context: &Context) -> anyhow::Result<()> {
    let sources = args.sources.complete(args.datasets)?;
    let listings = sources
        .into_iter()
        .map(|source| list(source, args.labels_only, args.sources.allow_missing))
        .collect::<anyhow::Result<Vec<Listing>>>()?;
    check_distinct(listings.iter().map(|listing| listing.name.as_str()))?;
    if context.json {
        return crate::output::print_json(&report(&listings));
    }
    for listing in &listings {
        print_listing(listing, args.labels_only, args.clips)?;
    }
    if listings.len() > 1 {
        let classes = &listings[0].source.classes;
        say!("composite: {}, {} subjects", in_words(classes, &total(&listings)), subjects(&listings))?;
    }
    Ok(())
}

fn list(source: ClipSource, labels_only: bool, allow_missing: bool) -> anyhow::Result<Listing> {
    let context = || format!("reading {source}");
    if labels_only {
        let Labels { dataset: name, file, annotations, dropped } =
            Labels::read(&source).with_context(context)?;
        return Ok(Listing { source, name, form: "", file, annotations, dropped, missing: Vec::new() });
    }
    let dataset = ClipDataset::open(&source, allow_missing).with_context(context)?;
    let ClipDataset { name, form, file, clips, dropped, missing, .. } = dataset;
    let annotations = clips.into_iter().map(|clip| clip.annotation).collect();
    Ok(Listing { source, name, form, file, annotations, dropped, missing })
}

impl Listing {
    fn class(&self, annotation: &Annotation) -> String {
        self.source.classes.names()[annotation.class].clone()
    }

    fn counts(&self) -> Vec<usize> {
        count_classes(&self.source.classes, &self.annotations)
    }

    fn published(&self) -> Option<[usize; 3]> {
        published_counts(&self.source.classes, &self.name)
    }

    fn subjects(&self) -> BTreeSet<&str> {
        self.annotations.iter().map(|annotation| annotation.subject.as_str()).collect()
    }

    fn as_published(&self) -> Option<bool> {
        self.published().map(|published| published[..] == self.counts())
    }

    fn without_apex(&self) -> usize {
        self.annotations.iter().filter(|annotation| annotation.apex.is_none()).count()
    }

    fn labels(&self) -> BTreeMap<String, LabelCounts> {
        let mut labels: BTreeMap<String, LabelCounts> = BTreeMap::new();
        for annotation in &self.annotations {
            let label = labels.entry(annotation.label.clone()).or_default();
            *label.kept.entry(self.class(annotation)).or_default() += 1;
        }
        for row in &self.dropped {
            labels.entry(row.label.clone()).or_default().dropped += 1;
        }
        labels
    }
}

fn total(listings: &[Listing]) -> Vec<usize> {
    let all = listings.iter().map(Listing::counts);
    all.reduce(|sum, counts| sum.iter().zip(counts).map(|(a, b)| a + b).collect()).unwrap_or_default()
}

fn subjects(listings: &[Listing]) -> usize {
    listings.iter().map(|listing| listing.subjects().len()).sum()
}

fn in_words(classes: &Classes, counts: &[usize]) -> String {
    let each: Vec<String> =
        classes.names().iter().zip(counts).map(|(class, clips)| format!("{clips} {class}")).collect();
    format!("{} clips: {}", counts.iter().sum::<usize>(), each.join(", "))
}

fn print_listing(listing: &Listing, labels_only: bool, clips: bool) -> anyhow::Result<()> {
    let form = if listing.form.is_empty() { String::new() } else { format!(" ({})", listing.form) };
    say!("{}{form}, {}", listing.name, listing.source)?;
    if let Some(file) = &listing.file {
        say!("  annotations  {}", file.display())?;
    }
    let published = match listing.as_published() {
        Some(true) => ", as published".to_owned(),
        Some(false) => match listing.published() {
            Some(counts) => format!(" (published: {})", in_words(&listing.source.classes, &counts)),
            None => String::new(),
        },
        None => String::new(),
    };
    say!(
        "  kept         {}, {} subjects{published}",
        in_words(&listing.source.classes, &listing.counts()),
        listing.subjects().len()
    )?;
    for (label, report) in listing.labels() {
        let mut parts: Vec<String> =
            report.kept.iter().map(|(class, clips)| format!("{clips} {class}")).collect();
        if report.dropped > 0 {
            parts.push(format!("{} dropped", report.dropped));
        }
        say!("    {label:<12} {}", parts.join(", "))?;
    }
    if listing.without_apex() > 0 {
        say!("  no apex      {} clips; `srflow mer apex` spots them", listing.without_apex())?;
    }
    print_dropped(&listing.dropped)?;
    if !labels_only {
        let frames: u64 = listing.missing.iter().map(MissingFrames::count).fold(0, u64::saturating_add);
        say!("  missing      {frames} frames of {} clips", listing.missing.len())?;
        for clip in &listing.missing {
            say!("    {clip}{}", if clip.dropped { ": dropped" } else { "" })?;
        }
    }
    if clips {
        for a in &listing.annotations {
            let apex = a.apex.map_or("?".to_owned(), |apex| apex.to_string());
            say!(
                "    {}/{} {} {}-{apex}-{} {}",
                a.subject,
                a.clip,
                listing.class(a),
                a.onset,
                a.offset,
                a.action_units
            )?;
        }
    }
    say!("")
}

/// Dropped rows, grouped by reason.
fn print_dropped(dropped: &[Dropped]) -> anyhow::Result<()> {
    let mut by_reason: BTreeMap<DropReason, Vec<&Dropped>> = BTreeMap::new();
    for row in dropped {
        by_reason.entry(row.reason).or_default().push(row);
    }
    for (reason, rows) in by_reason {
        say!("  dropped      {}: {reason}", rows.len())?;
        for rows in rows.chunks(4) {
            let names: Vec<String> =
                rows.iter().map(|row| format!("{}/{} ({})", row.subject, row.clip, row.label)).collect();
            say!("    {}", names.join(", "))?;
        }
    }
    Ok(())
}

fn report(listings: &[Listing]) -> Listed {
    Listed {
        datasets: listings.iter().map(dataset_report).collect(),
        composite: counts(&listings[0].source.classes, &total(listings)),
        subjects: subjects(listings),
    }
}

fn dataset_report(listing: &Listing) -> ListedDataset {
    let clip = |a: &Annotation| ListedClip {
        subject: a.subject.clone(),
        clip: a.clip.clone(),
        class: listing.class(a),
        label: a.label.clone(),
        action_units: a.action_units.clone(),
        onset: a.onset,
        apex: a.apex,
        offset: a.offset,
    };
    let missing = |clip: &MissingFrames| ClipWithGaps {
        subject: clip.subject.clone(),
        clip: clip.clip.clone(),
        folder: clip.folder.clone(),
        frames: clip.count(),
        ranges: clip.numbers.clone(),
        dropped: clip.dropped,
    };
    ListedDataset {
        name: listing.name.clone(),
        form: listing.form,
        dir: listing.source.dir.clone(),
        annotations: listing.file.clone(),
        counts: counts(&listing.source.classes, &listing.counts()),
        as_published: listing.as_published(),
        subjects: listing.subjects().len(),
        without_apex: listing.without_apex(),
        labels: listing.labels(),
        clips: listing.annotations.iter().map(clip).collect(),
        dropped: listing.dropped.clone(),
        missing_frames: listing.missing.iter().map(MissingFrames::count).fold(0, u64::saturating_add),
        missing: listing.missing.iter().map(missing).collect(),
    }
}

fn counts(classes: &Classes, counts: &[usize]) -> Counts {
    let classes = classes.names().iter().cloned().zip(counts.iter().copied()).collect();
    Counts { classes, total: counts.iter().sum() }
}

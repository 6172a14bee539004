//! Runs estimators over the pairs of a dataset and scores them.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::time::Instant;

use rayon::prelude::*;
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image, Mask, ScoreError, Shard,
    Size, score,
};
use srflow_data::flow::{DatasetError, Entry, EntryFile, FlowDataset, Sample};

use crate::crop::{CropError, Window, head_window};
use crate::error_curve::shares_within;
use crate::expression::Expression;
use crate::expression_error::{ExpressionTruth, Face};
use crate::flow_files::{FlowFileError, FlowFiles};
use crate::kept::KeptScores;
use crate::method_sums::MethodSums;
use crate::regions;
use crate::results::{Evaluation, Failure, PairScores, Region, dataset_title};
use crate::zero::Zero;

/// The source of the flow that is scored.
#[derive(Clone, Copy)]
pub enum Method<'a> {
    Estimator(&'a dyn FlowEstimator),
    /// Flow files of another program.
    Files(&'a FlowFiles),
}

impl<'a> Method<'a> {
    /// Name in tables.
    pub fn name(self) -> &'a str {
        match self {
            Self::Estimator(estimator) => estimator.name(),
            Self::Files(files) => files.name(),
        }
    }
}

/// Settings of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings<'a> {
    /// Size of the window around the head that estimators see and scores count; `None` for whole frames.
    pub crop: Option<Size>,
    /// Windows by the names of pairs, in place of `crop`; or why a pair has none, so that it cannot be scored.
    pub windows: Option<&'a BTreeMap<String, Result<Window, String>>>,
    /// Score only this many pairs, spread evenly over the dataset.
    pub limit: Option<usize>,
    /// What to do with a pair that cannot be scored.
    pub on_failure: OnFailure,
    /// Pairs of one size that a method estimates at once, where it can; `None` for one.
    pub batch: Option<NonZeroUsize>,
    /// Read the next pair while methods estimate, not only while they are scored: for methods that leave the CPU idle. The times of those that
    /// do not are then longer.
    pub read_ahead: bool,
    /// Also score the regions of [region maps](srflow_data::region_map), which all pairs must have.
    pub regions: bool,
    /// Also score the pixels whose true flow is shorter than this many pixels; of the head, where there are masks.
    pub small_motion: Option<f32>,
    /// Also score the motion of the [`Expression`].
    pub expression: bool,
    /// Also score the flow of the expression against the exact one, which all pairs must have: see [`ExpressionError`](crate::ExpressionError).
    pub expression_error: bool,
    /// Also keep the refinement iterations of each pair, for methods that have some.
    pub iterations: bool,
    /// The part of the pairs to score, of those that `limit` leaves.
    pub part: Shard,
    /// Scores of an earlier run by the names of pairs, which are not estimated again.
    pub kept: Option<&'a BTreeMap<String, Vec<KeptScores>>>,
}

/// What to do when a pair cannot be read, cropped or estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnFailure {
    /// End the run with an error that names the pair.
    #[default]
    Stop,
    /// Leave the pair out for every method, so that all rows are means over the same pairs, and list it in
    /// [`Evaluation::failures`].
    LeaveOut,
}

/// Progress of [`evaluate`].
#[derive(Debug)]
pub enum Event<'a> {
    /// The start, before the first pair.
    Started {
        /// Pairs to be scored.
        pairs: usize,
    },
    /// A method starts a pair, or a batch of pairs.
    Estimating {
        method: &'a str,
        /// Name of the first pair.
        pair: &'a str,
    },
    /// Every method has scored a pair.
    Scored(&'a ScoredPair<'a>),
    /// A pair was left out.
    LeftOut(&'a Failure),
    /// The scores of an earlier run were taken for a pair.
    Kept,
}

/// A scored pair with its inputs and results, for pictures.
#[derive(Debug)]
pub struct ScoredPair<'a> {
    /// Index among the pairs to be scored, from 0.
    pub index: usize,
    /// Name within its dataset.
    pub name: &'a str,
    /// Frames, mask and occlusion, cropped.
    pub sample: &'a Sample,
    /// The true flow, cropped.
    pub truth: &'a FlowField,
    /// The results of each method, in the order of [`Evaluation::methods`]: the baseline first.
    pub estimates: &'a [Estimate],
}

/// The result of one method on one pair.
#[derive(Debug)]
pub struct Estimate {
    pub method: String,
    /// Whether it is the baseline.
    pub baseline: bool,
    pub flow: FlowField,
    pub kept: KeptScores,
}

/// Errors that end an evaluation.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The split has frames but no ground truth.
    #[error(
        "{dataset}: none of its {pairs} pairs has a true flow to score against; choose a split whose truth is published, such as train"
    )]
    NoTruth {
        /// The dataset and its split.
        dataset: String,
        /// How many pairs it has.
        pairs: usize,
    },
    /// Regions are to be scored, and pairs have no region maps.
    #[error(
        "{dataset}: {lacking} of {pairs} pairs have no region map; `srflow render --regions` makes datasets with them"
    )]
    NoRegions {
        /// The dataset and its split.
        dataset: String,
        /// How many of the pairs to be scored have none.
        lacking: usize,
        /// How many pairs are to be scored.
        pairs: usize,
    },
    /// The flow of the expression is to be scored, and pairs do not have it.
    #[error(
        "{dataset}: {lacking} of {pairs} pairs have no true flow of the expression, which `expression_error` needs; `srflow render \
         --decompose` and `srflow mer synth` make datasets with it"
    )]
    NoExpressionFlow {
        /// The dataset and its split.
        dataset: String,
        /// How many of the pairs to be scored have none.
        lacking: usize,
        /// How many pairs are to be scored.
        pairs: usize,
    },
    /// A pair could not be scored.
    #[error("{pair}: {problem}")]
    Pair { pair: String, problem: PairProblem },
    /// Every pair failed.
    #[error("no pair of {dataset} could be scored; the first failure: {first}")]
    NothingScored {
        /// The dataset and its split.
        dataset: String,
        /// The first failure.
        first: String,
    },
}

/// Why a pair could not be scored.
#[derive(Debug, thiserror::Error)]
pub enum PairProblem {
    /// Its files could not be read.
    #[error(transparent)]
    Read(#[from] DatasetError),
    /// It has no ground truth.
    #[error("it has no true flow to score against")]
    NoTruth,
    #[error(transparent)]
    Crop(#[from] CropError),
    /// The windows that were given have none for it.
    #[error("{0}")]
    Window(String),
    /// A method failed.
    #[error("{method} gave no flow: {source}")]
    Estimate { method: String, source: EstimateError },
    /// A file with a method's flow could not be read.
    #[error("{method}: {source}")]
    File { method: String, source: FlowFileError },
    /// A method's flow could not be scored.
    #[error("the flow of {method} could not be scored: {source}")]
    Score { method: String, source: ScoreError },
}

/// Scores every method over the pairs of a dataset that have ground truth: per pair, then the mean over pairs, over all
/// pixels, inside the head's mask and outside occlusions where the dataset has them, and in the regions that `settings` name; the
/// mean of a region is over the pairs that show it. The [`Zero`] baseline always comes first.
///
/// Pairs, or batches of pairs of one size, run one after another, each method on the current rayon pool; a method's time is
/// that of estimation alone, divided evenly over the pairs of a batch. While one pair or batch is scored, the next is read: two are in memory
/// at a time, and without `read_ahead` nothing else runs during an estimation. A method that
/// [remembers](FlowEstimator::remembers) estimates the pairs one by one, and starts a new sequence when a pair does not begin
/// with the last frame of the previous pair, in the same scene.
///
/// # Errors
/// When no pair has ground truth, region maps are missing, or none could be scored; with [`OnFailure::Stop`], at the first pair that
/// fails.
pub fn evaluate(
    dataset: &FlowDataset,
    methods: &[Method<'_>],
    settings: Settings<'_>,
    on_event: &mut dyn FnMut(Event<'_>),
) -> Result<Evaluation, EvaluateError> {
    let title = dataset_title(dataset.name(), dataset.split());
    if dataset.entries().iter().all(|entry| entry.flow.is_none()) {
        return Err(EvaluateError::NoTruth { dataset: title, pairs: dataset.entries().len() });
    }
    let methods: Vec<Method> = std::iter::once(Method::Estimator(&Zero))
        .chain(methods.iter().copied().filter(|method| method.name() != Zero.name()))
        .collect();
    let mut chosen = chosen(dataset, settings.limit);
    let part = settings.part.range(chosen.len() as u64);
    chosen.truncate(part.end as usize);
    chosen.drain(..part.start as usize);
    let lacking = chosen.iter().filter(|entry| entry.regions.is_none()).count();
    if settings.regions && lacking > 0 {
        return Err(EvaluateError::NoRegions { dataset: title, lacking, pairs: chosen.len() });
    }
    let lacking = chosen.iter().filter(|entry| entry.expression_flow.is_none()).count();
    if settings.expression_error && lacking > 0 {
        return Err(EvaluateError::NoExpressionFlow { dataset: title, lacking, pairs: chosen.len() });
    }
    on_event(Event::Started { pairs: chosen.len() });

    let mut failures = Vec::new();
    // By the index of the pair, so that sums do not depend on which pairs were scored before.
    let mut results: BTreeMap<usize, Vec<KeptScores>> = BTreeMap::new();
    let index_of: BTreeMap<String, usize> = chosen.iter().map(|entry| entry.id()).zip(0..).collect();
    if let Some(kept) = settings.kept {
        for (name, scores) in kept {
            if let Some(&index) = index_of.get(name).filter(|_| scores.len() == methods.len()) {
                results.insert(index, scores.clone());
                on_event(Event::Kept);
            }
        }
    }
    chosen.retain(|entry| !results.contains_key(&index_of[&entry.id()]));
    let mut videos: Vec<Video> = methods.iter().map(|_| Video::default()).collect();
    let mut batches = Batches { dataset, settings, entries: chosen.into_iter(), next: None };
    let mut next = batches.next();
    while let Some(batch) = next.take() {
        let read = || next = batches.next();
        rayon::in_place_scope(|scope| {
            let (at_once, later) = if settings.read_ahead { (Some(read), None) } else { (None, Some(read)) };
            if let Some(mut read) = at_once {
                scope.spawn(move |_| read());
            }
            let estimated = estimate_batch(batch, &methods, &mut videos, on_event);
            if let Some(mut read) = later {
                scope.spawn(move |_| read());
            }
            for (name, outcome) in estimated {
                match outcome.and_then(|estimated| scored_pair(&name, &methods, estimated)) {
                    Ok((pair, estimates)) => {
                        let index = index_of[&name];
                        let pair = ScoredPair {
                            index,
                            name: &name,
                            sample: &pair.sample,
                            truth: &pair.truth,
                            estimates: &estimates,
                        };
                        on_event(Event::Scored(&pair));
                        results.insert(index, estimates.into_iter().map(|estimate| estimate.kept).collect());
                    }
                    Err(problem) if settings.on_failure == OnFailure::Stop => {
                        return Err(EvaluateError::Pair { pair: name, problem });
                    }
                    Err(problem) => {
                        let failure = Failure { pair: name, reason: problem.to_string() };
                        on_event(Event::LeftOut(&failure));
                        failures.push(failure);
                    }
                }
            }
            Ok(())
        })?;
    }
    match failures.first() {
        Some(first) if results.is_empty() => {
            let first = format!("{}: {}", first.pair, first.reason);
            Err(EvaluateError::NothingScored { dataset: title, first })
        }
        _ => Ok(Evaluation {
            pairs: results.len(),
            methods: (0..)
                .zip(&methods)
                .map(|(number, method)| {
                    let mut sums = MethodSums::new(method.name());
                    results.values().for_each(|scores: &Vec<KeptScores>| sums.add(&scores[number]));
                    sums.finish()
                })
                .collect(),
            dataset: dataset.name().to_owned(),
            split: dataset.split(),
            folder: dataset.dir().display().to_string(),
            crop: settings.crop.map(|Size { width, height }| [width, height]),
            at_faces: settings.windows.is_some(),
            limit: settings.limit,
            small_motion: settings.small_motion,
            failures,
            left_out: Vec::new(),
            improvements: Vec::new(),
        }),
    }
}

/// A pair's name and its outcome.
type Outcome<T> = (String, Result<T, PairProblem>);

/// Reads pairs, in batches of pairs of one size.
struct Batches<'a, E> {
    dataset: &'a FlowDataset,
    settings: Settings<'a>,
    entries: E,
    /// Of another size than the pairs before it.
    next: Option<Outcome<Pair>>,
}

impl<'a, E: Iterator<Item = &'a Entry>> Iterator for Batches<'a, E> {
    type Item = Vec<Outcome<Pair>>;

    fn next(&mut self) -> Option<Self::Item> {
        let most = self.settings.batch.map_or(1, NonZeroUsize::get);
        let mut batch: Vec<Outcome<Pair>> = self.next.take().into_iter().collect();
        while batch.len() < most
            && let Some(entry) = self.entries.next()
        {
            let read = (entry.id(), Pair::read(self.dataset, entry, self.settings));
            let size = |(_, pair): &Outcome<Pair>| pair.as_ref().ok().map(Pair::size);
            let sizes: Vec<_> = batch.iter().chain([&read]).filter_map(size).collect();
            if sizes.iter().all(|size| *size == sizes[0]) {
                batch.push(read);
            } else {
                self.next = Some(read);
                break;
            }
        }
        (!batch.is_empty()).then_some(batch)
    }
}

/// A sample, cropped, with its ground truth taken out.
struct Pair {
    sample: Sample,
    truth: FlowField,
    /// The pixels of each region, cropped.
    regions: Vec<(Region, Mask)>,
    /// Whether the motion of the expression is scored.
    expression: bool,
    /// What the flow of the expression is scored against, if it is scored.
    expression_truth: Option<ExpressionTruth>,
    /// Whether iterations are kept.
    iterations: bool,
    /// Of the frames before cropping.
    whole: Size,
    window: Option<Window>,
    scene: String,
    files: [EntryFile; 2],
}

impl Pair {
    fn read(dataset: &FlowDataset, entry: &Entry, settings: Settings<'_>) -> Result<Self, PairProblem> {
        let sample = dataset.read(entry)?;
        let whole = sample.frame1.size();
        let window = match (settings.windows, settings.crop) {
            (Some(windows), _) => {
                let missing = || Err("it has no window".to_owned());
                let window = windows.get(&entry.id()).cloned().unwrap_or_else(missing);
                Some(window.and_then(|window| window.inside(whole)).map_err(PairProblem::Window)?)
            }
            (None, Some(crop)) => Some(head_window(whole, crop, sample.mask.as_ref())?),
            (None, None) => None,
        };
        let mut sample = match window {
            Some(window) => cropped(&sample, window),
            None => sample,
        };
        let truth = sample.flow.take().ok_or(PairProblem::NoTruth)?;
        let mut regions = Vec::new();
        regions.extend(sample.mask.clone().map(|head| (Region::Head, head)));
        regions.extend(sample.occlusion.as_ref().map(|hidden| (Region::Visible, inverse(hidden))));
        let needs_map = settings.regions || settings.expression_error;
        let map = needs_map.then(|| entry.read_regions()).transpose()?.flatten();
        if let (true, Some(map)) = (settings.regions, &map) {
            // Divided before it is cropped, so that a crop does not move the rim.
            let in_window = |mask: Mask| match window {
                Some(Window { left, top, width, height }) => mask.crop(left, top, width, height),
                None => mask,
            };
            regions.extend(regions::of_map(map).into_iter().map(|(region, mask)| (region, in_window(mask))));
        }
        let expression_flow =
            settings.expression_error.then(|| entry.read_expression_flow()).transpose()?.flatten();
        let expression_truth = expression_flow.map(|expression| {
            let (expression, map) = match window {
                Some(Window { left, top, width, height }) => (
                    expression.crop(left, top, width, height),
                    map.map(|map| map.crop(left, top, width, height)),
                ),
                None => (expression, map),
            };
            let face = Face::new(map.as_ref(), sample.mask.as_ref(), truth.size());
            ExpressionTruth::new(&truth, expression, face)
        });
        if let Some(limit) = settings.small_motion {
            regions.push((Region::SmallMotion, regions::small_motion(&truth, sample.mask.as_ref(), limit)));
        }
        let files = [entry.frame1.clone(), entry.frame2.clone()];
        Ok(Self {
            sample,
            truth,
            regions,
            expression: settings.expression,
            expression_truth,
            iterations: settings.iterations,
            whole,
            window,
            scene: entry.scene.clone(),
            files,
        })
    }

    fn frames(&self) -> [&Image; 2] {
        [&self.sample.frame1, &self.sample.frame2]
    }

    fn size(&self) -> [Size; 2] {
        self.frames().map(Image::size)
    }
}

/// The sequence that a method which remembers is estimating.
#[derive(Default)]
struct Video<'a> {
    sequence: Option<Box<dyn FlowSequence + 'a>>,
    /// Scene and file of the last frame.
    last: Option<(String, EntryFile)>,
}

impl<'a> Video<'a> {
    /// The estimate of the next pair, and the seconds it took.
    fn timed(
        &mut self,
        estimator: &'a dyn FlowEstimator,
        pair: &Pair,
    ) -> Result<(FlowEstimate, f64), EstimateError> {
        let [first, second] = pair.files.clone();
        if self.last != Some((pair.scene.clone(), first)) {
            self.sequence = None;
        }
        let start = Instant::now();
        let mut sequence = self.sequence.take().unwrap_or_else(|| estimator.sequence(false));
        let estimate = sequence.push_pair(pair.frames())?;
        (self.sequence, self.last) = (Some(sequence), Some((pair.scene.clone(), second)));
        Ok((estimate, start.elapsed().as_secs_f64()))
    }
}

/// A pair with what the methods found for it, in their order.
struct Estimated {
    pair: Pair,
    /// With the seconds that each took.
    found: Vec<(FlowEstimate, Option<f64>)>,
    /// Why the method after those failed.
    failed: Option<PairProblem>,
    /// Whether the next method gets the pair.
    goes_on: bool,
}

/// Runs every method on pairs of one size. A pair that fails with one method, or whose flow of it cannot be scored, is not passed to the
/// next.
fn estimate_batch<'a>(
    batch: Vec<Outcome<Pair>>,
    methods: &[Method<'a>],
    videos: &mut [Video<'a>],
    on_event: &mut dyn FnMut(Event<'_>),
) -> Vec<Outcome<Estimated>> {
    let start = |pair| Estimated { pair, found: Vec::new(), failed: None, goes_on: true };
    let mut batch: Vec<Outcome<Estimated>> =
        batch.into_iter().map(|(name, pair)| (name, pair.map(start))).collect();
    for (source, video) in methods.iter().zip(videos) {
        let method = source.name();
        let pairs = || {
            let outcomes = batch.iter().filter_map(|(name, outcome)| Some((name, outcome.as_ref().ok()?)));
            outcomes
                .filter(|(_, estimated)| estimated.goes_on)
                .map(|(name, estimated)| (name, &estimated.pair))
        };
        let Some((pair, _)) = pairs().next() else { break };
        on_event(Event::Estimating { method, pair });
        let failed = |source| PairProblem::Estimate { method: method.to_owned(), source };
        let unread = |source| PairProblem::File { method: method.to_owned(), source };
        let found: Vec<Result<(FlowEstimate, Option<f64>), PairProblem>> = match source {
            Method::Estimator(estimator) if estimator.remembers() => {
                let timed = pairs().map(|(_, pair)| video.timed(*estimator, pair));
                timed
                    .map(|found| found.map(|(found, seconds)| (found, Some(seconds))).map_err(failed))
                    .collect()
            }
            Method::Estimator(estimator) => {
                let frames: Vec<[&Image; 2]> = pairs().map(|(_, pair)| pair.frames()).collect();
                let timed = timed(*estimator, &frames).into_iter();
                timed
                    .map(|found| found.map(|(found, seconds)| (found, Some(seconds))).map_err(failed))
                    .collect()
            }
            Method::Files(files) => {
                let read = |(name, pair): (&String, &Pair)| files.read(name, pair.whole, pair.window);
                pairs().map(|pair| read(pair).map(|flow| (flow.into(), None)).map_err(unread)).collect()
            }
        };
        let passed = batch.iter_mut().filter_map(|(_, outcome)| outcome.as_mut().ok());
        for (estimated, found) in passed.filter(|estimated| estimated.goes_on).zip(found) {
            match found {
                Ok((estimate, seconds)) => {
                    // Flow that was estimated can be scored.
                    estimated.goes_on = matches!(source, Method::Estimator(_))
                        || score(&estimate.flow, &estimated.pair.truth, None).is_ok();
                    estimated.found.push((estimate, seconds));
                }
                Err(problem) => {
                    (estimated.failed, estimated.goes_on) = (Some(problem), false);
                }
            }
        }
    }
    batch
}

/// The scores of every method on a pair.
fn scored_pair(
    name: &str,
    methods: &[Method<'_>],
    Estimated { pair, found, failed, .. }: Estimated,
) -> Result<(Pair, Vec<Estimate>), PairProblem> {
    let found: Vec<_> = methods.iter().map(|method| method.name()).zip(found).collect();
    let scored =
        found.into_par_iter().map(|(method, (found, seconds))| scored(name, method, &pair, found, seconds));
    // Collected first, so that of several problems the first is reported.
    let scored: Vec<Result<Estimate, PairProblem>> = scored.collect();
    let estimates = scored.into_iter().collect::<Result<_, _>>()?;
    failed.map_or(Ok((pair, estimates)), Err)
}

/// The estimate of each pair and the seconds it took. When a batch fails, its pairs are estimated one by one, so that only
/// those at fault fail.
fn timed(
    estimator: &dyn FlowEstimator,
    pairs: &[[&Image; 2]],
) -> Vec<Result<(FlowEstimate, f64), EstimateError>> {
    let start = Instant::now();
    match estimator.estimate_pairs(pairs) {
        Ok(estimates) => {
            let seconds = start.elapsed().as_secs_f64() / pairs.len() as f64;
            estimates.into_iter().map(|estimate| Ok((estimate, seconds))).collect()
        }
        Err(problem) if pairs.len() == 1 => vec![Err(problem)],
        Err(_) => pairs.chunks(1).flat_map(|pair| timed(estimator, pair)).collect(),
    }
}

fn scored(
    name: &str,
    method: &str,
    pair: &Pair,
    FlowEstimate { flow, iterations, .. }: FlowEstimate,
    seconds: Option<f64>,
) -> Result<Estimate, PairProblem> {
    let scores = scores_of(name, seconds, &flow, pair)
        .map_err(|source| PairProblem::Score { method: method.to_owned(), source })?;
    let scores = PairScores { iterations: iterations.filter(|_| pair.iterations), ..scores };
    let kept = KeptScores { scores, within: shares_within(&flow, &pair.truth) };
    Ok(Estimate { method: method.to_owned(), baseline: method == Zero.name(), flow, kept })
}

/// The scores of one flow in every region of the pair.
fn scores_of(
    name: &str,
    seconds: Option<f64>,
    flow: &FlowField,
    pair: &Pair,
) -> Result<PairScores, ScoreError> {
    let mut found = BTreeMap::new();
    for (region, mask) in &pair.regions {
        found.extend(score(flow, &pair.truth, Some(mask))?.map(|metrics| (*region, metrics)));
    }
    Ok(PairScores {
        pair: name.to_owned(),
        seconds,
        iterations: None,
        whole: score(flow, &pair.truth, None)?,
        head: found.remove(&Region::Head),
        visible: found.remove(&Region::Visible),
        regions: found,
        expression: match pair.expression {
            true => Expression::of(flow, &pair.truth, pair.sample.mask.as_ref()),
            false => None,
        },
        expression_error: pair.expression_truth.as_ref().and_then(|truth| truth.error(flow, &pair.truth)),
    })
}

/// Names of the pairs that are scored with this `limit`, in their order.
pub fn scored_pairs(dataset: &FlowDataset, limit: Option<usize>) -> Vec<String> {
    chosen(dataset, limit).into_iter().map(Entry::id).collect()
}

/// The pairs that are scored: `limit` of them, spread evenly over the dataset, or all.
pub(crate) fn chosen(dataset: &FlowDataset, limit: Option<usize>) -> Vec<&Entry> {
    let entries = dataset.entries();
    spread(entries.len(), limit).into_iter().map(|index| &entries[index]).collect()
}

/// `limit` indices spread evenly over `0..count`, or all of them when `limit` is not below `count`.
pub fn spread(count: usize, limit: Option<usize>) -> Vec<usize> {
    let wanted = limit.unwrap_or(count).min(count);
    (0..wanted).map(|i| i * count / wanted).collect()
}

fn cropped(sample: &Sample, window: Window) -> Sample {
    let Window { left, top, width, height } = window;
    Sample {
        frame1: sample.frame1.crop(left, top, width, height),
        frame2: sample.frame2.crop(left, top, width, height),
        flow: sample.flow.as_ref().map(|flow| flow.crop(left, top, width, height)),
        mask: sample.mask.as_ref().map(|mask| mask.crop(left, top, width, height)),
        occlusion: sample.occlusion.as_ref().map(|mask| mask.crop(left, top, width, height)),
    }
}

fn inverse(mask: &Mask) -> Mask {
    Mask::from_fn(mask.width(), mask.height(), |x, y| !mask.get(x, y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_spreads_over_the_dataset() {
        assert_eq!(spread(10, Some(4)), [0, 2, 5, 7]);
        assert_eq!(spread(3, Some(9)), [0, 1, 2]);
        assert_eq!(spread(3, None), [0, 1, 2]);
        assert_eq!(spread(0, Some(2)), [0; 0]);
        assert_eq!(spread(5, Some(0)), [0; 0]);
    }
}

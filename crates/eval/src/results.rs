//! The results of an evaluation, and their tables.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use srflow_core::{Metrics, named};
use srflow_data::flow::Split;
use srflow_report::{Better, Column, Row, Table, csv_text};

use crate::expression::Expression;
use crate::expression_error::ExpressionError;

/// The scores of every method over one dataset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// The kind of dataset with its options, e.g. `sintel-clean`.
    pub dataset: String,
    /// The split.
    pub split: Split,
    pub folder: String,
    /// Width and height of the window around the head; `None` for whole frames.
    pub crop: Option<[usize; 2]>,
    /// Whether each pair was scored in a window of its own about the face; of the size `crop`, if it is given.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub at_faces: bool,
    /// The limit on the number of pairs; `None` for all.
    pub limit: Option<usize>,
    /// The length of true flow, pixels, that [`Region::SmallMotion`] stays below; `None` when it is not scored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub small_motion: Option<f32>,
    /// The number of pairs in the mean of every row.
    pub pairs: usize,
    /// The methods, baseline first.
    pub methods: Vec<MethodScores>,
    /// Pairs left out for every method.
    pub failures: Vec<Failure>,
    /// Rows that were asked for and are not there, and why.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
    /// Names of methods, and of those that each is held against in the table of improvements.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub improvements: Vec<(String, String)>,
}

/// One method over all pairs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MethodScores {
    /// The method's name.
    pub name: String,
    /// Whether it is a baseline, which is not ranked.
    pub baseline: bool,
    /// Mean over pairs of the scores over all pixels with ground truth.
    pub whole: Option<Metrics>,
    /// The same inside the head's mask; `None` when the dataset has none.
    pub head: Option<Metrics>,
    /// The same over pixels that are not occluded; `None` when the dataset has no occlusions.
    pub visible: Option<Metrics>,
    /// The same in each of the regions that were asked for; the mean is over the pairs that show the region.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub regions: BTreeMap<Region, Metrics>,
    /// The same of the motion of the expression, if it was asked for; the mean is over the pairs that show one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression: Option<Expression>,
    /// Errors of the flow of the expression, if they were asked for; the mean is over the pairs that show a face.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression_error: Option<ExpressionError>,
    /// Mean over pairs of the refinement iterations, if they were asked for and the method has some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iterations: Option<f64>,
    /// Mean over pairs of the share of pixels whose end-point error is at most 0.05, 0.10, ... 5 px.
    pub within: Vec<f64>,
    pub pairs: Vec<PairScores>,
}

/// One method on one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairScores {
    /// The pair's name within its dataset.
    pub pair: String,
    /// Wall-clock seconds of the estimation alone; `None` for flow files.
    pub seconds: Option<f64>,
    /// Refinement iterations, if they were asked for and the method has some; the mean over tiles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iterations: Option<f32>,
    /// Over all pixels with ground truth.
    pub whole: Option<Metrics>,
    /// Inside the head's mask.
    pub head: Option<Metrics>,
    /// Over pixels that are not occluded.
    pub visible: Option<Metrics>,
    /// In each of the regions that were asked for and that the pair shows.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub regions: BTreeMap<Region, Metrics>,
    /// Of the motion of the expression, if it was asked for and the pair shows one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression: Option<Expression>,
    /// Errors of the flow of the expression, if they were asked for and the pair shows a face.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression_error: Option<ExpressionError>,
}

/// A pair left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    pub pair: String,
    /// The error.
    pub reason: String,
}

/// The pixels that a score covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// All with ground truth.
    Whole,
    /// Those inside the head's mask.
    Head,
    /// Those that are not occluded.
    Visible,
    /// Those of a part of the head, by region map, that are not in the rim.
    Skin,
    Eyes,
    Mouth,
    Hair,
    Neck,
    /// Those of the head, by region map, at most 3 px away from the background.
    Rim,
    /// Those that do not show the head, by region map.
    Background,
    /// Those whose true flow is short; of the head, where there are masks.
    SmallMotion,
}

named!(Region, "a region", {
    Whole => "whole",
    Head => "head",
    Visible => "visible",
    Skin => "skin",
    Eyes => "eyes",
    Mouth => "mouth",
    Hair => "hair",
    Neck => "neck",
    Rim => "rim",
    Background => "background",
    SmallMotion => "small_motion",
});

impl Region {
    /// The regions that a region map divides a frame into.
    pub const OF_MAPS: [Self; 7] =
        [Self::Skin, Self::Eyes, Self::Mouth, Self::Hair, Self::Neck, Self::Rim, Self::Background];

    /// Name in table titles.
    pub fn words(self) -> &'static str {
        match self {
            Region::Whole => "all pixels",
            Region::Head => "inside the head mask",
            Region::Visible => "outside occlusions",
            Region::SmallMotion => "small motion",
            Region::Rim => "rim of the head",
            part => part.name(),
        }
    }
}

/// Key, header, direction and value of a score.
pub type ScoreColumn = (&'static str, &'static str, Better, fn(&Metrics) -> f64);

/// The scores of the paper's Table II, in its order.
pub const SCORES: [ScoreColumn; 6] = [
    ("epe", "EPE", Better::Lower, |metrics| metrics.epe),
    ("px1", "px1", Better::Higher, |metrics| metrics.px1),
    ("px3", "px3", Better::Higher, |metrics| metrics.px3),
    ("px5", "px5", Better::Higher, |metrics| metrics.px5),
    ("f1_all", "F1-ALL", Better::Lower, |metrics| metrics.f1_all),
    ("wauc", "WAUC", Better::Higher, |metrics| metrics.wauc),
];

/// The columns of [`SCORES`].
pub fn score_columns() -> Vec<Column> {
    SCORES.map(|(key, header, better, _)| Column::ranked(key, header, better)).to_vec()
}

/// The columns of [`SCORES`] in a table of [`improvement_percent`].
pub fn improvement_columns() -> Vec<Column> {
    let column = |(key, header, ..): ScoreColumn| {
        Column::plain(&format!("{key}_improvement_percent"), &format!("{header} %"), 2)
    };
    SCORES.map(column).to_vec()
}

/// By how many percent of `other` the score `own` is better; `None` where that is no number.
pub fn improvement_percent(better: Better, own: f64, other: f64) -> Option<f64> {
    let change = match better {
        Better::Lower => other - own,
        Better::Higher => own - other,
    };
    Some(100.0 * change / other).filter(|percent| percent.is_finite())
}

impl Evaluation {
    /// The paper's Table II for one region, with the median seconds per pair appended, and the mean iterations where there are some;
    /// `None` when the dataset has no such region.
    pub fn table(&self, region: Region) -> Option<Table> {
        self.methods.iter().find_map(|method| method.region(region))?;
        let iterations = self.counts_iterations().then(|| Column::plain("iterations", "iterations", 1));
        let columns = [Column::plain("seconds", "s/pair", 3)].into_iter().chain(iterations.clone());
        let row = |method: &MethodScores| {
            let metrics = method.region(region);
            let scores = SCORES.iter().map(|(.., value)| metrics.map(value));
            Row {
                name: method.name.clone(),
                values: scores
                    .chain(std::iter::once(method.median_seconds().filter(|_| !method.baseline)))
                    .chain(iterations.as_ref().map(|_| method.iterations))
                    .collect(),
                baseline: method.baseline,
            }
        };
        let crop = self.crop_in_words();
        let limit = self.small_motion.filter(|_| region == Region::SmallMotion);
        let limit = limit.map_or(String::new(), |limit| format!(" (true flow under {limit} px)"));
        Some(Table {
            title: format!("{}, {}{crop}, {}{limit}", self.title(), self.pairs_in_words(), region.words()),
            columns: score_columns().into_iter().chain(columns).collect(),
            rows: self.methods.iter().map(row).collect(),
            notes: self.notes(),
            ..Table::default()
        })
    }

    /// What a reader of any table must know: the rows that are not there, and the methods that found nothing.
    fn notes(&self) -> Vec<String> {
        let baseline = self.methods.iter().find(|method| method.baseline);
        let useless = |method: &&MethodScores| {
            !method.baseline && baseline.is_some_and(|baseline| method.is_worse_on_every_pair(baseline))
        };
        let note = |method: &MethodScores| {
            format!(
                "{}: worse than zero flow on every pair. Check that its weights and settings suit these frames.",
                method.name
            )
        };
        self.left_out.iter().cloned().chain(self.methods.iter().filter(useless).map(note)).collect()
    }

    /// Whether iterations were asked for and a method has some.
    fn counts_iterations(&self) -> bool {
        self.methods.iter().any(|method| method.iterations.is_some())
    }

    /// See [`dataset_title`].
    pub fn title(&self) -> String {
        dataset_title(&self.dataset, self.split)
    }

    /// `1 pair`, `12 pairs`.
    pub fn pairs_in_words(&self) -> String {
        format!("{} pair{}", self.pairs, if self.pairs == 1 { "" } else { "s" })
    }

    fn crop_in_words(&self) -> String {
        match (self.crop, self.at_faces) {
            (Some([width, height]), false) => format!(", cropped to {width}x{height}"),
            (Some([width, height]), true) => format!(", cropped to {width}x{height} about the face"),
            (None, true) => ", cropped to the face".to_owned(),
            (None, false) => String::new(),
        }
    }

    /// The EPE of each method in the regions that were asked for, and its ratio to the EPE of zero flow, which is the mean length of
    /// the true flow; empty when no region was asked for.
    pub fn by_region(&self) -> Vec<Table> {
        let shown = |region: &Region| self.methods.iter().any(|method| method.regions.contains_key(region));
        let regions: Vec<Region> = Region::ALL.into_iter().filter(shown).collect();
        let epe = |method: &MethodScores, region: Region| Some(method.regions.get(&region)?.epe);
        let length = |region: Region| epe(self.methods.iter().find(|method| method.baseline)?, region);
        let relative = |method: &MethodScores, region: Region| {
            Some(epe(method, region)? / length(region)?).filter(|ratio| ratio.is_finite())
        };
        let table = |what: &str, value: &dyn Fn(&MethodScores, Region) -> Option<f64>| {
            let column = |region: &Region| Column::ranked(region.name(), region.words(), Better::Lower);
            let row = |method: &MethodScores| Row {
                name: method.name.clone(),
                values: regions.iter().map(|region| value(method, *region)).collect(),
                baseline: method.baseline,
            };
            let crop = self.crop_in_words();
            Table {
                title: format!("{}, {}{crop}, {what}", self.title(), self.pairs_in_words()),
                columns: regions.iter().map(column).collect(),
                rows: self.methods.iter().map(row).collect(),
                notes: self.notes(),
                ..Table::default()
            }
        };
        match regions.is_empty() {
            true => Vec::new(),
            false => vec![
                table("EPE by region", &epe),
                table("EPE by region, relative to the mean length of the true flow", &relative),
            ],
        }
    }

    /// How well each method shows the motion of expressions; `None` when it was not asked for.
    pub fn expression(&self) -> Option<Table> {
        let rms = self.methods.iter().find_map(|method| method.expression)?.true_rms;
        let row = |method: &MethodScores| Row {
            name: method.name.clone(),
            values: [
                method.expression.map(|found| found.correlation).filter(|_| !method.baseline),
                method.expression.map(|found| found.strength).filter(|_| !method.baseline),
            ]
            .into(),
            baseline: method.baseline,
        };
        let crop = self.crop_in_words();
        Some(Table {
            title: format!(
                "{}, {}{crop}, motion of the expression ({rms:.3} px root mean square)",
                self.title(),
                self.pairs_in_words()
            ),
            columns: vec![
                Column::ranked("correlation", "correlation", Better::Higher),
                Column::plain("strength", "strength", 4),
            ],
            rows: self.methods.iter().map(row).collect(),
            notes: self.notes(),
            ..Table::default()
        })
    }

    /// How exact the flow of the expression is that each method gives; `None` when it was not asked for.
    pub fn expression_error(&self) -> Option<Table> {
        let floor = self.methods.iter().find_map(|method| method.expression_error)?.floor_epe;
        let row = |method: &MethodScores| {
            let found = method.expression_error;
            Row {
                name: method.name.clone(),
                values: vec![
                    found.map(|found| found.flow_epe),
                    found.map(|found| found.expression_epe),
                    found.and_then(|found| found.ratio).filter(|_| !method.baseline),
                ],
                baseline: method.baseline,
            }
        };
        let crop = self.crop_in_words();
        Some(Table {
            title: format!(
                "{}, {}{crop}, flow of the expression in the face ({floor:.3} px for the true flow)",
                self.title(),
                self.pairs_in_words()
            ),
            columns: vec![
                Column::ranked("flow_epe", "EPE flow", Better::Lower),
                Column::ranked("expression_epe", "EPE expression", Better::Lower),
                Column::plain("ratio", "ratio", 3),
            ],
            rows: self.methods.iter().map(row).collect(),
            notes: self.notes(),
            ..Table::default()
        })
    }

    /// By how many percent of the other's score each score is better than that of another method (the paper's Table III);
    /// `None` when nothing is held against another.
    pub fn improvement(&self) -> Option<Table> {
        let of = |name: &str| self.methods.iter().find(|method| method.name == name)?.whole.as_ref();
        let row = |(name, other): &(String, String)| {
            let (own, other) = (of(name)?, of(other)?);
            let value =
                |(.., better, value): &ScoreColumn| improvement_percent(*better, value(own), value(other));
            Some(Row { name: name.clone(), values: SCORES.iter().map(value).collect(), baseline: false })
        };
        let rows: Vec<Row> = self.improvements.iter().filter_map(row).collect();
        let against: Vec<String> =
            self.improvements.iter().map(|(name, other)| format!("{name} against {other}")).collect();
        (!rows.is_empty()).then(|| Table {
            title: format!("{}: improvement in percent", self.title()),
            columns: improvement_columns(),
            rows,
            notes: vec![against.join(", ")],
            ..Table::default()
        })
    }

    /// The tables of all regions that were scored, those that compare regions, those of expressions and that of improvements.
    pub fn tables(&self) -> Vec<Table> {
        let regions = Region::ALL.into_iter().filter_map(|region| self.table(region));
        let expressions = self.expression().into_iter().chain(self.expression_error());
        regions.chain(self.by_region()).chain(expressions).chain(self.improvement()).collect()
    }

    /// Comma-separated values at full precision: one line per method and region, the mean over pairs.
    pub fn csv(&self) -> String {
        let counts = self.counts_iterations();
        let mut lines = vec![score_head(
            ["median_seconds", "pairs"].into_iter().chain(counts.then_some("mean_iterations")),
        )];
        for method in &self.methods {
            for region in Region::ALL {
                let Some(metrics) = method.region(region) else { continue };
                let seconds = shown(method.median_seconds());
                let mut line = score_fields(&method.name, region, metrics);
                line.extend([seconds, self.pairs.to_string()]);
                line.extend(counts.then(|| shown(method.iterations)));
                lines.push(line);
            }
        }
        csv_text(lines.into_iter())
    }

    /// Comma-separated values at full precision: one line per method, region and pair.
    pub fn pairs_csv(&self) -> String {
        let counts = self.counts_iterations();
        let mut lines =
            vec![score_head(["seconds", "pair"].into_iter().chain(counts.then_some("iterations")))];
        for method in &self.methods {
            for pair in &method.pairs {
                for region in Region::ALL {
                    let Some(metrics) = pair.region(region) else { continue };
                    let mut line = score_fields(&method.name, region, metrics);
                    line.extend([shown(pair.seconds), pair.pair.clone()]);
                    line.extend(counts.then(|| shown(pair.iterations)));
                    lines.push(line);
                }
            }
        }
        csv_text(lines.into_iter())
    }
}

/// Where nothing moves, every method is worse than zero flow, and may still be a good one.
const NOTICEABLE_PX: f64 = 0.1;

impl MethodScores {
    /// Whether the error of each pair is noticeable and above that of `other`, which has the same pairs.
    fn is_worse_on_every_pair(&self, other: &Self) -> bool {
        let errors =
            |scores: &Self| scores.pairs.iter().filter_map(|pair| Some(pair.whole.as_ref()?.epe)).collect();
        let [own, other]: [Vec<f64>; 2] = [self, other].map(errors);
        !own.is_empty() && own.iter().zip(&other).all(|(own, other)| *own > other.max(NOTICEABLE_PX))
    }

    /// The mean over pairs in one region.
    pub fn region(&self, region: Region) -> Option<&Metrics> {
        match region {
            Region::Whole => self.whole.as_ref(),
            Region::Head => self.head.as_ref(),
            Region::Visible => self.visible.as_ref(),
            other => self.regions.get(&other),
        }
    }

    /// Median over pairs of the seconds of the estimation; `None` when none was timed.
    pub fn median_seconds(&self) -> Option<f64> {
        let mut seconds: Vec<f64> = self.pairs.iter().filter_map(|pair| pair.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        let upper = *seconds.get(seconds.len() / 2)?;
        let lower = seconds[(seconds.len() - 1) / 2];
        Some((lower + upper) / 2.0)
    }
}

impl PairScores {
    /// The scores in one region.
    pub fn region(&self, region: Region) -> Option<&Metrics> {
        match region {
            Region::Whole => self.whole.as_ref(),
            Region::Head => self.head.as_ref(),
            Region::Visible => self.visible.as_ref(),
            other => self.regions.get(&other),
        }
    }
}

/// A kind of dataset and its split, e.g. `sintel-clean, train split`.
pub fn dataset_title(dataset: &str, split: Split) -> String {
    match split {
        Split::All => dataset.to_owned(),
        split => format!("{dataset}, {split} split"),
    }
}

/// A field; empty without a number.
fn shown(number: Option<impl ToString>) -> String {
    number.map_or(String::new(), |number| number.to_string())
}

/// Names of the fields of [`score_fields`], and of others.
fn score_head(more: impl Iterator<Item = &'static str>) -> Vec<String> {
    let scores = SCORES.iter().map(|(key, ..)| *key);
    let names = ["method", "region"].into_iter().chain(scores).chain(["valid_pixels"]).chain(more);
    names.map(str::to_owned).collect()
}

fn score_fields(method: &str, region: Region, metrics: &Metrics) -> Vec<String> {
    let names = [method.to_owned(), region.name().to_owned()];
    let scores = SCORES.iter().map(|(.., value)| value(metrics).to_string());
    names.into_iter().chain(scores).chain(std::iter::once(metrics.valid_pixels.to_string())).collect()
}

//! From frames and flows to the panels and legends of a figure.

use crate::{ColorMap, color_scale, color_wheel, error_map, flow_picture, flow_scale, middle_scale};
use srflow_core::{FlowField, Image, Plane, Size, score};

use super::columns::{Content, Source};
use super::grid::{Arrow, Figure, Legend, Panel, Row};
use super::scale::{Ends, Scale, Scales};

/// One pair of frames with its flows, all of one size.
#[derive(Debug, Clone)]
pub struct Pair {
    pub name: String,
    pub frames: [Image; 2],
    /// From frame 1 to frame 2.
    pub truth: Option<FlowField>,
    /// The flow of each method of the figure that a column shows.
    pub flows: Vec<Option<FlowField>>,
}

/// What a figure shows of its pairs, and how.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Names of the methods.
    pub methods: Vec<String>,
    /// The panels of each column, from top to bottom: see [`resolve`](super::resolve).
    pub columns: Vec<Vec<Content>>,
    /// At most so many columns are beside each other; the others continue in a further row.
    pub most_columns: usize,
    pub scales: Scales,
    /// Computes the optical strain of a flow, in its size.
    pub strain: fn(&FlowField) -> Plane,
    /// Draw an arrow over each so many pixels of a flow.
    pub arrows: Option<usize>,
    /// Write the end-point error of each method below its panels.
    pub scores: bool,
    /// Begin captions with (a), (b), ...
    pub letters: bool,
    /// Titles of the columns in place of the usual ones.
    pub titles: Option<Vec<String>>,
    /// Labels of the pairs in place of their names.
    pub labels: Option<Vec<String>>,
    /// Captions of the panels in place of the scores, from left to right and from top to bottom.
    pub captions: Option<Vec<String>>,
}

/// Why pairs do not make the figure of a plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ComposeError {
    #[error(
        "{pair} has no true flow, which columns of the figure need: leave out `truth`, `error` and `strain:truth`"
    )]
    NoTruth { pair: String },
    #[error("{pair}: the figure shows the flow of {method}, and it is missing")]
    NoFlow { pair: String, method: String },
    #[error("{pair}: {what} is {found}, expected {frame} (WIDTHxHEIGHT) as frame 1 is")]
    Size { pair: String, what: String, found: Size, frame: Size },
    #[error("`{what}`: expected {expected}, one for each {of}, found {found}")]
    Count { what: &'static str, of: &'static str, expected: usize, found: usize },
}

/// A figure and the numbers behind it.
#[derive(Debug, Clone)]
pub struct Composed {
    pub figure: Figure,
    /// Ends of the scales of each pair.
    pub ends: Vec<Ends>,
    /// Mean end-point error in pixels of each method on each pair; `None` without truth, or where the method's flow is unknown
    /// although the truth is known.
    pub epe: Vec<Vec<Option<f64>>>,
}

/// Share of the pixels within the scale of errors and of strain. Of strain it is smaller: at the outline of a moving head, over a
/// still background, strain is hundreds of times that of skin.
const ERRORS_WITHIN: f64 = 0.98;
const STRAIN_WITHIN: f64 = 0.95;
/// Smallest ends of scales: below, colours would show noise.
const LEAST_FLOW: f64 = 0.1;
const LEAST_ERROR: f64 = 0.1;
const LEAST_STRAIN: f64 = 0.001;

/// The colours of strain, which differ from those of errors.
const STRAIN_COLORS: ColorMap = ColorMap::Viridis;
const ERROR_COLORS: ColorMap = ColorMap::Inferno;

/// What is computed of a pair.
struct Maps {
    /// By method.
    errors: Vec<Option<Plane>>,
    strain: Vec<Option<Plane>>,
    true_strain: Option<Plane>,
}

impl Plan {
    fn contents(&self) -> impl Iterator<Item = Content> {
        self.columns.iter().flatten().copied()
    }

    /// Whether a column takes the flow of a method.
    pub fn shows_method(&self, method: usize) -> bool {
        self.contents().any(|content| content.method() == Some(method))
    }

    /// Whether a column takes the true flow.
    pub fn needs_truth(&self) -> bool {
        self.contents().any(Content::needs_truth)
    }

    /// Checks the numbers of titles, labels and captions for so many pairs.
    ///
    /// # Errors
    /// When one is not that of columns, pairs or panels.
    pub fn check_counts(&self, pairs: usize) -> Result<(), ComposeError> {
        let panels = pairs * self.contents().count();
        for (what, of, given, expected) in [
            ("titles", "column", &self.titles, self.columns.len()),
            ("labels", "pair", &self.labels, pairs),
            ("captions", "panel", &self.captions, panels),
        ] {
            match given.as_ref().map(Vec::len) {
                Some(found) if found != expected => {
                    return Err(ComposeError::Count { what, of, expected, found });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// The texts that the figure of pairs with these names may show and that are not its own.
    pub fn texts<'a>(&'a self, pairs: &'a [String]) -> Vec<&'a str> {
        let given = [&self.titles, &self.captions].into_iter().flatten().flatten();
        let names = if self.titles.is_none() { self.methods.as_slice() } else { &[] };
        let labels = self.labels.as_deref().unwrap_or(if pairs.len() > 1 { pairs } else { &[] });
        given.chain(names).chain(labels).map(String::as_str).collect()
    }

    /// The figure of these pairs.
    ///
    /// # Errors
    /// When a pair lacks a flow that a column shows, its parts differ in size, or there are not as many titles, labels or captions
    /// as needed.
    pub fn compose(&self, pairs: &[Pair]) -> Result<Composed, ComposeError> {
        self.check_counts(pairs.len())?;
        for pair in pairs {
            self.check(pair)?;
        }
        let maps: Vec<Maps> = pairs.iter().map(|pair| self.maps(pair)).collect();
        let suitable: Vec<Ends> =
            pairs.iter().zip(&maps).map(|(pair, maps)| self.suitable_ends(pair, maps)).collect();
        let ends = self.scales.ends(&suitable);
        let epe: Vec<Vec<Option<f64>>> = pairs.iter().map(epe).collect();
        let mut rows = Vec::new();
        for (number, pair) in pairs.iter().enumerate() {
            let of_pair =
                OfPair { plan: self, pair, maps: &maps[number], ends: ends[number], epe: &epe[number] };
            let before = rows.len();
            rows.extend(self.rows(number, pairs.len(), &of_pair));
            if let Some(last) = rows[before..].last_mut() {
                last.legends =
                    self.legends(&pairs[number..=number], &maps[number..=number], &ends[number], true);
            }
        }
        let legends = ends.first().map_or(Vec::new(), |ends| self.legends(pairs, &maps, ends, false));
        let mut figure = Figure { rows, legends };
        self.caption(&mut figure);
        Ok(Composed { figure, ends, epe })
    }

    fn check(&self, pair: &Pair) -> Result<(), ComposeError> {
        let frame = pair.frames[0].size();
        if self.needs_truth() && pair.truth.is_none() {
            return Err(ComposeError::NoTruth { pair: pair.name.clone() });
        }
        let mut sizes = vec![("frame 2".to_owned(), pair.frames[1].size())];
        sizes.extend(pair.truth.as_ref().map(|truth| ("the true flow".to_owned(), truth.size())));
        for (number, method) in self.methods.iter().enumerate() {
            match pair.flows.get(number).and_then(Option::as_ref) {
                Some(flow) => sizes.push((format!("the flow of {method}"), flow.size())),
                None if self.shows_method(number) => {
                    return Err(ComposeError::NoFlow { pair: pair.name.clone(), method: method.clone() });
                }
                None => {}
            }
        }
        match sizes.into_iter().find(|(_, size)| *size != frame) {
            Some((what, found)) => Err(ComposeError::Size { pair: pair.name.clone(), what, found, frame }),
            None => Ok(()),
        }
    }

    fn maps(&self, pair: &Pair) -> Maps {
        let shown = |content: Content| self.contents().any(|other| other == content);
        let of_methods = |content: fn(usize) -> Content, map: &dyn Fn(&FlowField) -> Option<Plane>| {
            let map = |(method, flow): (usize, &Option<FlowField>)| {
                flow.as_ref().filter(|_| shown(content(method))).and_then(map)
            };
            pair.flows.iter().enumerate().map(map).collect()
        };
        let truth = pair.truth.as_ref();
        Maps {
            errors: of_methods(Content::Error, &|flow| truth.map(|truth| error_map(flow, truth))),
            strain: of_methods(|method| Content::Strain(Source::Method(method)), &|flow| {
                Some((self.strain)(flow))
            }),
            true_strain: truth.filter(|_| shown(Content::Strain(Source::Truth))).map(self.strain),
        }
    }

    /// Ends that suit the values of one pair: those of the truth where it is known, and robust to one method that is far off.
    fn suitable_ends(&self, pair: &Pair, maps: &Maps) -> Ends {
        let lengths = pair.flows.iter().flatten().flat_map(|flow| flow.pixels()).map(|[u, v]| u.hypot(*v));
        let errors: Vec<&Plane> = maps.errors.iter().flatten().collect();
        let strain: Vec<&Plane> = match &maps.true_strain {
            Some(strain) => vec![strain],
            None => maps.strain.iter().flatten().collect(),
        };
        Ends {
            flow: pair.truth.as_ref().map_or_else(|| color_scale(lengths, LEAST_FLOW), flow_scale),
            error: middle_scale(&errors, ERRORS_WITHIN, LEAST_ERROR),
            strain: middle_scale(&strain, STRAIN_WITHIN, LEAST_STRAIN),
        }
    }

    /// The rows of a pair.
    fn rows(&self, number: usize, pairs: usize, of_pair: &OfPair) -> Vec<Row> {
        let most = self.most_columns.max(1);
        let wrapped = self.columns.len() > most;
        let titles: Vec<String> = match &self.titles {
            Some(titles) => titles.clone(),
            None => self.columns.iter().map(|column| self.title(column)).collect(),
        };
        let label = match &self.labels {
            Some(labels) => labels.get(number).cloned().unwrap_or_default(),
            None if pairs > 1 => of_pair.pair.name.clone(),
            None => String::new(),
        };
        let chunks = self.columns.chunks(most).zip(titles.chunks(most)).enumerate();
        let row = |(chunk, (columns, titles)): (usize, (&[Vec<Content>], &[String]))| Row {
            titles: if wrapped || number == 0 { titles.to_vec() } else { Vec::new() },
            label: if chunk == 0 { label.clone() } else { String::new() },
            cells: columns
                .iter()
                .map(|column| column.iter().map(|content| of_pair.panel(*content)).collect())
                .collect(),
            legends: Vec::new(),
        };
        chunks.map(row).collect()
    }

    /// The usual title of a column: what its panels have in common, or what each of them is.
    fn title(&self, column: &[Content]) -> String {
        let name = |source| match source {
            Source::Truth => "Ground truth",
            Source::Method(method) => self.methods.get(method).map_or("", String::as_str),
        };
        let source = |content: &Content| match *content {
            Content::Flow(source) | Content::Strain(source) => Some(source),
            Content::Error(method) => Some(Source::Method(method)),
            _ => None,
        };
        if let [first, _, ..] = column
            && let Some(of) = source(first)
            && column.iter().all(|content| source(content) == Some(of))
        {
            return name(of).to_owned();
        }
        let words = |content: &Content| match *content {
            Content::Frame1 => ("Frame 1", ""),
            Content::Frame2 => ("Frame 2", ""),
            Content::Overlay => ("Frames 1 and 2", ""),
            Content::Flow(source) => (name(source), ""),
            Content::Error(method) => (name(Source::Method(method)), ", error"),
            Content::Strain(source) => (name(source), ", strain"),
        };
        let words: Vec<(&str, &str)> = column.iter().map(words).collect();
        // `A / B, strain`: what all panels show is said once, at the end.
        let said = |number: usize| words.get(number + 1).is_some_and(|next| next.1 == words[number].1);
        let parts = words.iter().enumerate().map(|(number, (name, what))| match said(number) {
            true => (*name).to_owned(),
            false => format!("{name}{what}"),
        });
        parts.collect::<Vec<_>>().join(" / ")
    }

    /// The legends of scales that are those of each pair, or of the figure.
    fn legends(&self, pairs: &[Pair], maps: &[Maps], ends: &Ends, of_pair: bool) -> Vec<Legend> {
        let belongs = |scale: Scale| (scale == Scale::Pair) == of_pair;
        let mut legends = Vec::new();
        let flows = || {
            pairs.iter().flat_map(|pair| {
                let shown = |source: Source| self.contents().any(|content| content == Content::Flow(source));
                let truth = pair.truth.iter().filter(move |_| shown(Source::Truth));
                let methods = pair.flows.iter().enumerate();
                let methods = methods.filter(move |(method, _)| shown(Source::Method(*method)));
                truth.chain(methods.filter_map(|(_, flow)| flow.as_ref()))
            })
        };
        if belongs(self.scales.flow) && flows().next().is_some() {
            let unknown = flows().flat_map(|flow| flow.pixels()).any(|[u, v]| !(u + v).is_finite());
            let black = if unknown { "; black: unknown" } else { "" };
            let rim = format!("radius: {} px{black}", value(ends.flow));
            legends.push(Legend::Wheel { disc: color_wheel(), lines: ["Flow".to_owned(), rim] });
            if let (Some(step), Some(pair)) = (self.arrows, pairs.first())
                && pairs.iter().all(|other| other.frames[0].width() == pair.frames[0].width())
            {
                let length = step as f64 / pair.frames[0].width().max(1) as f64;
                legends.push(Legend::Arrow { label: format!("{} px", value(ends.flow)), length });
            }
        }
        let errors: Vec<&Plane> = maps.iter().flat_map(|maps| maps.errors.iter().flatten()).collect();
        if belongs(self.scales.error) && !errors.is_empty() {
            legends.push(bar("End-point error (px)", ERROR_COLORS, ends.error, &errors));
        }
        let strain: Vec<&Plane> =
            maps.iter().flat_map(|maps| maps.strain.iter().flatten().chain(&maps.true_strain)).collect();
        if belongs(self.scales.strain) && !strain.is_empty() {
            legends.push(bar("Optical strain", STRAIN_COLORS, ends.strain, &strain));
        }
        legends
    }

    /// Letters, and captions in place of the scores.
    fn caption(&self, figure: &mut Figure) {
        for (number, panel) in figure.panels_mut().into_iter().enumerate() {
            if let Some(caption) = self.captions.as_ref().and_then(|captions| captions.get(number)) {
                panel.caption = caption.clone();
            }
            if self.letters {
                let space = if panel.caption.is_empty() { "" } else { " " };
                panel.caption = format!("({}){space}{}", letters(number), panel.caption);
            }
        }
    }
}

/// The parts of one pair's panels.
struct OfPair<'a> {
    plan: &'a Plan,
    pair: &'a Pair,
    maps: &'a Maps,
    ends: Ends,
    epe: &'a [Option<f64>],
}

impl OfPair<'_> {
    fn panel(&self, content: Content) -> Panel {
        let [frame1, frame2] = &self.pair.frames;
        let flow = |source| match source {
            Source::Truth => self.pair.truth.as_ref(),
            Source::Method(method) => self.pair.flows.get(method).and_then(Option::as_ref),
        };
        let name = |source| match source {
            Source::Truth => "truth".to_owned(),
            Source::Method(method) => self.plan.methods.get(method).cloned().unwrap_or_default(),
        };
        // `check` found every flow that a column shows.
        let blank = || Image::new(frame1.width(), frame1.height());
        let (what, picture) = match content {
            Content::Frame1 => ("frame1".to_owned(), frame1.clone()),
            Content::Frame2 => ("frame2".to_owned(), frame2.clone()),
            Content::Overlay => ("overlay".to_owned(), mean(frame1, frame2)),
            Content::Flow(source) => {
                let what = if source == Source::Truth {
                    "truth".to_owned()
                } else {
                    format!("flow {}", name(source))
                };
                (what, flow(source).map_or_else(blank, |flow| flow_picture(flow, self.ends.flow)))
            }
            Content::Error(method) => {
                let error = self.maps.errors.get(method).and_then(Option::as_ref);
                let picture = error.map(|error| ERROR_COLORS.picture(error, self.ends.error as f32));
                (format!("error {}", name(Source::Method(method))), picture.unwrap_or_else(blank))
            }
            Content::Strain(source) => {
                let strain = match source {
                    Source::Truth => self.maps.true_strain.as_ref(),
                    Source::Method(method) => self.maps.strain.get(method).and_then(Option::as_ref),
                };
                let picture = strain.map(|strain| STRAIN_COLORS.picture(strain, self.ends.strain as f32));
                (format!("strain {}", name(source)), picture.unwrap_or_else(blank))
            }
        };
        let arrows = match (content, self.plan.arrows) {
            (Content::Flow(source), Some(step)) => {
                flow(source).map_or_else(Vec::new, |flow| arrows(flow, step, self.ends.flow))
            }
            _ => Vec::new(),
        };
        Panel { name: format!("{} {what}", self.pair.name), picture, caption: self.score(content), arrows }
    }

    /// The score of a method, below its error if that is shown, otherwise below its flow.
    fn score(&self, content: Content) -> String {
        let shown = |other: Content| self.plan.contents().any(|content| content == other);
        let scored = match content {
            Content::Error(method) => Some(method),
            Content::Flow(Source::Method(method)) if !shown(Content::Error(method)) => Some(method),
            _ => None,
        };
        let epe = scored.and_then(|method| self.epe.get(method).copied().flatten());
        epe.filter(|_| self.plan.scores).map_or_else(String::new, |epe| format!("EPE {epe:.3} px"))
    }
}

/// The mean end-point error of each method.
fn epe(pair: &Pair) -> Vec<Option<f64>> {
    let of = |flow: &Option<FlowField>| {
        let (flow, truth) = (flow.as_ref()?, pair.truth.as_ref()?);
        // An error is a flow that is unknown where the truth is known: it has no mean error.
        Some(score(flow, truth, None).ok()??.epe)
    };
    pair.flows.iter().map(of).collect()
}

fn mean(a: &Image, b: &Image) -> Image {
    let mean = |a: u8, b: u8| u8::midpoint(a, b);
    Image::from_fn(a.width(), a.height(), |x, y| {
        let (a, b) = (a.get(x, y), b.get(x, y));
        std::array::from_fn(|channel| mean(a[channel], b[channel]))
    })
}

/// An arrow over each `step` pixels; one of `longest` pixels of flow is `step` pixels long.
fn arrows(flow: &FlowField, step: usize, longest: f64) -> Vec<Arrow> {
    let step = step.max(1);
    let gain = step as f64 / longest;
    let places = |side: usize| (step / 2..side).step_by(step);
    let mut arrows = Vec::new();
    for y in places(flow.height()) {
        for x in places(flow.width()) {
            let from = [x as f64, y as f64];
            let [u, v] = flow.get(x, y).map(|component| gain * f64::from(component));
            // Shorter ones would be dots.
            if u.hypot(v) >= 0.05 * step as f64 {
                arrows.push(Arrow { from, to: [from[0] + u, from[1] + v] });
            }
        }
    }
    arrows
}

fn bar(label: &str, colors: ColorMap, end: f64, maps: &[&Plane]) -> Legend {
    let mut values = maps.iter().flat_map(|map| map.pixels());
    let unknown = values.clone().any(|value| value.is_nan());
    let ticks = [0.0, 0.5, 1.0].map(|share| (share, value(share * end)));
    Legend::Bar {
        label: if unknown { format!("{label}; grey: unknown") } else { label.to_owned() },
        strip: Image::from_fn(256, 1, |x, _| colors.color(x as f32 / 255.0)),
        ticks: ticks.into(),
        open: values.any(|&value| f64::from(value) > end),
    }
}

/// A value of a scale, which is round.
fn value(value: f64) -> String {
    ((value * 1e6).round() / 1e6).to_string()
}

/// `a`, `b`, ... `z`, `aa`, `ab`, ...
fn letters(number: usize) -> String {
    let last = char::from(b'a' + (number % 26) as u8);
    match number / 26 {
        0 => last.to_string(),
        before => letters(before - 1) + &last.to_string(),
    }
}

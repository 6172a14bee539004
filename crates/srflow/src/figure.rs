//! Figures for papers.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context as _, bail, ensure};
use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, Mask, Plane, SettingError, Size, excerpt, excerpts, serialize_as_text};
use srflow_data::flow::{DatasetSpec, FlowDataset, Split};
use srflow_eval::{Window, head_window, spread};
use srflow_files::{create_folder, read_flow, read_image, write_file, write_image_png};
use srflow_mer::{StrainFormula, optical_strain};
use srflow_report::figure::{Composed, Ends, Figure, Pair, Plan, Scales, Style, check_text, resolve};

pub use srflow_report::figure::{Column, Length, Scale};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::methods::{self, Method, MethodParameters, MethodSpec};
use crate::opening::open_dataset;
use crate::output::{ensure_folder, ensure_free, write_line};
use crate::{Job, Report, Watch};

/// Make a figure for a paper: frames, flow, errors and strain in a grid
///
/// Writes a vector file for LaTeX (.pdf) or for the web and drawing programs (.svg): each row is a pair of frames, and --columns
/// sets the columns. Flow has one scale of colours for all methods, with a colour wheel as its legend; errors and strain have bars.
/// Text stays text, and pictures are compressed without loss.
///
/// Pairs come from a dataset, or from two frames and flow files of any program. Flow is estimated as in `srflow eval`: by the
/// built-in network if neither --method nor --flow is given.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(after_help = "\
Each word of --columns is a column; panels joined by + are below each other:
  frame1, frame2     the frames
  overlay            the mean of both frames
  truth              the true flow
  flow:NAME          the flow of a method, under its name in tables
  error:NAME         its end-point error
  strain:NAME        its optical strain, as in `srflow mer strain`; strain:truth is that of the true flow
  flow+error         flow, with the error below it
flow, error and strain without a name are one column for each method.

Examples:
  srflow figure --dataset srflow:DIR --split test --samples 0 7 12 --method srflow tvl1 -o fig.pdf
  srflow figure --dataset srflow:DIR --method srflow tvl1 --columns frame1 truth flow error strain:truth -o fig.pdf --panels panels
  srflow figure --dataset sintel-clean:DIR --method Theirs:files:out skflow=things.ckpt --samples alley_1/frame_0001 -o fig.pdf fig.svg
  srflow figure --frames a.png b.png --flow Ours=a.flo Theirs=b.flo --truth t.flo --crop 40,60,200x150 --width 8.6cm -o fig.svg

In LaTeX: \\includegraphics{fig.pdf}, at the width of --width. docs/guides/figures.md shows an example.")]
pub struct FigureJob {
    /// Figures to write, as .pdf or .svg
    #[arg(short, long, value_name = "FILE", num_args = 1.., required_unless_present = "panels")]
    pub output: Vec<PathBuf>,
    /// Also write every panel as a PNG of full size into this folder
    #[arg(long, value_name = "DIR")]
    pub panels: Option<PathBuf>,
    /// Kind of dataset and its folder, as for `srflow eval`
    #[arg(long, value_name = "KIND:DIR", required_unless_present = "frames", conflicts_with = "frames")]
    pub dataset: Option<DatasetSpec>,
    /// Split: train, val, test or all [default: the one that results are usually reported on]
    #[arg(long, conflicts_with = "frames")]
    pub split: Option<Split>,
    /// Pairs of the dataset, one row for each: their names in pairs.csv of `srflow eval`, or their numbers from 0 [default: 3, spread
    /// evenly]
    #[arg(long, value_name = "PAIR", num_args = 1.., value_delimiter = ',', conflicts_with = "frames")]
    pub samples: Vec<String>,
    /// Two frames instead of a dataset
    #[arg(long, value_name = "PICTURE", num_args = 2)]
    pub frames: Vec<PathBuf>,
    /// True flow between --frames, in any format of `srflow convert`
    #[arg(long, value_name = "FLOW", conflicts_with = "dataset")]
    pub truth: Option<PathBuf>,
    /// Flow files between --frames, with the names of their methods
    #[arg(long, value_name = "NAME=FLOW", num_args = 1.., conflicts_with = "dataset")]
    pub flow: Vec<NamedFile>,
    #[arg(long, value_name = "METHOD", num_args = 1.., value_delimiter = ',', value_parser = methods::scored_method, help = Method::help_of_several("Methods to show"))]
    #[serde(deserialize_with = "methods::scored_methods")]
    pub method: Vec<MethodSpec>,
    /// Columns: see below [default: truth+frame1 flow+error; without truth: frame1 frame2 flow]
    #[arg(long, value_name = "COLUMN", num_args = 1.., value_delimiter = ',')]
    pub columns: Vec<Column>,
    /// Show only this part of the frames: around the head (without a mask, in the middle), or from column X
    /// and row Y. Flow is estimated on whole frames; scores and scales are of the part
    #[arg(long, value_name = "[X,Y,]WIDTHxHEIGHT")]
    pub crop: Option<Crop>,
    /// Flow length of full colour, in pixels: a number, `auto` (one scale for the figure) or `pair` (one for
    /// each pair)
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = Self::default().flow_scale,
        help_heading = "Scales",
        allow_negative_numbers = true
    )]
    pub flow_scale: Scale,
    /// Upper end of errors, in pixels, likewise
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = Self::default().error_scale,
        help_heading = "Scales",
        allow_negative_numbers = true
    )]
    pub error_scale: Scale,
    /// Upper end of strain, likewise
    #[arg(
        long,
        value_name = "STRAIN",
        default_value_t = Self::default().strain_scale,
        help_heading = "Scales",
        allow_negative_numbers = true
    )]
    pub strain_scale: Scale,
    /// Draw an arrow on flow every STEP pixels; flow with full colour has arrows of that length
    #[arg(long, value_name = "STEP")]
    pub arrows: Option<u32>,
    /// Titles of the columns, one for each; may be empty [default: what they show]
    #[arg(long, value_name = "TEXT", num_args = 1.., help_heading = "Text")]
    pub titles: Option<Vec<String>>,
    /// Labels of the rows, one for each pair; may be empty [default: their names, if there are several]
    #[arg(long, value_name = "TEXT", num_args = 1.., help_heading = "Text")]
    pub labels: Option<Vec<String>>,
    /// Captions of the panels, from left to right and from top to bottom [default: the end-point error of methods]
    #[arg(long, value_name = "TEXT", num_args = 1.., help_heading = "Text")]
    pub captions: Option<Vec<String>>,
    /// Begin the captions of panels with (a), (b), ...
    #[arg(long, help_heading = "Text")]
    pub letters: bool,
    /// Leave out the end-point errors
    #[arg(long, help_heading = "Text")]
    pub no_scores: bool,
    /// Size of titles and labels in points; captions are smaller
    #[arg(long, value_name = "POINTS", default_value_t = Self::default().font_size, help_heading = "Text")]
    pub font_size: u8,
    /// Width of the figure, in mm, cm, in, pt or bp (those of LaTeX), such as 252pt
    #[arg(long, value_name = "LENGTH", default_value_t = Self::default().width, help_heading = "Page")]
    pub width: Length,
    /// Maximum number of columns in a row; further columns start another row
    #[arg(long, value_name = "N", default_value_t = Self::default().max_columns, help_heading = "Page")]
    pub max_columns: u16,
    /// Maximum resolution of pictures, in pixels per inch; finer pictures are averaged down
    #[arg(long, value_name = "N", default_value_t = Self::default().dpi, help_heading = "Page")]
    pub dpi: u16,
    /// Overwrite these files
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

impl Default for FigureJob {
    fn default() -> Self {
        Self {
            output: Vec::new(),
            panels: None,
            dataset: None,
            split: None,
            samples: Vec::new(),
            frames: Vec::new(),
            truth: None,
            flow: Vec::new(),
            method: Vec::new(),
            columns: Vec::new(),
            crop: None,
            flow_scale: Scale::Auto,
            error_scale: Scale::Auto,
            strain_scale: Scale::Auto,
            arrows: None,
            titles: None,
            labels: None,
            captions: None,
            letters: false,
            no_scores: false,
            font_size: 8,
            width: Length::PAGE,
            max_columns: 10,
            dpi: 600,
            force: false,
            parameters: MethodParameters::default(),
        }
    }
}

/// `NAME=FILE`; the name of a file alone is its stem.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NamedFile {
    pub name: String,
    pub file: PathBuf,
}

serialize_as_text!(NamedFile, Crop);

impl fmt::Display for NamedFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.file.display())
    }
}

impl FromStr for NamedFile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, file) = match text.split_once('=') {
            Some((name, file)) => (name.to_owned(), file),
            None => (Path::new(text).file_stem().unwrap_or_default().to_string_lossy().into_owned(), text),
        };
        if name.trim().is_empty() || file.is_empty() {
            return Err("expected NAME=FLOW, such as Ours=ours.flo".to_owned());
        }
        Ok(Self { name, file: file.into() })
    }
}

/// A part of the frames: around the head, or at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crop {
    /// Column and row of its corner; around the head if `None`.
    pub at: Option<(usize, usize)>,
    pub size: Size,
}

impl fmt::Display for Crop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some((x, y)) = self.at {
            write!(f, "{x},{y},")?;
        }
        write!(f, "{}", self.size)
    }
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            |_| "expected WIDTHxHEIGHT or X,Y,WIDTHxHEIGHT in pixels, such as 40,60,200x150".to_owned();
        let (at, size) = match text.rsplit_once(',') {
            None => (None, text),
            Some((at, size)) => (Some(at), size),
        };
        let at = at.map(|at| {
            let (x, y) = at.split_once(',').ok_or(())?;
            Ok((x.trim().parse().map_err(drop)?, y.trim().parse().map_err(drop)?))
        });
        Ok(Self {
            at: at.transpose().map_err(wrong)?,
            size: size.trim().parse().map_err(|_: String| wrong(()))?,
        })
    }
}

impl Crop {
    /// The window of a frame. Without a place, it is around the head.
    fn window(self, pair: &str, frame: Size, head: Option<&Mask>) -> anyhow::Result<Window> {
        let size @ Size { width, height } = self.size;
        let Some((left, top)) = self.at else {
            return head_window(frame, size, head).with_context(|| format!("`crop` of {pair}"));
        };
        let inside = |from: usize, length: usize, whole: usize| {
            from.checked_add(length).is_some_and(|end| end <= whole)
        };
        if !inside(left, width, frame.width) || !inside(top, height, frame.height) {
            wrong_settings!(
                "`crop`: {size} from column {left} and row {top} is not within the frames of {pair}, which are {frame} \
                 (WIDTHxHEIGHT): choose a part of them"
            );
        }
        Ok(Window { left, top, width, height })
    }
}

/// What [`FigureJob`] has written.
#[derive(Debug, Clone, Serialize)]
pub struct FigureMade {
    pub outputs: Vec<PathBuf>,
    /// Files of the panels, from left to right and from top to bottom.
    pub panels: Vec<PathBuf>,
    /// Width and height of the figure in millimetres; `None` for panels alone.
    pub size_mm: Option<[f64; 2]>,
    pub pairs: Vec<FigurePair>,
    #[serde(skip)]
    panels_folder: Option<PathBuf>,
}

/// A pair of a figure.
#[derive(Debug, Clone, Serialize)]
pub struct FigurePair {
    pub name: String,
    /// Upper ends of its scales.
    pub scales: Ends,
    pub methods: Vec<FigureMethod>,
}

/// A method of a pair of a figure.
#[derive(Debug, Clone, Serialize)]
pub struct FigureMethod {
    pub name: String,
    /// Mean end-point error in pixels, if the method is shown and the true flow is known.
    pub epe: Option<f64>,
}

impl Report for FigureMade {}

impl fmt::Display for FigureMade {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if let Some([width, height]) = self.size_mm {
            for file in &self.outputs {
                write_line(f, format_args!("{}: {width:.1} mm x {height:.1} mm", file.display()))?;
            }
        }
        match &self.panels_folder {
            Some(folder) => write_line(f, format_args!("{}: {} panels", folder.display(), self.panels.len())),
            None => Ok(()),
        }
    }
}

/// The file formats of figures.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Svg,
    Pdf,
}

impl Format {
    fn of(file: &Path) -> anyhow::Result<Self> {
        match file.extension().map(|extension| extension.to_string_lossy().to_lowercase()).as_deref() {
            Some("svg") => Ok(Self::Svg),
            Some("pdf") => Ok(Self::Pdf),
            _ => wrong_settings!(
                "{}: expected the name of a figure, ending in .pdf or .svg; `panels` writes the panels as .png",
                file.display()
            ),
        }
    }
}

impl Job for FigureJob {
    const NAME: &'static str = "figure";

    type Report = FigureMade;

    fn work(&self, watch: &Watch) -> anyhow::Result<FigureMade> {
        self.check()?;
        let formats = self.output.iter().map(|file| Format::of(file)).collect::<anyhow::Result<Vec<_>>>()?;
        ensure_free(&self.output, self.force)?;
        if let Some(folder) = &self.panels {
            ensure_folder(folder)?;
            ensure_free([folder], self.force)?;
        }
        let (plan, pairs) = match &self.dataset {
            Some(spec) => self.of_dataset(spec, &formats, watch)?,
            None => self.of_files(&formats, watch)?,
        };
        let composed = plan.compose(&pairs)?;
        note_unscored(&plan, &composed, &pairs);
        let drawing = match formats.is_empty() {
            true => None, // panels alone may have any size
            false => Some(composed.figure.drawing(&self.style())?),
        };
        let mm = |points: f64| (points * 2540.0 / 72.0).round() / 100.0;
        if let Some(drawing) = &drawing {
            let content = |format: &Format| match format {
                Format::Svg => drawing.svg().map(String::into_bytes),
                Format::Pdf => drawing.pdf(),
            };
            // All before the first is written.
            let contents = formats.iter().map(content).collect::<Result<Vec<_>, _>>()?;
            for (file, content) in self.output.iter().zip(contents) {
                write_file(file, content)?;
            }
        }
        let panels = match &self.panels {
            Some(folder) => write_panels(folder, &composed.figure)?,
            None => Vec::new(),
        };
        let pair = |(number, pair): (usize, &Pair)| FigurePair {
            name: pair.name.clone(),
            scales: composed.ends[number],
            methods: plan
                .methods
                .iter()
                .zip(&composed.epe[number])
                .map(|(name, epe)| FigureMethod { name: name.clone(), epe: *epe })
                .collect(),
        };
        Ok(FigureMade {
            outputs: self.output.clone(),
            panels,
            size_mm: drawing.as_ref().map(|drawing| [mm(drawing.width), mm(drawing.height)]),
            pairs: pairs.iter().enumerate().map(pair).collect(),
            panels_folder: self.panels.clone(),
        })
    }
}

/// The strain that figures show.
pub(crate) fn strain(flow: &FlowField) -> Plane {
    optical_strain(flow, StrainFormula::Literature)
}

/// Writes the panels of a figure as PNGs of full size, numbered from left to right and from top to bottom, and returns their files.
#[doc(hidden)]
pub fn write_panels(dir: &Path, figure: &Figure) -> anyhow::Result<Vec<PathBuf>> {
    create_folder(dir)?;
    let mut files = Vec::new();
    for (number, panel) in figure.panels().enumerate() {
        let file = dir.join(panel_file(number + 1, &panel.name));
        write_image_png(&file, &panel.picture)?;
        files.push(file);
    }
    Ok(files)
}

/// `03-p1-flow-tvl1.png`: a name that LaTeX and every system take.
fn panel_file(number: usize, name: &str) -> String {
    const LONGEST: usize = 100;
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
    let name: String = name.chars().map(plain).take(LONGEST).collect();
    let words: Vec<&str> = name.split('-').filter(|word| !word.is_empty()).collect();
    format!("{number:02}-{}.png", words.join("-"))
}

/// Scores that are missing although the truth is known.
fn note_unscored(plan: &Plan, composed: &Composed, pairs: &[Pair]) {
    for (pair, epe) in pairs.iter().zip(&composed.epe).filter(|(pair, _)| pair.truth.is_some()) {
        for ((method, flow), epe) in plan.methods.iter().zip(&pair.flows).zip(epe) {
            if flow.is_some() && epe.is_none() {
                log::warn!(
                    "{}: no end-point error of {method}: it is unknown where the truth is known, or nothing is known",
                    pair.name
                );
            }
        }
    }
}

impl FigureJob {
    /// Refuses what no figure can be made of.
    fn check(&self) -> anyhow::Result<()> {
        if self.output.is_empty() && self.panels.is_none() {
            wrong_settings!("give `output`, `panels` or both: there is nothing to write");
        }
        if self.dataset.is_some() && !(self.frames.is_empty() && self.truth.is_none() && self.flow.is_empty())
        {
            wrong_settings!(
                "`frames`, `truth` and `flow` cannot be used with `dataset`: leave them or it out"
            );
        }
        for (field, value, least, most) in [
            ("arrows", self.arrows.unwrap_or(4), 4, u32::MAX),
            ("font_size", self.font_size.into(), 4, 36),
            ("max_columns", self.max_columns.into(), 1, u16::MAX.into()),
            ("dpi", self.dpi.into(), 36, 9600),
        ] {
            if !(least..=most).contains(&value) {
                let expected = format!("{least} to {most}");
                return Err(SettingError { field, found: value.to_string(), expected }.into());
            }
        }
        Ok(())
    }

    fn style(&self) -> Style {
        Style {
            width: self.width.points(),
            font_size: self.font_size.into(),
            pixels_per_inch: self.dpi.into(),
            ..Style::default()
        }
    }

    /// The methods to estimate: the usual one if columns show a method and none is given.
    fn methods(&self, columns: &[Column]) -> Vec<MethodSpec> {
        match columns.iter().any(Column::shows_methods) {
            true if self.method.is_empty() && self.flow.is_empty() => vec![Method::DEFAULT.into()],
            _ => self.method.clone(),
        }
    }

    fn columns(&self, has_truth: bool) -> anyhow::Result<Vec<Column>> {
        let usual: &[&str] =
            if has_truth { &["truth+frame1", "flow+error"] } else { &["frame1", "frame2", "flow"] };
        match self.columns.as_slice() {
            [] => usual.iter().map(|column| column.parse().map_err(anyhow::Error::msg)).collect(),
            given => Ok(given.to_vec()),
        }
    }

    /// The plan for these methods and pairs. What can be wrong with it is refused before flow is estimated.
    fn plan(
        &self,
        columns: &[Column],
        methods: Vec<String>,
        pairs: &[String],
        formats: &[Format],
    ) -> anyhow::Result<Plan> {
        if methods.iter().any(|method| method == "truth") {
            wrong_settings!(
                "`flow` truth: this name is for the true flow; give the method another one, as in `flow` NAME=FLOW"
            );
        }
        let columns = match resolve(columns, &methods) {
            Ok(columns) => columns,
            Err(error) => wrong_settings!("`columns`: {error}"),
        };
        let plan = Plan {
            methods,
            columns,
            most_columns: self.max_columns.into(),
            strain,
            scales: Scales { flow: self.flow_scale, error: self.error_scale, strain: self.strain_scale },
            arrows: self.arrows.map(|step| step as usize),
            scores: !self.no_scores,
            letters: self.letters,
            titles: self.titles.clone(),
            labels: self.labels.clone(),
            captions: self.captions.clone(),
        };
        if let Err(error) = plan.check_counts(pairs.len()) {
            wrong_settings!("{error}");
        }
        if formats.contains(&Format::Pdf) {
            plan.texts(pairs).into_iter().try_for_each(check_text)?;
        }
        if !formats.is_empty() {
            self.style().panel_width(plan.columns.len().min(plan.most_columns), pairs.len() > 1)?;
        }
        Ok(plan)
    }

    /// The pair, or the part of it that is shown.
    fn cropped(&self, pair: Pair, head: Option<&Mask>) -> anyhow::Result<Pair> {
        let Some(crop) = self.crop else { return Ok(pair) };
        let Window { left, top, width, height } = crop.window(&pair.name, pair.frames[0].size(), head)?;
        let flow = |flow: FlowField| flow.crop(left, top, width, height);
        Ok(Pair {
            name: pair.name,
            frames: pair.frames.map(|frame| frame.crop(left, top, width, height)),
            truth: pair.truth.map(flow),
            flows: pair.flows.into_iter().map(|estimate| estimate.map(flow)).collect(),
        })
    }

    /// The plan and the pairs of a dataset.
    fn of_dataset(
        &self,
        spec: &DatasetSpec,
        formats: &[Format],
        watch: &Watch,
    ) -> anyhow::Result<(Plan, Vec<Pair>)> {
        let dataset = open_dataset(spec, self.split, watch)?;
        let chosen = chosen(&dataset, &self.samples)?;
        let dataset = dataset.only(&chosen);
        let names: Vec<String> = dataset.entries().iter().map(|entry| entry.id()).collect();
        let without = dataset.entries().iter().find(|entry| entry.flow.is_none());
        let columns = self.columns(without.is_none())?;
        let specs = self.methods(&columns);
        if let (Some(crop @ Crop { at: Some(_), .. }), entries) = (self.crop, dataset.entries()) {
            for entry in entries {
                crop.window(&entry.id(), entry.read_size()?, None)?;
            }
        }
        let sources = match specs.as_slice() {
            [] => Vec::new(),
            specs => methods::sources(specs, &self.parameters, &dataset, None, watch)?,
        };
        let methods: Vec<String> = sources.iter().map(|source| source.method().name().to_owned()).collect();
        let plan = self.plan(&columns, methods, &names, formats)?;
        if let (Some(entry), true) = (without, plan.needs_truth()) {
            bail!(
                "{}: the dataset has no true flow of this pair: leave out truth, error and strain:truth from `columns`",
                entry.id()
            );
        }
        let shown = watch.count("pairs", names.len() as u64);
        let mut pairs = Vec::new();
        for entry in dataset.entries() {
            let sample = dataset.read(entry)?;
            let mut flows = Vec::new();
            for (number, source) in sources.iter().enumerate() {
                let estimate = plan.shows_method(number).then(|| {
                    shown.message(format!("{} on {}", plan.methods[number], entry.id()));
                    source.flow(&entry.id(), &sample.frame1, &sample.frame2).with_context(|| entry.id())
                });
                flows.push(estimate.transpose()?);
            }
            let pair =
                Pair { name: entry.id(), frames: [sample.frame1, sample.frame2], truth: sample.flow, flows };
            pairs.push(self.cropped(pair, sample.mask.as_ref())?);
            shown.inc();
        }
        Ok((plan, pairs))
    }

    /// The plan and the pair of two frames.
    fn of_files(&self, formats: &[Format], watch: &Watch) -> anyhow::Result<(Plan, Vec<Pair>)> {
        let [file1, file2] = self.frames.as_slice() else {
            wrong_settings!("`frames`: expected two pictures, found {}", self.frames.len())
        };
        let name = file1.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let columns = self.columns(self.truth.is_some())?;
        let specs = self.methods(&columns);
        if specs.iter().any(|spec| spec.method == Method::Files) {
            wrong_settings!(
                "`method` files:DIR is for datasets: name flow files between `frames` by `flow` NAME=FLOW"
            );
        }
        let estimators = match specs.as_slice() {
            [] => Vec::new(),
            specs => methods::estimators(specs, &self.parameters, watch)?,
        };
        let mut methods: Vec<String> = self.flow.iter().map(|flow| flow.name.clone()).collect();
        methods.extend(estimators.iter().map(|estimator| estimator.name().to_owned()));
        if let Some((_, twice)) =
            methods.iter().enumerate().find(|(number, name)| methods[..*number].contains(name))
        {
            wrong_settings!(
                "two methods have the name {}: rename one, as in `flow` NAME=FLOW or `method` NAME:tvl1",
                excerpt(twice)
            );
        }
        let plan = self.plan(&columns, methods, std::slice::from_ref(&name), formats)?;
        if plan.needs_truth() && self.truth.is_none() {
            wrong_settings!(
                "`columns`: truth, error and strain:truth need the true flow: give it as `truth`, or leave them out"
            );
        }
        let (frame1, frame2) = (read_image(file1)?, read_image(file2)?);
        ensure!(
            frame1.size() == frame2.size(),
            "{} is {} and {} {} (WIDTHxHEIGHT): give two frames of one size",
            file1.display(),
            frame1.size(),
            file2.display(),
            frame2.size()
        );
        let read = |file: &Path| {
            let flow = read_flow(file)?;
            ensure!(
                flow.size() == frame1.size(),
                "{}: expected a flow of {} as {} is, found {} (WIDTHxHEIGHT)",
                file.display(),
                frame1.size(),
                file1.display(),
                flow.size()
            );
            Ok(flow)
        };
        if let Some(crop) = self.crop {
            crop.window(&name, frame1.size(), None)?;
        }
        let truth = self.truth.as_deref().map(read).transpose()?;
        let mut flows =
            self.flow.iter().map(|flow| read(&flow.file).map(Some)).collect::<anyhow::Result<Vec<_>>>()?;
        for estimator in &estimators {
            let estimate = plan.shows_method(flows.len()).then(|| estimator.estimate(&frame1, &frame2));
            flows.push(estimate.transpose()?);
        }
        let pair = self.cropped(Pair { name, frames: [frame1, frame2], truth, flows }, None)?;
        Ok((plan, vec![pair]))
    }
}

/// The numbers of the pairs that `samples` names.
fn chosen(dataset: &FlowDataset, samples: &[String]) -> anyhow::Result<Vec<usize>> {
    const USUAL: usize = 3;
    let count = dataset.entries().len();
    if samples.is_empty() {
        return Ok(spread(count, Some(USUAL)));
    }
    let names: Vec<String> = dataset.entries().iter().map(|entry| entry.id()).collect();
    let number = |sample: &String| {
        let named = names.iter().position(|name| name == sample);
        match named.or_else(|| sample.parse().ok().filter(|number| *number < count)) {
            Some(number) => Ok(number),
            None => wrong_settings!(
                "`samples`: expected the name of a pair of the {} split, such as {}, or a number from 0 to {}; found {}",
                dataset.split(),
                excerpts(names.iter().take(3).map(String::as_str), 3),
                count - 1,
                excerpt(sample)
            ),
        }
    };
    samples.iter().map(number).collect()
}

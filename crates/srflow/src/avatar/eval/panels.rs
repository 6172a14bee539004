//! Pictures of an evaluation: the capture beside the avatar, and the true flow beside the avatar's.

use std::path::Path;

use srflow_avatar::capture::CaptureSplit;
use srflow_avatar::train::{Scorer, ViewScore};
use srflow_core::{FlowField, Image, Mask, Plane, Size, flow_colors};
use srflow_files::{FileError, FileProblem, write_image_png};
use srflow_render::label_error::{FlowComparison, FlowPair};
use srflow_report::html::{
    Figure, Page, Panel, Picture, PictureError, Section, heat_legend, panels, ramp_legend, score_table,
    side_by_side, wheel_legend,
};
use srflow_report::{Table, color_scale, heat, shrink_image};

use super::super::scores::{SCORE_DEFINITIONS, split_words};
use crate::machine;

/// Most width of a picture on the page, pixels.
const WIDTH: usize = 550;

/// Most width of a flow that is kept to be shown, pixels: several are kept at once.
const KEPT_WIDTH: usize = 1200;

/// Of pixels of the true head that the avatar lacks, and of those that only the avatar has.
const MISSING: [u8; 3] = [40, 120, 255];
const SURPLUS: [u8; 3] = [30, 170, 90];

/// What is shown of an evaluation.
#[derive(Default)]
pub struct Panels {
    pub pictures: Vec<PicturePanels>,
    pub flows: Vec<FlowPanels>,
}

/// A picture of the capture, the rendering, and their difference.
pub struct PicturePanels {
    split: CaptureSplit,
    /// E.g. `worst`.
    word: &'static str,
    score: ViewScore,
    truth: Image,
    rendering: Image,
    /// Mean absolute difference of the channels, in levels of 255.
    difference: Plane,
}

impl PicturePanels {
    /// Of the picture that was scored last.
    pub fn new(
        split: CaptureSplit,
        word: &'static str,
        score: &ViewScore,
        size: Size,
        scorer: &Scorer,
    ) -> Self {
        let difference = |a: [f32; 3], b: [f32; 3]| -> f32 {
            let channels = a.into_iter().zip(b).map(|(a, b)| (a - b.clamp(0.0, 1.0)).abs());
            channels.sum::<f32>() * (255.0 / 3.0)
        };
        let (picture, rendered) = (scorer.picture(), scorer.rendered());
        let at = |x: usize, y: usize| y * size.width + x;
        let difference =
            Plane::from_fn(size.width, size.height, |x, y| difference(picture[at(x, y)], rendered[at(x, y)]));
        let [truth, rendering] = scorer.images();
        Self { split, word, score: score.clone(), truth, rendering, difference }
    }
}

/// The flow of a pair: the true one, the avatar's, and the end-point error.
pub struct FlowPanels {
    split: CaptureSplit,
    step: u32,
    pair: FlowPair,
    truth: FlowField,
    avatar: FlowField,
    error: Plane,
    missing: Mask,
    surplus: Mask,
    /// Mean error over all pixels.
    mean: f64,
}

impl FlowPanels {
    pub fn new(split: CaptureSplit, step: u32, pair: FlowPair, flows: &FlowComparison) -> Self {
        let (truth, avatar) = (flows.truth(), flows.avatar());
        let errors: Vec<f32> = flows.errors().collect();
        // Every nth pixel, in both directions.
        let n = truth.width.div_ceil(KEPT_WIDTH).max(1);
        let (width, height) = (truth.width / n, truth.height / n);
        let shown = |x: usize, y: usize| [truth, avatar].map(|frame| frame.alpha.get(n * x, n * y) > 0.5);
        Self {
            split,
            step,
            pair,
            truth: FlowField::from_fn(width, height, |x, y| truth.flow.get(n * x, n * y)),
            avatar: FlowField::from_fn(width, height, |x, y| avatar.flow.get(n * x, n * y)),
            error: Plane::from_fn(width, height, |x, y| errors[n * y * truth.width + n * x]),
            missing: Mask::from_fn(width, height, |x, y| shown(x, y) == [true, false]),
            surplus: Mask::from_fn(width, height, |x, y| shown(x, y) == [false, true]),
            mean: mean(&errors),
        }
    }

    /// The error in heat colours.
    fn error_image(&self, max: f64) -> Image {
        let mut image = heat(&self.error, max as f32);
        for (pixel, (&missing, &surplus)) in
            image.pixels_mut().iter_mut().zip(self.missing.pixels().iter().zip(self.surplus.pixels()))
        {
            if missing {
                *pixel = MISSING;
            } else if surplus {
                *pixel = SURPLUS;
            }
        }
        image
    }
}

/// Of the known ones.
fn mean(errors: &[f32]) -> f64 {
    let known = errors.iter().filter(|error| !error.is_nan());
    let (sum, count) = known.fold((0.0, 0_usize), |(sum, count), error| (sum + f64::from(*error), count + 1));
    sum / count.max(1) as f64
}

/// Ends of the colour scales.
struct Scales {
    /// Levels of 255.
    difference: f64,
    /// Pixels.
    flow: f64,
    error: f64,
}

impl Panels {
    fn scales(&self) -> Scales {
        let lengths = self
            .flows
            .iter()
            .flat_map(|flow| flow.truth.pixels())
            .map(|[u, v]| u.hypot(*v))
            .filter(|length| *length > 0.0);
        let errors = self.flows.iter().flat_map(|flow| flow.error.pixels()).copied();
        let differences = self.pictures.iter().flat_map(|picture| picture.difference.pixels()).copied();
        Scales {
            difference: color_scale(differences, 10.0),
            flow: color_scale(lengths, 0.1),
            error: color_scale(errors, 0.05),
        }
    }

    /// Writes each as one PNG of three pictures side by side, and deletes those of an earlier report.
    pub fn write(&self, dir: &Path) -> Result<(), FileError> {
        let scales = self.scales();
        let failed = |error| FileProblem::Io { doing: "deleting an earlier picture", error }.in_file(dir);
        for entry in std::fs::read_dir(dir).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if ["picture_", "flow_"].iter().any(|kind| name.starts_with(kind)) && name.ends_with(".png") {
                std::fs::remove_file(&path).map_err(failed)?;
            }
        }
        for picture in &self.pictures {
            let ViewScore { timestep, camera, .. } = picture.score;
            let name = format!("picture_{}_{}_{timestep:05}_{camera:02}.png", picture.split, picture.word);
            write_image_png(&dir.join(name), &Image::beside(&picture.images(&scales)))?;
        }
        for flow in &self.flows {
            let FlowPair { camera, timesteps: [first, _] } = flow.pair;
            let name = format!("flow_{}_step{}_{first:05}_{camera:02}.png", flow.split, flow.step);
            write_image_png(&dir.join(name), &Image::beside(&flow.images(&scales)))?;
        }
        Ok(())
    }

    /// The report.
    ///
    /// # Errors
    /// When a picture cannot be encoded.
    pub fn page(&self, pictures: &[Table], flow: &[Table], lead: &str) -> Result<Page, PictureError> {
        let scales = self.scales();
        let tables = pictures.iter().zip(std::iter::once(SCORE_DEFINITIONS).chain(std::iter::repeat("")));
        let mut figures: Vec<Figure> = tables.map(|(table, words)| score_table(table, words)).collect();
        for picture in &self.pictures {
            figures.push(picture.figure(&scales)?);
        }
        if !self.pictures.is_empty() {
            let ramp = heat(&Plane::from_fn(256, 1, |x, _| x as f32 / 255.0), 1.0);
            let words = format!("0 to {} of 255 and more, mean of the channels.", scales.difference);
            figures.push(ramp_legend(&ramp, "colours of differences, from black to light yellow", &words)?);
        }
        let section = "Of each split, the pictures with the lowest and the highest PSNR.";
        let mut sections = vec![Section::new("Pictures", section, figures)];
        if !flow.is_empty() {
            sections.push(self.flow_section(flow, &scales)?);
        }
        Ok(Page {
            title: "Scores of an avatar".to_owned(),
            kicker: "srflow avatar eval".to_owned(),
            lead: lead.to_owned(),
            opening: Vec::new(),
            sections,
            colophon: format!("Made by srflow {} on {}.", env!("CARGO_PKG_VERSION"), machine::describe()),
        })
    }

    fn flow_section(&self, tables: &[Table], scales: &Scales) -> Result<Section, PictureError> {
        let mut figures: Vec<Figure> = tables.iter().map(|table| score_table(table, "")).collect();
        for flow in &self.flows {
            figures.push(flow.figure(scales)?);
        }
        if !self.flows.is_empty() {
            let words = "Grey: outside of the head. Blue: missing in the avatar. Green: only in the avatar.";
            let legends = vec![wheel_legend(scales.flow, "")?, heat_legend(scales.error, words)?];
            figures.push(side_by_side(legends, 420));
        }
        Ok(Section::new(
            "Flow",
            "The flow that srflow render writes for the avatar, against that of the true head; end-point error in pixels.",
            figures,
        ))
    }
}

impl PicturePanels {
    fn images(&self, scales: &Scales) -> [Image; 3] {
        [self.truth.clone(), self.rendering.clone(), heat(&self.difference, scales.difference as f32)]
    }

    fn figure(&self, scales: &Scales) -> Result<Figure, PictureError> {
        let ViewScore { timestep, camera, score, .. } = &self.score;
        let caption = format!(
            "{}, {}: timestep {timestep}, camera {camera}: PSNR {:.2} dB (mean of channels {:.2} dB), SSIM {:.4}",
            split_words(self.split),
            self.word,
            score.psnr,
            score.psnr_channels,
            score.ssim
        );
        row(&self.images(scales), ["Picture", "Avatar", "Difference"], &caption)
    }
}

impl FlowPanels {
    fn images(&self, scales: &Scales) -> [Image; 3] {
        let colours = |flow: &FlowField| flow_colors(flow, Some(scales.flow as f32));
        [colours(&self.truth), colours(&self.avatar), self.error_image(scales.error)]
    }

    fn figure(&self, scales: &Scales) -> Result<Figure, PictureError> {
        let FlowPair { camera, timesteps: [first, second] } = self.pair;
        let caption = format!(
            "{}: camera {camera}, timesteps {first} to {second}: mean error {:.3} px",
            split_words(self.split),
            self.mean
        );
        row(&self.images(scales), ["True flow", "Flow of the avatar", "Error"], &caption)
    }
}

fn row(images: &[Image; 3], titles: [&str; 3], caption: &str) -> Result<Figure, PictureError> {
    let panel = |(image, title): (&Image, &str)| {
        Ok(Panel::new(Picture::jpeg(&shrink_image(image, WIDTH), title)?, title, ""))
    };
    let shown = images.iter().zip(titles).map(panel).collect::<Result<Vec<_>, PictureError>>()?;
    Ok(panels(&shown, 200, caption))
}

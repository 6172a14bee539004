//! The qualitative figure of a paper: of each pair the frame and the truth, then for every method its flow over its error. The
//! pictures are PNGs of full size; the figure is one SVG in the width of a page, with text as text.

use maud::{Markup, html};
use srflow_field::Image;

use super::charts::{number, place};
use super::heat::{colour, heat};
use super::legend::wheel;
use super::pair_figures::PairMaps;
use super::picture::{Picture, PictureError};
use super::shrink::shrink_image;
use crate::evaluate::ScoredPair;

/// Width of the figure in points of 1/72 inch: both columns of an IEEE page.
const WIDTH: f64 = 516.0;
/// Resolution up to which pictures are put into the figure.
const PIXELS_PER_INCH: f64 = 600.0;
/// Most columns beside each other; more methods go into further rows.
const COLUMNS: usize = 8;
const GAP: f64 = 3.0;
/// Room for the rows' labels, and for a line of text.
const LABEL: f64 = 12.0;

/// The pictures of one pair.
#[derive(Debug)]
pub struct PaperPanels {
    /// The pair within its dataset.
    name: String,
    frame: Image,
    truth: Image,
    methods: Vec<MethodPanels>,
    /// Length in pixels of the flow at the rim of the wheel, and of the error at the end of its scale.
    scales: [f64; 2],
}

#[derive(Debug)]
struct MethodPanels {
    name: String,
    flow: Image,
    error: Image,
    epe: Option<f64>,
}

impl PaperPanels {
    /// Flow and error have one scale for all methods.
    pub fn new(pair: &ScoredPair<'_>) -> Self {
        let maps = PairMaps::new(pair, pair.truth.width());
        let method = |(place, error): &(usize, _)| {
            let estimate = &pair.estimates[*place];
            MethodPanels {
                name: estimate.method.clone(),
                flow: maps.colors(&estimate.flow),
                error: heat(error, maps.largest as f32),
                epe: estimate.scores.whole.as_ref().map(|metrics| metrics.epe),
            }
        };
        Self {
            name: pair.name.to_owned(),
            frame: pair.sample.frame1.clone(),
            truth: maps.colors(&maps.truth),
            methods: maps.errors.iter().map(method).collect(),
            scales: [maps.longest, maps.largest],
        }
    }

    /// The pair within its dataset.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Every picture in full size, with a name for its file: `frame`, `truth`, `METHOD flow`, `METHOD error`.
    pub fn pictures(&self) -> Vec<(String, &Image)> {
        let whole = [("frame".to_owned(), &self.frame), ("truth".to_owned(), &self.truth)];
        let of_method = |method: &'_ MethodPanels| {
            [(format!("{} flow", method.name), 0), (format!("{} error", method.name), 1)]
        };
        let images = self.methods.iter().flat_map(|method| [&method.flow, &method.error]);
        let names = self.methods.iter().flat_map(of_method).map(|(name, _)| name);
        whole.into_iter().chain(names.zip(images)).collect()
    }
}

/// The figure of these pairs, as SVG.
///
/// # Errors
/// When a picture cannot be encoded.
pub fn paper_figure(pairs: &[PaperPanels]) -> Result<String, PictureError> {
    let most = pairs.iter().map(|pair| pair.methods.len() + 1).max().unwrap_or(1);
    let columns = most.min(COLUMNS);
    let width = (WIDTH - LABEL - GAP * (columns - 1) as f64) / columns as f64;
    let mut y = 0.0;
    let mut drawing = Vec::new();
    for pair in pairs {
        let height = width * pair.frame.height() as f64 / pair.frame.width().max(1) as f64;
        let x = |column: usize| LABEL + column as f64 * (width + GAP);
        for (number, methods) in pair.methods.chunks(columns - usize::from(columns > 1)).enumerate() {
            let rows = [y + LABEL, y + LABEL + height + GAP];
            for (row, label) in rows.iter().zip(["flow", if number == 0 { "frame, error" } else { "error" }])
            {
                drawing.push(html! {
                    text transform={ "translate(8 " (place(row + height / 2.0)) ") rotate(-90)" } text-anchor="middle" { (label) }
                });
            }
            if number == 0 {
                drawing.push(title(x(0), y, width, "Truth"));
                drawing.push(picture(&pair.truth, "truth", [x(0), rows[0], width, height])?);
                drawing.push(picture(&pair.frame, "frame 1", [x(0), rows[1], width, height])?);
                drawing.push(title(x(0), rows[1] + height - 2.0, width, &pair.name));
            }
            for (column, method) in methods.iter().enumerate() {
                let x = x(column + usize::from(columns > 1));
                drawing.push(title(x, y, width, &method.name));
                drawing.push(picture(&method.flow, "flow", [x, rows[0], width, height])?);
                drawing.push(picture(&method.error, "error", [x, rows[1], width, height])?);
                let epe = method.epe.map_or(String::new(), |epe| format!("EPE {epe:.3} px"));
                drawing.push(title(x, rows[1] + height - 2.0, width, &epe));
            }
            y = rows[1] + height + LABEL;
        }
        let [longest, largest] = pair.scales;
        drawing.push(legend(y, longest, largest)?);
        y += LEGEND + 2.0 * GAP;
    }
    let size = (place(WIDTH), place(y));
    let svg = html! {
        svg xmlns="http://www.w3.org/2000/svg" width={ (size.0) "pt" } height={ (size.1) "pt" }
            viewBox={ "0 0 " (size.0) " " (size.1) } font-family="Helvetica, Arial, sans-serif" font-size="7.5" {
            @for part in &drawing { (part) }
        }
    };
    Ok(svg.into_string())
}

/// Height of the legend.
const LEGEND: f64 = 22.0;

/// The wheel of the flow and the ramp of the error, with their ends.
fn legend(y: f64, longest: f64, largest: f64) -> Result<Markup, PictureError> {
    let ramp = Image::from_fn(256, 1, |x, _| colour(x as f32 / 255.0));
    let (wheel, ramp) = (Picture::exact(&wheel(), "wheel")?, Picture::exact(&ramp, "ramp")?);
    let (top, line) = (place(y + 4.0), place(y + 4.0 + LEGEND / 2.0));
    let side = LEGEND - 4.0;
    Ok(html! {
        image href=(wheel.uri) x=(LABEL) y=(top) width=(side) height=(side) {}
        text x=(LABEL + side + 4.0) y=(line) { "flow: rim " (number(longest)) " px" }
        image href=(ramp.uri) x="150" y=(place(y + 8.0)) width="90" height="8" preserveAspectRatio="none" {}
        text x="244" y=(line) { "error: 0 to " (number(largest)) " px" }
    })
}

/// Text over the middle of a column, made narrower where it is longer than the column.
fn title(x: f64, y: f64, width: f64, text: &str) -> Markup {
    // About half an em for each character of a sans serif.
    let long = text.chars().count() as f64 * 4.0 > width;
    let fitted = long.then(|| place(width));
    html! {
        text x=(place(x + width / 2.0)) y=(place(y + 9.0)) text-anchor="middle" textLength=[fitted]
            lengthAdjust=[long.then_some("spacingAndGlyphs")] { (text) }
    }
}

fn picture(image: &Image, alt: &str, [x, y, width, height]: [f64; 4]) -> Result<Markup, PictureError> {
    let most = (width / 72.0 * PIXELS_PER_INCH).round() as usize;
    let picture = Picture::exact(&shrink_image(image, most), alt)?;
    Ok(html! {
        image href=(picture.uri) x=(place(x)) y=(place(y)) width=(place(width)) height=(place(height)) {}
    })
}

//! Where everything goes on the page.

use std::borrow::Cow;

use crate::shrink_image;
use srflow_core::{Size, excerpt};

use super::drawing::{Anchor, Area, Drawing, Item, Paint};
use super::font::{ASCENT, DESCENT, shortened, width};
use super::grid::{Arrow, Figure, Legend, Panel, Row};

/// Sizes of a figure in points of 1/72 inch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Style {
    /// Width of the whole figure.
    pub width: f64,
    /// Size of titles and labels; captions and legends are smaller.
    pub font_size: f64,
    /// Space between panels.
    pub gap: f64,
    /// Pictures with more pixels than this are averaged down to it.
    pub pixels_per_inch: f64,
}

impl Default for Style {
    /// The width of a page with two columns, 17.8 cm.
    fn default() -> Self {
        Self { width: 17.8 / 2.54 * 72.0, font_size: 8.0, gap: 3.0, pixels_per_inch: 600.0 }
    }
}

impl Style {
    /// What is left of the panels.
    fn label_width(&self, labelled: bool) -> f64 {
        MARGIN + if labelled { LINE * self.font_size } else { 0.0 }
    }

    /// Width of a panel in points where so many are beside each other, with or without labels of rows.
    ///
    /// # Errors
    /// When too little is left.
    pub fn panel_width(&self, columns: usize, labelled: bool) -> Result<f64, FigureError> {
        let gaps = self.gap * columns.saturating_sub(1) as f64;
        let panel = (self.width - MARGIN - self.label_width(labelled) - gaps) / columns.max(1) as f64;
        let least = LEAST_PANEL * self.font_size;
        if panel < least || panel.is_nan() {
            let (width, each, least) = (self.width * MM, panel.max(0.0) * MM, least * MM);
            return Err(FigureError::Narrow { columns, width, each, least });
        }
        Ok(panel)
    }
}

/// Why a figure cannot be laid out or written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FigureError {
    #[error("a figure needs at least one row and one column")]
    Empty,
    #[error("row {row}, column {column} of the figure has a picture without pixels")]
    EmptyPicture { row: usize, column: usize },
    #[error(
        "{columns} columns within {width:.1} mm leave {each:.1} mm for each, expected at least {least:.1} mm: choose fewer columns or \
         a wider figure"
    )]
    Narrow { columns: usize, width: f64, each: f64, least: f64 },
    #[error(
        "the figure would be {width:.0} mm wide and {height:.0} mm high, expected at most {most:.0} mm, the largest page of a PDF: \
         choose fewer rows, a crop or a narrower figure"
    )]
    Large { width: f64, height: f64, most: f64 },
    /// A character that the font of the PDF lacks.
    #[error(
        "the text `{}` contains `{}` (U+{:04X}), which Helvetica, the font of the PDF, does not have: write it in other words, or \
         write an .svg",
        excerpt(.text), excerpt(&.character.to_string()), u32::from(*.character)
    )]
    Character { text: String, character: char },
    #[error("encoding a picture of {size}: {reason}")]
    Encode { size: Size, reason: String },
}

/// Narrowest panel in units of the font size: no text would fit above or below narrower ones.
const LEAST_PANEL: f64 = 3.0;
/// Longest side of a page in PDF 1.4 (Adobe, *PDF Reference*, appendix C).
const LARGEST_PAGE: f64 = 14_400.0;
const MM: f64 = 25.4 / 72.0;

/// Size of captions and legends relative to that of titles.
const NOTE: f64 = 0.875;
/// Text that does not fit is set smaller, down to this share of its size, and shortened beyond.
const SMALLEST: f64 = 0.75;
/// Height of a line in units of the font size.
const LINE: f64 = 1.25;
/// Height of a legend in units of its font size.
const LEGEND: f64 = 3.4;
/// Length of a bar of colours in units of its font size.
const BAR: f64 = 13.0;

const BLACK: [u8; 3] = [0; 3];
const BORDER: [u8; 3] = [96; 3];
const HAIRLINE: f64 = 0.3;
/// Around everything, so that lines at the edge are not cut.
const MARGIN: f64 = 0.4;

impl Figure {
    /// The figure on its page.
    ///
    /// # Errors
    /// When it has no panel, or its panels do not fit.
    pub fn drawing(&self, style: &Style) -> Result<Drawing<'_>, FigureError> {
        let columns = self.rows.iter().map(|row| row.cells.len()).max().unwrap_or(0);
        if columns == 0 {
            return Err(FigureError::Empty);
        }
        let labelled = self.rows.iter().any(|row| !row.label.is_empty());
        let panel = style.panel_width(columns, labelled)?;
        let left = style.label_width(labelled);
        let captions =
            self.rows.iter().flat_map(|row| row.cells.iter().flatten()).map(|panel| &panel.caption);
        let titles = self.rows.iter().flat_map(|row| &row.titles);
        let title_size = fitting(titles, style.font_size, panel);
        let mut page = Page {
            style,
            left,
            panel,
            title_size,
            caption_size: fitting(captions, title_size.min(NOTE * style.font_size), panel),
            y: MARGIN,
            items: Vec::new(),
        };
        for (number, row) in self.rows.iter().enumerate() {
            if number > 0 {
                page.y += style.gap;
            }
            page.titles(&row.titles);
            page.row(number, row)?;
            page.legends(&row.legends);
        }
        page.legends(&self.legends);
        let (width, height) = (style.width, page.y + MARGIN);
        if width.max(height) > LARGEST_PAGE {
            let most = LARGEST_PAGE * MM;
            return Err(FigureError::Large { width: width * MM, height: height * MM, most });
        }
        Ok(Drawing { width, height, items: page.items })
    }
}

/// The page while it is filled from top to bottom.
struct Page<'a, 's> {
    style: &'s Style,
    /// Room for the labels of rows.
    left: f64,
    /// Width of a panel.
    panel: f64,
    title_size: f64,
    caption_size: f64,
    /// Lower end of what is on the page.
    y: f64,
    items: Vec<Item<'a>>,
}

impl<'a> Page<'a, '_> {
    fn column(&self, number: usize) -> f64 {
        self.left + number as f64 * (self.panel + self.style.gap)
    }

    fn titles(&mut self, titles: &[String]) {
        if titles.iter().all(String::is_empty) {
            return;
        }
        let (size, line) = (self.title_size, LINE * self.style.font_size);
        for (number, title) in titles.iter().enumerate() {
            let x = self.column(number) + self.panel / 2.0;
            self.text_over(title, [x, self.y + line - 1.5 * DESCENT * size], size, self.panel);
        }
        self.y += line;
    }

    /// Text centred at a point and shortened to a width.
    fn text_over(&mut self, text: &str, at: [f64; 2], size: f64, most: f64) {
        self.text(&shortened(&excerpt(text), most / size), at, size, Anchor::Middle);
    }

    fn text(&mut self, text: &str, at: [f64; 2], size: f64, anchor: Anchor) {
        if !text.is_empty() {
            self.items.push(Item::Text { text: text.to_owned(), at, size, anchor, upright: false });
        }
    }

    fn row(&mut self, number: usize, row: &'a Row) -> Result<(), FigureError> {
        let top = self.y;
        let mut bottom = top;
        for level in 0..row.depth() {
            if level > 0 {
                self.y += self.style.gap;
            }
            let mut height: f64 = 0.0;
            let mut captioned = false;
            for (column, cell) in row.cells.iter().enumerate() {
                let Some(panel) = cell.get(level) else { continue };
                let (pixels_x, pixels_y) = (panel.picture.width(), panel.picture.height());
                if pixels_x == 0 || pixels_y == 0 {
                    return Err(FigureError::EmptyPicture { row: number + 1, column: column + 1 });
                }
                height = height.max(self.panel * pixels_y as f64 / pixels_x as f64);
                captioned |= !panel.caption.is_empty();
            }
            for (column, cell) in row.cells.iter().enumerate() {
                if let Some(panel) = cell.get(level) {
                    self.place(panel, self.column(column));
                }
            }
            self.y += height;
            bottom = self.y;
            if captioned {
                let size = self.caption_size;
                let baseline = self.y + 1.1 * size;
                for (column, cell) in row.cells.iter().enumerate() {
                    let middle = self.column(column) + self.panel / 2.0;
                    if let Some(panel) = cell.get(level) {
                        self.text_over(&panel.caption, [middle, baseline], size, self.panel);
                    }
                }
                self.y = baseline + 1.4 * DESCENT * size;
            }
        }
        let size = self.title_size;
        let label = shortened(&excerpt(&row.label), (bottom - top) / size);
        if !row.label.is_empty() {
            let at = [(1.0 - DESCENT) * size, (top + bottom) / 2.0];
            self.items.push(Item::Text { text: label, at, size, anchor: Anchor::Middle, upright: true });
        }
        Ok(())
    }

    fn place(&mut self, panel: &'a Panel, x: f64) {
        let scale = self.panel / panel.picture.width() as f64;
        let (width, height) = (self.panel, scale * panel.picture.height() as f64);
        let area = Area { x, y: self.y, width, height };
        let most = (width / 72.0 * self.style.pixels_per_inch).ceil().max(1.0) as usize;
        let image = match panel.picture.width() > most {
            true => Cow::Owned(shrink_image(&panel.picture, most)),
            false => Cow::Borrowed(&panel.picture),
        };
        self.items.push(Item::Picture { image, area });
        let point = |[px, py]: [f64; 2]| [x + (px + 0.5) * scale, area.y + (py + 0.5) * scale];
        let inside =
            |[px, py]: [f64; 2]| (x..=x + width).contains(&px) && (area.y..=area.y + height).contains(&py);
        let arrows = panel.arrows.iter().map(|Arrow { from, to }| [point(*from), point(*to)]);
        self.arrows(arrows.filter(|[from, to]| inside(*from) && inside(*to)));
        self.items.push(outline(area));
    }

    fn arrows(&mut self, arrows: impl Iterator<Item = [[f64; 2]; 2]>) {
        let (mut shafts, mut heads) = (Vec::new(), Vec::new());
        for [from, to] in arrows {
            let along = [to[0] - from[0], to[1] - from[1]];
            let length = along[0].hypot(along[1]);
            if length == 0.0 || !length.is_finite() {
                continue;
            }
            let head = HEAD.min(0.6 * length);
            let [u, v] = along.map(|component| component / length * head);
            let base = [to[0] - u, to[1] - v];
            shafts.push(vec![from, base]);
            heads.push(vec![
                to,
                [base[0] - 0.4 * v, base[1] + 0.4 * u],
                [base[0] + 0.4 * v, base[1] - 0.4 * u],
            ]);
        }
        if !shafts.is_empty() {
            self.items.push(Item::Path { lines: shafts, color: BLACK, paint: Paint::Stroke(0.4) });
            self.items.push(Item::Path { lines: heads, color: BLACK, paint: Paint::Fill });
        }
    }

    /// Legends in lines, each in the middle of the page.
    fn legends(&mut self, legends: &'a [Legend]) {
        let room = self.style.width - 2.0 * MARGIN;
        let usual = NOTE * self.style.font_size;
        let widest = legends.iter().map(|legend| self.legend_width(legend, usual)).fold(0.0, f64::max);
        // All of a legend grows with its text, so that smaller text makes room in narrow figures.
        let size = if widest > room { usual * room / widest } else { usual };
        let space = 3.0 * size;
        let mut line: Vec<(&Legend, f64)> = Vec::new();
        let mut used = 0.0;
        for legend in legends {
            let width = self.legend_width(legend, size);
            if !line.is_empty() && used + space + width > room {
                self.legend_line(&line, used, space, size);
                line.clear();
            }
            used = if line.is_empty() { width } else { used + space + width };
            line.push((legend, width));
        }
        if !line.is_empty() {
            self.legend_line(&line, used, space, size);
        }
    }

    fn legend_width(&self, legend: &Legend, size: f64) -> f64 {
        let text = |text: &str| width(&excerpt(text)) * size;
        match legend {
            Legend::Wheel { lines, .. } => {
                (LEGEND + 0.6) * size + lines.iter().map(|line| text(line)).fold(0.0, f64::max)
            }
            Legend::Bar { label, .. } => text(label).max((BAR + TIP) * size + overhang(legend, size)),
            Legend::Arrow { label, length } => text(label).max(self.arrow_length(*length)),
        }
    }

    fn arrow_length(&self, length: f64) -> f64 {
        (length * self.panel).clamp(0.0, self.style.width / 2.0)
    }

    fn legend_line(&mut self, line: &[(&'a Legend, f64)], used: f64, space: f64, size: f64) {
        self.y += 1.5 * self.style.gap;
        let mut x = (self.style.width - used) / 2.0;
        for (legend, width) in line {
            self.legend(legend, x, *width, size);
            x += width + space;
        }
        self.y += LEGEND * size;
    }

    fn legend(&mut self, legend: &'a Legend, x: f64, width: f64, size: f64) {
        let y = self.y;
        let shown = |text: &str, room: f64| shortened(&excerpt(text), room / size);
        match legend {
            Legend::Wheel { disc, lines } => {
                let side = LEGEND * size;
                let area = Area { x, y, width: side, height: side };
                self.items.push(Item::Picture { image: Cow::Borrowed(disc), area });
                self.items.push(circle(area));
                let text_x = x + side + 0.6 * size;
                for (line, baseline) in lines.iter().zip([1.5, 2.7]) {
                    let line = shown(line, x + width - text_x);
                    self.text(&line, [text_x, y + baseline * size], size, Anchor::Start);
                }
            }
            Legend::Bar { label, strip, ticks, open } => {
                self.text(&shown(label, width), [x, y + 0.95 * size], size, Anchor::Start);
                let x = x + overhang_before(ticks, size);
                let area = Area { x, y: y + 1.25 * size, width: BAR * size, height: 0.85 * size };
                let (right, bottom) = (area.x + area.width, area.y + area.height);
                self.items.push(Item::Picture { image: Cow::Borrowed(strip), area });
                let last = strip.pixels().last().copied().unwrap_or(BLACK);
                let mut rim = vec![[right, area.y], [area.x, area.y], [area.x, bottom], [right, bottom]];
                if *open {
                    let tip =
                        vec![[right, area.y], [right + TIP * size, (area.y + bottom) / 2.0], [right, bottom]];
                    rim.push(tip[1]);
                    self.items.push(Item::Path { lines: vec![tip], color: last, paint: Paint::Fill });
                }
                self.items.push(Item::Path {
                    lines: vec![rim],
                    color: BORDER,
                    paint: Paint::Outline(HAIRLINE),
                });
                let places: Vec<f64> =
                    ticks.iter().map(|(share, _)| area.x + share.clamp(0.0, 1.0) * area.width).collect();
                let marks = places.iter().map(|&x| vec![[x, bottom], [x, bottom + 0.2 * size]]).collect();
                self.items.push(Item::Path { lines: marks, color: BORDER, paint: Paint::Stroke(HAIRLINE) });
                for ((_, label), x) in ticks.iter().zip(places) {
                    self.text(&excerpt(label), [x, bottom + (0.35 + ASCENT) * size], size, Anchor::Middle);
                }
            }
            Legend::Arrow { label, length } => {
                self.text(&shown(label, width), [x, y + 1.5 * size], size, Anchor::Start);
                let (y, length) = (y + 2.4 * size, self.arrow_length(*length));
                self.arrows(std::iter::once([[x, y], [x + length, y]]));
            }
        }
    }
}

/// Length of the head of an arrow.
const HEAD: f64 = 2.2;
/// Length of the tip of an open bar in units of the font size.
const TIP: f64 = 0.7;

/// By how much the labels at the ends of a bar stand out to its left and right.
fn overhang(legend: &Legend, size: f64) -> f64 {
    let Legend::Bar { ticks, .. } = legend else { return 0.0 };
    let last = ticks.last().map_or(0.0, |(_, label)| width(&excerpt(label)) / 2.0 - TIP);
    overhang_before(ticks, size) + last.max(0.0) * size
}

fn overhang_before(ticks: &[(f64, String)], size: f64) -> f64 {
    ticks.first().map_or(0.0, |(_, label)| width(&excerpt(label)) / 2.0 * size)
}

fn outline(Area { x, y, width, height }: Area) -> Item<'static> {
    let corners = vec![[x, y], [x + width, y], [x + width, y + height], [x, y + height]];
    Item::Path { lines: vec![corners], color: BORDER, paint: Paint::Outline(HAIRLINE) }
}

/// The circle inside a square, which hides the steps of its pixels.
fn circle(Area { x, y, width, height }: Area) -> Item<'static> {
    const CORNERS: usize = 120;
    let corner = |number: usize| {
        let turn = number as f64 / CORNERS as f64 * std::f64::consts::TAU;
        [x + width / 2.0 * (1.0 + libm::cos(turn)), y + height / 2.0 * (1.0 + libm::sin(turn))]
    };
    let lines = vec![(0..CORNERS).map(corner).collect()];
    Item::Path { lines, color: BORDER, paint: Paint::Outline(0.6) }
}

/// The largest size, at most `size`, at which all texts fit within a width; at least [`SMALLEST`] of it.
fn fitting<'t>(texts: impl IntoIterator<Item = &'t String>, size: f64, most: f64) -> f64 {
    let widest = texts.into_iter().map(|text| width(&excerpt(text))).fold(0.0, f64::max);
    if widest * size <= most { size } else { (most / widest).max(SMALLEST * size) }
}

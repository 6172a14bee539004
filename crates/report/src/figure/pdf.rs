use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use pdf_writer::types::Predictor;
use pdf_writer::{Content, Filter, Finish, Name, Pdf, Rect, Ref, Str};

use srflow_core::excerpt;

use super::drawing::{Anchor, Drawing, Item, Paint};
use super::font::{code, width};
use super::layout::FigureError;
use super::number::rounded;
use super::picture::Png;

const CATALOG: Ref = Ref::new(1);
const PAGES: Ref = Ref::new(2);
const PAGE: Ref = Ref::new(3);
const CONTENT: Ref = Ref::new(4);
const FONT: Ref = Ref::new(5);
/// Object of the first picture.
const PICTURES: i32 = 6;
const FONT_NAME: Name = Name(b"F1");

impl Drawing<'_> {
    /// The drawing as a PDF of one page that is as large as it. Text is text in Helvetica, which viewers have and the file does not
    /// contain; pictures are compressed without loss. PDF 1.4, without dates: equal drawings are equal bytes.
    ///
    /// # Errors
    /// When a text has characters that Helvetica lacks, or a picture cannot be encoded.
    pub fn pdf(&self) -> Result<Vec<u8>, FigureError> {
        let pictures: Vec<Png> = self
            .items
            .iter()
            .filter_map(|item| match item {
                Item::Picture { image, .. } => Some(Png::of(image)),
                _ => None,
            })
            .collect::<Result<_, _>>()?;
        let content = self.content()?;
        let mut pdf = Pdf::new();
        pdf.set_version(1, 4); // LaTeX warns of files newer than its own
        pdf.catalog(CATALOG).pages(PAGES);
        pdf.pages(PAGES).kids([PAGE]).count(1);
        let mut page = pdf.page(PAGE);
        page.media_box(Rect::new(0.0, 0.0, real(self.width), real(self.height)));
        page.parent(PAGES);
        page.contents(CONTENT);
        let mut resources = page.resources();
        resources.fonts().pair(FONT_NAME, FONT);
        let mut names = resources.x_objects();
        for number in 0..pictures.len() {
            names.pair(Name(picture_name(number).as_bytes()), picture_object(number));
        }
        names.finish();
        resources.finish();
        page.finish();
        let packed = compressed(&content);
        pdf.stream(CONTENT, &packed).filter(Filter::FlateDecode);
        pdf.type1_font(FONT).base_font(Name(b"Helvetica")).encoding_predefined(Name(b"WinAnsiEncoding"));
        let images = self.items.iter().filter_map(|item| match item {
            Item::Picture { image, .. } => Some(image),
            _ => None,
        });
        for (number, (png, image)) in pictures.iter().zip(images).enumerate() {
            let stream = png.stream();
            let side = |pixels: usize| i32::try_from(pixels).unwrap_or(i32::MAX); // PNG sides are below 2^31
            let mut object = pdf.image_xobject(picture_object(number), &stream);
            object.width(side(image.width())).height(side(image.height()));
            object.color_space().device_rgb();
            object.bits_per_component(8);
            object.filter(Filter::FlateDecode);
            object.decode_parms().predictor(Predictor::PngOptimum).colors(3).columns(side(image.width()));
        }
        Ok(pdf.finish())
    }

    /// The operators of the page, whose origin is the bottom left corner.
    fn content(&self) -> Result<Vec<u8>, FigureError> {
        let mut content = Content::new();
        let up = |y: f64| real(self.height - y);
        let mut pictures = 0;
        for item in &self.items {
            match item {
                Item::Picture { area, .. } => {
                    let (width, height) = (real(area.width), real(area.height));
                    content.save_state();
                    content.transform([width, 0.0, 0.0, height, real(area.x), up(area.y + area.height)]);
                    content.x_object(Name(picture_name(pictures).as_bytes()));
                    content.restore_state();
                    pictures += 1;
                }
                Item::Text { text, at: [x, y], size, anchor, upright } => {
                    let encoded = encoded(text)?;
                    let back = match anchor {
                        Anchor::Start => 0.0,
                        Anchor::Middle => width(text) * size / 2.0,
                    };
                    let matrix = match upright {
                        false => [1.0, 0.0, 0.0, 1.0, real(x - back), up(*y)],
                        true => [0.0, 1.0, -1.0, 0.0, real(*x), up(y + back)],
                    };
                    content.begin_text().set_font(FONT_NAME, real(*size));
                    content.set_text_matrix(matrix).show(Str(&encoded)).end_text();
                }
                Item::Path { lines, color, paint } => {
                    let [r, g, b] = color.map(|channel| real(f64::from(channel) / 255.0));
                    content.save_state();
                    content.set_fill_rgb(r, g, b).set_stroke_rgb(r, g, b);
                    if let Paint::Stroke(width) | Paint::Outline(width) = paint {
                        content.set_line_width(real(*width));
                    }
                    for line in lines {
                        for (place, [x, y]) in line.iter().enumerate() {
                            match place {
                                0 => content.move_to(real(*x), up(*y)),
                                _ => content.line_to(real(*x), up(*y)),
                            };
                        }
                        if !matches!(paint, Paint::Stroke(_)) {
                            content.close_path();
                        }
                    }
                    match paint {
                        Paint::Fill => content.fill_nonzero(),
                        _ => content.stroke(),
                    };
                    content.restore_state();
                }
            }
        }
        Ok(content.finish().into_vec())
    }
}

fn real(value: f64) -> f32 {
    rounded(value) as f32
}

fn picture_name(number: usize) -> String {
    format!("I{number}")
}

/// There are fewer pictures than a page has room for.
fn picture_object(number: usize) -> Ref {
    Ref::new(PICTURES + number as i32)
}

/// Whether the font of a PDF has the characters of a text.
///
/// # Errors
/// [`FigureError::Character`] with the first that it lacks.
pub fn check_text(text: &str) -> Result<(), FigureError> {
    encoded(&excerpt(text)).map(drop)
}

fn encoded(text: &str) -> Result<Vec<u8>, FigureError> {
    let code = |character| {
        code(character).ok_or_else(|| FigureError::Character { text: text.to_owned(), character })
    };
    text.chars().map(code).collect()
}

fn compressed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).and_then(|()| encoder.finish()).expect("a Vec takes every byte")
}

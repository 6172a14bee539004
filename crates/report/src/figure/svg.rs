use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use maud::{Markup, PreEscaped, html};

use super::drawing::{Anchor, Drawing, Item, Paint};
use super::layout::FigureError;
use super::number::number;
use super::picture::Png;

/// Fonts with the metrics of Helvetica, the most exact first.
const FONTS: &str = "Helvetica, Arial, 'Liberation Sans', 'Nimbus Sans', Arimo, sans-serif";

impl Drawing<'_> {
    /// The drawing as SVG, with text as text and pictures as PNG.
    ///
    /// # Errors
    /// When a picture cannot be encoded.
    pub fn svg(&self) -> Result<String, FigureError> {
        let items = self.items.iter().map(element).collect::<Result<Vec<_>, _>>()?;
        let (width, height) = (number(self.width), number(self.height));
        // The unit of the page: 1 pt of CSS is 1/72 inch.
        let svg = html! {
            svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" version="1.1"
                width={ (width) "pt" } height={ (height) "pt" } viewBox={ "0 0 " (width) " " (height) }
                font-family=(FONTS) {
                @for item in &items { (item) (PreEscaped("\n")) }
            }
        };
        Ok(format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n", svg.into_string()))
    }
}

fn element(item: &Item) -> Result<Markup, FigureError> {
    Ok(match item {
        Item::Picture { image, area } => {
            let uri = format!("data:image/png;base64,{}", BASE64_STANDARD.encode(Png::of(image)?.bytes()));
            // xlink:href: also read by programs older than SVG 2.
            html! {
                image x=(number(area.x)) y=(number(area.y)) width=(number(area.width)) height=(number(area.height))
                    preserveAspectRatio="none" xlink:href=(uri) {}
            }
        }
        Item::Text { text, at: [x, y], size, anchor, upright } => {
            let (x, y) = (number(*x), number(*y));
            let turn = upright.then(|| format!("rotate(-90 {x} {y})"));
            let anchor = (*anchor == Anchor::Middle).then_some("middle");
            html! {
                text x=(x) y=(y) font-size=(number(*size)) text-anchor=[anchor] transform=[turn] { (text) }
            }
        }
        Item::Path { lines, color: [r, g, b], paint } => {
            let color = format!("#{r:02x}{g:02x}{b:02x}");
            let data = path_data(lines, !matches!(paint, Paint::Stroke(_)));
            match paint {
                Paint::Fill => html! { path d=(data) fill=(color) {} },
                Paint::Stroke(width) | Paint::Outline(width) => html! {
                    path d=(data) fill="none" stroke=(color) stroke-width=(number(*width)) {}
                },
            }
        }
    })
}

fn path_data(lines: &[Vec<[f64; 2]>], closed: bool) -> String {
    let mut data = String::new();
    for line in lines {
        for (place, [x, y]) in line.iter().enumerate() {
            data += if place == 0 { "M" } else { "L" };
            data += &format!("{} {}", number(*x), number(*y));
        }
        data += if closed { "Z" } else { "" };
    }
    data
}

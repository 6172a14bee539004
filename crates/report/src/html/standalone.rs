//! A chart as a separate file, for papers: SVG that browsers, Inkscape and LaTeX's converters render alike.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use maud::{Markup, PreEscaped, html};
use srflow_core::printable;

use super::charts::{Chart, WIDTH, place};

/// Class and colour of each series on paper; those of `page.css` in its light scheme.
const SERIES: [(&str, &str); 6] = [
    ("s1", "#2f6bd8"),
    ("s2", "#d9733a"),
    ("s3", "#2f9677"),
    ("s4", "#8b5fc7"),
    ("s5", "#b5892a"),
    ("s0", "#a3a7ae"),
];

/// The rules of `page.css` for charts with the variables substituted, which converters do not support.
const STYLE: &str = "text{fill:#5f646d}.strong,.name{fill:#1d1f23}.name{font-weight:600}.rule{stroke:#e5e2db}\
    .axis{stroke:#8d929b}.line{fill:none;stroke-width:2;stroke-linejoin:round;stroke-linecap:round}\
    .s0 .line{stroke-dasharray:4 4}.title{font-size:15px;font-weight:600;fill:#1d1f23}.on{fill:#ffffff}";

/// A link that saves the chart: title, legend and drawing as one SVG file, embedded in the page.
pub(super) fn download(chart: &Chart, keys: &[(&str, &str)], drawing: &Markup, height: f64) -> Markup {
    let uri =
        format!("data:image/svg+xml;base64,{}", BASE64_STANDARD.encode(file(chart, keys, drawing, height)));
    html! { a.save href=(uri) download={ (file_name(&chart.title)) ".svg" } { "SVG" } }
}

fn file(chart: &Chart, keys: &[(&str, &str)], drawing: &Markup, height: f64) -> String {
    const MARGIN: f64 = 12.0;
    const LINE: f64 = 20.0;
    let places = key_places(keys);
    let lines = places.last().map_or(0.0, |(_, line)| line + 1.0);
    let top = 2.0 * MARGIN + 15.0 + lines * LINE;
    let (width, height) = (WIDTH + 2.0 * MARGIN, top + height + MARGIN);
    let colours: String = SERIES
        .iter()
        .map(|(class, colour)| format!(".{class} .fill{{fill:{colour}}}.{class} .line{{stroke:{colour}}}"))
        .collect();
    let svg = html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(place(width)) height=(place(height))
            viewBox={ "0 0 " (place(width)) " " (place(height)) }
            font-family="Helvetica, Arial, sans-serif" font-size="12.5" {
            style { (PreEscaped(STYLE)) (PreEscaped(colours)) }
            text.title x=(MARGIN) y=(MARGIN + 13.0) { (chart.title) }
            @for ((name, class), (x, line)) in keys.iter().zip(places) {
                @let y = MARGIN + 15.0 + (line + 0.9) * LINE;
                g class=(class) {
                    rect.fill x=(place(MARGIN + x)) y=(place(y - 6.0)) width="14" height="3" rx="1" {}
                    text x=(place(MARGIN + x + 20.0)) y=(place(y)) { (name) }
                }
            }
            g transform={ "translate(" (MARGIN) " " (place(top)) ")" } { (drawing) }
        }
    };
    printable(&svg.0).into_owned()
}

/// Left end and row of each legend entry, estimated from the average width of a letter.
fn key_places(keys: &[(&str, &str)]) -> Vec<(f64, f64)> {
    let (mut x, mut line) = (0.0, 0.0);
    let place = |(name, _): &(&str, &str)| {
        let width = 38.0 + 6.8 * name.chars().count() as f64;
        if x > 0.0 && x + width > WIDTH {
            (x, line) = (0.0, line + 1.0);
        }
        let here = (x, line);
        x += width;
        here
    };
    keys.iter().map(place).collect()
}

/// `Training loss` as `training-loss`.
fn file_name(title: &str) -> String {
    let words = title.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    let name = words.map(str::to_lowercase).collect::<Vec<_>>().join("-");
    if name.is_empty() { "figure".to_owned() } else { name.chars().take(80).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_on_paper_are_those_of_the_page() {
        let css = include_str!("page.css");
        for (class, colour) in SERIES {
            let name = if class == "s0" { "quiet".to_owned() } else { class.replace('s', "series-") };
            assert!(css.contains(&format!("--{name}: {colour};")), "{name} {colour}");
        }
    }

    #[test]
    fn a_file_holds_title_keys_and_drawing_escaped() {
        let chart = Chart::new("a < b", "", "", "");
        let svg = file(&chart, &[("x & y", "s1"), ("other", "s2")], &html! { circle r="3" {} }, 100.0);
        assert!(svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\""), "{svg}");
        assert!(svg.contains("a &lt; b") && svg.contains("x &amp; y") && svg.contains("<circle"), "{svg}");
        assert!(!svg.contains("var("), "{svg}");
        assert_eq!(file_name("EPE, px (logarithmic)"), "epe-px-logarithmic");
        let many = [("a long name of a series", "s1"); 5];
        assert!(key_places(&many).iter().all(|(x, _)| *x < WIDTH - 150.0), "keys stay inside");
    }
}

use maud::html;

use super::Figure;

/// Large numbers with a label under each: `(number, label)`.
pub fn tiles(numbers: &[(String, String)]) -> Figure {
    Figure(html! {
        div.tiles { @for (number, words) in numbers { div { strong { (number) } span { (words) } } } }
    })
}

/// Names and values in rows: settings and machine.
pub fn facts(pairs: &[(String, String)]) -> Figure {
    titled_facts("", pairs)
}

/// [`facts`] under a title, which may be empty.
pub fn titled_facts(title: &str, pairs: &[(String, String)]) -> Figure {
    Figure(html! {
        figure {
            div.panel.plain {
                @if !title.is_empty() { h3 { (title) } }
                dl.facts { @for (name, value) in pairs { dt { (name) } dd { (value) } } }
            }
        }
    })
}

/// Settings in TOML as [`facts`]: their keys, as `section.key`, and values.
pub fn settings_facts(toml: &str) -> Figure {
    let mut section = String::new();
    let mut pairs = Vec::new();
    for line in toml.lines() {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            section = format!("{name}.");
        } else if let Some((key, value)) = line.split_once(" = ") {
            pairs.push((format!("{section}{key}"), value.to_owned()));
        }
    }
    facts(&pairs)
}

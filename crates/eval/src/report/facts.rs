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
    Figure(html! {
        figure { div.panel.plain { dl.facts { @for (name, value) in pairs { dt { (name) } dd { (value) } } } } }
    })
}

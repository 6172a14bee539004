use maud::html;

use super::Figure;

/// Another page within this one, such as those of `srflow view`, as a window of its own; it is built when a reader comes near it.
pub fn embedded(page: &str, title: &str, caption: &str) -> Figure {
    Figure(html! {
        figure {
            iframe.embedded title=(title) loading="lazy" srcdoc=(page) {}
            figcaption { (caption) }
        }
    })
}

use maud::{Markup, html};

use super::{Figure, Picture};

/// A picture with a title and a note.
#[derive(Debug, Clone)]
pub struct Panel {
    pub picture: Picture,
    /// E.g. `Flow`.
    pub title: String,
    /// May be empty.
    pub note: String,
}

impl Panel {
    /// A picture with these words.
    pub fn new(picture: Picture, title: impl Into<String>, note: impl Into<String>) -> Self {
        Self { picture, title: title.into(), note: note.into() }
    }
}

/// Pictures in a row with one caption, wrapped on narrow pages and never enlarged. `least_width` is the width in CSS pixels
/// below which a picture moves to the next line.
pub fn panels(panels: &[Panel], least_width: usize, caption: &str) -> Figure {
    Figure(html! {
        figure {
            div.grid style={ "--least:" (least_width) "px" } {
                @for panel in panels { (card(panel)) }
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}

/// Pictures in columns that stay together: each is shown from top to bottom, and wraps as a whole.
pub fn columns(columns: &[Vec<Panel>], least_width: usize, caption: &str) -> Figure {
    Figure(html! {
        figure {
            div.grid style={ "--least:" (least_width) "px" } {
                @for column in columns { div.column { @for panel in column { (card(panel)) } } }
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}

/// Figures side by side while each gets at least `least_width` CSS pixels, otherwise stacked.
pub fn side_by_side(figures: Vec<Figure>, least_width: usize) -> Figure {
    Figure(
        html! { div.sides style={ "--least:" (least_width) "px" } { @for figure in figures { (figure.0) } } },
    )
}

/// Several pictures of one thing, side by side.
#[derive(Debug, Clone)]
pub struct Strip {
    pub title: String,
    /// May be empty.
    pub note: String,
    /// Pictures with their labels.
    pub pictures: Vec<(Picture, String)>,
}

/// Cards of pictures in a row, wrapped where a card would get less than `least_width` CSS pixels.
pub fn strips(strips: &[Strip], least_width: usize, caption: &str) -> Figure {
    Figure(html! {
        figure {
            div.grid style={ "--least:" (least_width) "px" } {
                @for strip in strips {
                    div.panel {
                        div.strip {
                            @for (picture, word) in &strip.pictures { div { (picture.img()) span { (word) } } }
                        }
                        (title_and_note(&strip.title, &strip.note))
                    }
                }
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}

fn card(panel: &Panel) -> Markup {
    html! {
        div.panel style={ "max-width:" (panel.picture.size.width) "px" } {
            div.picture { (panel.picture.img()) }
            (title_and_note(&panel.title, &panel.note))
        }
    }
}

pub(super) fn title_and_note(title: &str, note: &str) -> Markup {
    html! { p { b { (title) } @if !note.is_empty() { " · " (note) } } }
}

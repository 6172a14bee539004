use maud::{Markup, html};

use super::{Figure, Picture};

/// A picture with its name and a few words.
#[derive(Debug, Clone)]
pub struct Panel {
    pub picture: Picture,
    /// Its name, e.g. `Flow`.
    pub title: String,
    /// What to see in it; may be empty.
    pub note: String,
}

impl Panel {
    /// A picture with these words.
    pub fn new(picture: Picture, title: impl Into<String>, note: impl Into<String>) -> Self {
        Self { picture, title: title.into(), note: note.into() }
    }
}

/// Pictures in a row, wrapped where the page is narrow and never enlarged, with one caption under all. `least_width` is the width in CSS
/// pixels below which a picture moves to the next line.
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

/// Pictures in columns that stay together: each is shown from top to bottom, and moves to the next line as a whole.
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

/// Figures beside each other where each can be `least_width` CSS pixels wide, under each other where not.
pub fn side_by_side(figures: Vec<Figure>, least_width: usize) -> Figure {
    Figure(
        html! { div.sides style={ "--least:" (least_width) "px" } { @for figure in figures { (figure.0) } } },
    )
}

/// Several pictures of one thing beside each other.
#[derive(Debug, Clone)]
pub struct Strip {
    /// What it is of.
    pub title: String,
    /// What to see in it; may be empty.
    pub note: String,
    /// The pictures, each with a word under it.
    pub pictures: Vec<(Picture, String)>,
}

/// Cards of pictures in a row, as many cards beside each other as can be `least_width` CSS pixels wide.
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
        div.panel style={ "max-width:" (panel.picture.width) "px" } {
            div.picture { (panel.picture.img()) }
            (title_and_note(&panel.title, &panel.note))
        }
    }
}

pub(super) fn title_and_note(title: &str, note: &str) -> Markup {
    html! { p { b { (title) } @if !note.is_empty() { " · " (note) } } }
}

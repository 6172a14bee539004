use maud::html;

use super::panels::title_and_note;
use super::{Figure, Picture};

/// One action unit: the face at rest, at full intensity, and the flow between the two.
#[derive(Debug, Clone)]
pub struct ActionCard {
    /// E.g. `AU 12`.
    pub title: String,
    /// E.g. `lip corner puller`.
    pub note: String,
    pub rest: Picture,
    /// At full intensity.
    pub full: Picture,
    /// Flow from rest to full, in colours.
    pub flow: Picture,
}

/// A grid of action units: full intensity beside its flow. Hovering over a card, or ticking the box for all, shows the face
/// at rest.
pub fn action_cards(cards: &[ActionCard], caption: &str) -> Figure {
    Figure(html! {
        figure {
            label.switch { input type="checkbox"; "Show every face at rest (or hover over one)" }
            div.cards {
                @for card in cards {
                    div.panel.card tabindex="0" {
                        div.pair {
                            div.turn { (card.full.img()) div.rest { (card.rest.img()) } }
                            (card.flow.img())
                        }
                        (title_and_note(&card.title, &card.note))
                    }
                }
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}

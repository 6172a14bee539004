//! Figures for papers: frames, flows, errors and strain of pairs in a grid with titles, captions and legends, as SVG and PDF.
//!
//! A [`Plan`] says what is shown of each [`Pair`]; it makes a [`Figure`], a grid of pictures that knows nothing of flow; the figure
//! is laid out as a [`Drawing`]; and a drawing is written as SVG or PDF.

mod columns;
mod compose;
mod drawing;
mod font;
mod grid;
mod layout;
mod length;
mod number;
mod pdf;
mod picture;
mod scale;
mod svg;
#[cfg(test)]
mod tests;

pub use columns::{Column, ColumnError, Content, Source, resolve};
pub use compose::{ComposeError, Composed, Pair, Plan};
pub use drawing::{Anchor, Area, Drawing, Item, Paint};
pub use grid::{Arrow, Figure, Legend, Panel, Row};
pub use layout::{FigureError, Style};
pub use length::Length;
pub use pdf::check_text;
pub use scale::{Ends, Scale, Scales};

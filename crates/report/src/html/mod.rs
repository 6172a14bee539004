//! The page: one self-contained HTML file. It loads nothing from elsewhere, except the video beside a [`timeline`]; pictures are
//! embedded as data URIs, charts are SVG.
//!
//! A [`Page`] holds [`Section`]s, a section holds [`Figure`]s. Figures can only be created by the functions here, which
//! escape all text.

mod action_cards;
mod bars;
mod charts;
mod compare;
mod confusion;
mod curves;
mod embedded;
mod facts;
mod film;
mod histogram;
mod legend;
mod page;
mod panels;
mod picture;
mod score_table;
mod standalone;
mod timeline;

pub use action_cards::{ActionCard, action_cards};
pub use bars::{Bar, bars};
pub use charts::{Axis, Chart, number};
pub use compare::compare;
pub use confusion::confusion_matrix;
pub use curves::{Curve, curves};
pub use embedded::embedded;
pub use facts::{facts, settings_facts, tiles, titled_facts};
pub use film::{Film, films};
pub use histogram::{Bin, histogram};
pub use legend::{heat_legend, ramp_legend, wheel_legend};
pub use page::{Figure, Page, Section};
pub use panels::{Panel, Strip, columns, panels, side_by_side, strips};
pub use picture::{Picture, PictureError};
pub use score_table::score_table;
pub use timeline::{Footage, Lane, Mark, Timeline, timeline};

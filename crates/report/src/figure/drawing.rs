use std::borrow::Cow;

use srflow_core::Image;

/// A figure laid out on a page: lengths in points of 1/72 inch, from the top left corner, `x` to the right and `y` down.
#[derive(Debug, Clone)]
pub struct Drawing<'a> {
    pub width: f64,
    pub height: f64,
    /// From back to front.
    pub items: Vec<Item<'a>>,
}

/// A part of a [`Drawing`].
#[derive(Debug, Clone)]
pub enum Item<'a> {
    Picture {
        image: Cow<'a, Image>,
        area: Area,
    },
    Text {
        text: String,
        /// Point on the baseline.
        at: [f64; 2],
        size: f64,
        anchor: Anchor,
        /// Whether it runs from bottom to top.
        upright: bool,
    },
    /// Lines through points, of one colour.
    Path {
        lines: Vec<Vec<[f64; 2]>>,
        color: [u8; 3],
        paint: Paint,
    },
}

/// A rectangle on the page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    pub x: f64,
    pub y: f64,
    pub width: f64,
    pub height: f64,
}

/// Which part of a text is at its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
}

/// How a path is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Paint {
    /// Each line closed and filled.
    Fill,
    /// Lines of this width, open.
    Stroke(f64),
    /// Lines of this width, each closed.
    Outline(f64),
}

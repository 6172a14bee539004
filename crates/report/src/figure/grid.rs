use srflow_core::Image;

/// A figure: rows of panels, with legends below.
#[derive(Debug, Clone, Default)]
pub struct Figure {
    pub rows: Vec<Row>,
    /// Below all rows.
    pub legends: Vec<Legend>,
}

/// Cells beside each other.
#[derive(Debug, Clone, Default)]
pub struct Row {
    /// Above each cell; rows that continue the columns of the row before have none.
    pub titles: Vec<String>,
    /// To the left of the row, upright; may be empty.
    pub label: String,
    /// One for each column: its panels from top to bottom. Cells with fewer panels than others leave the rest empty, and rows with
    /// fewer cells the columns at the end.
    pub cells: Vec<Vec<Panel>>,
    /// Below the row.
    pub legends: Vec<Legend>,
}

/// A picture with a caption.
#[derive(Debug, Clone)]
pub struct Panel {
    /// For the name of its file.
    pub name: String,
    pub picture: Image,
    /// Below the picture; may be empty.
    pub caption: String,
    /// Drawn over the picture.
    pub arrows: Vec<Arrow>,
}

/// An arrow in pixels of its picture; an integer is the centre of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrow {
    pub from: [f64; 2],
    pub to: [f64; 2],
}

/// What colours or arrows mean.
#[derive(Debug, Clone)]
pub enum Legend {
    /// A disc of colours.
    Wheel {
        /// A square that the disc fills.
        disc: Image,
        /// Two lines beside it: what it shows, and what its rim is.
        lines: [String; 2],
    },
    /// A scale of colours.
    Bar {
        label: String,
        /// One pixel high: the colours from the lower to the upper end.
        strip: Image,
        /// Places along the scale, 0 to 1, and their labels.
        ticks: Vec<(f64, String)>,
        /// Whether the pictures have values beyond the upper end.
        open: bool,
    },
    /// An arrow with its meaning.
    Arrow {
        label: String,
        /// Its length, in widths of a panel.
        length: f64,
    },
}

impl Figure {
    /// The panels from left to right and from top to bottom.
    pub fn panels(&self) -> impl Iterator<Item = &Panel> {
        self.rows.iter().flat_map(|row| {
            (0..row.depth()).flat_map(|level| row.cells.iter().filter_map(move |cell| cell.get(level)))
        })
    }

    /// As [`panels`](Self::panels).
    pub(crate) fn panels_mut(&mut self) -> Vec<&mut Panel> {
        let mut panels: Vec<((usize, usize), &mut Panel)> = Vec::new();
        for (number, row) in self.rows.iter_mut().enumerate() {
            for cell in &mut row.cells {
                panels.extend(cell.iter_mut().enumerate().map(|(level, panel)| ((number, level), panel)));
            }
        }
        panels.sort_by_key(|(place, _)| *place); // stable: columns stay in order
        panels.into_iter().map(|(_, panel)| panel).collect()
    }
}

impl Row {
    /// Number of panels in the highest cell.
    pub(crate) fn depth(&self) -> usize {
        self.cells.iter().map(Vec::len).max().unwrap_or(0)
    }
}

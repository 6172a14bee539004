//! What is read of a spreadsheet, and how much.

use std::collections::BTreeMap;

/// Text of the cells by row and column, both from 0, without empty cells.
pub type Cells = BTreeMap<u32, BTreeMap<u32, String>>;

pub const MAX_SHEETS: usize = 64;
/// Limits on rows and columns; what is beyond is not read.
const MAX_ROWS: u32 = 100_000;
const MAX_COLUMNS: u32 = 256;

/// Limits on what is kept of a workbook. The published ones contain up to 35,000 cells.
pub struct Budget {
    cells: usize,
    /// Bytes of the cells' text: many cells may share one string of the file.
    text: usize,
}

impl Budget {
    pub const WHOLE: Self = Self { cells: 500_000, text: 32 << 20 };

    /// Keeps a cell that holds any text.
    ///
    /// # Errors
    /// When the limits are reached.
    pub fn keep(&mut self, cells: &mut Cells, (row, column): (u32, u32), text: &str) -> Result<(), String> {
        if row >= MAX_ROWS || column >= MAX_COLUMNS || text.trim().is_empty() {
            return Ok(());
        }
        match (self.cells.checked_sub(1), self.text.checked_sub(text.len())) {
            (Some(cells), Some(bytes)) => (self.cells, self.text) = (cells, bytes),
            _ => {
                let Self { cells, text } = Self::WHOLE;
                return Err(format!("more than {cells} cells or {} MiB of text", text >> 20));
            }
        }
        cells.entry(row).or_default().insert(column, text.to_owned());
        Ok(())
    }
}

/// A number in its shortest form: whole numbers without a fraction, for frame numbers.
pub fn number_text(number: f64) -> String {
    number.to_string()
}

//! Tables in text files whose first row names the columns, as spreadsheets, pandas, R and trackers write them.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use srflow_core::excerpts;

use crate::{FileError, FileKind, FileProblem, read_text};

/// A table, read row by row.
///
/// Cells are separated by commas, semicolons, tabs or bars, whichever the first row has most of. Numbers in a table that is not separated
/// by commas may have a decimal comma. A byte order mark, Excel's line `sep=;`, blank rows, and spaces and quotes around cells are left
/// out.
#[derive(Debug)]
pub struct CsvTable {
    path: PathBuf,
    columns: Vec<String>,
    first_line: usize,
    reader: csv::Reader<Cursor<String>>,
    record: csv::StringRecord,
    decimal_comma: bool,
    /// A place in the text, and its line.
    counted: (usize, usize),
}

/// A row of a [`CsvTable`].
#[derive(Debug)]
pub struct CsvRow<'a> {
    /// Line of the file in which it starts, from 1.
    pub line: usize,
    columns: &'a [String],
    record: &'a csv::StringRecord,
    decimal_comma: bool,
}

impl CsvTable {
    /// Opens a file and reads the names of its columns; an empty file has none.
    ///
    /// # Errors
    /// When the file cannot be read, or is not UTF-8.
    pub fn open(path: &Path, kind: FileKind) -> Result<Self, FileError> {
        let mut text = read_text(path, kind)?;
        let mark = text.len() - text.trim_start_matches('\u{feff}').len();
        text.drain(..mark);
        let mut line = 1;
        let mut separator = None;
        // Excel's word for the separator of the rows below.
        if let Some(rest) = text.strip_prefix("sep=")
            && let Some(end) = rest.find('\n')
            && let [byte] = rest[..end].trim_end_matches('\r').as_bytes()
        {
            separator = Some(*byte);
            text.drain(.."sep=".len() + end + 1);
            line = 2;
        }
        let header = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
        let separator = separator.unwrap_or_else(|| separator_of(header));
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(separator)
            .from_reader(Cursor::new(text));
        let mut table = Self {
            path: path.to_owned(),
            columns: Vec::new(),
            first_line: line,
            reader,
            record: csv::StringRecord::new(),
            decimal_comma: separator != b',',
            counted: (0, line),
        };
        if let Some(row) = table.next_row()? {
            let first_line = row.line;
            let columns = row.cells().map(str::to_owned).collect();
            (table.columns, table.first_line) = (columns, first_line);
        }
        Ok(table)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names of the columns, as the file spells them.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// Line of the row that names the columns.
    pub fn first_line(&self) -> usize {
        self.first_line
    }

    /// Place of the column of this name, spelled exactly so or, where none is, in other case.
    ///
    /// # Errors
    /// When several columns have the name.
    pub fn column(&self, name: &str) -> Result<Option<usize>, FileError> {
        let exactly = self.places(|column| column == name);
        let found = match exactly.is_empty() {
            true => self.places(|column| column.eq_ignore_ascii_case(name)),
            false => exactly,
        };
        match found[..] {
            [] => Ok(None),
            [one] => Ok(Some(one)),
            _ => {
                let expected = format!("one column `{name}`");
                let found = format!("{} of them", found.len());
                Err(FileProblem::field("header", expected, found).in_file(&self.path))
            }
        }
    }

    fn places(&self, is: impl Fn(&str) -> bool) -> Vec<usize> {
        (0..self.columns.len()).filter(|place| is(&self.columns[*place])).collect()
    }

    /// The columns, for messages.
    pub fn shown_columns(&self) -> String {
        match self.columns.len() {
            0 => "an empty file".to_owned(),
            _ => format!("the columns {}", excerpts(self.columns.iter().map(String::as_str), 12)),
        }
    }

    /// The next row that is not blank; `None` at the end.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn next_row(&mut self) -> Result<Option<CsvRow<'_>>, FileError> {
        loop {
            let more = self.reader.read_record(&mut self.record).map_err(|error| {
                let found = error.to_string();
                FileProblem::field("table", "rows of separated cells", found).in_file(&self.path)
            })?;
            if !more {
                return Ok(None);
            }
            if self.record.iter().any(|cell| !bare(cell).is_empty()) {
                break;
            }
        }
        let start = self.record.position().map_or(0, csv::Position::byte);
        let line = self.line_at(usize::try_from(start).unwrap_or(usize::MAX));
        let Self { columns, record, decimal_comma, .. } = self;
        Ok(Some(CsvRow { line, columns, record, decimal_comma: *decimal_comma }))
    }

    /// The line of the first row at or after this byte.
    fn line_at(&mut self, start: usize) -> usize {
        let text = self.reader.get_ref().get_ref().as_bytes();
        let start = start.min(text.len());
        let blank = text[start..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
        let (from, line) = self.counted;
        let to = (start + blank).max(from);
        let line = line + text[from..to].iter().filter(|byte| **byte == b'\n').count();
        self.counted = (to, line);
        line
    }
}

impl CsvRow<'_> {
    /// Number of cells, which may differ from that of columns.
    pub fn count(&self) -> usize {
        self.record.len()
    }

    pub fn cells(&self) -> impl Iterator<Item = &str> {
        self.record.iter().map(bare)
    }

    /// The text of a cell; empty where the row is shorter.
    pub fn text(&self, column: usize) -> &str {
        self.record.get(column).map_or("", bare)
    }

    /// The number in a cell; `None` where it is empty, not finite, or a word for a missing value.
    ///
    /// # Errors
    /// When it holds something else.
    pub fn number(&self, column: usize) -> Result<Option<f64>, FileProblem> {
        let text = self.text(column);
        if is_missing(text) {
            return Ok(None);
        }
        let parsed: Result<f64, _> = match self.decimal_comma && !text.contains('.') {
            true => text.replace(',', ".").parse(),
            false => text.parse(),
        };
        let finite = |number: f64| number.is_finite().then_some(number);
        parsed.map(finite).map_err(|_| self.wrong(column, "a number"))
    }

    /// An error about a cell.
    pub fn wrong(&self, column: usize, expected: impl Into<String>) -> FileProblem {
        FileProblem::Cell {
            row: self.line,
            column: self.columns.get(column).cloned().unwrap_or_default(),
            expected: expected.into(),
            found: self.text(column).to_owned(),
        }
    }
}

/// A whole number, also as programs write it whose columns hold fractions, such as `19.0`.
pub fn whole_number(text: &str) -> Option<u64> {
    let (whole, fraction) = text.trim().split_once('.').unwrap_or((text.trim(), ""));
    fraction.bytes().all(|digit| digit == b'0').then(|| whole.parse().ok()).flatten()
}

/// A cell without the spaces and quotes around it. Quotes after a space are no quotes to the parser.
fn bare(cell: &str) -> &str {
    let cell = cell.trim();
    cell.strip_prefix('"').and_then(|cell| cell.strip_suffix('"')).map_or(cell, str::trim)
}

fn is_missing(text: &str) -> bool {
    let sign_left = text.trim_start_matches(['-', '+']);
    let starts_nan = sign_left.get(..3).is_some_and(|start| start.eq_ignore_ascii_case("nan"));
    // C's printf writes `-nan(ind)`.
    let is_nan = starts_nan && matches!(sign_left.as_bytes().get(3), None | Some(b'('));
    let words = ["", "NA", "N/A", "#N/A", "null", "None"];
    is_nan || words.iter().any(|word| text.eq_ignore_ascii_case(word))
}

fn separator_of(header: &str) -> u8 {
    let count = |separator: u8| {
        let mut inside = false;
        let outside = header.bytes().filter(|byte| {
            inside ^= *byte == b'"';
            !inside && *byte == separator
        });
        outside.count()
    };
    let mut best = (b',', count(b','));
    for separator in *b";\t|" {
        if count(separator) > best.1 {
            best = (separator, count(separator));
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> (Vec<String>, Vec<(usize, Vec<String>)>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, text).unwrap();
        let mut table = CsvTable::open(&path, FileKind::Table).unwrap();
        let mut rows = Vec::new();
        while let Some(row) = table.next_row().unwrap() {
            rows.push((row.line, row.cells().map(str::to_owned).collect()));
        }
        (table.columns().to_vec(), rows)
    }

    #[test]
    fn tables_of_spreadsheets_and_programs_are_alike() {
        let expected = (
            vec!["frame".to_owned(), "x 0".to_owned()],
            vec![(2, vec!["1".to_owned(), "2.5".to_owned()]), (4, vec!["2".to_owned(), String::new()])],
        );
        for text in [
            "frame,x 0\n1,2.5\n\n2,\n",
            "\u{feff}frame,x 0\r\n1,2.5\r\n\r\n2,\r\n",
            "frame, \"x 0\"\n 1 , \"2.5\"\n,\n2,",
            "frame;x 0\n1;2.5\n;;\n2;",
            "\"frame\"\t\"x 0\"\n1\t2.5\n\t\n2\t\n",
        ] {
            assert_eq!(rows(text), expected, "{text:?}");
        }
        let (columns, found) = rows("\u{feff}sep=;\nframe;x,y\n1;2,5\n");
        assert_eq!((columns[1].as_str(), found[0].0, found[0].1[1].as_str()), ("x,y", 3, "2,5"));
        assert_eq!(rows("").0, [""; 0]);
        assert_eq!(rows("a,b\n\"1\n2\",3\n4,5\n").1[1].0, 4, "a cell of two lines");
    }

    #[test]
    fn numbers_may_have_a_decimal_comma_or_be_missing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let numbers = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let mut table = CsvTable::open(&path, FileKind::Table).unwrap();
            let row = table.next_row().unwrap().expect("a row");
            let numbers: Result<Vec<_>, _> = (0..row.count()).map(|column| row.number(column)).collect();
            numbers.map_err(|problem| problem.to_string())
        };
        assert_eq!(numbers("a;b;c\n1,5;-2.5;3\n"), Ok(vec![Some(1.5), Some(-2.5), Some(3.0)]));
        let missing = numbers("a,b,c,d,e,f\n1,,NaN,-nan(ind),NA,inf\n");
        assert_eq!(missing, Ok(vec![Some(1.0), None, None, None, None, None]));
        assert_eq!(numbers("a,b\n1,\"2,5\"\n"), Err("row 2, b: expected a number, found `2,5`".to_owned()));
        assert_eq!(
            numbers("a,b\n1,nano\u{7}\n").unwrap_err(),
            "row 2, b: expected a number, found `nano\\u{7}`"
        );
    }

    #[test]
    fn columns_are_found_in_any_case_and_must_be_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, "X_0,x_0,Frame,a,A,a\n").unwrap();
        let table = CsvTable::open(&path, FileKind::Table).unwrap();
        let found = ["x_0", "X_0", "frame", "A", "b"].map(|name| table.column(name).unwrap());
        assert_eq!(found, [Some(1), Some(0), Some(2), Some(4), None]);
        let twice = table.column("a").unwrap_err().to_string();
        assert!(twice.contains("header: expected one column `a`, found 2 of them"), "{twice}");
    }

    #[test]
    fn whole_numbers_may_have_a_fraction_of_zeros() {
        let numbers =
            ["19", " 19.0 ", "19.", "0.00", "19.5", "-1", "", ".0", "1e3", "19.0.0"].map(whole_number);
        let (nineteen, none) = (Some(19), None);
        assert_eq!(numbers, [nineteen, nineteen, nineteen, Some(0), none, none, none, none, none, none]);
    }
}

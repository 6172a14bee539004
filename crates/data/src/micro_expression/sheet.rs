//! Annotation tables: the published spreadsheets, and CSV files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use srflow_core::{excerpt, excerpts};
use srflow_files::{CsvTable, FileKind, read_file, whole_number};

use super::MicroExpressionError;
use super::cells::Cells;
use super::forms::{FORMS, Form};
use super::source::ClipSource;
use super::{xls, xlsx};
use crate::listing;

/// Number of rows in which the header is looked for.
const HEADER_ROWS: u32 = 40;

/// The first bytes of the files of old Office programs, whatever their names end in.
const COMPOUND: &[u8] = b"\xd0\xcf\x11\xe0";

/// A table with named columns.
#[derive(Debug)]
pub struct Table {
    pub path: PathBuf,
    columns: BTreeMap<String, u32>,
    rows: Vec<(usize, BTreeMap<u32, String>)>,
}

/// One row of a table.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    table: &'a Table,
    number: usize,
    cells: &'a BTreeMap<u32, String>,
}

impl Table {
    /// The non-empty rows below the header.
    pub fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        self.rows.iter().map(|(number, cells)| Row { table: self, number: *number, cells })
    }

    fn of(path: &Path, columns: BTreeMap<String, u32>, rows: Cells, header: u32) -> Self {
        let below = rows.into_iter().filter(|(row, _)| *row > header);
        Self {
            path: path.to_owned(),
            columns,
            rows: below.map(|(row, cells)| (row as usize + 1, cells)).collect(),
        }
    }
}

impl<'a> Row<'a> {
    /// The trimmed text of a column; empty if the cell or the column is.
    pub fn text(self, column: &str) -> &'a str {
        let at = self.table.columns.get(&header_key(column));
        at.and_then(|at| self.cells.get(at)).map_or("", |text| text.trim())
    }

    /// The frame number of a column.
    pub fn frame(self, column: &str) -> Result<u64, MicroExpressionError> {
        let text = self.text(column);
        let wrong = || self.wrong(format!("{column}: expected a frame number, found `{text}`"));
        whole_number(text).ok_or_else(wrong)
    }

    /// The text of a required column.
    pub fn filled(self, column: &str) -> Result<&'a str, MicroExpressionError> {
        match self.text(column) {
            "" => Err(self.wrong(format!("{column}: expected a value, found an empty cell"))),
            text => Ok(text),
        }
    }

    /// Number of the row in its file, from 1.
    pub fn number(self) -> usize {
        self.number
    }

    /// An error about this row.
    pub fn wrong(self, reason: String) -> MicroExpressionError {
        MicroExpressionError::Row {
            path: self.table.path.clone(),
            row: self.number,
            reason: excerpt(&reason),
        }
    }
}

/// Reads the spreadsheet of `source`, or the matching one in its folder.
pub fn read_spreadsheet(form: &Form, source: &ClipSource) -> Result<Table, MicroExpressionError> {
    if let Some(path) = &source.annotations {
        return read_form(form, path);
    }
    match spreadsheet_in(form, &source.dir)? {
        Some(table) => Ok(table),
        None => Err(none_fits(form, &source.dir)),
    }
}

/// All spreadsheets of this form in the folder of `source`, or the one that it names.
pub fn read_spreadsheets(form: &Form, source: &ClipSource) -> Result<Vec<Table>, MicroExpressionError> {
    if let Some(path) = &source.annotations {
        return Ok(vec![read_form(form, path)?]);
    }
    let tables = spreadsheets_in(form, &source.dir)?;
    if tables.is_empty() { Err(none_fits(form, &source.dir)) } else { Ok(tables) }
}

/// The spreadsheet of this form in a folder, or the CSV file, if there is one.
pub fn spreadsheet_in(form: &Form, dir: &Path) -> Result<Option<Table>, MicroExpressionError> {
    let mut fitting = spreadsheets_in(form, dir)?;
    if let [first, second, ..] = &fitting[..] {
        let found = format!(
            "both {} and {} match: choose one with `annotations` {}:FILE",
            listing::name(&first.path),
            listing::name(&second.path),
            form.kind
        );
        return Err(no_annotations(form, dir, found));
    }
    Ok(fitting.pop())
}

/// The .xlsx spreadsheets of this form in a folder, or else the .xls ones, or else the CSV files.
fn spreadsheets_in(form: &Form, dir: &Path) -> Result<Vec<Table>, MicroExpressionError> {
    for ending in ["xlsx", "xls"] {
        let mut fitting: Vec<Table> = Vec::new();
        for path in spreadsheet_files(dir, &[ending])? {
            match read_form(form, &path) {
                Ok(table) => fitting.push(table),
                Err(MicroExpressionError::Columns { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        if !fitting.is_empty() {
            return Ok(fitting);
        }
    }
    let tables = listing::files(dir, &["csv"])?;
    Ok(tables.iter().filter_map(|path| read_form(form, path).ok()).collect())
}

/// The spreadsheets in a folder.
pub fn spreadsheet_files(dir: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, MicroExpressionError> {
    let mut files = listing::files(dir, endings)?;
    // Names that start with ~$ are lock files of office programs.
    files.retain(|path| !listing::name(path).starts_with("~$"));
    Ok(files)
}

/// No spreadsheet of this form is in a folder.
pub fn none_fits(form: &Form, dir: &Path) -> MicroExpressionError {
    let spreadsheets = listing::files(dir, &["xlsx", "xls"]).unwrap_or_default();
    let names: Vec<String> = spreadsheets.iter().map(|path| listing::name(path)).collect();
    let there = match &names[..] {
        [] => "there is no spreadsheet".to_owned(),
        [only] => match read_form(form, &spreadsheets[0]) {
            Err(error) => format!("{only} is not it: {error}"),
            Ok(_) => String::new(),
        },
        _ => format!("none of {} is it", names.join(", ")),
    };
    no_annotations(
        form,
        dir,
        format!("{there}. Put it there, or give it with `annotations` {}:FILE", form.kind),
    )
}

fn no_annotations(form: &Form, dir: &Path, found: String) -> MicroExpressionError {
    MicroExpressionError::NoAnnotations { kind: form.kind, dir: dir.to_owned(), expected: form.called, found }
}

/// Reads a spreadsheet of one form: the first sheet with its header row.
pub fn read_form(form: &Form, path: &Path) -> Result<Table, MicroExpressionError> {
    let sheets = read_sheets(path)?;
    for rows in &sheets {
        if let Some((header, columns)) = header_of(rows, form.columns) {
            return Ok(Table::of(path, columns, rows.clone(), header));
        }
    }
    let fits = |other: &&&Form| sheets.iter().any(|rows| header_of(rows, other.columns).is_some());
    let found = match FORMS.iter().find(fits) {
        Some(other) => format!("these are those of {}; give the file of {}", other.called, form.called),
        None => match sheets.iter().flat_map(BTreeMap::values).find(|row| row.len() > 2) {
            Some(row) => {
                format!("the first full row holds {}", excerpts(row.values().map(String::as_str), 8))
            }
            None => "its sheets are empty".to_owned(),
        },
    };
    Err(MicroExpressionError::Columns {
        path: path.to_owned(),
        kind: form.kind,
        expected: form.columns.join(", "),
        found,
    })
}

/// The row that contains all `columns`, and the position of each name in it.
fn header_of(rows: &Cells, columns: &[&str]) -> Option<(u32, BTreeMap<String, u32>)> {
    rows.range(..HEADER_ROWS).find_map(|(row, cells)| {
        let mut named = BTreeMap::new();
        for (column, text) in cells {
            named.entry(header_key(text)).or_insert(*column);
        }
        columns.iter().all(|column| named.contains_key(&header_key(column))).then_some((*row, named))
    })
}

/// Spaces inside a name count: `Onset Frame` is SAMM's and `OnsetFrame` CASME II's.
fn header_key(text: &str) -> String {
    text.trim().trim_start_matches('\u{feff}').to_lowercase()
}

/// The sheets of a spreadsheet, or the only one of a CSV file.
pub fn read_sheets(path: &Path) -> Result<Vec<Cells>, MicroExpressionError> {
    if listing::has_ending(path, &["csv"]) {
        return Ok(vec![csv_sheet(path)?]);
    }
    let bytes = read_file(path, FileKind::Spreadsheet)?;
    let wrong = |form: &str, reason: String| MicroExpressionError::Table {
        path: path.to_owned(),
        reason: format!("expected a valid {form} spreadsheet: {}", excerpt(&reason)),
    };
    match bytes.starts_with(COMPOUND) {
        true => xls::read_workbook(bytes).map_err(|reason| wrong(".xls", reason)),
        false => xlsx::read_workbook(bytes).map_err(|reason| wrong(".xlsx", reason)),
    }
}

/// All rows of a CSV file.
fn csv_sheet(path: &Path) -> Result<Cells, MicroExpressionError> {
    let filled = |cells: &mut dyn Iterator<Item = &str>| -> BTreeMap<u32, String> {
        let cells = (0..).zip(cells).filter(|(_, text)| !text.is_empty());
        cells.map(|(at, text)| (at, text.to_owned())).collect()
    };
    let place = |line: usize| u32::try_from(line.saturating_sub(1)).unwrap_or(u32::MAX);
    let mut table = CsvTable::open(path, FileKind::Table)?;
    let header = filled(&mut table.columns().iter().map(String::as_str));
    let mut rows = Cells::from([(place(table.first_line()), header)]);
    while let Some(row) = table.next_row()? {
        rows.insert(place(row.line), filled(&mut row.cells()));
    }
    Ok(rows)
}

/// Reads a CSV file whose header contains at least `columns`.
pub fn read_csv(kind: &'static str, path: &Path, columns: &[&str]) -> Result<Table, MicroExpressionError> {
    let rows = csv_sheet(path)?;
    let first = Cells::from_iter(rows.first_key_value().map(|(row, cells)| (*row, cells.clone())));
    match header_of(&first, columns) {
        Some((header, names)) => Ok(Table::of(path, names, rows, header)),
        None => Err(MicroExpressionError::Columns {
            path: path.to_owned(),
            kind,
            expected: columns.join(", "),
            found: match first.first_key_value() {
                Some((_, cells)) if !cells.is_empty() => {
                    format!("its first row holds {}", excerpts(cells.values().map(String::as_str), 20))
                }
                _ => "it is empty".to_owned(),
            },
        }),
    }
}

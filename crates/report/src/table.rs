//! Tables of scores with the best three of every column marked, as in the SRFlow paper (Table II).

use std::borrow::Cow;
use std::fmt::Write;

use serde::{Deserialize, Serialize};

/// The direction in which a score improves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// Smaller is better: an error.
    Lower,
    /// Larger is better: a share of correct pixels.
    Higher,
}

impl Better {
    /// The arrow that tables print after the name of a score.
    pub fn arrow(self) -> char {
        match self {
            Better::Lower => '↓',
            Better::Higher => '↑',
        }
    }
}

/// One column of a [`Table`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Name in the CSV header.
    pub key: String,
    /// Name in other tables, without the arrow.
    pub header: String,
    /// Which way is better; `None` for a column that is not ranked.
    pub better: Option<Better>,
    /// Decimal places shown. Ranks compare the rounded values, so that values that look equal get equal marks.
    pub decimals: usize,
}

/// One row of a [`Table`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The name of the row: a method.
    pub name: String,
    /// One value per column, at full precision; `None` where nothing was measured.
    pub values: Vec<Option<f64>>,
    /// A baseline is shown for reference and never ranked.
    pub baseline: bool,
}

/// The rank of a value in its column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// Bold blue in the paper.
    Best,
    /// Blue in the paper.
    Second,
    /// Underlined in the paper.
    Third,
}

/// Rows of scores under named columns.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Table {
    /// Title.
    pub title: String,
    /// The columns, except that of the row names.
    pub columns: Vec<Column>,
    /// The rows, in the order they are shown.
    pub rows: Vec<Row>,
    /// By row and column, what a test found best or no worse than the best: it is marked in place of the best three. A column
    /// without any is not decided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tested: Option<Vec<Vec<bool>>>,
    /// What a reader of the rows must know, a sentence each; shown below them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// How [`Table::text`] shows the marks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextStyle {
    /// `**`, `*` and `_` after the value.
    Plain,
    /// Colours and underlines of an ANSI terminal, as in the paper.
    Ansi,
}

impl Table {
    /// The mark of every value, `marks[row][column]`.
    ///
    /// Equal values share a rank and use up the following ones (1, 1, 3), as in the paper's Table IV. Ranks compare
    /// rounded values; baselines, missing and non-finite values have none.
    pub fn marks(&self) -> Vec<Vec<Option<Mark>>> {
        let mut marks = vec![vec![None; self.columns.len()]; self.rows.len()];
        if let Some(tested) = &self.tested {
            for (marks, tested) in marks.iter_mut().zip(tested) {
                for (mark, best) in marks.iter_mut().zip(tested) {
                    *mark = best.then_some(Mark::Best);
                }
            }
            return marks;
        }
        for (c, column) in self.columns.iter().enumerate() {
            let Some(better) = column.better else { continue };
            // The shown digits as a number, negated where larger is better, so that smaller is always better.
            let key = |row: &Row| -> Option<f64> {
                let value = row.value(c).filter(|value| value.is_finite() && !row.baseline)?;
                let shown: f64 = format!("{value:.*}", column.decimals).parse().ok()?;
                Some(if better == Better::Higher { -shown } else { shown })
            };
            let keys: Vec<Option<f64>> = self.rows.iter().map(key).collect();
            for (r, own) in keys.iter().enumerate() {
                let Some(own) = own else { continue };
                marks[r][c] = match keys.iter().flatten().filter(|other| *other < own).count() {
                    0 => Some(Mark::Best),
                    1 => Some(Mark::Second),
                    2 => Some(Mark::Third),
                    _ => None,
                };
            }
        }
        marks
    }

    /// What marks say, in the order of [`Mark`]; nothing where no value has one.
    pub fn legend(&self) -> &'static [(Mark, &'static str)] {
        match &self.tested {
            _ if !self.ranked() => &[],
            None => &[(Mark::Best, "best"), (Mark::Second, "second"), (Mark::Third, "third")],
            Some(tested) if tested.iter().flatten().any(|marked| *marked) => {
                &[(Mark::Best, "best, or not significantly different (paired test over subjects)")]
            }
            Some(_) => &[],
        }
    }

    /// Whether any column is ranked: the rows of such a table are methods.
    pub fn ranked(&self) -> bool {
        self.columns.iter().any(|column| column.better.is_some())
    }

    /// For a terminal: the title, aligned columns, and a legend of the marks where there are any.
    pub fn text(&self, style: TextStyle) -> String {
        let marks = self.marks();
        let mut cells: Vec<Vec<String>> = vec![self.headers()];
        for (row, marks) in self.rows.iter().zip(&marks) {
            let mut line = vec![srflow_core::excerpt(&row.name)];
            for ((c, column), mark) in self.columns.iter().enumerate().zip(marks) {
                line.push(format!("{}{}", column.show(row.value(c)), plain_suffix(style, *mark)));
            }
            cells.push(line);
        }
        let widths: Vec<usize> = (0..=self.columns.len())
            .map(|c| cells.iter().map(|line| line[c].chars().count()).max().unwrap_or(0))
            .collect();

        let mut out = format!("{}\n\n", srflow_core::excerpt(&self.title));
        for (r, line) in cells.iter().enumerate() {
            for (c, cell) in line.iter().enumerate() {
                let pad = " ".repeat(widths[c] - cell.chars().count());
                let mark =
                    (style == TextStyle::Ansi && r > 0 && c > 0).then(|| marks[r - 1][c - 1]).flatten();
                let (on, off) = mark.map_or(("", ""), ansi);
                match c {
                    0 => write!(out, "  {cell}{pad}"),
                    _ => write!(out, "  {pad}{on}{cell}{off}"),
                }
                .expect("writing to a string");
            }
            out.truncate(out.trim_end().len());
            out.push('\n');
            if r == 0 {
                let rule = widths.iter().sum::<usize>() + 2 * self.columns.len();
                out.push_str(&format!("  {}\n", "─".repeat(rule)));
            }
        }
        let legend = self.legend();
        if legend.is_empty() && self.notes.is_empty() {
            return out;
        }
        out.push('\n');
        self.notes.iter().for_each(|note| out += &format!("  {}\n", srflow_core::excerpt(note)));
        if legend.is_empty() {
            return out;
        }
        let word = |(mark, text): &(Mark, &str)| match style {
            TextStyle::Plain => format!("{text} {}", plain_suffix(style, Some(*mark)).trim_end()),
            TextStyle::Ansi => format!("{}{text}{}", ansi(*mark).0, ansi(*mark).1),
        };
        out.push_str(&format!("  {}\n", legend.iter().map(word).collect::<Vec<_>>().join("   ")));
        out
    }

    /// Comma-separated values at full precision: `method` and the columns' keys, then one line per row. A missing value is an
    /// empty field.
    pub fn csv(&self) -> String {
        let head = std::iter::once("method".to_owned()).chain(self.columns.iter().map(|c| c.key.clone()));
        let lines = self.rows.iter().map(|row| {
            let values =
                (0..self.columns.len()).map(|c| row.value(c).map_or(String::new(), |v| v.to_string()));
            std::iter::once(row.name.clone()).chain(values).collect::<Vec<_>>()
        });
        csv_text(std::iter::once(head.collect()).chain(lines))
    }

    /// A Markdown table: best bold, second italic, third underlined.
    pub fn markdown(&self) -> String {
        let mut out = format!(
            "| {} |\n|:--",
            self.headers().iter().map(|header| markdown_escape(header)).collect::<Vec<_>>().join(" | ")
        );
        out.push_str(&"|--:".repeat(self.columns.len()));
        out.push_str("|\n");
        for (row, marks) in self.rows.iter().zip(self.marks()) {
            out.push_str(&format!("| {}", markdown_escape(&row.name)));
            for ((c, column), mark) in self.columns.iter().enumerate().zip(marks) {
                let shown = column.show(row.value(c));
                out.push_str(&match mark {
                    Some(Mark::Best) => format!(" | **{shown}**"),
                    Some(Mark::Second) => format!(" | *{shown}*"),
                    Some(Mark::Third) => format!(" | <u>{shown}</u>"),
                    None => format!(" | {shown}"),
                });
            }
            out.push_str(" |\n");
        }
        self.notes.iter().for_each(|note| out += &format!("\n{}\n", markdown_escape(note)));
        out
    }

    /// A LaTeX `tabular` in the paper's style; needs the packages listed by [`latex_file`].
    pub fn latex(&self) -> String {
        let mut out = format!("\\begin{{tabular}}{{l*{{{}}}c}}\n\\toprule\n", self.columns.len());
        let headers: Vec<String> = self.headers().iter().map(|header| latex_header(header)).collect();
        out.push_str(&format!("{} \\\\\n\\midrule\n", headers.join(" & ")));
        for (row, marks) in self.rows.iter().zip(self.marks()) {
            out.push_str(&latex_escape(&row.name));
            for ((c, column), mark) in self.columns.iter().enumerate().zip(marks) {
                let shown = column.show(row.value(c));
                out.push_str(&match mark {
                    Some(Mark::Best) => format!(" & \\textcolor{{blue}}{{\\textbf{{{shown}}}}}"),
                    Some(Mark::Second) => format!(" & \\textcolor{{blue}}{{{shown}}}"),
                    Some(Mark::Third) => format!(" & \\uline{{{shown}}}"),
                    None => format!(" & {shown}"),
                });
            }
            out.push_str(" \\\\\n");
        }
        out.push_str("\\bottomrule\n");
        for note in &self.notes {
            let columns = self.columns.len() + 1;
            out += &format!("\\multicolumn{{{columns}}}{{l}}{{{}}} \\\\\n", latex_escape(note));
        }
        out.push_str("\\end{tabular}\n");
        out
    }

    /// Header above the row names.
    pub(crate) fn row_header(&self) -> &'static str {
        if self.ranked() { "Methods" } else { "" }
    }

    /// All headers, with their arrows.
    fn headers(&self) -> Vec<String> {
        std::iter::once(self.row_header().to_owned()).chain(self.columns.iter().map(Column::title)).collect()
    }
}

impl Row {
    /// The value of a column; a row that is too short has none.
    pub fn value(&self, column: usize) -> Option<f64> {
        self.values.get(column).copied().flatten()
    }
}

impl Column {
    /// A column whose best values are marked; its numbers have four digits behind the point.
    pub fn ranked(key: &str, header: &str, better: Better) -> Self {
        Self { better: Some(better), ..Self::plain(key, header, 4) }
    }

    /// A column without ranks.
    pub fn plain(key: &str, header: &str, decimals: usize) -> Self {
        Self { key: key.to_owned(), header: header.to_owned(), better: None, decimals }
    }

    /// The header with the arrow of the better direction.
    pub fn title(&self) -> String {
        match self.better {
            Some(better) => format!("{} {}", self.header, better.arrow()),
            None => self.header.clone(),
        }
    }

    /// A value as shown; a dash where there is none.
    pub fn show(&self, value: Option<f64>) -> String {
        value.map_or("–".to_owned(), |value| format!("{value:.*}", self.decimals))
    }
}

/// Lines of fields as CSV (RFC 4180, lines ended by a line feed), none of which is a formula; see [`csv_cell`].
pub fn csv_text(lines: impl Iterator<Item = Vec<String>>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for line in lines {
        let cells = line.iter().map(|cell| csv_cell(cell).into_owned());
        writer.write_record(cells).expect("lines of equal length go to memory");
    }
    let bytes = writer.into_inner().expect("memory does not fail");
    String::from_utf8(bytes).expect("fields are strings")
}

fn plain_suffix(style: TextStyle, mark: Option<Mark>) -> &'static str {
    // Suffixes of equal width keep the decimal points of a column aligned.
    match (style, mark) {
        (TextStyle::Ansi, _) => "",
        (TextStyle::Plain, Some(Mark::Best)) => "**",
        (TextStyle::Plain, Some(Mark::Second)) => "* ",
        (TextStyle::Plain, Some(Mark::Third)) => "_ ",
        (TextStyle::Plain, None) => "  ",
    }
}

/// Escape sequences before and after a marked value.
fn ansi(mark: Mark) -> (&'static str, &'static str) {
    match mark {
        Mark::Best => ("\x1b[1;34m", "\x1b[0m"),
        Mark::Second => ("\x1b[34m", "\x1b[0m"),
        Mark::Third => ("\x1b[4m", "\x1b[0m"),
    }
}

/// Tables in one format, one after another.
pub fn joined(tables: &[Table], form: impl Fn(&Table) -> String) -> String {
    tables.iter().map(form).collect::<Vec<_>>().join("\n")
}

/// Tables as Markdown, each under its title.
pub fn markdown_file(tables: &[Table]) -> String {
    joined(tables, |table| format!("{}\n\n{}", markdown_escape(&table.title), table.markdown()))
}

/// Text as Markdown on one line that shows it as it is: markup, HTML and links are escaped.
pub fn markdown_escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '|' | '&' | '#' | '~' => {
                escaped.extend(['\\', character])
            }
            _ if character.is_control() => escaped.push(' '),
            _ => escaped.push(character),
        }
    }
    escaped
}

/// A cell as text in spreadsheets, which take what begins with `=`, `+`, `-` or `@` and is no number for a formula: after an apostrophe.
pub fn csv_cell(text: &str) -> Cow<'_, str> {
    if is_formula(text) { format!("'{text}").into() } else { text.into() }
}

/// The text of a [`csv_cell`].
pub fn csv_value(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|text| is_formula(text)).unwrap_or(cell)
}

fn is_formula(text: &str) -> bool {
    text.starts_with(['=', '+', '-', '@', '\t', '\r']) && text.parse::<f64>().is_err()
}

/// A file for `\input`: a comment with the required packages, then each `tabular` under its title as a comment.
pub fn latex_file(tables: impl IntoIterator<Item = (String, String)>) -> String {
    const PACKAGES: &str =
        "% \\usepackage{booktabs}\n% \\usepackage[table]{xcolor}\n% \\usepackage[normalem]{ulem}\n";
    let one_line = |title: &str| title.split_whitespace().collect::<Vec<_>>().join(" ");
    let tables = tables.into_iter().map(|(title, tabular)| format!("\n% {}\n{tabular}", one_line(&title)));
    std::iter::once(PACKAGES.to_owned()).chain(tables).collect()
}

/// `F1_μ ↑` as `$F1_\mu$ $\uparrow$`: a symbol with a subscript is set in math mode.
fn latex_header(header: &str) -> String {
    let (symbol, rest) = header.split_once(' ').unwrap_or((header, ""));
    let rest = if rest.is_empty() { String::new() } else { format!(" {}", latex_escape(rest)) };
    match symbol.split_once('_') {
        Some((base, "μ")) => format!("${}_\\mu${rest}", latex_escape(base)),
        Some((base, sub)) if sub.len() == 1 => format!("${}_{sub}${rest}", latex_escape(base)),
        _ => latex_escape(header),
    }
}

/// Escapes text for LaTeX; characters that stock pdflatex has no glyph for stay as they are.
pub fn latex_escape(text: &str) -> String {
    let mut out = String::new();
    for character in text.chars() {
        match character {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', character]),
            '\\' => out.push_str("\\textbackslash{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '<' => out.push_str("\\textless{}"),
            '>' => out.push_str("\\textgreater{}"),
            '|' => out.push_str("\\textbar{}"),
            '↓' => out.push_str("$\\downarrow$"),
            '↑' => out.push_str("$\\uparrow$"),
            'μ' | 'µ' => out.push_str("$\\mu$"),
            _ if character.is_control() => out.push(' '),
            _ => out.push(character),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(better: Better, values: &[Option<f64>]) -> Table {
        let column = Column { key: "epe".into(), header: "EPE".into(), better: Some(better), decimals: 2 };
        let row = |(i, value): (usize, &Option<f64>)| Row {
            name: format!("m{i}"),
            values: vec![*value],
            baseline: false,
        };
        Table {
            title: "made up".into(),
            columns: vec![column],
            rows: values.iter().enumerate().map(row).collect(),
            ..Table::default()
        }
    }

    fn marks(better: Better, values: &[Option<f64>]) -> Vec<Option<Mark>> {
        table(better, values).marks().into_iter().map(|row| row[0]).collect()
    }

    #[test]
    fn the_three_best_are_marked_in_either_direction() {
        use Mark::{Best, Second, Third};
        let values = [Some(4.0), Some(1.0), Some(3.0), Some(2.0)];
        assert_eq!(marks(Better::Lower, &values), [None, Some(Best), Some(Third), Some(Second)]);
        assert_eq!(marks(Better::Higher, &values), [Some(Best), None, Some(Second), Some(Third)]);
    }

    #[test]
    fn a_table_without_ranks_has_no_legend_of_them() {
        let ranked = table(Better::Lower, &[Some(1.0)]);
        let mut counts = ranked.clone();
        counts.columns[0].better = None;
        assert!(
            ranked.text(TextStyle::Plain).contains("Methods")
                && ranked.text(TextStyle::Plain).contains("best")
        );
        let text = counts.text(TextStyle::Plain);
        assert!(text.contains("m0") && !text.contains("Methods") && !text.contains("best"), "{text}");
    }

    #[test]
    fn equal_values_share_a_rank_and_use_up_the_next() {
        use Mark::{Best, Second, Third};
        let tied_best = [Some(1.0), Some(1.0), Some(2.0), Some(3.0)];
        assert_eq!(marks(Better::Lower, &tied_best), [Some(Best), Some(Best), Some(Third), None]);
        let tied_second = [Some(1.0), Some(2.0), Some(2.0), Some(3.0)];
        assert_eq!(marks(Better::Lower, &tied_second), [Some(Best), Some(Second), Some(Second), None]);
        // Equal as shown (two digits), different behind it.
        assert_eq!(marks(Better::Lower, &[Some(0.1249), Some(0.1201)]), [Some(Best), Some(Best)]);
    }

    #[test]
    fn baselines_and_missing_values_take_no_rank() {
        let values = [Some(0.5), None, Some(f64::NAN), Some(1.0)];
        assert_eq!(marks(Better::Lower, &values), [Some(Mark::Best), None, None, Some(Mark::Second)]);
        let mut with_baseline = table(Better::Lower, &values);
        with_baseline.rows[0].baseline = true;
        assert_eq!(with_baseline.marks()[0][0], None);
        assert_eq!(with_baseline.marks()[3][0], Some(Mark::Best));
    }

    #[test]
    fn text_lines_up_and_marks() {
        let text = table(Better::Lower, &[Some(10.0), Some(2.0), None]).text(TextStyle::Plain);
        assert!(text.contains("EPE ↓"), "{text}");
        assert!(text.contains("10.00*\n") && text.contains(" 2.00**\n") && text.contains("–"), "{text}");
        let ansi = table(Better::Lower, &[Some(10.0), Some(2.0)]).text(TextStyle::Ansi);
        assert!(ansi.contains("\x1b[1;34m2.00\x1b[0m"), "{ansi:?}");
    }

    #[test]
    fn csv_keeps_every_bit_and_quotes_names() {
        let mut table = table(Better::Lower, &[Some(0.1 + 0.2), None]);
        table.rows[0].name = "a, \"quoted\"\nname".into();
        let text = table.csv();
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        assert_eq!(reader.headers().unwrap(), vec!["method", "epe"]);
        let records: Vec<_> = reader.records().map(Result::unwrap).collect();
        assert_eq!(&records[0][0], table.rows[0].name);
        assert_eq!(records[0][1].parse::<f64>().unwrap(), 0.1 + 0.2);
        assert_eq!(&records[1][1], "");
    }

    #[test]
    fn no_cell_is_a_formula() {
        for text in ["=1+1", "+a", "-a", "@a", "\t=1"] {
            assert_eq!(csv_cell(text), format!("'{text}"));
            assert_eq!(csv_value(&csv_cell(text)), text);
        }
        for text in ["-0.5", "+1e-3", "-inf", "a=b", "", "'a", "–"] {
            assert_eq!((&*csv_cell(text), csv_value(text)), (text, text));
        }
        assert!(csv_text([vec!["=cmd|' /C calc'!A0".to_owned()]].into_iter()).starts_with("'=cmd"));
    }

    #[test]
    fn markdown_shows_names_as_they_are() {
        let mut table = table(Better::Lower, &[Some(1.0)]);
        table.title = "a\n# b".into();
        table.rows[0].name = "<img src=x>|[a](b) *c* `d`\n".into();
        let text = markdown_file(&[table]);
        assert!(text.starts_with("a \\# b\n\n| "), "{text}");
        assert!(text.contains("\n| \\<img src=x\\>\\|\\[a\\](b) \\*c\\* \\`d\\`  | "), "{text}");
    }

    #[test]
    fn latex_has_the_marks_of_the_paper_and_escapes() {
        let mut table = table(Better::Higher, &[Some(1.0), Some(2.0), Some(3.0)]);
        table.rows[0].name = "a_b%".into();
        let latex = table.latex();
        assert!(latex.contains("EPE $\\uparrow$"), "{latex}");
        assert!(latex.contains("a\\_b\\% & \\uline{1.00}"), "{latex}");
        assert!(
            latex.contains("\\textcolor{blue}{\\textbf{3.00}}") && latex.contains("\\textcolor{blue}{2.00}")
        );
        assert!(table.markdown().contains("| m2 | **3.00** |"));
        table.columns[0].header = "F1_μ".into();
        assert!(table.latex().contains("& $F1_\\mu$ $\\uparrow$ \\\\"), "{}", table.latex());
    }

    #[test]
    fn a_latex_file_names_its_packages_and_keeps_titles_in_comments() {
        let file = latex_file([("two\nlines".to_owned(), "\\begin{tabular}".to_owned())]);
        assert!(
            file.starts_with("% \\usepackage{booktabs}\n")
                && file.ends_with("\n% two lines\n\\begin{tabular}")
        );
    }
}

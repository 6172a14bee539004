use maud::{Markup, html};

use super::Figure;
use crate::table::{Mark, Table};

/// A table in the paper's style: best bold blue, second blue, third underlined; baselines grey.
pub fn score_table(table: &Table, caption: &str) -> Figure {
    let marks = table.marks();
    Figure(html! {
        figure {
            div.panel.plain {
                h3 { (table.title) }
                div.scroll {
                    table {
                        thead { tr { th { (table.row_header()) } @for column in &table.columns { th { (column.title()) } } } }
                        tbody {
                            @for (row, marks) in table.rows.iter().zip(&marks) {
                                tr class=[row.baseline.then_some("baseline")] {
                                    td { (row.name) }
                                    @for ((c, column), mark) in table.columns.iter().enumerate().zip(marks) {
                                        (cell(&column.show(row.value(c)), *mark))
                                    }
                                }
                            }
                        }
                    }
                }
                @for note in &table.notes { p.note { (note) } }
                @if table.ranked() { p.marks {
                    @for (mark, text) in table.legend() { span class=(class(*mark)) { (text) } }
                    @if table.rows.iter().any(|row| row.baseline) { span { i { "baseline, not ranked" } } }
                } }
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}

fn cell(shown: &str, mark: Option<Mark>) -> Markup {
    html! { td { span class=[mark.map(class)] { (shown) } } }
}

fn class(mark: Mark) -> &'static str {
    match mark {
        Mark::Best => "best",
        Mark::Second => "second",
        Mark::Third => "third",
    }
}

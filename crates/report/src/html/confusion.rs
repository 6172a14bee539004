use maud::html;

use super::Figure;
use super::charts::{Chart, WIDTH, framed_at, place};

/// A confusion matrix: `counts[truth][predicted]` clips, cells shaded by their share of the row. `chart.x` labels the
/// columns, `chart.y` the rows.
pub fn confusion_matrix(classes: &[String], counts: &[Vec<usize>], chart: &Chart) -> Figure {
    const LETTER: f64 = 6.6;
    /// Names longer than this do not fit above their column and are rotated by 60 degrees.
    const SLANTED: usize = 18;
    let letters = |class: &String| class.chars().count();
    let longest = classes.iter().map(letters).max().unwrap_or(0);
    let left = (LETTER * longest as f64 + 16.0).clamp(70.0, 170.0);
    let columns = classes.len().max(1) as f64;
    let slanted = LETTER * longest as f64 > (WIDTH - left) / columns - 6.0;
    // A rotated name takes half its length in width, and extends to the right of its column.
    let right =
        if slanted { LETTER / 2.0 * classes.last().map_or(0, letters).min(SLANTED) as f64 } else { 0.0 };
    let top = if slanted { 34.0 + 0.87 * LETTER * longest.min(SLANTED) as f64 } else { 40.0 };
    let width = (WIDTH - left - right) / columns;
    let height = width.clamp(30.0, 52.0);
    let shortened = |name: &str, letters: usize| {
        let short: String = name.chars().take(letters.saturating_sub(1)).collect();
        if name.chars().count() <= letters { name.to_owned() } else { format!("{short}…") }
    };
    let center = |column: usize| left + (column as f64 + 0.5) * width;
    let base = top - 8.0;
    let drawing = html! {
        text.strong x="0" y=(place(base)) { (chart.y) }
        text.strong x=(place(left + columns * width / 2.0)) y="12" text-anchor="middle" { (chart.x) }
        @for (at, class) in classes.iter().enumerate() {
            @if slanted {
                @let x = place(center(at) + 4.0);
                text x=(x) y=(place(base)) transform={ "rotate(-60 " (x) " " (place(base)) ")" } {
                    (shortened(class, SLANTED)) title { (class) }
                }
            } @else {
                text x=(place(center(at))) y=(place(base)) text-anchor="middle" { (class) }
            }
        }
        @for (at, (class, row)) in classes.iter().zip(counts).enumerate() {
            @let top = top + at as f64 * height;
            @let clips = row.iter().sum::<usize>();
            text x=(place(left - 10.0)) y=(place(top + height / 2.0 + 4.0)) text-anchor="end" {
                (shortened(class, ((left - 12.0) / LETTER) as usize)) title { (class) }
            }
            g.s1 {
                @for (column, count) in row.iter().enumerate() {
                    @let share = *count as f64 / clips.max(1) as f64;
                    @let ink = if share > 0.55 { "on" } else { "strong" };
                    rect.fill x=(place(left + column as f64 * width + 1.0)) y=(place(top + 1.0)) rx="3"
                        width=(place(width - 2.0)) height=(place(height - 2.0))
                        fill-opacity=(format!("{:.3}", 0.06 + 0.94 * share)) {
                        title { (class) " predicted " (classes[column]) ": " (count) " of " (clips) }
                    }
                    text class=(ink) x=(place(center(column))) y=(place(top + height / 2.0 + if height > 40.0 { -1.0 } else { 4.0 }))
                        text-anchor="middle" font-weight="600" { (count) }
                    @if height > 40.0 {
                        text class=(ink) x=(place(center(column))) y=(place(top + height / 2.0 + 14.0))
                            text-anchor="middle" font-size="11" { (format!("{:.0} %", 100.0 * share)) }
                    }
                }
            }
        }
    };
    Figure(framed_at(chart, &[], drawing, top + height * counts.len().max(1) as f64))
}

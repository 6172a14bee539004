use maud::html;

use super::Figure;
use super::charts::{Chart, WIDTH, framed_at, place};

/// A confusion matrix: `counts[truth][predicted]` clips, each row shaded by its shares. `chart.x` names the columns,
/// `chart.y` the rows.
pub fn confusion_matrix(classes: &[String], counts: &[Vec<usize>], chart: &Chart) -> Figure {
    const TOP: f64 = 40.0;
    const LETTER: f64 = 6.6;
    let columns = classes.len().max(1) as f64;
    let longest = classes.iter().map(|class| class.chars().count()).max().unwrap_or(0);
    let left = (LETTER * longest as f64 + 16.0).clamp(70.0, 170.0);
    let width = (WIDTH - left) / columns;
    let height = width.clamp(30.0, 52.0);
    let fits = |name: &str, room: f64| {
        let letters = (room / LETTER) as usize;
        let short: String = name.chars().take(letters.saturating_sub(1)).collect();
        if name.chars().count() <= letters { name.to_owned() } else { format!("{short}…") }
    };
    let center = |column: usize| left + (column as f64 + 0.5) * width;
    let drawing = html! {
        text.strong x="0" y=(TOP - 8.0) { (chart.y) }
        text.strong x=(place(left + columns * width / 2.0)) y="12" text-anchor="middle" { (chart.x) }
        @for (at, class) in classes.iter().enumerate() {
            text x=(place(center(at))) y=(TOP - 8.0) text-anchor="middle" {
                (fits(class, width - 4.0)) title { (class) }
            }
        }
        @for (at, (class, row)) in classes.iter().zip(counts).enumerate() {
            @let top = TOP + at as f64 * height;
            @let clips = row.iter().sum::<usize>();
            text x=(place(left - 10.0)) y=(place(top + height / 2.0 + 4.0)) text-anchor="end" {
                (fits(class, left - 12.0)) title { (class) }
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
    Figure(framed_at(chart, &[], drawing, TOP + height * counts.len().max(1) as f64))
}

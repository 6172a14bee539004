use maud::html;

use super::Figure;
use super::charts::{Chart, Scale, WIDTH, colour_class, framed_at, number, place};

/// One horizontal bar.
#[derive(Debug, Clone)]
pub struct Bar {
    /// Label above the bar.
    pub name: String,
    /// Length of the bar.
    pub value: f64,
    /// Label after the bar: the value with its unit.
    pub label: String,
    /// A baseline is grey.
    pub baseline: bool,
}

/// Horizontal bars from zero, one per line, in the order given.
pub fn bars(bars: &[Bar], chart: &Chart) -> Figure {
    const LINE: f64 = 46.0;
    let scale =
        Scale::from_zero(bars.iter().map(|bar| bar.value).filter(|v| v.is_finite()).fold(0.0, f64::max));
    // Space after the longest bar for its label.
    let length = |value: f64| (scale.share(value) * (WIDTH - 110.0)).max(1.5);
    let mut series = 0;
    let drawing = html! {
        @for (line, bar) in bars.iter().enumerate() {
            @let top = line as f64 * LINE;
            @let class = colour_class((!bar.baseline).then(|| { series += 1; series - 1 }));
            g class=(class) {
                text.name x="0" y=(place(top + 13.0)) { (bar.name) }
                rect.fill x="0" y=(place(top + 20.0)) width=(place(length(bar.value))) height="13" rx="3" {}
                text x=(place(length(bar.value) + 8.0)) y=(place(top + 31.0)) {
                    @if bar.label.is_empty() { (number(bar.value)) } @else { (bar.label) }
                }
            }
        }
    };
    Figure(framed_at(chart, &[], drawing, (bars.len() as f64 * LINE).max(LINE)))
}

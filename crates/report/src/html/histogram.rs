use maud::html;

use super::Figure;
use super::charts::{AREA, Axis, Chart, Scale, axes, framed, place};

/// One bin: the number of values from `low` up to `high`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Number or share of values.
    pub count: f64,
}

/// Bins in ascending order; each axis linear or logarithmic. On a logarithmic horizontal axis a bin that starts at 0 is drawn
/// as half a decade below its upper end.
pub fn histogram(bins: &[Bin], horizontal: Axis, vertical: Axis, chart: &Chart) -> Figure {
    let filled = || bins.iter().map(|bin| bin.count).filter(|count| count.is_finite() && *count > 0.0);
    let most = filled().fold(0.0, f64::max);
    let y = match vertical {
        Axis::Linear => Scale::from_zero(most),
        Axis::Logarithmic => Scale::decades(filled().fold(f64::INFINITY, f64::min), most),
    };
    let (first, last) = (bins.first(), bins.last());
    let high = last.map_or(1.0, |bin| bin.high);
    let x = match horizontal {
        Axis::Linear => Scale::exact(first.map_or(0.0, |bin| bin.low), high),
        Axis::Logarithmic => Scale::exact_logarithmic(
            first.map_or(1.0, |bin| if bin.low > 0.0 { bin.low } else { bin.high / 2.0 }),
            high,
        ),
    };
    let drawing = html! {
        (axes(&x, &y, chart))
        g.s1 {
            @for bin in bins.iter().filter(|bin| bin.count > 0.0) {
                @let (left, right) = (x.x(bin.low), x.x(bin.high));
                rect.fill x=(place(left + 0.5)) y=(place(y.y(bin.count)))
                    width=(place((right - left - 1.0).max(0.6))) height=(place(AREA[3] - y.y(bin.count))) {}
            }
        }
    };
    Figure(framed(chart, &[], drawing))
}

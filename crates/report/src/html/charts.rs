//! Shared parts of the SVG charts: frame, axes, and round numbers for ticks.

use maud::{Markup, html};

use super::standalone::download;

/// Size of a chart in SVG units, which are CSS pixels on a wide page.
pub(super) const WIDTH: f64 = 520.0;
pub(super) const HEIGHT: f64 = 270.0;
/// The plotting area: left, right, top, bottom.
pub(super) const AREA: [f64; 4] = [52.0, 508.0, 30.0, 226.0];

/// The texts around a chart.
#[derive(Debug, Clone)]
pub struct Chart {
    /// Title.
    pub title: String,
    /// Label of the horizontal axis, with its unit.
    pub x: String,
    /// Label of the vertical axis, with its unit.
    pub y: String,
    /// Caption.
    pub caption: String,
}

impl Chart {
    /// A chart with these words around it; each may be empty.
    pub fn new(
        title: impl Into<String>,
        x: impl Into<String>,
        y: impl Into<String>,
        caption: impl Into<String>,
    ) -> Self {
        Self { title: title.into(), x: x.into(), y: y.into(), caption: caption.into() }
    }
}

/// The scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Linear.
    Linear,
    /// Logarithmic; values of 0 or below are drawn at the lower end.
    Logarithmic,
}

/// A range of values along an axis, with its ticks.
pub(super) struct Scale {
    axis: Axis,
    low: f64,
    high: f64,
    pub(super) ticks: Vec<f64>,
}

impl Scale {
    /// From zero to a round number at or above `max`.
    pub(super) fn from_zero(max: f64) -> Self {
        let max = if max.is_finite() && max > 0.0 { max } else { 1.0 };
        let step = round_step(max / 4.0);
        let count = (max / step - 1e-9).ceil().max(1.0) as usize;
        let ticks: Vec<f64> = (0..=count).map(|i| i as f64 * step).collect();
        Self { axis: Axis::Linear, low: 0.0, high: count as f64 * step, ticks }
    }

    /// From exactly `low` to exactly `high`. Between integers, ticks are integers too unless that would leave too few: there is
    /// no pair 2.5.
    pub(super) fn exact(low: f64, high: f64) -> Self {
        let mut step = round_step((high - low).max(1e-9) / 5.0);
        if low.fract() == 0.0 && high.fract() == 0.0 && step > 1.0 && step.fract() != 0.0 {
            step *= 2.0; // 2.5 becomes 5
        }
        let first = (low / step - 1e-9).ceil() as i64;
        let last = (high / step + 1e-9).floor() as i64;
        Self { axis: Axis::Linear, low, high, ticks: (first..=last).map(|i| i as f64 * step).collect() }
    }

    /// Whole decades around the positive values between `min` and `max`.
    pub(super) fn decades(min: f64, max: f64) -> Self {
        let usable = |value: f64| value.is_finite() && value > 0.0;
        let max = if usable(max) { max } else { 1.0 };
        let min = if usable(min) { min.clamp(max * 1e-8, max) } else { max * 0.1 };
        let low = min.log10().floor() as i32;
        let high = (max.log10().ceil() as i32).max(low + 1);
        let ticks = (low..=high).map(|decade| 10_f64.powi(decade)).collect();
        Self { axis: Axis::Logarithmic, low: 10_f64.powi(low), high: 10_f64.powi(high), ticks }
    }

    /// From exactly `low` to exactly `high` on a logarithmic scale, with ticks at the decades between.
    pub(super) fn exact_logarithmic(low: f64, high: f64) -> Self {
        let low = if low.is_finite() && low > 0.0 { low } else { 1.0 };
        let high = if high.is_finite() && high > low { high } else { 10.0 * low };
        let (first, last) = (low.log10().ceil() as i32, high.log10().floor() as i32);
        let ticks = (first..=last).map(|decade| 10_f64.powi(decade)).collect();
        Self { axis: Axis::Logarithmic, low, high, ticks }
    }

    /// Position of a value: 0 at the low end, 1 at the high end, clamped.
    pub(super) fn share(&self, value: f64) -> f64 {
        let share = match self.axis {
            Axis::Linear => (value - self.low) / (self.high - self.low),
            Axis::Logarithmic if value <= self.low => 0.0,
            Axis::Logarithmic => (value / self.low).ln() / (self.high / self.low).ln(),
        };
        if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) }
    }

    /// Horizontal position in the plotting area.
    pub(super) fn x(&self, value: f64) -> f64 {
        AREA[0] + self.share(value) * (AREA[1] - AREA[0])
    }

    /// Vertical position in the plotting area.
    pub(super) fn y(&self, value: f64) -> f64 {
        AREA[3] - self.share(value) * (AREA[3] - AREA[2])
    }
}

/// Grid lines and labels of both axes.
pub(super) fn axes(x: &Scale, y: &Scale, chart: &Chart) -> Markup {
    let [left, right, _, bottom] = AREA;
    html! {
        @for tick in &y.ticks {
            line.rule x1=(left) x2=(right) y1=(place(y.y(*tick))) y2=(place(y.y(*tick))) {}
            text x=(left - 8.0) y=(place(y.y(*tick) + 4.0)) text-anchor="end" { (number(*tick)) }
        }
        @for tick in &x.ticks {
            text x=(place(x.x(*tick))) y=(bottom + 18.0) text-anchor="middle" { (number(*tick)) }
        }
        text.strong x="0" y="12" { (chart.y) }
        line.axis x1=(left) x2=(right) y1=(bottom) y2=(bottom) {}
        text.strong x=((left + right) / 2.0) y=(HEIGHT - 6.0) text-anchor="middle" { (chart.x) }
    }
}

/// The frame of a chart: title, keys of its series (name and colour class), the drawing, the caption.
pub(super) fn framed(chart: &Chart, keys: &[(&str, &str)], drawing: Markup) -> Markup {
    framed_at(chart, keys, drawing, HEIGHT)
}

/// [`framed`] with a given height.
pub(super) fn framed_at(chart: &Chart, keys: &[(&str, &str)], drawing: Markup, height: f64) -> Markup {
    html! {
        figure {
            div.panel.plain {
                (download(chart, keys, &drawing, height))
                h3 { (chart.title) }
                @if !keys.is_empty() {
                    ul.keys { @for (name, class) in keys { li class=(class) { (name) } } }
                }
                svg viewBox={ "0 0 " (WIDTH) " " (place(height)) } role="img" aria-label=(chart.title) {
                    (drawing)
                }
            }
            @if !chart.caption.is_empty() { figcaption { (chart.caption) } }
        }
    }
}

/// The colour class of a series: the first is number 1; `None` is a baseline.
pub(super) fn colour_class(number: Option<usize>) -> &'static str {
    match number {
        None => "s0",
        Some(number) => ["s1", "s2", "s3", "s4", "s5"][number % 5],
    }
}

/// A coordinate, rounded to what a screen can show.
pub(super) fn place(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// A number with no unnecessary digits.
pub fn number(value: f64) -> String {
    let size = value.abs();
    for (unit, letter) in [(1e9, 'G'), (1e6, 'M'), (1e4, 'k')] {
        if size >= unit {
            let unit = if letter == 'k' { 1e3 } else { unit };
            return format!("{} {letter}", number(value / unit));
        }
    }
    let digits = match size {
        _ if size >= 100.0 || value == 0.0 => 0,
        _ if size >= 10.0 => 1,
        _ if size >= 1.0 => 2,
        _ => (2 - size.log10().floor() as i32).clamp(2, 9) as usize,
    };
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// The smallest of 1, 2, 2.5, 5 times a power of ten that is not below `least`.
fn round_step(least: f64) -> f64 {
    let power = 10_f64.powf(least.log10().floor());
    [1.0, 2.0, 2.5, 5.0, 10.0]
        .into_iter()
        .map(|step| step * power)
        .find(|step| *step >= least * 0.999_999)
        .unwrap_or(least)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_on_round_numbers_around_the_values() {
        let scale = Scale::from_zero(0.83);
        assert_eq!(scale.ticks.first(), Some(&0.0));
        assert!((scale.high - 1.0).abs() < 1e-12 && scale.ticks.len() == 5, "{:?}", scale.ticks);
        let decades = Scale::decades(0.03, 7.0);
        assert_eq!(decades.ticks.len(), 4); // 0.01, 0.1, 1, 10
        assert!((decades.share(0.01) - 0.0).abs() < 1e-9 && (decades.share(10.0) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn odd_values_stay_inside_the_chart() {
        for scale in [Scale::from_zero(f64::NAN), Scale::from_zero(0.0), Scale::decades(0.0, f64::INFINITY)] {
            for value in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e300] {
                let share = scale.share(value);
                assert!((0.0..=1.0).contains(&share), "{value} lies at {share}");
            }
        }
    }

    #[test]
    fn numbers_have_no_unnecessary_digits() {
        let shown = [0.0, 0.25, 5.0, 12.5, 1234.0, 25e3, 2.5e6, 0.001].map(number);
        assert_eq!(shown, ["0", "0.25", "5", "12.5", "1234", "25 k", "2.5 M", "0.001"]);
    }
}

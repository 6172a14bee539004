use maud::html;

use super::Figure;
use super::charts::{Axis, Chart, Scale, axes, colour_class, framed, place};

/// One line of a chart.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Its points, from left to right; points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
    /// A baseline is grey and dashed.
    pub baseline: bool,
}

impl Curve {
    /// A curve of many points, each the mean of neighbouring ones: at most 300 are drawn.
    pub fn averaged(name: impl Into<String>, points: &[(f64, f64)]) -> Self {
        const MOST: usize = 300;
        let mean = |points: &[(f64, f64)], of: fn(&(f64, f64)) -> f64| {
            points.iter().map(of).sum::<f64>() / points.len() as f64
        };
        let together = points.len().div_ceil(MOST).max(1);
        let points = points.chunks(together).map(|points| (mean(points, |p| p.0), mean(points, |p| p.1)));
        Self { name: name.into(), points: points.collect(), baseline: false }
    }
}

/// Curves over one pair of axes. With `dots`, every point is marked: for a few measured points.
pub fn curves(curves: &[Curve], vertical: Axis, dots: bool, chart: &Chart) -> Figure {
    let finite = |curve: &Curve| -> Vec<(f64, f64)> {
        curve.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
    };
    let all: Vec<(f64, f64)> = curves.iter().flat_map(finite).collect();
    let least = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::INFINITY, f64::min);
    let most = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::NEG_INFINITY, f64::max);
    let x = match all.is_empty() {
        true => Scale::exact(0.0, 1.0),
        false => {
            let low = least(&mut all.iter().map(|point| point.0));
            let high = most(&mut all.iter().map(|point| point.0));
            // An axis that starts close to zero starts at zero, and so does one with a single position.
            let from_zero = 0.0 < low && (low < 0.05 * high || low == high);
            let low = if from_zero { 0.0 } else { low };
            Scale::exact(low, if low == high { low + 1.0 } else { high })
        }
    };
    let top = most(&mut all.iter().map(|point| point.1));
    let y = match vertical {
        Axis::Linear => Scale::from_zero(top),
        Axis::Logarithmic => Scale::decades(least(&mut all.iter().map(|p| p.1).filter(|v| *v > 0.0)), top),
    };
    let mut series = 0;
    let classes: Vec<&str> = curves
        .iter()
        .map(|curve| {
            colour_class((!curve.baseline).then(|| {
                series += 1;
                series - 1
            }))
        })
        .collect();
    let line = |points: &[(f64, f64)]| -> String {
        points
            .iter()
            .map(|(px, py)| format!("{},{}", place(x.x(*px)), place(y.y(*py))))
            .collect::<Vec<_>>()
            .join(" ")
    };
    let drawing = html! {
        (axes(&x, &y, chart))
        @for (curve, class) in curves.iter().zip(&classes) {
            @let points = finite(curve);
            g class=(class) {
                polyline.line points=(line(&points)) {}
                @if dots {
                    @for (px, py) in &points { circle.fill cx=(place(x.x(*px))) cy=(place(y.y(*py))) r="3" {} }
                }
            }
        }
    };
    let keys: Vec<(&str, &str)> =
        curves.iter().zip(&classes).map(|(curve, class)| (curve.name.as_str(), *class)).collect();
    Figure(framed(chart, &keys, drawing))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_points_are_averaged_and_few_are_kept() {
        let points: Vec<(f64, f64)> = (0..1000).map(|i| (f64::from(i), f64::from(i % 2))).collect();
        let curve = Curve::averaged("loss", &points);
        assert_eq!((curve.points.len(), curve.points[1]), (250, (5.5, 0.5)));
        assert_eq!(Curve::averaged("loss", &points[..300]).points, points[..300]);
        assert!(Curve::averaged("loss", &[]).points.is_empty());
    }

    #[test]
    fn an_axis_of_a_single_place_has_distinct_labels() {
        for (x, y) in [(4.0, 1.5), (9000.0, 0.4), (1.0, 2.0), (0.0, 0.0)] {
            let curve = Curve { name: "EPE".to_owned(), points: vec![(x, y)], baseline: false };
            let chart = Chart::new("Validation", "step", "EPE", "");
            let page = axes_of(&[curve], &chart);
            let labels: Vec<&str> = page
                .split("text-anchor=\"middle\">")
                .skip(1)
                .filter_map(|rest| rest.split('<').next())
                .collect();
            let mut distinct = labels.clone();
            distinct.sort_unstable();
            distinct.dedup();
            assert!(labels.len() >= 2 && labels.len() == distinct.len(), "x = {x}: {labels:?}");
        }
    }

    /// The drawing alone, which the downloadable file repeats.
    fn axes_of(lines: &[Curve], chart: &Chart) -> String {
        let figure = curves(lines, Axis::Linear, true, chart).0.into_string();
        figure.rsplit("<svg").next().unwrap_or_default().to_owned()
    }
}

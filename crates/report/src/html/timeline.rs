use maud::{PreEscaped, html};
use srflow_core::median;

use super::Figure;
use super::charts::{number, place};

/// The pictures beside a [`Timeline`].
#[derive(Debug, Clone)]
pub enum Footage {
    /// URL of a video.
    Video(String),
    /// URL of a folder, ending in `/`, and the encoded names of the files in it, shown at so many per second.
    Frames { folder: String, files: Vec<String>, per_second: f64 },
}

/// A row of a [`Timeline`]: two values over time.
#[derive(Debug, Clone)]
pub struct Lane {
    pub name: String,
    /// At equal distances from the start to the end.
    pub values: Vec<[f64; 2]>,
}

/// A stretch of time that is marked in one lane.
#[derive(Debug, Clone)]
pub struct Mark {
    /// Start, peak and end in seconds.
    pub seconds: [f64; 3],
    /// Number of the lane.
    pub lane: usize,
    /// Shown when the pointer rests on it, and in the list.
    pub words: String,
    /// Whether it is drawn in the second colour.
    pub second: bool,
}

/// Curves beside the video that they are measured in.
#[derive(Debug, Clone)]
pub struct Timeline {
    pub footage: Footage,
    pub seconds: f64,
    /// What the two values of the lanes are.
    pub names: [String; 2],
    pub unit: String,
    pub lanes: Vec<Lane>,
    pub marks: Vec<Mark>,
}

/// Width and height of the drawing; where the names of the lanes end; height of a lane.
const WIDTH: f64 = 960.0;
const LEFT: f64 = 132.0;
const RIGHT: f64 = 8.0;
const LANE: f64 = 34.0;
const BOTTOM: f64 = 26.0;
/// More columns cannot be seen.
const COLUMNS: usize = 600;
/// A mark is at least so wide.
const LEAST_MARK: f64 = 3.0;

/// A video, and curves under it: a click jumps to a time, and a line shows where the video is. The video is not part of the page.
pub fn timeline(timeline: &Timeline, caption: &str) -> Figure {
    let Timeline { footage, seconds, names, unit, lanes, marks } = timeline;
    let duration = seconds.max(1e-6);
    let height = LANE * lanes.len() as f64 + BOTTOM;
    let x = |time: f64| LEFT + (time / duration).clamp(0.0, 1.0) * (WIDTH - LEFT - RIGHT);
    let top = |lane: usize| LANE * lane as f64;
    let scale = scale_of(lanes);
    let middle = |lane: usize| top(lane) + LANE / 2.0;
    let tick = step_of(duration / 8.0);
    let ticks = (0..).map(|count| f64::from(count) * tick).take_while(|time| *time <= duration);
    Figure(html! {
        figure.timeline data-seconds=(duration) data-left=(LEFT) data-right=(RIGHT) data-width=(WIDTH) {
            div.screen {
                @match footage {
                    Footage::Video(address) => { video src=(address) controls preload="metadata" playsinline {} }
                    Footage::Frames { folder, files, per_second } => {
                        img alt="Frame of the video" data-folder=(folder) data-rate=(per_second)
                            data-files=(files.join("\n"))
                            src={ (folder) (files.first().map_or("", String::as_str)) };
                        p { button type="button" { "Play" } " " output { "0.00 s" } }
                    }
                }
            }
            @if !marks.is_empty() {
                ol.jumps {
                    @for mark in marks {
                        li class=(if mark.second { "s2" } else { "s1" }) {
                            button type="button" data-seconds=(mark.seconds[0]) { (mark.words) }
                        }
                    }
                }
            }
            div.panel.plain {
                ul.keys { li.s3 { (names[0]) } li.s4 { (names[1]) } }
                svg viewBox={ "0 0 " (WIDTH) " " (height) } role="img" aria-label="Curves over time" {
                    @for (number, lane) in lanes.iter().enumerate() {
                        line.rule x1=(LEFT) x2=(WIDTH - RIGHT) y1=(middle(number)) y2=(middle(number)) {}
                        text x="0" y=(middle(number) + 4.0) { (lane.name) }
                    }
                    @for mark in marks {
                        @let (from, to) = (x(mark.seconds[0]), x(mark.seconds[2]));
                        g class=(if mark.second { "s2" } else { "s1" }) {
                            rect.mark x=(place(from)) y="0" width=(place((to - from).max(LEAST_MARK))) height=(height - BOTTOM) {
                                title { (mark.words) }
                            }
                            circle.fill cx=(place(x(mark.seconds[1]))) cy=(middle(mark.lane)) r="3" {}
                        }
                    }
                    @for (number, lane) in lanes.iter().enumerate() {
                        @for (axis, class) in ["s3", "s4"].into_iter().enumerate() {
                            g class=(class) {
                                polyline.thin points=(points_of(&lane.values, axis, scale, middle(number))) {}
                            }
                        }
                    }
                    @for time in ticks {
                        text x=(place(x(time))) y=(height - 8.0) text-anchor="middle" { (number(time)) }
                    }
                    line.playhead x1=(LEFT) x2=(LEFT) y1="0" y2=(height - BOTTOM) {}
                }
            }
            figcaption {
                "Seconds from left to right; half a row is " (number(scale)) " " (unit) ". " (caption)
            }
            script { (PreEscaped(include_str!("timeline.js"))) }
        }
    })
}

/// The value that fills half a lane: all but the largest few fit.
fn scale_of(lanes: &[Lane]) -> f64 {
    let centred = |lane: &Lane, axis: usize| -> Vec<f64> {
        let middle = middle_of(&lane.values, axis);
        lane.values.iter().map(|value| (value[axis] - middle).abs()).filter(|size| size.is_finite()).collect()
    };
    let mut sizes: Vec<f64> =
        lanes.iter().flat_map(|lane| [centred(lane, 0), centred(lane, 1)]).flatten().collect();
    if sizes.is_empty() {
        return 1.0;
    }
    let place = (sizes.len() - 1) * 199 / 200;
    let (_, size, _) = sizes.select_nth_unstable_by(place, f64::total_cmp);
    size.max(1e-3)
}

/// The median of one of the values.
fn middle_of(values: &[[f64; 2]], axis: usize) -> f64 {
    median(values.iter().map(|value| value[axis]).filter(|value| value.is_finite()))
}

/// The points of a line: of each column the least and the largest value, so that short peaks remain.
fn points_of(values: &[[f64; 2]], axis: usize, scale: f64, centre: f64) -> String {
    let middle = middle_of(values, axis);
    let together = values.len().div_ceil(COLUMNS).max(1);
    let y = |value: f64| centre + ((value - middle) / scale).clamp(-1.0, 1.0) * (LANE / 2.0 - 1.0);
    let mut points = Vec::new();
    for (column, chunk) in values.chunks(together).enumerate() {
        let share = (column * together) as f64 / values.len().saturating_sub(1).max(1) as f64;
        let x = place(LEFT + share.min(1.0) * (WIDTH - LEFT - RIGHT));
        let finite = || chunk.iter().map(|value| value[axis]).filter(|value| value.is_finite());
        let (low, high) = finite()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        if low > high {
            continue;
        }
        points.push(format!("{x},{}", place(y(low))));
        if high > low {
            points.push(format!("{x},{}", place(y(high))));
        }
    }
    points.join(" ")
}

/// A round number of seconds at or above `least`.
fn step_of(least: f64) -> f64 {
    let steps = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0];
    steps.into_iter().find(|step| *step >= least).unwrap_or(least)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_peaks_remain_in_long_curves() {
        let mut values = vec![[0.0, 1.0]; 100_000];
        values[43_210] = [5.0, 1.0];
        let points = points_of(&values, 0, 5.0, 17.0);
        assert!(points.split(' ').count() <= 2 * COLUMNS);
        let lowest: f64 =
            points.split(' ').filter_map(|point| point.split_once(',')?.1.parse().ok()).fold(0.0, f64::max);
        assert!((lowest - 33.0).abs() < 1e-9, "{lowest}");
    }

    #[test]
    fn names_and_addresses_are_escaped() {
        let lane = Lane { name: "<b>".to_owned(), values: vec![[f64::NAN, 0.0]; 3] };
        let footage = Footage::Video("file:///a\"b.mp4".to_owned());
        let mark = Mark { seconds: [0.0, 0.1, 0.2], lane: 0, words: "<i>".to_owned(), second: true };
        let names = ["x".to_owned(), "y".to_owned()];
        let page = timeline(
            &Timeline {
                footage,
                seconds: 0.0,
                names,
                unit: "px".to_owned(),
                lanes: vec![lane],
                marks: vec![mark],
            },
            "",
        );
        let text = page.0.into_string();
        assert!(!text.contains("<b>") && !text.contains("<i>") && !text.contains("a\"b"), "{text}");
        assert!(!text.contains("NaN"), "{text}");
    }
}

//! The tables of what was spotted.

use std::path::Path;

use srflow_data::micro_expression::intervals::ExpressionKind;
use srflow_files::write_atomically;
use srflow_mer::spotting::{ACTION_UNITS, REGIONS, Signals, unit_motion};

use super::spotted::{Event, SpottedVideo};

/// The events of all videos, with the names of these.
fn events_of(videos: &[SpottedVideo]) -> impl Iterator<Item = (&str, &Event)> {
    videos.iter().flat_map(|video| video.events.iter().map(move |event| (video.video.as_str(), event)))
}

/// All events, with seconds, region and strength.
pub(super) fn write_events(path: &Path, videos: &[SpottedVideo]) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record([
            "video",
            "type",
            "onset",
            "apex",
            "offset",
            "onset_s",
            "apex_s",
            "offset_s",
            "duration_ms",
            "rise_ms",
            "region",
            "height_px",
            "score",
            "with_lids",
            "action_units",
        ])?;
        for (video, event) in events_of(videos) {
            let milliseconds = |from: f64, to: f64| format!("{:.0}", 1000.0 * (to - from));
            table.write_record([
                video,
                event.kind.name(),
                &event.onset.to_string(),
                &event.apex.to_string(),
                &event.offset.to_string(),
                &format!("{:.3}", event.onset_seconds),
                &format!("{:.3}", event.apex_seconds),
                &format!("{:.3}", event.offset_seconds),
                &milliseconds(event.onset_seconds, event.offset_seconds),
                &milliseconds(event.onset_seconds, event.apex_seconds),
                &event.region,
                &format!("{:.3}", event.height_px),
                &format!("{:.2}", event.score),
                if event.with_lids { "yes" } else { "no" },
                &event.units(),
            ])?;
        }
        table.flush()
    })?)
}

/// As the challenges take it: `vid,pred_onset,pred_offset,type`.
pub(super) fn write_megc(path: &Path, videos: &[SpottedVideo]) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record(["vid", "pred_onset", "pred_offset", "type"])?;
        for (video, event) in events_of(videos) {
            let kind = match event.kind {
                ExpressionKind::Micro => "me",
                ExpressionKind::Macro => "mae",
            };
            table.write_record([video, &event.onset.to_string(), &event.offset.to_string(), kind])?;
        }
        table.flush()
    })?)
}

/// The motion of every region and action unit in every frame, in pixels of the video.
pub(super) fn write_signals(
    path: &Path,
    signals: &Signals,
    frame: impl Fn(usize) -> i64,
    seconds: impl Fn(usize) -> f64,
    pixel: f64,
) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        let columns = REGIONS.iter().flat_map(|region| ["x", "y"].map(|axis| format!("{region}_{axis}")));
        let first = ["frame", "timestamp", "usable", "head_x", "head_y"].map(str::to_owned);
        let units = ACTION_UNITS.iter().map(|unit| format!("au{unit}"));
        table.write_record(first.into_iter().chain(columns).chain(units))?;
        for (place, (regions, head)) in signals.regions.iter().zip(&signals.head).enumerate() {
            let units = unit_motion(regions);
            let values = head.iter().chain(regions.as_flattened()).chain(&units);
            let values = values.map(|value| format!("{:.4}", value * pixel));
            let usable = if signals.usable[place] { "yes" } else { "no" };
            let place = [frame(place).to_string(), format!("{:.4}", seconds(place)), usable.to_owned()];
            table.write_record(place.into_iter().chain(values))?;
        }
        table.flush()
    })?)
}

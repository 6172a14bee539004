//! Annotations for ELAN (EAF 3.0), in which people look at a video and its events.

use std::fmt::Write;

use srflow_data::micro_expression::intervals::{ExpressionKind, Interval};

/// The text of an `.eaf` file: a tier of micro- and one of macro-expressions, and one of the action units of each. Frames of `intervals` count from `first_frame`. `date` is as in
/// `2026-01-31T12:00:00+00:00`.
pub fn elan(video: &str, intervals: &[Interval], first_frame: i64, fps: f64, date: &str) -> String {
    let milliseconds = |frames: i64| ((frames as f64 / fps) * 1000.0).round().max(0.0) as u64;
    let video = escaped(video);
    let mut slots = String::new();
    let mut tiers = String::new();
    let mut count = 0;
    // Annotations of a tier must not overlap: units of micro- and macro-expressions have a tier each.
    for (tier, kind, words) in [
        ("ME", ExpressionKind::Micro, label as fn(&Interval) -> &str),
        ("ME AU", ExpressionKind::Micro, units),
        ("MaE", ExpressionKind::Macro, label),
        ("MaE AU", ExpressionKind::Macro, units),
    ] {
        let mut annotations = String::new();
        for interval in intervals.iter().filter(|interval| interval.kind == kind) {
            let [begin, end] =
                [interval.onset - first_frame, interval.offset + 1 - first_frame].map(milliseconds);
            count += 1;
            let (first, second) = (2 * count - 1, 2 * count);
            _ = writeln!(slots, r#"    <TIME_SLOT TIME_SLOT_ID="ts{first}" TIME_VALUE="{begin}"/>"#);
            _ = writeln!(slots, r#"    <TIME_SLOT TIME_SLOT_ID="ts{second}" TIME_VALUE="{end}"/>"#);
            _ = writeln!(
                annotations,
                r#"    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a{count}" TIME_SLOT_REF1="ts{first}" TIME_SLOT_REF2="ts{second}"><ANNOTATION_VALUE>{}</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>"#,
                escaped(words(interval))
            );
        }
        _ = write!(
            tiers,
            "  <TIER LINGUISTIC_TYPE_REF=\"expression\" TIER_ID=\"{tier}\">\n{annotations}  </TIER>\n"
        );
    }
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<ANNOTATION_DOCUMENT AUTHOR="srflow" DATE="{date}" FORMAT="3.0" VERSION="3.0" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">
  <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds">
    <MEDIA_DESCRIPTOR MEDIA_URL="{video}" MIME_TYPE="video/*" RELATIVE_MEDIA_URL="{video}"/>
  </HEADER>
  <TIME_ORDER>
{slots}  </TIME_ORDER>
{tiers}  <LINGUISTIC_TYPE GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="expression" TIME_ALIGNABLE="true"/>
</ANNOTATION_DOCUMENT>
"#
    )
}

fn label(interval: &Interval) -> &str {
    &interval.label
}

fn units(interval: &Interval) -> &str {
    &interval.action_units
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

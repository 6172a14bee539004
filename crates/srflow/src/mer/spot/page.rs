//! The page of a video: the film beside the motion of the face.

use std::path::Path;

use anyhow::anyhow;
use srflow_core::median;
use srflow_data::micro_expression::intervals::ExpressionKind;
use srflow_files::write_file;
use srflow_mer::spotting::{REGIONS, Signals};
use srflow_report::html::{Footage, Lane, Mark, Page, Section, Timeline, tiles, timeline};
use url::Url;

use super::spotted::{Event, SpottedVideo};
use crate::flow::frames::Source;

/// The page of one video, whose frames are shown in steps of so many.
pub struct VideoPage<'a> {
    pub spotted: &'a SpottedVideo,
    pub signals: &'a Signals,
    pub source: &'a Source,
    pub stride: usize,
    pub method: &'a str,
    /// Pixels of the video per pixel of the signals.
    pub pixel: f64,
}

impl VideoPage<'_> {
    /// Writes the page.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let SpottedVideo { video, seconds, usable, events, .. } = self.spotted;
        let micro = events.iter().filter(|event| event.kind == ExpressionKind::Micro).count();
        let facts = [
            (micro.to_string(), "micro-expressions"),
            ((events.len() - micro).to_string(), "macro-expressions"),
            (format!("{seconds:.1} s"), "of video"),
            (format!("{:.0} %", 100.0 * usable), "of it with a steady face"),
        ];
        let facts = facts.map(|(number, words)| (number, words.to_owned()));
        let curves = Timeline {
            footage: self.footage()?,
            seconds: *seconds,
            names: ["to the right".to_owned(), "down".to_owned()],
            unit: "px of the video".to_owned(),
            lanes: self.lanes(),
            marks: events.iter().map(mark).collect(),
        };
        let caption = "Where a region is for longer than two seconds is drawn as zero. Blue: micro-expressions. Orange: macro-expressions. A dot marks the apex in the region that moves most. If the \
            film does not play, the browser does not know its format.";
        let lead = "Click on an expression or into the curves to see that moment.";
        let page = Page {
            title: video.clone(),
            kicker: "Spotted expressions".to_owned(),
            lead: format!(
                "Motion of 16 regions of the face, from flow of {}, without the motion of the head.",
                self.method
            ),
            opening: vec![tiles(&facts)],
            sections: vec![Section::new("Motion", lead, vec![timeline(&curves, caption)])],
            colophon: "Check every event by eye. A micro-expression is not evidence of lying.".to_owned(),
        };
        Ok(write_file(path, page.html())?)
    }

    fn footage(&self) -> anyhow::Result<Footage> {
        let address = |path: &Path, url: Result<Url, ()>| {
            url.map_err(|()| anyhow!("{}: expected a path that a page can name", path.display()))
        };
        let path = &self.spotted.path;
        Ok(match self.source {
            Source::Video(..) => Footage::Video(address(path, Url::from_file_path(path))?.into()),
            Source::Files(files) => {
                let folder = address(path, Url::from_directory_path(path))?;
                let name = |file: &std::path::PathBuf| {
                    let name = file.file_name().unwrap_or_default();
                    let url = Url::from_file_path(path.join(name)).ok();
                    let name =
                        url.as_ref().and_then(|url| url.path_segments()?.next_back().map(str::to_owned));
                    name.unwrap_or_default()
                };
                let files: Vec<String> = files.iter().step_by(self.stride).map(name).collect();
                let per_second = files.len() as f64 / self.spotted.seconds.max(1e-6);
                Footage::Frames { folder: folder.into(), files, per_second }
            }
        })
    }

    /// The motion of the regions out of where they are in the seconds around.
    fn lanes(&self) -> Vec<Lane> {
        let regions = &self.signals.regions;
        let reach = (DRIFT_SECONDS / 2.0 * regions.len() as f64 / self.spotted.seconds.max(1e-6)) as usize;
        let lane = |(region, name): (usize, &str)| {
            let along = |frame: usize, axis: usize| regions[frame][region][axis] * self.pixel;
            let out = |frame: usize| {
                let around = frame.saturating_sub(reach)..(frame + reach + 1).min(regions.len());
                let step = (around.len() / DRIFT_FRAMES).max(1);
                [0, 1].map(|axis| {
                    along(frame, axis) - median(around.clone().step_by(step).map(|at| along(at, axis)))
                })
            };
            Lane { name: name.replace('-', " "), values: (0..regions.len()).map(out).collect() }
        };
        REGIONS.into_iter().enumerate().map(lane).collect()
    }
}

/// Slower motion is not drawn, and is found from so many of the frames.
const DRIFT_SECONDS: f64 = 4.0;
const DRIFT_FRAMES: usize = 16;

fn mark(event: &Event) -> Mark {
    let Event { kind, onset_seconds, apex_seconds, offset_seconds, region, with_lids, action_units, .. } =
        event;
    let blink = if *with_lids { ", with the lids" } else { "" };
    let units = match action_units.is_empty() {
        true => String::new(),
        false => format!(", perhaps AU {}", event.units()),
    };
    Mark {
        seconds: [*onset_seconds, *apex_seconds, *offset_seconds],
        lane: REGIONS.iter().position(|name| name == region).unwrap_or_default(),
        words: format!(
            "{onset_seconds:.2} s: {kind}, {} ms, {}{units}{blink}",
            (1000.0 * (offset_seconds - onset_seconds)).round(),
            region.replace('-', " ")
        ),
        second: *kind == ExpressionKind::Macro,
    }
}

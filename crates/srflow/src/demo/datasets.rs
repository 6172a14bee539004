//! The demo's two datasets: stills of three heads at full size, and a smaller one with more frames.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use rayon::prelude::*;
use srflow_avatar::{Avatars, HeadSource};
use srflow_core::{FlowField, Image, Size, flow_colors};
use srflow_data::flow::{DatasetSpec, Entry, FlowDataset, Sample, Split};
use srflow_data::manifest::Manifest;
use srflow_eval::{head_window, sample_panels};
use srflow_render::generate::{self, Background, Report, Settings};
use srflow_report::html::{Film, Panel, Picture};
use srflow_report::{flow_scale, shrink_flow, shrink_image, shrink_mask};

use crate::Watch;
use crate::rendering::RenderingArgs;

/// Background of every head: a warm grey that suits light and dark pages.
pub const BACKGROUND: [u8; 3] = [0xdd, 0xda, 0xd4];

/// Number of heads, one scene each.
pub const HEADS: u32 = 3;

/// Three heads at full size. With eight pairs, the first pair moves no faster than faces do.
pub fn stills(size: Size) -> Plan {
    Plan { folder: "stills", frames: 8, size }
}

/// The same three heads in motion, at a sixteenth of the pixels.
pub fn clips(full: Size) -> Plan {
    let quarter = |side: usize| (side / 4).max(16);
    Plan {
        folder: "clips",
        frames: 36,
        size: Size { width: quarter(full.width), height: quarter(full.height) },
    }
}

/// Settings of one dataset.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    /// Folder inside the demo's.
    pub folder: &'static str,
    frames: u32,
    size: Size,
}

/// A dataset that was rendered.
#[derive(Debug)]
pub struct Rendered {
    /// Its folder.
    pub dir: PathBuf,
    /// Time and contents.
    pub report: Report,
    /// Its pairs.
    pub dataset: FlowDataset,
}

impl Plan {
    /// Renders the dataset, or the missing part of it.
    ///
    /// # Errors
    /// Those of [`generate::generate_with`] and of opening the result; or when it was stopped.
    pub fn render(
        self,
        out: &Path,
        head: &HeadSource,
        avatars: &Avatars,
        seed: u64,
        force: bool,
        watch: &Watch,
    ) -> anyhow::Result<Rendered> {
        let settings = Settings {
            head: head.clone(),
            scenes: HEADS,
            frames: f64::from(self.frames),
            size: self.size,
            splits: srflow_core::Numbers([0.0, 0.0, 1.0]),
            seed,
            background: Background::Colour(BACKGROUND),
            ..Settings::default()
        };
        let dir = out.join(self.folder);
        let rendering = RenderingArgs { force, ..RenderingArgs::default() };
        let made = rendering
            .make(&dir, "pairs", watch, |request| generate::generate_with(&settings, request, avatars))?;
        let report = made.report;
        if report.run.stopped {
            bail!("{}: stopped on request; running the demo again renders what is missing", dir.display());
        }
        let spec = DatasetSpec { kind: "srflow".to_owned(), dir: dir.clone() };
        Ok(Rendered { dir, report, dataset: FlowDataset::open(&spec, Some(Split::All))? })
    }

    /// The command that renders the same dataset.
    pub fn command(self, head: &HeadSource, seed: u64) -> String {
        let size = self.size;
        let head = if head.is_builtin() { String::new() } else { format!(" --head {head}") };
        let [r, g, b] = BACKGROUND;
        format!(
            "srflow render --out {} --scenes {} --frames {} --size {size} --splits 0,0,1{head} --seed {seed} \\
             --background '#{r:02x}{g:02x}{b:02x}'",
            self.folder, HEADS, self.frames
        )
    }
}

impl Rendered {
    /// Seed of the first scene's subject.
    ///
    /// # Errors
    /// When `dataset.json` cannot be read.
    pub fn first_subject(&self) -> anyhow::Result<u64> {
        let manifest = Manifest::read(&self.dir)?;
        let first = manifest.scenes.first().context("the dataset has no scene")?;
        Ok(first.subject)
    }
}

/// One head at full size, as pictures.
#[derive(Debug)]
pub struct Still {
    /// The whole frame.
    pub portrait: Panel,
    /// A part of it at full resolution.
    pub detail: Panel,
    /// Frame, flow, mask and occlusion.
    pub panels: Vec<Panel>,
    /// The frame and its flow, for a comparison with a divider.
    pub over_flow: (Picture, Picture),
}

/// The first pair of every scene as pictures, starting from the frontal camera.
///
/// # Errors
/// When a file cannot be read or a picture cannot be encoded.
pub fn portraits(rendered: &Rendered) -> anyhow::Result<Vec<Still>> {
    let mut firsts: Vec<&Entry> = rendered.dataset.entries().iter().collect();
    firsts.dedup_by_key(|entry| &entry.scene);
    let still = |(number, entry)| still(&rendered.dataset.read(entry)?, &format!("head {}", number + 1));
    firsts.into_par_iter().enumerate().map(still).collect()
}

fn still(sample: &Sample, name: &str) -> anyhow::Result<Still> {
    let frame = &sample.frame1;
    let portrait = shrink_image(frame, 720);
    let flow =
        sample.flow.as_ref().map(|flow| shrink_flow(flow, 720)).unwrap_or_else(|| FlowField::new(1, 1));
    let size = Size::new(frame.width().min(720), frame.height().min(620));
    // The rig looks at the middle of the head, which is between the eyes.
    let window = head_window(frame.size(), size, None)?;
    let detail = frame.crop(window.left, window.top, window.width, window.height);
    let panel = |picture, title: &str, note: String| Panel::new(picture, title, note);
    Ok(Still {
        portrait: panel(
            Picture::jpeg(&portrait, &format!("{name}, whole frame"))?,
            name,
            format!("{}×{} pixels", frame.width(), frame.height()),
        ),
        detail: panel(
            Picture::jpeg(&detail, &format!("{name}, detail"))?,
            name,
            format!("{}×{} of its pixels", size.width, size.height),
        ),
        panels: sample_panels(sample, name, 420)?,
        over_flow: (
            Picture::jpeg(&portrait, "frame")?,
            Picture::jpeg(&flow_colors(&flow, Some(flow_scale(&flow) as f32)), "flow")?,
        ),
    })
}

/// The first scene as animations: the frames, and their flow on one colour scale.
///
/// # Errors
/// When a file cannot be read or an animation cannot be encoded.
pub fn films(rendered: &Rendered) -> anyhow::Result<(Vec<Film>, f64)> {
    const WIDTH: usize = 366;
    let entries = rendered.dataset.entries();
    let scene = entries.first().map(|entry| entry.scene.clone()).unwrap_or_default();
    let of_scene = entries.par_iter().filter(|entry| entry.scene == scene).map(|entry| {
        let sample = rendered.dataset.read(entry)?;
        let flow = sample.flow.as_ref().map(|flow| shrink_flow(flow, WIDTH));
        let hidden = sample.occlusion.as_ref().map(|mask| {
            let share = shrink_mask(mask, WIDTH);
            Image::from_fn(share.width(), share.height(), |x, y| [(share.get(x, y) * 255.0) as u8; 3])
        });
        Ok((shrink_image(&sample.frame1, WIDTH), flow, hidden))
    });
    let of_scene: Vec<(Image, Option<FlowField>, Option<Image>)> = of_scene.collect::<anyhow::Result<_>>()?;
    let (mut frames, mut flows, mut hidden) = (Vec::new(), Vec::new(), Vec::new());
    for (frame, flow, occlusion) in of_scene {
        frames.push(frame);
        flows.extend(flow);
        hidden.extend(occlusion);
    }
    let longest = flows.iter().map(flow_scale).fold(0.1, f64::max);
    let flows: Vec<Image> = flows.iter().map(|flow| flow_colors(flow, Some(longest as f32))).collect();
    let films = [
        (frames, "Frames", "the rendered frames"),
        (flows, "Flow", "the motion of every pixel to the next frame"),
        (hidden, "Occlusion", "pixels that the next frame hides"),
    ];
    let films = films.into_par_iter().map(|(frames, title, note)| Film::new(&frames, title, note));
    Ok((films.collect::<Result<_, _>>()?, longest))
}

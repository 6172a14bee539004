//! A moving camera: a folder of frames and their flow, or a video.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;
use srflow_core::{Size, longest_flow};
use srflow_files::{create_folder, write_flow, write_image_png, write_mask_png};
use srflow_splat::{Camera, Frame, Gaussians, Next, Options, Outputs, Rasterizer};

use crate::Watch;
use crate::output::ensure_free;
use crate::video::VideoWriter;

/// Frames along a path of the camera, in a folder or a video.
#[derive(Debug, Clone, Serialize)]
pub struct RenderedPath {
    pub out: PathBuf,
    pub frames: usize,
    pub width: usize,
    pub height: usize,
    pub gaussians: usize,
    /// Length of the longest flow to the next frame in pixels; none for a video.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub longest_flow: Option<f32>,
}

impl fmt::Display for RenderedPath {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { out, frames, width, height, gaussians, longest_flow } = self;
        write!(f, "{}: {frames} frames of {width}x{height} pixels, {gaussians} Gaussians", out.display())?;
        if let Some(longest) = longest_flow {
            write!(f, ", flow at most {longest:.2} px long")?;
        }
        writeln!(f)
    }
}

/// The subfolders of a sequence, which `folder:DIR` reads as a dataset.
const FOLDERS: [&str; 3] = ["frames", "flow", "mask"];

/// Writes `frames/`, the `flow/` from each frame to the next and the `mask/` of each, numbered from 1.
///
/// # Errors
/// When files exist and `force` was not given, or one cannot be written.
pub fn write_frames(
    gaussians: &Gaussians,
    cameras: &[Camera],
    options: &Options,
    out: &Path,
    force: bool,
    watch: &Watch,
) -> anyhow::Result<RenderedPath> {
    let file = |folder: &str, number: usize, extension: &str| {
        out.join(folder).join(format!("{number:06}.{extension}"))
    };
    ensure_free(FOLDERS.map(|folder| out.join(folder)), force)?;
    // A longer sequence is never overwritten in part.
    ensure_free([file("frames", cameras.len() + 1, "png")], false)?;
    FOLDERS.iter().try_for_each(|folder| create_folder(&out.join(folder)))?;
    let outputs = Outputs { depth_next: false, ..Outputs::ALL };
    let options = Options { outputs, ..*options };
    let (mut rasterizer, mut frame) = (Rasterizer::new(), Frame::new());
    let count = watch.count("frames", cameras.len() as u64);
    let mut longest = 0.0_f32;
    for (number, camera) in (1..).zip(cameras) {
        let next = cameras.get(number).map(|camera| Next { gaussians, camera });
        rasterizer.render(gaussians, camera, next, &options, &mut frame)?;
        write_image_png(&file("frames", number, "png"), &frame.image)?;
        write_mask_png(&file("mask", number, "png"), &frame.mask())?;
        if next.is_some() {
            write_flow(&file("flow", number, "flo"), &frame.flow)?;
            longest = longest.max(longest_flow(&frame.flow));
        }
        count.inc();
    }
    Ok(RenderedPath { longest_flow: Some(longest), ..rendered(gaussians, cameras, out) })
}

/// Writes the frames as a video.
///
/// # Errors
/// When the file exists and `force` was not given, or it cannot be written.
pub fn write_video(
    gaussians: &Gaussians,
    cameras: &[Camera],
    options: &Options,
    out: &Path,
    rate: u16,
    force: bool,
    watch: &Watch,
) -> anyhow::Result<RenderedPath> {
    ensure_free([out], force)?;
    let options = Options { outputs: Outputs::IMAGE, ..*options };
    let (mut rasterizer, mut frame) = (Rasterizer::new(), Frame::new());
    let count = watch.count("frames", cameras.len() as u64);
    let mut video: Option<VideoWriter> = None;
    for camera in cameras {
        rasterizer.render(gaussians, camera, None, &options, &mut frame)?;
        let video = match &mut video {
            Some(video) => video,
            None => video.insert(VideoWriter::create(out, frame.image.size(), &rate.to_string())?),
        };
        video.write(&frame.image)?;
        count.inc();
    }
    video.map_or(Ok(()), VideoWriter::finish)?;
    Ok(rendered(gaussians, cameras, out))
}

fn rendered(gaussians: &Gaussians, cameras: &[Camera], out: &Path) -> RenderedPath {
    let Size { width, height } = cameras.first().map(Camera::size).unwrap_or_default();
    RenderedPath {
        out: out.to_owned(),
        frames: cameras.len(),
        width,
        height,
        gaussians: gaussians.len(),
        longest_flow: None,
    }
}

//! Frames with the points of a face drawn into them.

use std::path::{Path, PathBuf};

use srflow_core::{Image, Size};
use srflow_face::Face;
use srflow_files::{create_folder, write_image_png};

use super::PointChoice;
use super::table::points_of;
use crate::flow::frames::Frame;
use crate::video::{VideoWriter, is_video};

const COLOUR: [u8; 3] = [60, 255, 120];

/// Where the frames go.
pub(super) enum Pictures {
    Folder(PathBuf),
    /// Begun with the first frame, whose size it has; the rate is frames per second as ffmpeg reads it.
    Video {
        path: PathBuf,
        rate: String,
        writer: Option<VideoWriter>,
    },
}

impl Pictures {
    pub(super) fn new(path: &Path, rate: &str) -> Self {
        match is_video(path) {
            true => Self::Video { path: path.to_owned(), rate: rate.to_owned(), writer: None },
            false => Self::Folder(path.to_owned()),
        }
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(super) fn push(
        &mut self,
        frame: &Frame,
        face: Option<&Face>,
        choice: PointChoice,
    ) -> anyhow::Result<()> {
        let picture = draw_points(&frame.image, face.map_or(&[], |face| points_of(face, choice)));
        match self {
            Self::Folder(folder) => {
                create_folder(folder)?;
                Ok(write_image_png(&folder.join(format!("{}.png", frame.stem)), &picture)?)
            }
            Self::Video { path, rate, writer } => {
                let writer = match writer {
                    Some(writer) => writer,
                    None => writer.insert(VideoWriter::create(path, picture.size(), rate)?),
                };
                writer.write(&picture)
            }
        }
    }

    /// Completes a video.
    ///
    /// # Errors
    /// When ffmpeg fails.
    pub(super) fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::Video { writer: Some(writer), .. } => writer.finish(),
            _ => Ok(()),
        }
    }
}

/// The frame with a square at each point, pixels.
pub fn draw_points(frame: &Image, points: &[[f64; 2]]) -> Image {
    let Size { width, height } = frame.size();
    let reach = (width.max(height) / 1000).max(1) as i64;
    let mut picture = frame.clone();
    for [x, y] in points.iter().map(|point| point.map(|at| at.round() as i64)) {
        for (x, y) in (y - reach..=y + reach).flat_map(|y| (x - reach..=x + reach).map(move |x| (x, y))) {
            if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y))
                && x < width
                && y < height
            {
                picture.set(x, y, COLOUR);
            }
        }
    }
    picture
}

//! The frames of a video that an avatar is learned from: spread over the video, sharp, with a face.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::bail;
use srflow_avatar::capture::Landmarks;
use srflow_core::{Image, Size, luminance};
use srflow_face::{FaceBox, FaceFinder};
use srflow_files::{create_folder, write_atomically, write_image_png};

use super::VideoArgs;
use crate::Watch;
use crate::face::FoundTrack;
use crate::video::VideoReader;

/// Folder of the frames.
const IMAGES: &str = "images";

/// Which frames of the video they are.
const FRAMES_NAME: &str = "frames.csv";

/// The camera of the video.
pub const CAMERA: u32 = 0;

/// Of the frames that one is chosen from, at most so many are looked at.
const CANDIDATES: u64 = 5;

/// Fewer frames with a face cannot show how a head moves.
const FEWEST: usize = 8;

/// The chosen frames.
pub struct Frames {
    pub size: Size,
    /// Number of each frame in the video, from 0. Its timestep is its place here.
    pub numbers: Vec<u64>,
    pub landmarks: Landmarks,
    /// Frames of the video.
    pub of: u64,
}

/// The path of a timestep's picture below the folder of the capture.
pub fn image_name(timestep: u32) -> PathBuf {
    Path::new(IMAGES).join(format!("{timestep:05}_{CAMERA:02}.png"))
}

struct Candidate {
    number: u64,
    sharpness: f64,
    image: Image,
    face: srflow_face::Face,
}

/// Chooses frames and writes them into a folder; `None` when it was stopped.
///
/// # Errors
/// When the video cannot be read, there are several faces and none is chosen, or too few frames have one.
pub fn choose(
    settings: &VideoArgs,
    video: &Path,
    dir: &Path,
    frames_of_video: Option<u64>,
    finder: FaceFinder,
    watch: &Watch,
) -> anyhow::Result<Option<Frames>> {
    let of = match frames_of_video {
        Some(frames) if frames > 0 => frames,
        _ => count(video)?,
    };
    let windows = (settings.most_frames() as u64).min(of).max(1);
    let window_of = |frame: u64| (frame * windows / of).min(windows - 1);
    let look_at_every = (of / windows).div_ceil(CANDIDATES).max(1);
    create_folder(&dir.join(IMAGES))?;
    let progress = watch.count("frames", of);
    let mut reader = VideoReader::open(video)?;
    let mut track = FoundTrack::new(finder, settings.face_index.map(usize::from));
    let mut frames =
        Frames { size: Size::default(), numbers: Vec::new(), landmarks: Landmarks::default(), of };
    let mut best: Option<Candidate> = None;
    let (mut number, mut looked_at) = (0, 0);
    while let Some(image) = reader.next_frame()? {
        if watch.stops() {
            return Ok(None);
        }
        if number > 0 && window_of(number) != window_of(number - 1) {
            frames.keep(best.take(), dir)?;
        }
        if frames.size == Size::default() {
            frames.size = image.size();
        } else if frames.size != image.size() {
            bail!(
                "{}: expected frames of one size, found {} and {} pixels",
                video.display(),
                frames.size,
                image.size()
            );
        }
        if number % look_at_every == 0 {
            looked_at += 1;
            if let Some(face) = track.face(&image)?
                && let Ok(bounds) = face.points.upright_box(image.size())
            {
                let sharpness = sharpness(&image, bounds);
                if best.as_ref().is_none_or(|best| sharpness > best.sharpness) {
                    best = Some(Candidate { number, sharpness, image, face });
                }
            }
        }
        number += 1;
        progress.inc();
    }
    frames.keep(best, dir)?;
    frames.of = number;
    if frames.numbers.len() < FEWEST {
        bail!(
            "{}: expected a face in at least {FEWEST} of the frames that an avatar is learned from, found one in {} of {looked_at} frames \
             that were looked at; is it large and facing the camera?",
            video.display(),
            frames.numbers.len()
        );
    }
    write_atomically(&dir.join(FRAMES_NAME), |file| {
        writeln!(file, "timestep,frame")?;
        frames
            .numbers
            .iter()
            .enumerate()
            .try_for_each(|(timestep, number)| writeln!(file, "{timestep},{number}"))
    })?;
    Ok(Some(frames))
}

impl Frames {
    fn keep(&mut self, candidate: Option<Candidate>, dir: &Path) -> anyhow::Result<()> {
        let Some(Candidate { number, image, face, .. }) = candidate else { return Ok(()) };
        let Some(dlib) = &face.points.dlib else { return Ok(()) };
        let timestep = self.numbers.len() as u32;
        write_image_png(&dir.join(image_name(timestep)), &image)?;
        self.landmarks.insert(timestep, CAMERA, dlib.map(Some));
        self.numbers.push(number);
        Ok(())
    }
}

/// How many frames a video has, by reading it.
fn count(video: &Path) -> anyhow::Result<u64> {
    let mut reader = VideoReader::open(video)?;
    let mut frames = 0;
    while reader.next_frame()?.is_some() {
        frames += 1;
    }
    Ok(frames)
}

/// Mean square of the Laplacian in a box of a picture, levels of 255: less where the lens or the motion blurs.
fn sharpness(image: &Image, face: FaceBox) -> f64 {
    let grey = luminance(&image.crop(face.left, face.top, face.width, face.height));
    let Size { width, height } = grey.size();
    let mut sum = 0.0;
    for y in 1..height.saturating_sub(1) {
        let [above, row, below] = [y - 1, y, y + 1].map(|y| grey.row(y));
        for x in 1..width.saturating_sub(1) {
            sum += f64::from(above[x] + below[x] + row[x - 1] + row[x + 1] - 4.0 * row[x]).powi(2);
        }
    }
    sum / (width * height).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blurred_face_is_less_sharp() {
        let face = FaceBox { left: 4, top: 4, width: 24, height: 24 };
        let sharp = Image::from_fn(32, 32, |x, _| [if x % 8 < 4 { 200 } else { 50 }; 3]);
        let blurred = Image::from_fn(32, 32, |x, _| [(125.0 + 75.0 * (x as f64 * 0.785).sin()) as u8; 3]);
        assert!(sharpness(&sharp, face) > 4.0 * sharpness(&blurred, face));
    }
}

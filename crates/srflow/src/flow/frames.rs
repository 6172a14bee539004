//! The source of the frames.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use srflow_core::Image;
use srflow_data::flow::pictures;
use srflow_files::{IMAGE_EXTENSIONS, read_image, read_image_size};

use crate::error::wrong_settings;
use crate::video::{self, VideoReader, is_video};

/// Two or more pictures, or a video.
pub enum Source {
    Files(Vec<PathBuf>),
    Video(PathBuf, video::Facts),
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Files(files) => write!(f, "{} frames", files.len()),
            Self::Video(..) => f.write_str("the frames of a video"),
        }
    }
}

/// A frame and its names.
pub struct Frame {
    /// For messages and reports.
    pub label: String,
    /// Stem of the files of its flow.
    pub stem: String,
    pub image: Image,
}

impl Source {
    /// # Errors
    /// When there are fewer than two frames. The headers of all pictures are read first, so that a wrong size or a broken
    /// file is reported before any work.
    pub fn open(arguments: &[PathBuf]) -> anyhow::Result<Self> {
        let files = match arguments {
            [folder] if folder.is_dir() => frames_of(folder)?,
            [file] if is_video(file) => return Ok(Self::Video(file.clone(), video::facts(file))),
            [frame] => {
                wrong_settings!(
                    "{}: one frame has no flow: give two or more, a folder of frames, or a video",
                    frame.display()
                )
            }
            frames => frames.to_vec(),
        };
        if let Some(video) = files.iter().find(|file| is_video(file)) {
            wrong_settings!("{}: a video must be the only input", video.display());
        }
        let mut first = None;
        for file in &files {
            let (width, height) = read_image_size(file)?;
            let (first_width, first_height) = *first.get_or_insert((width, height));
            ensure!(
                (first_width, first_height) == (width, height),
                "the frames differ in size: {} is {first_width}x{first_height}, {} is {width}x{height}; resize or crop one",
                files[0].display(),
                file.display()
            );
        }
        Ok(Self::Files(files))
    }

    /// Number of pairs, if known.
    pub fn pairs(&self) -> Option<u64> {
        match self {
            Self::Files(files) => Some(files.len() as u64 - 1),
            Self::Video(_, facts) => Some(facts.frames?.saturating_sub(1)),
        }
    }

    /// Names of the first frames of the pairs, as far as known; for a video, one stands for all.
    pub fn stems(&self) -> Vec<String> {
        match self {
            Self::Files(files) => files[..files.len() - 1].iter().map(|file| stem(file)).collect(),
            Self::Video(..) => vec![number(1)],
        }
    }

    /// Names of the first frames of the pairs; for a video, of as many as it may have.
    pub fn all_stems(&self) -> Box<dyn Iterator<Item = String> + '_> {
        match self {
            Self::Files(files) => Box::new(files[..files.len() - 1].iter().map(|file| stem(file))),
            Self::Video(..) => Box::new((1..).map(number)),
        }
    }

    /// Frames per second for a video of the results.
    pub fn rate(&self) -> &str {
        match self {
            Self::Video(_, video::Facts { rate: Some(rate), .. }) => rate,
            _ => "25",
        }
    }

    /// The first frame.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn first(&self) -> anyhow::Result<Image> {
        let mut first = None;
        self.read(0, |frame| {
            first = Some(frame);
            false
        });
        Ok(first.context("expected a frame, found none")??.image)
    }

    /// Reads the frames in order, except the first `skip`; `take` returns whether it wants more.
    pub fn read(&self, skip: u64, mut take: impl FnMut(anyhow::Result<Frame>) -> bool) {
        match self {
            Self::Files(files) => {
                for file in files.iter().skip(skip as usize) {
                    let frame = |image| Frame { label: file.display().to_string(), stem: stem(file), image };
                    if !take(read_image(file).map(frame).map_err(Into::into)) {
                        return;
                    }
                }
            }
            Self::Video(path, _) => {
                if let Err(error) = read_video(path, skip, &mut take) {
                    take(Err(error));
                }
            }
        }
    }
}

fn read_video(
    path: &Path,
    skip: u64,
    take: &mut impl FnMut(anyhow::Result<Frame>) -> bool,
) -> anyhow::Result<()> {
    let mut video = VideoReader::open(path)?;
    let mut count = 0;
    while let Some(image) = video.next_frame()? {
        count += 1;
        if count <= skip {
            continue;
        }
        let label = format!("{} frame {count}", path.display());
        if !take(Ok(Frame { label, stem: number(count), image })) {
            return Ok(());
        }
    }
    ensure!(count >= 2, "{}: expected two frames or more, found {count}", path.display());
    Ok(())
}

/// Frames of a video are named by their number, from 1.
fn number(count: u64) -> String {
    format!("{count:06}")
}

fn stem(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The frames in a folder, in natural order of their names.
fn frames_of(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let frames = pictures(folder).with_context(|| "the folder of the frames")?;
    check_for_holes(folder, &frames)?;
    ensure!(
        frames.len() >= 2,
        "{}: expected two frames or more (files named *.{}), found {}",
        folder.display(),
        IMAGE_EXTENSIONS.join(", *."),
        frames.len()
    );
    Ok(frames)
}

/// A missing frame would give the flow between frames that are not neighbours.
///
/// # Errors
/// Names a picture that is not a file (such as a dangling link), or a missing number.
fn check_for_holes(folder: &Path, frames: &[PathBuf]) -> anyhow::Result<()> {
    let advice = "add it, or list the frames one by one";
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        let is_picture = IMAGE_EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension));
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        ensure!(
            !is_picture || hidden || path.is_dir() || path.is_file(),
            "{}: expected a frame, found a dangling link or no regular file; {advice}",
            path.display()
        );
    }
    if let Some((before, after)) = hole(&frames.iter().map(|file| stem(file)).collect::<Vec<_>>()) {
        anyhow::bail!(
            "{}: a frame is missing between {} and {}; {advice}",
            folder.display(),
            frames[before].display(),
            frames[after].display()
        );
    }
    Ok(())
}

/// Positions of the first two neighbours whose numbers differ by more than the others': `f_1`, `f_2`, `f_4`. None unless all
/// names are the same text around a number.
fn hole(stems: &[String]) -> Option<(usize, usize)> {
    let parts = |stem: &String| {
        let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
        let start = stem[..end].trim_end_matches(|c: char| c.is_ascii_digit()).len();
        Some((stem[..start].to_owned(), stem[start..end].parse::<u64>().ok()?, stem[end..].to_owned()))
    };
    let named: Vec<_> = stems.iter().map(parts).collect::<Option<_>>()?;
    let (prefix, _, suffix) = named.first()?;
    if named.iter().any(|(before, _, after)| before != prefix || after != suffix) {
        return None;
    }
    let apart = |pair: &[(String, u64, String)]| pair[1].1.saturating_sub(pair[0].1);
    let step = named.windows(2).map(apart).min()?;
    let at = named.windows(2).position(|pair| apart(pair) != step)?;
    Some((at, at + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_number_is_detected() {
        let hole = |names: &[&str]| hole(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        assert_eq!(hole(&["f1", "f2", "f4"]), Some((1, 2)));
        assert_eq!(hole(&["a_08_l", "a_10_l", "a_12_l"]), None, "every second frame");
        assert_eq!(hole(&["a9", "a10", "a11"]), None);
        assert_eq!(hole(&["onset", "apex", "f7"]), None);
        assert_eq!(hole(&["a1", "b3", "c9"]), None);
    }
}

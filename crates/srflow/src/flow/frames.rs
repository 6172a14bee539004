//! The source of the frames.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use srflow_core::{Image, excerpt};
use srflow_data::flow::pictures;
use srflow_data::{FrameNames, unread_files};
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
#[derive(Clone)]
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
            [file] if !file.exists() => {
                wrong_settings!(
                    "{}: expected frames, a folder of them or a video, found no such file or folder",
                    file.display()
                )
            }
            [file] if !is_picture(file) => {
                wrong_settings!(
                    "{}: expected two frames or more (.{}), a folder of frames, or a video (.{}), found one file with another ending",
                    file.display(),
                    IMAGE_EXTENSIONS.join(", ."),
                    video::EXTENSIONS.join(", .")
                )
            }
            [frame] => {
                wrong_settings!(
                    "{}: one frame has no flow: give two or more, a folder of frames, or a video",
                    frame.display()
                )
            }
            frames => frames.to_vec(),
        };
        if let Some(video) = files.iter().find(|file| is_video(file)) {
            let gif = video.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gif"));
            let advice = if gif { "; a GIF is read as a video: convert stills to PNG" } else { "" };
            wrong_settings!("{}: a video must be the only input{advice}", video.display());
        }
        let mut first = None;
        for file in &files {
            let size = read_image_size(file)?;
            let first = *first.get_or_insert(size);
            ensure!(
                first == size,
                "the frames differ in size: {} is {first}, {} is {size}; resize or crop one",
                files[0].display(),
                file.display()
            );
        }
        Ok(Self::Files(files))
    }

    /// As [`Self::open`]; one picture is also enough.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn of_any(arguments: &[PathBuf]) -> anyhow::Result<Self> {
        match arguments {
            [file] if is_picture(file) && file.is_file() => Ok(Self::Files(vec![file.clone()])),
            _ => Self::open(arguments),
        }
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

    /// Frames per second of a video, where they are known.
    pub fn measured_rate(&self) -> Option<f64> {
        let Self::Video(_, video::Facts { rate: Some(rate), .. }) = self else { return None };
        let (above, below) = rate.split_once('/').unwrap_or((rate, "1"));
        let rate = above.parse::<f64>().ok()? / below.parse::<f64>().ok()?;
        rate.is_finite().then_some(rate)
    }

    /// The file of a video.
    pub fn video(&self) -> Option<&Path> {
        match self {
            Self::Files(_) => None,
            Self::Video(path, _) => Some(path),
        }
    }

    /// Number of the first frame: that in its file's name; 1 in a video.
    pub fn first_number(&self) -> i64 {
        match self {
            Self::Files(files) => {
                FrameNames::new(files.clone()).numbers().first().copied().flatten().unwrap_or(1)
            }
            Self::Video(..) => 1,
        }
    }

    /// Reads every `stride`-th frame in order, after the first `skip`; `take` returns whether it wants more.
    pub fn read(&self, skip: u64, stride: usize, mut take: impl FnMut(anyhow::Result<Frame>) -> bool) {
        match self {
            Self::Files(files) => {
                for file in files.iter().skip(skip as usize).step_by(stride) {
                    let frame = |image| Frame { label: file.display().to_string(), stem: stem(file), image };
                    if !take(read_image(file).map(frame).map_err(Into::into)) {
                        return;
                    }
                }
            }
            Self::Video(path, _) => {
                if let Err(error) = read_video(path, skip, stride, &mut take) {
                    take(Err(error));
                }
            }
        }
    }
}

fn read_video(
    path: &Path,
    skip: u64,
    stride: usize,
    take: &mut impl FnMut(anyhow::Result<Frame>) -> bool,
) -> anyhow::Result<()> {
    let mut video = VideoReader::open(path)?;
    let mut count = 0;
    while let Some(image) = video.next_frame()? {
        count += 1;
        if count <= skip || !(count - 1 - skip).is_multiple_of(stride as u64) {
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

/// Whether the name has the extension of a picture.
fn is_picture(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    IMAGE_EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension))
}

/// Frames of a video are named by their number, from 1.
fn number(count: u64) -> String {
    format!("{count:06}")
}

fn stem(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The frames in a folder, in the order of their numbers.
fn frames_of(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let names = FrameNames::new(pictures(folder).with_context(|| "the folder of the frames")?);
    let unread = unread_files(folder);
    let others = unread.as_ref().map(|others| format!(", and {others}")).unwrap_or_default();
    check_for_holes(folder, &names).map_err(|error| match &unread {
        Some(unread) => anyhow::anyhow!("{error}; the folder also has {unread}"),
        None => error,
    })?;
    let count = names.files().len();
    ensure!(
        count >= 2,
        "{}: expected two frames or more (files named *.{}), found {count}{others}",
        folder.display(),
        IMAGE_EXTENSIONS.join(", *."),
    );
    names.notes().for_each(|note| log::warn!("{note}"));
    if let Some(unread) = unread {
        log::warn!("{}: the folder also has {unread}", folder.display());
    }
    Ok(names.files().to_vec())
}

/// A missing frame would give the flow between frames that are not neighbours, and a frame that exists twice no flow at all.
///
/// # Errors
/// Names a picture that is not a file (such as a dangling link), a missing number, or two files of one number.
fn check_for_holes(folder: &Path, names: &FrameNames) -> anyhow::Result<()> {
    let advice = "add it, or list the frames one by one";
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        ensure!(
            !is_picture(&path) || hidden || path.is_dir() || path.is_file(),
            "{}: expected a frame, found a dangling link or no regular file; {advice}",
            path.display()
        );
    }
    let named =
        |pair: [&Path; 2]| pair.map(|file| excerpt(&file.file_name().unwrap_or_default().to_string_lossy()));
    if let Some([one, other]) = names.twice().map(named) {
        anyhow::bail!(
            "{}: one frame exists twice, as {one} and {other}; keep one of the two, or list the frames one by one",
            folder.display()
        );
    }
    if let Some([before, after]) = names.gap() {
        anyhow::bail!(
            "{}: a frame is missing between {} and {}; {advice}",
            folder.display(),
            before.display(),
            after.display()
        );
    }
    Ok(())
}

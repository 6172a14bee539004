//! Reading a capture: its lists of pictures, with checks of everything but the pictures themselves.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use srflow_files::{FileError, FileKind, FileProblem, parse_error_in_words, read_text};
use srflow_splat::read_cameras;

use super::{CANONICAL_NAME, Capture, CaptureSplit, CaptureView, problem};

#[derive(Deserialize)]
struct Transforms {
    frames: Vec<Frame>,
    timestep_indices: Option<Vec<u32>>,
    camera_indices: Option<Vec<u32>>,
}

#[derive(Deserialize)]
struct Frame {
    timestep_index: u32,
    camera_index: u32,
    file_path: PathBuf,
    fg_mask_path: Option<PathBuf>,
    flame_param_path: Option<PathBuf>,
}

impl Capture {
    /// Reads the list of pictures of a VHAP export, of one sequence or combined from several: `transforms_train.json`,
    /// `transforms_val.json` and `transforms_test.json`, or where they are missing `transforms.json`, divided by [`split_of`](super::split_of).
    /// Pictures, masks and parameters are read later, when asked for.
    ///
    /// # Errors
    /// When no list can be read, one is malformed or holds a camera that cannot be rendered, a picture is listed twice, a listed
    /// timestep or camera has no picture, or the head is behind most cameras, as in files with other axes.
    pub fn read(dir: &Path) -> Result<Self, FileError> {
        let path_of = |split: CaptureSplit| dir.join(format!("transforms_{split}.json"));
        let mut views = BTreeMap::new();
        let is_divided = path_of(CaptureSplit::Train).exists();
        if is_divided {
            for split in CaptureSplit::ALL {
                let path = path_of(split);
                // VHAP's validation set of one camera is empty, and a combined set may have no test part.
                if split == CaptureSplit::Train || path.exists() {
                    add(&mut views, &path, split)?;
                }
            }
        } else {
            let path = dir.join("transforms.json");
            if !path.exists() {
                let expected = "a capture as VHAP exports it, with transforms_train.json or transforms.json";
                let found = match dir.is_file() {
                    true => "a file; `srflow avatar import` makes a capture of a video or of pictures",
                    false => "neither",
                };
                let problem = problem("folder", expected, found);
                return Err(FileError { path: dir.to_owned(), problem });
            }
            add(&mut views, &path, CaptureSplit::Train)?;
        }
        let mut capture = Self { dir: dir.to_owned(), views: views.into_values().collect() };
        if !is_divided {
            capture.divide();
        }
        if capture.views.is_empty() {
            let problem = problem("frames", "one picture or more", "none");
            return Err(FileError { path: path_of(CaptureSplit::Train), problem });
        }
        if dir.join(CANONICAL_NAME).exists() {
            capture.check_facing()?;
        }
        Ok(capture)
    }

    /// VHAP moves the world such that the tracked head is at its origin.
    fn check_facing(&self) -> Result<(), FileError> {
        let behind = self.views.iter().filter(|view| view.camera.camera_from_world.w_axis.z <= 0.0);
        let behind = behind.collect::<Vec<_>>();
        let (Some(first), true) = (behind.first(), 2 * behind.len() > self.views.len()) else {
            return Ok(());
        };
        let expected = "world from camera with the axes x right, y up, z backward (OpenGL), in front of which the head is; \
                        negate the second and third column if they are OpenCV's";
        let found = format!(
            "{} of {} cameras that look away from the head at the origin, such as that of `{}`",
            behind.len(),
            self.views.len(),
            first.image.display()
        );
        let problem = problem("transform_matrix", expected, found);
        Err(FileError { path: self.dir.clone(), problem })
    }
}

/// Adds the pictures of one list.
fn add(
    views: &mut BTreeMap<(u32, u32), CaptureView>,
    path: &Path,
    split: CaptureSplit,
) -> Result<(), FileError> {
    let in_file = |problem| FileError { path: path.to_owned(), problem };
    let Transforms { frames, timestep_indices, camera_indices } =
        serde_json::from_str(&read_text(path, FileKind::Json)?).map_err(|error| {
            let expected = "frames with timestep_index, camera_index and file_path, as VHAP exports them";
            in_file(problem("transforms", expected, parse_error_in_words(&error)))
        })?;
    if frames.is_empty() {
        return Ok(());
    }
    for (name, listed, of) in [
        ("timestep_indices", timestep_indices, (|frame| frame.timestep_index) as fn(&Frame) -> u32),
        ("camera_indices", camera_indices, |frame| frame.camera_index),
    ] {
        check_listed(name, listed.as_deref(), frames.iter().map(of)).map_err(in_file)?;
    }
    let cameras = read_cameras(path, None)?;
    for (frame, named) in frames.into_iter().zip(cameras) {
        let Frame { timestep_index, camera_index, file_path, fg_mask_path, flame_param_path } = frame;
        let view = CaptureView {
            split,
            timestep: timestep_index,
            camera_index,
            camera: named.camera,
            image: with_extension(file_path),
            mask: fg_mask_path,
            parameters: flame_param_path,
        };
        if let Some(other) = views.insert((timestep_index, camera_index), view) {
            let expected = "each picture once, in one split";
            let found = format!(
                "timestep {timestep_index} of camera {camera_index} a second time (`{}`, in {})",
                other.image.display(),
                other.split
            );
            return Err(in_file(problem("frames", expected, found)));
        }
    }
    Ok(())
}

/// Pictures may be listed without their extension, which is then `.png`.
fn with_extension(path: PathBuf) -> PathBuf {
    if path.extension().is_some() { path } else { path.with_extension("png") }
}

/// Every listed timestep or camera has a picture, and every picture is of a listed one.
fn check_listed(
    name: &'static str,
    listed: Option<&[u32]>,
    found: impl Iterator<Item = u32>,
) -> Result<(), FileProblem> {
    let Some(listed) = listed else { return Ok(()) };
    let listed: std::collections::BTreeSet<u32> = listed.iter().copied().collect();
    let found: std::collections::BTreeSet<u32> = found.collect();
    if let Some(missing) = listed.difference(&found).next() {
        let expected = "those of the pictures (export the capture again, or remove it from the list)";
        return Err(problem(name, expected, format!("{missing}, of which no picture is listed")));
    }
    match found.difference(&listed).next() {
        None => Ok(()),
        Some(stray) => {
            let expected = format!("all {} of the pictures (export the capture again)", found.len());
            Err(problem(name, expected, format!("{}, without {stray}", listed.len())))
        }
    }
}

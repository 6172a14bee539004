//! Settings of cameras.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use srflow_core::{Size, excerpt, excerpts};
use srflow_splat::{Camera, Gaussians, NamedCamera, Surroundings, Up, read_cameras};

use crate::clap::Args;
use crate::error::wrong_settings;

/// Size of the default camera, in pixels.
const SIZE: Size = Size::new(800, 800);

/// The camera of a frame, and that of the next.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CameraArgs {
    /// Camera of this frame [default: one that sees all Gaussians from +z, where +y is up; those of a .splat file from -z, where -y is
    /// up]
    #[arg(long, value_name = "CAM")]
    pub camera: Option<PathBuf>,
    /// Camera of CAM: its picture's name, with or without folder and extension, or its number from 0
    #[arg(long, value_name = "NAME|N", requires = "camera")]
    pub view: Option<String>,
    /// Camera of the next frame, of the same image size
    #[arg(long, value_name = "CAM")]
    pub camera_next: Option<PathBuf>,
    /// Camera to use from --camera-next, or from --camera without --camera-next
    #[arg(long, value_name = "NAME|N")]
    pub view_next: Option<String>,
    /// Size of the pictures, with the camera's aspect ratio; required if CAM has no size
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    pub size: Option<Size>,
}

/// A circle of the camera, written `360`, `360x120`, `-90x30`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orbit {
    pub degrees: f64,
    pub frames: usize,
}

impl fmt::Display for Orbit {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}x{}", self.degrees, self.frames)
    }
}

srflow_core::serialize_as_text!(Orbit);

impl FromStr for Orbit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (degrees, frames) = match text.split_once('x') {
            Some((degrees, frames)) => (degrees, Some(frames)),
            None => (text, None),
        };
        let degrees = degrees.parse().ok().filter(|degrees: &f64| degrees.is_finite() && *degrees != 0.0);
        let frames = match (degrees, frames) {
            (_, Some(frames)) => frames.parse().ok(),
            (Some(degrees), None) => Some((degrees.abs() / 3.0).ceil() as usize),
            (None, None) => None,
        };
        match (degrees, frames) {
            (Some(degrees), Some(frames)) if (2..=100_000).contains(&frames) => Ok(Self { degrees, frames }),
            _ => Err("expected DEGREES or DEGREESxFRAMES with 2 frames or more, such as 360x120".to_owned()),
        }
    }
}

impl CameraArgs {
    /// The camera of this frame.
    ///
    /// # Errors
    /// When it cannot be read, or the file holds several and none was selected.
    pub fn first(&self, gaussians: &Gaussians, up: Up) -> anyhow::Result<Camera> {
        match &self.camera {
            Some(file) => self.chosen(file, self.view.as_deref(), "view"),
            None => Ok(self.facing(gaussians, up)),
        }
    }

    /// The camera of the next frame, if it differs.
    ///
    /// # Errors
    /// As [`CameraArgs::first`].
    pub fn next(&self) -> anyhow::Result<Option<Camera>> {
        let view = self.view_next.as_deref();
        match (&self.camera_next, &self.camera) {
            (Some(file), _) => self.chosen(file, view, "view_next").map(Some),
            (None, Some(file)) if view.is_some() => self.chosen(file, view, "view_next").map(Some),
            (None, None) if view.is_some() => {
                wrong_settings!("`view_next` selects a camera of `camera_next` or `camera`: give one of them")
            }
            (None, _) => Ok(None),
        }
    }

    /// Cameras on a circle around the Gaussians, starting from the camera of this frame.
    ///
    /// # Errors
    /// As [`CameraArgs::first`].
    pub fn orbit(&self, orbit: Orbit, gaussians: &Gaussians, up: Up) -> anyhow::Result<Vec<Camera>> {
        let centre = Surroundings::of(gaussians).map_or_else(Default::default, |seen| seen.centre);
        Ok(self.first(gaussians, up)?.orbit(centre, orbit.degrees, orbit.frames))
    }

    /// All cameras of a file.
    ///
    /// # Errors
    /// When it cannot be read, or they differ in size.
    pub fn path(&self, file: &Path) -> anyhow::Result<Vec<Camera>> {
        let named = self.read(file)?;
        if let Some(bent) = named.iter().find(|camera| camera.distortion.is_some()) {
            note_distortion(file, bent);
        }
        let cameras =
            named.iter().map(|named| self.resized(named)).collect::<anyhow::Result<Vec<Camera>>>()?;
        if let Some((odd, camera)) =
            named.iter().zip(&cameras).find(|(_, camera)| camera.size() != cameras[0].size())
        {
            anyhow::bail!(
                "{}: the pictures of a path must have one size; `{}` is {}, `{}` is {}",
                file.display(),
                excerpt(&named[0].name),
                cameras[0].size(),
                excerpt(&odd.name),
                camera.size()
            );
        }
        Ok(cameras)
    }

    fn facing(&self, gaussians: &Gaussians, up: Up) -> Camera {
        let size = self.size.unwrap_or(SIZE);
        let seen =
            Surroundings::of(gaussians).unwrap_or(Surroundings { centre: Default::default(), radius: 1.0 });
        match up {
            Up::PlusY => Camera::facing(seen, size),
            Up::MinusY => Camera::facing_down(seen, size),
        }
    }

    fn chosen(&self, file: &Path, view: Option<&str>, field: &str) -> anyhow::Result<Camera> {
        let cameras = self.read(file)?;
        let found = match view {
            None => (cameras.len() == 1).then_some(&cameras[0]),
            Some(view) => named(&cameras, view),
        };
        let Some(found) = found else {
            let what = match view {
                Some(view) => format!("no camera has the name `{view}`"),
                None => "choose one".to_owned(),
            };
            wrong_settings!(
                "{} holds {} cameras: {what}; give `{field}` a name or a number from 0 to {}; the first names are {}",
                file.display(),
                cameras.len(),
                cameras.len() - 1,
                excerpts(cameras.iter().take(3).map(|camera| camera.name.as_str()), 3)
            );
        };
        if found.distortion.is_some() {
            note_distortion(file, found);
        }
        self.resized(found)
    }

    fn read(&self, file: &Path) -> anyhow::Result<Vec<NamedCamera>> {
        Ok(read_cameras(file, self.size)?)
    }

    fn resized(&self, NamedCamera { name, camera, .. }: &NamedCamera) -> anyhow::Result<Camera> {
        let Some(size) = self.size else { return Ok(*camera) };
        let proportions = (size.width * camera.height) as f64 / (size.height * camera.width) as f64;
        if (proportions - 1.0).abs() > 0.01 {
            wrong_settings!(
                "`size` {size} would stretch the picture of `{}`, which is {}: give the same proportions",
                excerpt(name),
                camera.size()
            );
        }
        Ok(camera.resized(size))
    }
}

fn note_distortion(file: &Path, NamedCamera { name, distortion, .. }: &NamedCamera) {
    log::warn!(
        "{}: the lens of `{}` distorts ({}); it is rendered without distortion, as Gaussians are trained on \
        undistorted pictures",
        file.display(),
        excerpt(name),
        distortion.as_deref().unwrap_or_default()
    );
}

/// Matches the whole name, the name of the picture without folder and extension, or the number.
fn named<'a>(cameras: &'a [NamedCamera], view: &str) -> Option<&'a NamedCamera> {
    fn only<'a>(mut found: impl Iterator<Item = &'a NamedCamera>) -> Option<&'a NamedCamera> {
        found.next().filter(|_| found.next().is_none())
    }
    let of_path = |part: fn(&Path) -> Option<&std::ffi::OsStr>| {
        only(
            cameras
                .iter()
                .filter(move |camera| part(Path::new(&camera.name)).is_some_and(|part| part == view)),
        )
    };
    only(cameras.iter().filter(|camera| camera.name == view))
        .or_else(|| of_path(Path::file_name))
        .or_else(|| of_path(Path::file_stem))
        .or_else(|| cameras.get(view.parse::<usize>().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_is_degrees_and_frames() {
        assert_eq!("360x120".parse(), Ok(Orbit { degrees: 360.0, frames: 120 }));
        assert_eq!("-90".parse(), Ok(Orbit { degrees: -90.0, frames: 30 }));
        for wrong in ["", "x", "0x10", "360x1", "360x", "infx4", "90x-3", "nan"] {
            assert!(wrong.parse::<Orbit>().is_err(), "{wrong}");
        }
        assert_eq!(Orbit { degrees: -90.0, frames: 30 }.to_string(), "-90x30");
    }

    #[test]
    fn a_camera_is_found_by_name_before_number() {
        let camera = |name: &str| NamedCamera {
            name: name.to_owned(),
            camera: Camera::centred(Size::new(4, 4), [1.0; 2]),
            distortion: None,
        };
        let cameras = ["images/1.png", "images/00.png", "left/a.jpg", "right/a.jpg"].map(camera);
        let found = |view: &str| named(&cameras, view).map(|camera| camera.name.as_str());
        assert_eq!(found("left/a.jpg"), Some("left/a.jpg"));
        assert_eq!(found("00.png"), Some("images/00.png"));
        assert_eq!(found("1"), Some("images/1.png"), "a name, though camera number 1 is another");
        assert_eq!(found("3"), Some("right/a.jpg"));
        assert_eq!(found("a"), None, "two have this name");
        assert_eq!(found("4"), None);
    }
}

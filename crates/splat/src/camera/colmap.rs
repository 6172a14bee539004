//! COLMAP models: `cameras` with the intrinsics and `images` with the poses, as text or binary (colmap/colmap,
//! `src/colmap/scene/reconstruction_io.cc`; `scripts/python/read_write_model.py` reads both). Poses are camera from world in
//! OpenCV's axes. The principal point is relative to the corner of the first pixel; ours to its centre.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat4, DQuat, DVec3};
use srflow_files::{FileError, FileKind, FileProblem, read_file};

use super::Camera;
use super::file::{NamedCamera, distortion, invalid, problem};

/// A camera model: its number in binary files, its name in text files, and its parameters in order. `f` is both focal lengths;
/// parameters other than focal lengths and principal point are distortion.
struct Model {
    id: i32,
    name: &'static str,
    parameters: &'static [&'static str],
    /// Whether it is a pinhole when its distortion is zero.
    pinhole: bool,
}

const fn model(id: i32, name: &'static str, parameters: &'static [&'static str], pinhole: bool) -> Model {
    Model { id, name, parameters, pinhole }
}

/// `src/colmap/sensor/models.h`.
const MODELS: [Model; 11] = [
    model(0, "SIMPLE_PINHOLE", &["f", "cx", "cy"], true),
    model(1, "PINHOLE", &["fx", "fy", "cx", "cy"], true),
    model(2, "SIMPLE_RADIAL", &["f", "cx", "cy", "k"], true),
    model(3, "RADIAL", &["f", "cx", "cy", "k1", "k2"], true),
    model(4, "OPENCV", &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"], true),
    model(5, "OPENCV_FISHEYE", &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"], false),
    model(6, "FULL_OPENCV", &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"], true),
    model(7, "FOV", &["fx", "fy", "cx", "cy", "omega"], true),
    model(8, "SIMPLE_RADIAL_FISHEYE", &["f", "cx", "cy", "k"], false),
    model(9, "RADIAL_FISHEYE", &["f", "cx", "cy", "k1", "k2"], false),
    model(
        10,
        "THIN_PRISM_FISHEYE",
        &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"],
        false,
    ),
];

/// The two relevant files of a model.
pub(super) struct Files {
    cameras: PathBuf,
    images: PathBuf,
    binary: bool,
}

impl Files {
    /// Finds them in a model's folder, its `sparse/0` or `sparse`, or next to any file of a model.
    pub(super) fn of(path: &Path) -> Option<Self> {
        let within = |folder: &Path| {
            ["bin", "txt"].into_iter().find_map(|extension| {
                let [cameras, images] =
                    ["cameras", "images"].map(|name| folder.join(name).with_extension(extension));
                (cameras.is_file() && images.is_file()).then(|| Self {
                    cameras,
                    images,
                    binary: extension == "bin",
                })
            })
        };
        if path.is_dir() {
            return ["", "sparse/0", "sparse"].into_iter().find_map(|folder| within(&path.join(folder)));
        }
        let of_model = |name: &str| {
            ["cameras", "images", "points3D"]
                .iter()
                .any(|known| ["bin", "txt"].iter().any(|extension| name == format!("{known}.{extension}")))
        };
        path.file_name()?.to_str().filter(|name| of_model(name))?;
        within(path.parent()?)
    }
}

/// Intrinsics of a camera, by its number.
struct Intrinsics {
    width: usize,
    height: usize,
    model: &'static Model,
    parameters: Vec<f64>,
}

/// Pose of an image: camera from world.
struct Pose {
    /// w, x, y, z.
    rotation: [f64; 4],
    translation: [f64; 3],
    camera: i64,
    name: String,
}

/// The cameras of all images, sorted by name.
pub(super) fn cameras(files: &Files) -> Result<Vec<NamedCamera>, FileError> {
    fn parsed<T>(
        path: &Path,
        binary: bool,
        text: fn(&str) -> Result<T, FileProblem>,
        of_bytes: fn(&mut Bytes) -> Result<T, FileProblem>,
    ) -> Result<T, FileError> {
        let bytes = read_file(path, FileKind::Table)?;
        let found = match (binary, str::from_utf8(&bytes)) {
            (true, _) => of_bytes(&mut Bytes(&bytes)),
            (false, Ok(lines)) => text(lines),
            (false, Err(error)) => Err(problem("text", "UTF-8", error)),
        };
        found.map_err(|problem| FileError { path: path.to_owned(), problem })
    }
    let intrinsics = parsed(&files.cameras, files.binary, intrinsics_of_text, intrinsics_of_bytes)?;
    let mut poses = parsed(&files.images, files.binary, poses_of_text, poses_of_bytes)?;
    poses.sort_by(|a, b| a.name.cmp(&b.name));
    let in_file = |path: &Path, problem| FileError { path: path.to_owned(), problem };
    if poses.is_empty() {
        return Err(in_file(&files.images, problem("images", "one or more", "none")));
    }
    let camera = |pose: Pose| {
        let intrinsics = intrinsics.get(&pose.camera).ok_or_else(|| {
            let found = format!("{} for `{}`", pose.camera, pose.name);
            in_file(&files.images, problem("CAMERA_ID", "that of a camera in the file of cameras", found))
        })?;
        placed(intrinsics, pose).map_err(|problem| in_file(&files.cameras, problem))
    };
    poses.into_iter().map(camera).collect()
}

fn placed(intrinsics: &Intrinsics, pose: Pose) -> Result<NamedCamera, FileProblem> {
    let Intrinsics { width, height, model, parameters } = intrinsics;
    let Pose { rotation: [w, x, y, z], translation, name, .. } = pose;
    if !model.pinhole {
        let found = format!("{}, a fisheye lens, for `{name}`", model.name);
        return Err(problem(
            "MODEL",
            "a model that generalizes the pinhole (undistort the images first)",
            found,
        ));
    }
    let get = |wanted: &str| {
        model.parameters.iter().zip(parameters).find(|(name, _)| **name == wanted).map(|(_, value)| *value)
    };
    let focal = |name: &str| get(name).or_else(|| get("f")).unwrap_or(f64::NAN);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    if !(rotation.length().is_finite() && rotation.length() > 0.0) {
        let found = format!("{w} {x} {y} {z} for `{name}`");
        return Err(problem("QW QX QY QZ", "a quaternion that is not zero", found));
    }
    let camera = Camera {
        width: *width,
        height: *height,
        fx: focal("fx"),
        fy: focal("fy"),
        cx: get("cx").unwrap_or(f64::NAN) - 0.5,
        cy: get("cy").unwrap_or(f64::NAN) - 0.5,
        camera_from_world: DMat4::from_rotation_translation(
            rotation.normalize(),
            DVec3::from_array(translation),
        ),
    };
    camera.validate().map_err(|error| invalid(&name, &error))?;
    let lens = model.parameters.iter().copied().zip(parameters.iter().copied());
    let lens = lens.filter(|(name, _)| !["f", "fx", "fy", "cx", "cy"].contains(name));
    Ok(NamedCamera { name, camera, distortion: distortion(lens) })
}

fn model_with(
    known: impl Fn(&Model) -> bool,
    found: &dyn std::fmt::Display,
) -> Result<&'static Model, FileProblem> {
    MODELS.iter().find(|model| known(model)).ok_or_else(|| {
        let names: Vec<&str> = MODELS.iter().filter(|model| model.pinhole).map(|model| model.name).collect();
        problem("MODEL", names.join(", "), found)
    })
}

/// Lines without comments and empty ones.
fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.trim_start_matches('\u{feff}').lines().map(str::trim).filter(|line| !line.starts_with('#'))
}

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]` on each line.
fn intrinsics_of_text(text: &str) -> Result<HashMap<i64, Intrinsics>, FileProblem> {
    let entry = |line: &str| {
        let wrong = || problem("camera", "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", line);
        let [id, name, width, height, ref parameters @ ..] = line.split_whitespace().collect::<Vec<_>>()[..]
        else {
            return Err(wrong());
        };
        let model = model_with(|model| model.name == name, &name)?;
        let parameters: Option<Vec<f64>> = parameters.iter().map(|value| value.parse().ok()).collect();
        let parameters =
            parameters.filter(|values| values.len() == model.parameters.len()).ok_or_else(|| {
                problem("PARAMS[]", format!("{} for {}", model.parameters.join(" "), model.name), line)
            })?;
        let (Ok(id), Ok(width), Ok(height)) = (id.parse(), width.parse(), height.parse()) else {
            return Err(wrong());
        };
        Ok((id, Intrinsics { width, height, model, parameters }))
    };
    lines(text).filter(|line| !line.is_empty()).map(entry).collect()
}

/// Two lines per image: `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, and its points, which may be empty.
fn poses_of_text(text: &str) -> Result<Vec<Pose>, FileProblem> {
    let mut poses = Vec::new();
    let mut lines = lines(text);
    while let Some(line) = lines.next() {
        if line.is_empty() {
            continue;
        }
        let wrong = || problem("image", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", line);
        let fields = words_and_rest::<9>(line);
        let Some(([_, numbers @ .., camera], name)) = &fields else { return Err(wrong()) };
        let numbers: Option<Vec<f64>> = numbers.iter().map(|number| number.parse().ok()).collect();
        let (Some(&[w, x, y, z, tx, ty, tz]), Ok(camera)) = (numbers.as_deref(), camera.parse()) else {
            return Err(wrong());
        };
        poses.push(Pose {
            rotation: [w, x, y, z],
            translation: [tx, ty, tz],
            camera,
            name: (*name).to_owned(),
        });
        let points = lines.next().unwrap_or_default();
        let words: Vec<&str> = points.split_whitespace().collect();
        // Without this, a file of one line for each image would lose every second image.
        if !words.len().is_multiple_of(3) || words.iter().any(|word| word.parse::<f64>().is_err()) {
            let expected =
                format!("the points of {name} as X Y POINT3D_ID, or an empty line: each image has two lines");
            return Err(problem("points", expected, points));
        }
    }
    Ok(poses)
}

/// The first words of a line, and what is behind them, such as a name with spaces.
fn words_and_rest<const N: usize>(line: &str) -> Option<([&str; N], &str)> {
    let mut rest = line;
    let mut words = [""; N];
    for word in &mut words {
        let (first, behind) = rest.split_once(char::is_whitespace)?;
        (*word, rest) = (first, behind.trim_start());
    }
    (!rest.is_empty()).then_some((words, rest))
}

/// The remaining bytes of a binary file, little-endian.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], FileProblem> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or_else(|| {
            problem("file size", format!("{count} more bytes"), format!("{}", self.0.len()))
        })?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FileProblem> {
        Ok(self.take(N)?.try_into().unwrap_or([0; N])) // `take` returns N bytes
    }

    fn u64(&mut self) -> Result<u64, FileProblem> {
        self.array().map(u64::from_le_bytes)
    }

    fn i32(&mut self) -> Result<i32, FileProblem> {
        self.array().map(i32::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], FileProblem> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.array().map(f64::from_le_bytes)?;
        }
        Ok(values)
    }

    /// A zero-terminated string.
    fn text(&mut self) -> Result<String, FileProblem> {
        let end = self.0.iter().position(|byte| *byte == 0);
        let end = end.ok_or_else(|| problem("NAME", "a zero at its end", "none"))?;
        let text = String::from_utf8_lossy(&self.0[..end]).into_owned();
        self.0 = &self.0[end + 1..];
        Ok(text)
    }
}

fn intrinsics_of_bytes(bytes: &mut Bytes) -> Result<HashMap<i64, Intrinsics>, FileProblem> {
    let mut found = HashMap::new();
    for _ in 0..bytes.u64()? {
        let (id, model) = (bytes.i32()?, bytes.i32()?);
        let model = model_with(|known| known.id == model, &model)?;
        let [width, height] =
            [bytes.u64()?, bytes.u64()?].map(|side| usize::try_from(side).unwrap_or(usize::MAX));
        let parameters = model
            .parameters
            .iter()
            .map(|_| bytes.array().map(f64::from_le_bytes))
            .collect::<Result<_, _>>()?;
        found.insert(i64::from(id), Intrinsics { width, height, model, parameters });
    }
    Ok(found)
}

fn poses_of_bytes(bytes: &mut Bytes) -> Result<Vec<Pose>, FileProblem> {
    /// Bytes of x, y and the id of a point.
    const POINT: usize = 24;
    let mut poses = Vec::new();
    for _ in 0..bytes.u64()? {
        bytes.i32()?; // IMAGE_ID
        let (rotation, translation) = (bytes.f64s()?, bytes.f64s()?);
        let camera = i64::from(bytes.i32()?);
        let name = bytes.text()?;
        let points = usize::try_from(bytes.u64()?).unwrap_or(usize::MAX);
        bytes.take(points.saturating_mul(POINT))?;
        poses.push(Pose { rotation, translation, camera, name });
    }
    Ok(poses)
}

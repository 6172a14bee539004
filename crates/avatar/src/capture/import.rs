//! A capture from pictures in folders of any naming, and a file of their cameras.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use srflow_core::{excerpt, excerpts};
use srflow_files::{FileError, FileProblem, read_image_size};
use srflow_splat::{Camera, NamedCamera, read_cameras};

use super::{Capture, CaptureSplit, CaptureView, problem};

/// How the pictures of a capture are named: a path with `{camera}` and `{timestep}`, such as `cam_{camera}/frame_{timestep}.jpg`.
/// Without an ending it stands for PNG and JPEG.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PicturePattern {
    text: String,
    parts: Vec<Part>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Text(String),
    /// Any text without a slash.
    Camera,
    /// Digits.
    Timestep,
}

const CAMERA: &str = "{camera}";
const TIMESTEP: &str = "{timestep}";
const ENDINGS: [&str; 3] = [".png", ".jpg", ".jpeg"];

impl FromStr for PicturePattern {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = Vec::new();
        let mut rest = text;
        while let Some(at) = [CAMERA, TIMESTEP].into_iter().filter_map(|name| rest.find(name)).min() {
            if at > 0 {
                parts.push(Part::Text(rest[..at].to_owned()));
            }
            let is_camera = rest[at..].starts_with(CAMERA);
            parts.push(if is_camera { Part::Camera } else { Part::Timestep });
            rest = &rest[at + if is_camera { CAMERA } else { TIMESTEP }.len()..];
        }
        if !rest.is_empty() {
            parts.push(Part::Text(rest.to_owned()));
        }
        let count = |wanted: &Part| parts.iter().filter(|part| *part == wanted).count();
        if count(&Part::Camera) != 1 || count(&Part::Timestep) != 1 {
            return Err(format!(
                "`{text}`: expected {CAMERA} and {TIMESTEP}, once each, such as cam_{CAMERA}/frame_{TIMESTEP}.jpg"
            ));
        }
        Ok(Self { text: text.to_owned(), parts })
    }
}

impl fmt::Display for PicturePattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

srflow_core::serialize_as_text!(PicturePattern);

impl PicturePattern {
    /// The camera and the timestep of a path, written with slashes; `None` if it does not have this form.
    pub fn matches<'a>(&self, path: &'a str) -> Option<(&'a str, u32)> {
        let whole = |path: &'a str| matches(&self.parts, path, None, None);
        whole(without_ending(path)?).or_else(|| whole(path))
    }
}

/// The path of a picture without its ending; `None` for other files.
fn without_ending(path: &str) -> Option<&str> {
    let lower = path.to_ascii_lowercase();
    let ending = ENDINGS.into_iter().find(|ending| lower.ends_with(ending))?;
    Some(&path[..path.len() - ending.len()])
}

/// The camera and the timestep of `text`, which has the form of `parts` and may have had some before.
fn matches<'a>(
    parts: &[Part],
    text: &'a str,
    camera: Option<&'a str>,
    timestep: Option<u32>,
) -> Option<(&'a str, u32)> {
    match parts.split_first() {
        None => camera.zip(timestep).filter(|_| text.is_empty()),
        Some((Part::Text(literal), rest)) => matches(rest, text.strip_prefix(literal)?, camera, timestep),
        Some((Part::Timestep, rest)) => {
            let digits = text.len() - text.trim_start_matches(|c: char| c.is_ascii_digit()).len();
            (1..=digits).rev().find_map(|len| {
                let number = text[..len].parse().ok()?;
                matches(rest, &text[len..], camera, Some(number))
            })
        }
        Some((Part::Camera, rest)) => {
            let name = text.split('/').next().unwrap_or_default();
            let ends = name.char_indices().map(|(at, c)| at + c.len_utf8());
            ends.rev().find_map(|end| matches(rest, &text[end..], Some(&text[..end]), timestep))
        }
    }
}

/// See [`import`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Imported {
    /// In the order of [`Capture::views`](super::Capture::views). Paths are relative to the folder of the pictures.
    pub views: Vec<CaptureView>,
    /// Numbers and names of the cameras.
    pub cameras: Vec<(u32, String)>,
    /// Names in the pictures that the file of cameras lacks; their pictures are left out.
    pub unknown_cameras: Vec<String>,
    /// Names of the file of cameras without pictures.
    pub unused_cameras: Vec<String>,
    /// Pictures for which the pattern of the masks finds none.
    pub without_mask: usize,
    /// A camera whose lens distorts, and how. The pictures must be undistorted.
    pub distorted: Option<(String, String)>,
}

/// What to import; paths of pictures and masks are relative to `pictures`.
#[derive(Debug, Clone, Copy)]
pub struct ImportRequest<'a> {
    pub pictures: &'a Path,
    pub pattern: &'a PicturePattern,
    pub masks: Option<&'a PicturePattern>,
    /// Any file that [`read_cameras`] reads. A camera is that of the pictures of its name: the name in the file, without its folder
    /// and ending, or the `{camera}` of its picture.
    pub cameras: &'a Path,
    /// Metres per unit of the cameras.
    pub unit: f64,
}

/// Finds pictures in a folder, their cameras in a file, and divides them as VHAP does. Cameras whose names are all numbers up to 999
/// keep them; others are numbered from 0 in the order of their names. A camera of another size than its pictures is resized if the
/// shape is the same.
///
/// # Errors
/// When nothing matches, two pictures have the same camera and timestep, the file of cameras cannot be read, or a camera has
/// another shape than its pictures.
pub fn import(request: &ImportRequest<'_>) -> Result<Imported, FileError> {
    let ImportRequest { pictures, pattern, masks, cameras: file, unit } = *request;
    let named = read_cameras(file, None)?;
    let files = files_below(pictures)?;
    let mut found = pictures_by_camera(pictures, &files, pattern)?;
    if found.is_empty() {
        let expected = format!("pictures named {}", pattern.text);
        let names = excerpts(files.iter().map(String::as_str), 3);
        let names = if files.is_empty() {
            "no files".to_owned()
        } else {
            format!("{} files, such as {names}", files.len())
        };
        return Err(problem("pictures", expected, names).in_file(pictures));
    }
    let mask_of: BTreeMap<(&str, u32), &String> = masks
        .map(|masks| files.iter().filter_map(|path| Some((masks.matches(path)?, path))).collect())
        .unwrap_or_default();

    let known: BTreeMap<&str, &NamedCamera> =
        named.iter().map(|camera| (key(&camera.name, pattern), camera)).collect();
    let unknown_cameras: Vec<String> =
        found.keys().filter(|name| !known.contains_key(name.as_str())).cloned().collect();
    let unused_cameras =
        known.keys().filter(|name| !found.contains_key(**name)).map(|name| (*name).to_owned()).collect();
    found.retain(|name, _| known.contains_key(name.as_str()));
    if found.is_empty() {
        let expected = format!("the cameras of the pictures: {}", some(&unknown_cameras));
        let names: Vec<String> = known.keys().map(|name| (*name).to_owned()).collect();
        let stems = || files.iter().filter_map(|path| Path::new(path).file_stem()?.to_str());
        let advice = match names.iter().any(|name| stems().any(|stem| stem == name)) {
            true => ", which are the names of pictures; name each camera as `{camera}` matches it",
            false => "",
        };
        return Err(problem("cameras", expected, some(&names) + advice).in_file(file));
    }
    let mut names: Vec<String> = found.keys().cloned().collect();
    names.sort_by(|a, b| (a.parse::<u64>().ok(), a).cmp(&(b.parse::<u64>().ok(), b)));

    let mut views = BTreeMap::new();
    let (mut without_mask, mut distorted) = (0, None);
    let indices = indices(&names);
    for (&index, name) in indices.iter().zip(&names) {
        let NamedCamera { camera, distortion, .. } = known[name.as_str()];
        distorted = distorted.or_else(|| Some((name.clone(), distortion.clone()?)));
        let timesteps = &found[name];
        let first = timesteps.values().next().map(|path| pictures.join(path)).unwrap_or_default();
        let camera = in_metres(sized(*camera, name, &first)?, unit);
        for (&timestep, path) in timesteps {
            let mask = mask_of.get(&(name.as_str(), timestep));
            without_mask += usize::from(masks.is_some() && mask.is_none());
            let view = CaptureView {
                split: CaptureSplit::Train,
                timestep,
                camera_index: index,
                camera,
                image: path.into(),
                mask: mask.map(PathBuf::from),
                parameters: None,
            };
            views.insert((timestep, index), view);
        }
    }
    let mut capture = Capture { dir: pictures.to_owned(), views: views.into_values().collect() };
    capture.divide();
    let cameras = indices.into_iter().zip(names).collect();
    Ok(Imported { views: capture.views, cameras, unknown_cameras, unused_cameras, without_mask, distorted })
}

/// The numbers of cameras of these names, ascending.
fn indices(names: &[String]) -> Vec<u32> {
    let numbers: Vec<u32> = names.iter().filter_map(|name| name.parse().ok()).collect();
    let distinct = numbers.windows(2).all(|pair| pair[0] < pair[1]);
    if numbers.len() == names.len() && distinct && numbers.last().is_some_and(|&last| last <= 999) {
        return numbers;
    }
    (0..names.len() as u32).collect()
}

fn some(names: &[String]) -> String {
    excerpts(names.iter().map(String::as_str), 8)
}

/// The name of a camera in the pictures.
fn key<'a>(name: &'a str, pattern: &PicturePattern) -> &'a str {
    if let Some((camera, _)) = pattern.matches(name) {
        return camera;
    }
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    without_ending(file).unwrap_or(file)
}

/// The pictures of each camera by timestep.
fn pictures_by_camera(
    dir: &Path,
    files: &[String],
    pattern: &PicturePattern,
) -> Result<BTreeMap<String, BTreeMap<u32, String>>, FileError> {
    let mut found: BTreeMap<String, BTreeMap<u32, String>> = BTreeMap::new();
    for path in files {
        let Some((camera, timestep)) = pattern.matches(path) else { continue };
        let other = found.entry(camera.to_owned()).or_default().insert(timestep, path.clone());
        if let Some(other) = other {
            let expected = format!("one picture of camera {} at timestep {timestep}", excerpt(camera));
            let names = format!("{} and {}", excerpt(&other), excerpt(path));
            return Err(problem("pictures", expected, names).in_file(dir));
        }
    }
    Ok(found)
}

/// The camera for the size of a picture.
fn sized(camera: Camera, name: &str, picture: &Path) -> Result<Camera, FileError> {
    let size = read_image_size(picture)?;
    let (of_width, of_height) =
        (size.width as f64 / camera.width as f64, size.height as f64 / camera.height as f64);
    // Sizes are rounded: 2200x3208 may have become 550x802.
    if (of_width / of_height - 1.0).abs() > 0.01 {
        let expected = format!("{} or the same shape, as camera {}", camera.size(), excerpt(name));
        return Err(problem("size", expected, size).in_file(picture));
    }
    Ok(camera.resized(size))
}

/// The camera in a world of metres; `unit` are the metres in a unit of its own.
fn in_metres(camera: Camera, unit: f64) -> Camera {
    let mut camera_from_world = camera.camera_from_world;
    let translation = camera_from_world.w_axis.truncate() * unit;
    camera_from_world.w_axis = translation.extend(1.0);
    Camera { camera_from_world, ..camera }
}

/// Most files that are listed.
const MOST_FILES: usize = 4_000_000;

/// All files below a folder, relative, with slashes, sorted. Hidden ones and links to folders are left out.
fn files_below(dir: &Path) -> Result<Vec<String>, FileError> {
    let mut files = Vec::new();
    let mut folders = vec![(dir.to_owned(), String::new())];
    while let Some((folder, prefix)) = folders.pop() {
        let failed = |error| FileProblem::Io { doing: "listing the folder", error }.in_file(&folder);
        for entry in std::fs::read_dir(&folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let name = entry.file_name();
            let Some(name) = name.to_str().filter(|name| !name.starts_with('.')) else { continue };
            let kind = entry.file_type().map_err(failed)?;
            if kind.is_dir() {
                folders.push((entry.path(), format!("{prefix}{name}/")));
            } else if files.len() < MOST_FILES {
                files.push(format!("{prefix}{name}"));
            }
        }
    }
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use srflow_core::Image;
    use srflow_files::write_image_png;

    use super::*;

    fn pattern(text: &str) -> PicturePattern {
        text.parse().unwrap()
    }

    #[test]
    fn patterns_find_camera_and_timestep() {
        for (text, path, expected) in [
            ("cam_{camera}/frame_{timestep}.jpg", "cam_222200037/frame_00012.jpg", Some(("222200037", 12))),
            ("cam_{camera}/frame_{timestep}", "cam_a/frame_1.PNG", Some(("a", 1))),
            ("{timestep}_{camera}.png", "00012_08.png", Some(("08", 12))),
            ("{camera}_{timestep}", "front_left_7.jpeg", Some(("front_left", 7))),
            ("{timestep}/{camera}", "3/gauche-é.jpg", Some(("gauche-é", 3))),
            ("{camera}{timestep}", "c12.png", Some(("c1", 2))),
            ("cam_{camera}/frame_{timestep}.jpg", "cam_1/frame_2.png", None),
            ("cam_{camera}/frame_{timestep}", "cam_1/frame_2.txt", None),
            ("{camera}/{timestep}", "a/b/1.png", None),
            ("{camera}/{timestep}", "a/99999999999.png", None),
        ] {
            assert_eq!(pattern(text).matches(path), expected, "{text}, {path}");
        }
        for text in ["", "{camera}", "{timestep}.png", "{camera}/{camera}_{timestep}"] {
            assert!(text.parse::<PicturePattern>().unwrap_err().contains("once each"), "{text}");
        }
    }

    /// Cameras of 3D Gaussian Splatting, 16x12, two units in front of the origin and half a unit apart.
    fn cameras(names: &[&str]) -> String {
        let camera = |(number, name): (usize, &&str)| {
            let x = 0.5 * number as f64;
            format!(
                r#"{{"id": {number}, "img_name": "{name}", "width": 16, "height": 12, "position": [{x}, 0, -2],
                    "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 20, "fy": 20}}"#
            )
        };
        format!("[{}]", names.iter().enumerate().map(camera).collect::<Vec<_>>().join(","))
    }

    /// Four timesteps of the cameras 2, 10 and x at half of the cameras' size, and masks of the first camera.
    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let image = Image::new(8, 6);
        for name in ["2", "10", "x"] {
            let dir = folder.path().join(format!("seq/cam_{name}"));
            std::fs::create_dir_all(&dir).unwrap();
            for timestep in 3..7 {
                write_image_png(&dir.join(format!("frame_{timestep:05}.png")), &image).unwrap();
                if name == "2" {
                    write_image_png(&dir.join(format!("mask_{timestep:05}.png")), &image).unwrap();
                }
            }
        }
        std::fs::write(folder.path().join("notes.txt"), "").unwrap();
        let names = ["cam_10.jpg", "seq/cam_2/frame_00000.png", "cam_unused"];
        std::fs::write(folder.path().join("cameras.json"), cameras(&names).replace("cam_10", "10")).unwrap();
        folder
    }

    fn import_from(folder: &Path, text: &str, masks: Option<&PicturePattern>) -> Result<Imported, FileError> {
        let cameras = &folder.join("cameras.json");
        import(&ImportRequest { pictures: folder, pattern: &pattern(text), masks, cameras, unit: 0.5 })
    }

    #[test]
    fn pictures_find_their_cameras_and_masks() {
        let folder = folder();
        let masks = pattern("seq/cam_{camera}/mask_{timestep}");
        let found =
            import_from(folder.path(), "seq/cam_{camera}/frame_{timestep}.png", Some(&masks)).unwrap();
        assert_eq!(found.cameras, [(2, "2".to_owned()), (10, "10".to_owned())]);
        assert_eq!((found.unknown_cameras, found.without_mask), (vec!["x".to_owned()], 4));
        assert_eq!(found.unused_cameras, ["cam_unused"]);
        let places: Vec<(u32, u32)> =
            found.views.iter().map(|view| (view.timestep, view.camera_index)).collect();
        assert_eq!(places[..3], [(3, 2), (3, 10), (4, 2)]);
        let view = &found.views[1];
        assert_eq!(view.image, Path::new("seq/cam_10/frame_00003.png"));
        assert_eq!((&view.mask, &found.views[0].mask), (&None, &Some("seq/cam_2/mask_00003.png".into())));
        // Half the size of the file's camera, in metres of two units each.
        let camera = view.camera;
        assert_eq!((camera.width, camera.height, camera.fx), (8, 6, 10.0));
        assert!((camera.position() - glam::DVec3::new(0.0, 0.0, -1.0)).length() < 1e-12);
        assert!((found.views[0].camera.position().x - 0.25).abs() < 1e-12);
        let splits: Vec<_> = found.views.iter().map(|view| view.split.to_string()).collect();
        assert_eq!(splits, ["train", "val", "train", "val", "train", "val", "test", "test"]);
    }

    #[test]
    fn cameras_keep_small_numbers() {
        let of = |names: &[&str]| indices(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        assert_eq!(of(&["00", "08", "15"]), [0, 8, 15]);
        assert_eq!(of(&["8", "08"]), [0, 1]);
        assert_eq!(of(&["221501007", "222200036"]), [0, 1]);
        assert_eq!(of(&["7", "front"]), [0, 1]);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let folder = folder();
        let error = |text: &str| import_from(folder.path(), text, None).unwrap_err().to_string();
        let none = error("{camera}/{timestep}");
        assert!(none.contains("named {camera}/{timestep}") && none.contains("18 files"), "{none}");
        std::fs::write(folder.path().join("seq/cam_2/frame_00004.jpg"), "").unwrap();
        let twice = error("seq/cam_{camera}/frame_{timestep}");
        assert!(twice.contains("one picture of camera 2") && twice.contains("frame_00004.jpg"), "{twice}");

        write_image_png(&folder.path().join("seq/cam_2/frame_00003.png"), &Image::new(6, 8)).unwrap();
        let shape = error("seq/cam_{camera}/frame_{timestep}.png");
        assert!(shape.contains("16x12 or the same shape") && shape.contains("6x8"), "{shape}");

        std::fs::write(folder.path().join("cameras.json"), cameras(&["other"])).unwrap();
        let strangers = error("seq/{camera}/frame_{timestep}.png");
        assert!(strangers.contains("the pictures: cam_10, cam_2, cam_x, found other"), "{strangers}");
    }
}

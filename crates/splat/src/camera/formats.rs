//! Camera files, recognized by content. Each format is one file in this folder and one line of the table.

use std::collections::BTreeMap;
use std::path::Path;

use serde::de::IgnoredAny;
use srflow_core::Size;
use srflow_files::{FileError, FileKind, FileProblem, read_text};

use super::file::{NamedCamera, Source, invalid, problem};
use super::{camera_path, colmap, gaussian_splatting, nersemble, own, transforms};

/// Reads the cameras of a file in file order (COLMAP: by name): our own format, `cameras.json` of 3D Gaussian Splatting,
/// `transforms.json` of NeRF, instant-ngp, nerfstudio and VHAP, a camera path of nerfstudio, `camera_params.json` of NeRSemble, or
/// a COLMAP model, text or binary: its folder, or any of its files.
///
/// `size` is for formats that do not store it; `None` looks it up in the pictures that the file lists.
///
/// # Errors
/// When the file cannot be read, has none of these formats or is corrupt, contains no camera, or one that cannot be rendered:
/// with a fisheye lens, a pose that is not rigid, or an unknown size.
pub fn read_cameras(path: &Path, size: Option<Size>) -> Result<Vec<NamedCamera>, FileError> {
    let in_file = |problem| FileError { path: path.to_owned(), problem };
    if let Some(files) = colmap::Files::of(path) {
        return colmap::cameras(&files);
    }
    let text = read_text(path, FileKind::Json)?;
    let bytes = text.as_bytes();
    let format = format_of(bytes).map_err(in_file)?;
    let cameras = (format.read)(&Source { path, bytes, size }).map_err(in_file)?;
    if cameras.is_empty() {
        return Err(in_file(problem("cameras", "one camera or more", "none")));
    }
    for NamedCamera { name, camera, .. } in &cameras {
        camera.validate().map_err(|error| in_file(invalid(name, &error)))?;
    }
    Ok(cameras)
}

struct Format {
    /// Name in messages, with the distinguishing keys.
    name: &'static str,
    /// The key at the root of the file that no other format has; none where the root is a list.
    key: Option<&'static str>,
    read: fn(&Source) -> Result<Vec<NamedCamera>, FileProblem>,
}

const FORMATS: [Format; 5] = [
    Format {
        name: "a camera with width, height, fx, fy, cx, cy and w2c",
        key: Some("w2c"),
        read: own::cameras,
    },
    Format {
        name: "cameras.json of 3D Gaussian Splatting (a list)",
        key: None,
        read: gaussian_splatting::cameras,
    },
    Format {
        name: "transforms.json of NeRF or nerfstudio (with frames)",
        key: Some("frames"),
        read: transforms::cameras,
    },
    Format {
        name: "a camera path of nerfstudio (with camera_path)",
        key: Some("camera_path"),
        read: camera_path::cameras,
    },
    Format {
        name: "camera_params.json of NeRSemble (with world_2_cam)",
        key: Some("world_2_cam"),
        read: nersemble::cameras,
    },
];

fn format_of(bytes: &[u8]) -> Result<&'static Format, FileProblem> {
    let unknown = |found: String| {
        let names = FORMATS.each_ref().map(|format| format.name).join(", ");
        problem("format", format!("{names}, or the folder of a COLMAP model"), found)
    };
    let is_list = bytes.trim_ascii_start().starts_with(b"[");
    let root: BTreeMap<String, IgnoredAny> = if is_list {
        BTreeMap::new()
    } else {
        serde_json::from_slice(bytes).map_err(|error| unknown(format!("not a JSON object: {error}")))?
    };
    FORMATS
        .iter()
        .find(|format| format.key.map_or(is_list, |key| root.contains_key(key)))
        .ok_or_else(|| unknown("a JSON object without any of these keys".to_owned()))
}

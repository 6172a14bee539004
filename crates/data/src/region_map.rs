//! Region maps: which part of a head each pixel of a frame shows.
//!
//! A map is an 8-bit grey picture of the frame's size: 0 is the background, other values are the labels of [`HeadPart`]s.
//! `srflow render --regions` writes them.

use std::path::Path;

use serde::Serialize;
use srflow_core::{Labels, named};
use srflow_files::{FileError, FileProblem, read_labels};

/// A part of a head as pixels show it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadPart {
    /// Face and ears, with lips, brows, lashes and stubble.
    Skin,
    /// Eyeballs and the lining of the lids.
    Eyes,
    /// Teeth, tongue and the inside of the mouth.
    Mouth,
    /// Hair, and the scalp below it.
    Hair,
    /// Neck and shoulders.
    Neck,
}

named!(HeadPart, "a part of the head", {
    Skin => "skin", Eyes => "eyes", Mouth => "mouth", Hair => "hair", Neck => "neck",
});

impl HeadPart {
    /// Its value in a region map: 1 to 5, in the order of [`HeadPart::ALL`].
    pub fn label(self) -> u8 {
        self as u8 + 1
    }

    /// The part with this label; `None` for 0, the background, and for values without a meaning.
    pub fn of_label(label: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|part| part.label() == label)
    }
}

/// Reads a region map: 0 or the [label](HeadPart::label) of a part at every pixel.
///
/// # Errors
/// When the file cannot be read, is not an 8-bit grey picture, or has another value.
pub fn read_region_map(path: &Path) -> Result<Labels, FileError> {
    let map = read_labels(path)?;
    check_region_map(&map).map_err(|problem| problem.in_file(path))?;
    Ok(map)
}

/// # Errors
/// When a value is neither 0 nor the label of a part.
pub(crate) fn check_region_map(map: &Labels) -> Result<(), FileProblem> {
    let meaningless = |label: &u8| *label > 0 && HeadPart::of_label(*label).is_none();
    match map.pixels().iter().position(meaningless) {
        None => Ok(()),
        Some(place) => {
            let (x, y) = (place % map.width(), place / map.width());
            let expected = "0 (background), 1 (skin), 2 (eyes), 3 (mouth), 4 (hair) or 5 (neck)";
            Err(FileProblem::Pixel { x, y, expected, found: map.get(x, y).to_string() })
        }
    }
}

#[cfg(test)]
mod tests {
    use srflow_files::write_labels_png;

    use super::*;

    #[test]
    fn labels_are_those_of_the_parts() {
        assert_eq!(HeadPart::ALL.map(HeadPart::label), [1, 2, 3, 4, 5]);
        for part in HeadPart::ALL {
            assert_eq!(HeadPart::of_label(part.label()), Some(part));
        }
        assert_eq!([0, 6, 255].map(HeadPart::of_label), [None; 3]);
    }

    #[test]
    fn maps_are_read_and_other_values_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.png");
        let map = Labels::from_fn(9, 4, |x, y| ((x + y) % 6) as u8);
        write_labels_png(&path, &map).unwrap();
        assert_eq!(read_region_map(&path).unwrap(), map);
        let mut wrong = map;
        wrong.set(7, 2, 6);
        write_labels_png(&path, &wrong).unwrap();
        let error = read_region_map(&path).unwrap_err().to_string();
        assert!(error.contains("map.png: pixel (7, 2): expected 0 (background), 1 (skin)"), "{error}");
        for part in HeadPart::ALL {
            assert!(error.contains(&format!("{} ({part})", part.label())), "{error}");
        }
        assert!(error.ends_with("found 6"), "{error}");
    }
}

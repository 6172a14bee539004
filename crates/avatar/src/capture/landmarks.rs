//! `landmarks.csv`: one row per landmark, `timestep,camera,landmark,x,y`. Coordinates are pixels, an integer being the centre of
//! a pixel; a landmark without a row is missing.

mod detectors;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use srflow_files::{FileError, FileKind, read_text, write_atomically};

use super::problem;

/// Name of the file of landmarks in a capture.
pub const LANDMARKS_NAME: &str = "landmarks.csv";

/// Landmarks of a face, in dlib's order.
pub const LANDMARK_COUNT: usize = 68;

const HEADER: &str = "timestep,camera,landmark,x,y";

/// The landmarks of one picture: pixel, or `None` where missing.
pub type Face = [Option<[f64; 2]>; LANDMARK_COUNT];

/// The 68 landmarks of dlib in the pictures of a capture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Landmarks {
    faces: BTreeMap<(u32, u32), Face>,
}

impl Landmarks {
    /// The landmarks of a picture; `None` if it has none at all.
    pub fn get(&self, timestep: u32, camera_index: u32) -> Option<&Face> {
        self.faces.get(&(timestep, camera_index))
    }

    /// Sets the landmarks of a picture.
    pub fn insert(&mut self, timestep: u32, camera_index: u32, face: Face) {
        self.faces.insert((timestep, camera_index), face);
    }

    /// Number of pictures with landmarks.
    pub fn len(&self) -> usize {
        self.faces.len()
    }

    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// Writes the file, with coordinates to a thousandth of a pixel.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        write_atomically(path, |writer| {
            writeln!(writer, "{HEADER}")?;
            for (&(timestep, camera), face) in &self.faces {
                for (number, place) in face.iter().enumerate() {
                    if let Some([x, y]) = place {
                        writeln!(writer, "{timestep},{camera},{number},{x:.3},{y:.3}")?;
                    }
                }
            }
            Ok(())
        })
    }

    /// Reads the file.
    ///
    /// # Errors
    /// When it cannot be read, has other columns, or a row is malformed, a second one for the same landmark, or of a landmark beyond
    /// 67. The error names the line.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let text = read_text(path, FileKind::Table)?;
        let in_file = |problem| FileError { path: path.to_owned(), problem };
        let mut lines = text.lines();
        let header = lines.next().unwrap_or_default();
        if header.trim() != HEADER {
            return Err(in_file(problem("header", format!("`{HEADER}`"), header)));
        }
        let mut landmarks = Self::default();
        for (number, line) in (2..).zip(lines) {
            if line.trim().is_empty() {
                continue;
            }
            let (key, landmark, pixel) = row(line).ok_or_else(|| {
                let expected =
                    "timestep, camera and landmark (0 to 67) as integers, x and y as finite numbers";
                in_file(problem("row", expected, format!("`{line}` in line {number}")))
            })?;
            let place = &mut landmarks.faces.entry(key).or_insert([None; LANDMARK_COUNT])[landmark];
            if place.replace(pixel).is_some() {
                let found = format!("a second one in line {number}: `{line}`");
                return Err(in_file(problem("row", "one row for each landmark of a picture", found)));
            }
        }
        Ok(landmarks)
    }
}

fn row(line: &str) -> Option<((u32, u32), usize, [f64; 2])> {
    let mut fields = line.split(',').map(str::trim);
    let mut next = || fields.next();
    let key = (next()?.parse().ok()?, next()?.parse().ok()?);
    let landmark = next()?.parse().ok().filter(|landmark| *landmark < LANDMARK_COUNT)?;
    let pixel: [f64; 2] = [next()?.parse().ok()?, next()?.parse().ok()?];
    (next().is_none() && pixel.iter().all(|value| value.is_finite())).then_some((key, landmark, pixel))
}

//! `landmarks.csv`: one row per landmark, `timestep,camera,landmark,x,y`. Coordinates are pixels, an integer being the centre of
//! a pixel; a landmark without a row is missing.

mod detectors;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use srflow_files::{CsvRow, CsvTable, FileError, FileKind, whole_number, write_atomically};

use super::problem;

/// Name of the file of landmarks in a capture.
pub const LANDMARKS_NAME: &str = "landmarks.csv";

/// Landmarks of a face, in dlib's order.
pub const LANDMARK_COUNT: usize = 68;

const COLUMNS: [&str; 5] = ["timestep", "camera", "landmark", "x", "y"];

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
            writeln!(writer, "{}", COLUMNS.join(","))?;
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
        let mut table = CsvTable::open(path, FileKind::Table)?;
        let in_file = |problem| FileError { path: path.to_owned(), problem };
        let mut columns = [0; COLUMNS.len()];
        for (place, name) in columns.iter_mut().zip(COLUMNS) {
            let found = table.column(name)?.filter(|_| table.columns().len() == COLUMNS.len());
            *place = found.ok_or_else(|| {
                let expected = format!("the columns `{}`", COLUMNS.join(","));
                in_file(problem("header", expected, table.shown_columns()))
            })?;
        }
        let mut landmarks = Self::default();
        while let Some(cells) = table.next_row()? {
            let shown = || format!("`{}`", cells.cells().collect::<Vec<_>>().join(","));
            let (key, landmark, pixel) = row(&cells, columns).ok_or_else(|| {
                let expected =
                    "timestep, camera and landmark (0 to 67) as integers, x and y as finite numbers";
                in_file(problem("row", expected, format!("{} in line {}", shown(), cells.line)))
            })?;
            let place = &mut landmarks.faces.entry(key).or_insert([None; LANDMARK_COUNT])[landmark];
            if place.replace(pixel).is_some() {
                let found = format!("a second one in line {}: {}", cells.line, shown());
                return Err(in_file(problem("row", "one row for each landmark of a picture", found)));
            }
        }
        Ok(landmarks)
    }
}

fn row(cells: &CsvRow, columns: [usize; 5]) -> Option<((u32, u32), usize, [f64; 2])> {
    if cells.count() != columns.len() {
        return None;
    }
    let [timestep, camera, landmark, x, y] = columns;
    let whole = |column: usize| whole_number(cells.text(column))?.try_into().ok();
    let landmark = whole(landmark)? as usize;
    let pixel = [x, y].map(|column| cells.number(column).ok().flatten());
    let key = (whole(timestep)?, whole(camera)?);
    (landmark < LANDMARK_COUNT).then_some((key, landmark, [pixel[0]?, pixel[1]?]))
}

//! Landmarks of faces in CSV files.

use std::path::{Path, PathBuf};

use srflow_core::excerpt;
use srflow_files::{FileKind, open_file, read_file, write_atomically};

use crate::{FaceError, FacePoints};

/// Larger coordinates, in pixels, are not in any frame of a face.
const MAX_COORDINATE: f64 = 65_536.0;

/// Faces from a CSV file, one in each row: dlib's 68 points as `x_0 y_0 .. x_67 y_67` (as OpenFace writes them) or the eyes alone as
/// `left_eye_x left_eye_y right_eye_x right_eye_y`, left and right as the picture shows them; and columns that say whose they are.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkTable {
    path: PathBuf,
    rows: Vec<LandmarkRow>,
}

/// A face of a [`LandmarkTable`].
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkRow {
    /// Line of the file, from 1.
    pub line: usize,
    /// Cells of the columns that were asked for, in their order; empty where the file lacks the column.
    pub keys: Vec<String>,
    pub face: FacePoints,
}

impl LandmarkTable {
    /// Reads the file. Of the columns beside the points, it must have those in `needed`; those in `optional` may be missing.
    ///
    /// # Errors
    /// When it cannot be read, lacks columns, or holds something other than places in a frame.
    pub fn read(path: &Path, needed: &[&str], optional: &[&str]) -> Result<Self, FaceError> {
        let wrong = |reason: String| FaceError::Landmarks { path: path.to_owned(), reason };
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(open_file(path, FileKind::Table)?.0);
        let headers = reader.headers().map_err(|error| wrong(error.to_string()))?.clone();
        let column = |name: &str| headers.iter().position(|header| header.eq_ignore_ascii_case(name));
        let must = |name: &str| {
            column(name).ok_or_else(|| {
                let points =
                    "x_0, y_0 to x_67, y_67 (or left_eye_x, left_eye_y, right_eye_x, right_eye_y)".to_owned();
                let mut all: Vec<String> = needed.iter().map(|name| (*name).to_owned()).collect();
                all.push(points);
                let (last, first) = all.split_last().expect("the points");
                let and = if first.is_empty() { "" } else { " and " };
                wrong(format!("expected the columns {}{and}{last}, found no {name}", first.join(", ")))
            })
        };
        let mut keys = needed.iter().map(|name| must(name).map(Some)).collect::<Result<Vec<_>, _>>()?;
        keys.extend(optional.iter().map(|name| column(name)));
        let point = |x: &str, y: &str| Ok::<_, FaceError>([must(x)?, must(y)?]);
        let points = if column("x_0").is_some() {
            (0..68).map(|n| point(&format!("x_{n}"), &format!("y_{n}"))).collect::<Result<Vec<_>, _>>()?
        } else {
            vec![point("left_eye_x", "left_eye_y")?, point("right_eye_x", "right_eye_y")?]
        };

        let mut rows = Vec::new();
        for (line, record) in (2..).zip(reader.records()) {
            let record = record.map_err(|error| wrong(error.to_string()))?;
            let coordinate = |at: usize| match record[at].parse::<f64>() {
                Ok(value) if value.abs() <= MAX_COORDINATE => Ok(value),
                _ => Err(wrong(format!(
                    "row {line}, {}: expected a place in a frame, in pixels, found `{}`",
                    excerpt(&headers[at]),
                    excerpt(&record[at])
                ))),
            };
            let read = |[x, y]: &[usize; 2]| Ok([coordinate(*x)?, coordinate(*y)?]);
            let read: Vec<[f64; 2]> = points.iter().map(read).collect::<Result<_, FaceError>>()?;
            let face = FacePoints::of(&read).ok_or_else(|| {
                wrong(format!("row {line}: the eyes are in the same place; leave the row out"))
            })?;
            let cell = |column: &Option<usize>| column.map_or("", |at| &record[at]).to_owned();
            rows.push(LandmarkRow { line, keys: keys.iter().map(cell).collect(), face });
        }
        Ok(Self { path: path.to_owned(), rows })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The face of the first row whose keys begin with this one.
    ///
    /// # Errors
    /// When there is no such row.
    pub fn of(&self, key: &str) -> Result<&FacePoints, FaceError> {
        let row = self.rows.iter().find(|row| row.keys.first().is_some_and(|found| found == key));
        let missing = || FaceError::NoLandmarks { path: self.path.clone(), of: key.to_owned() };
        row.map(|row| &row.face).ok_or_else(missing)
    }

    pub fn rows(&self) -> &[LandmarkRow] {
        &self.rows
    }
}

/// Writes a file that [`LandmarkTable::read`] reads: a row for each face, with cells of the columns `keys` before its 68 points. Faces
/// without dlib's points are left out. Unless `force` allows it, a file with other contents is not overwritten; the same contents are
/// those of an interrupted run.
///
/// # Errors
/// When the file cannot be written, or holds something else.
pub fn write_landmarks<'a>(
    path: &Path,
    keys: &[&str],
    force: bool,
    faces: impl IntoIterator<Item = (Vec<String>, &'a FacePoints)>,
) -> Result<(), FaceError> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let columns = ["x", "y"].into_iter().flat_map(|axis| (0..68).map(move |n| format!("{axis}_{n}")));
    let header = keys.iter().map(|key| (*key).to_owned()).chain(columns);
    let failed =
        |error: csv::Error| FaceError::Landmarks { path: path.to_owned(), reason: error.to_string() };
    csv.write_record(header).map_err(failed)?;
    for (keys, face) in faces {
        let Some(points) = &face.dlib else { continue };
        // Enough digits that the file gives the same crop again.
        let points =
            [0, 1].into_iter().flat_map(|axis| points.iter().map(move |point| point[axis].to_string()));
        csv.write_record(keys.into_iter().chain(points)).map_err(failed)?;
    }
    let text = csv.into_inner().map_err(|error| failed(error.into_error().into()))?;
    if !force && path.exists() && read_file(path, FileKind::Table)? != text {
        let reason = "holds something else; give `force` to overwrite it, or another name".to_owned();
        return Err(FaceError::Landmarks { path: path.to_owned(), reason });
    }
    Ok(write_atomically(path, |file| std::io::Write::write_all(file, &text))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, needed: &[&str]) -> Result<LandmarkTable, FaceError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("landmarks.csv");
        std::fs::write(&path, text).unwrap();
        LandmarkTable::read(&path, needed, &["frame"])
    }

    #[test]
    fn dlibs_points_give_the_eyes_and_are_written_as_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("landmarks.csv");
        let points: Vec<[f64; 2]> = (0..68).map(|n| [2.0 * f64::from(n) / 3.0, f64::from(n)]).collect();
        let face = FacePoints::of(&points).unwrap();
        assert_eq!(face.eyes[0], [77.0 / 3.0, 38.5]);
        let write = |name: &str| {
            let keys = vec![name.to_owned(), "7".to_owned()];
            write_landmarks(&path, &["clip", "frame"], false, [(keys, &face)])
        };
        write("a, b").unwrap();
        write("a, b").unwrap();
        assert!(write("other").unwrap_err().to_string().contains("`force`"));
        let table = LandmarkTable::read(&path, &["clip"], &["frame", "dataset"]).unwrap();
        assert_eq!(
            table.rows(),
            [LandmarkRow { line: 2, keys: ["a, b", "7", ""].map(String::from).into(), face }]
        );
    }

    #[test]
    fn wrong_landmarks_are_refused() {
        let eyes = "left_eye_x,left_eye_y,right_eye_x,right_eye_y";
        for (text, expected) in [
            ("subject,clip,x_0,y_0\n".to_owned(), "x_1"),
            (
                "subject,left_eye_x\n".to_owned(),
                "expected the columns subject, clip and x_0, y_0 to x_67, y_67",
            ),
            (format!("subject,clip,{eyes}\n1,a,x,2,3,4\n"), "row 2, left_eye_x"),
            (
                format!("subject,clip,{eyes}\n1,a,2,2,99999,2\n"),
                "row 2, right_eye_x: expected a place in a frame",
            ),
            (format!("subject,clip,{eyes}\n1,a,2,2,2,2\n"), "same place"),
        ] {
            let error = read(&text, &["subject", "clip"]).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(read("x_0\n", &[]).unwrap_err().to_string().contains("expected the columns x_0, y_0 to"));
    }
}

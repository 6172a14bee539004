//! Landmarks of faces in CSV files.

use std::path::{Path, PathBuf};

use srflow_files::{FileKind, FileProblem, PointSet, PointTable, read_file, write_atomically};

use crate::{FaceError, FacePoints};

/// Faces from a CSV file, one in each row: the points of a [`PointTable`] in pixels, and columns that say whose they are.
///
/// Eyes are left and right as the picture shows them; where a row has them the other way round, as the subject's own, they are swapped.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkTable {
    path: PathBuf,
    rows: Vec<LandmarkRow>,
    swapped: usize,
}

/// A row of a [`LandmarkTable`].
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkRow {
    /// Line of the file, from 1.
    pub line: usize,
    /// Cells of the columns that were asked for, in their order; empty where the file lacks the column.
    pub keys: Vec<String>,
    /// `None` where the program that wrote the file found no face.
    pub face: Option<FacePoints>,
}

impl LandmarkTable {
    /// Reads the file. Of the columns beside the points, it must have those in `needed`; those in `optional` may be missing.
    ///
    /// # Errors
    /// When it cannot be read, lacks columns, or holds something other than places in a frame in pixels.
    pub fn read(path: &Path, needed: &[&str], optional: &[&str]) -> Result<Self, FaceError> {
        let mut table = PointTable::read(path, needed, optional)?.in_pixels()?;
        let mut rows = Vec::new();
        let mut swapped = 0;
        for row in std::mem::take(&mut table.rows) {
            let face = match table.whole_face(&row)? {
                None => None,
                Some(mut points) => {
                    if let (PointSet::Eyes, [left, right]) = (table.set, &mut points[..])
                        && left[0] > right[0]
                    {
                        std::mem::swap(left, right);
                        swapped += 1;
                    }
                    let face = match table.set {
                        PointSet::MediaPipe => FacePoints::of_mesh_table(&points),
                        PointSet::Eyes | PointSet::Dlib => FacePoints::of(&points),
                    };
                    let problem = || FileProblem::Cell {
                        row: row.line,
                        column: "eyes".to_owned(),
                        expected: "eyes in two places; leave the row out".to_owned(),
                        found: "the same place".to_owned(),
                    };
                    Some(face.ok_or_else(|| problem().in_file(path))?)
                }
            };
            rows.push(LandmarkRow { line: row.line, keys: row.keys, face });
        }
        Ok(Self { path: path.to_owned(), rows, swapped })
    }

    /// What the user should know about how the file was read.
    pub fn note(&self) -> Option<String> {
        let Self { path, rows, swapped } = self;
        (*swapped > 0).then(|| {
            format!(
                "{}: left_eye is to the right of right_eye in {swapped} of {} rows: they are taken as the subject's left and \
                 right, and swapped to those of the picture",
                path.display(),
                rows.len()
            )
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The face of the first row whose keys begin with this one.
    ///
    /// # Errors
    /// When there is no such row, or it has no face.
    pub fn of(&self, key: &str) -> Result<&FacePoints, FaceError> {
        let row = self.rows.iter().find(|row| row.keys.first().is_some_and(|found| found == key));
        row.and_then(|row| row.face.as_ref()).ok_or_else(|| self.no_landmarks(key.to_owned(), row))
    }

    /// The first row with a face.
    ///
    /// # Errors
    /// When there is none.
    pub fn first(&self) -> Result<(&LandmarkRow, &FacePoints), FaceError> {
        let mut faces = self.rows.iter().filter_map(|row| Some((row, row.face.as_ref()?)));
        faces.next().ok_or_else(|| {
            let found = match self.rows.len() {
                0 => "none".to_owned(),
                count => format!("{count} in which the program that wrote the file found no face"),
            };
            FileProblem::field("rows", "a row of landmarks", found).in_file(&self.path).into()
        })
    }

    /// An error about a face that is not in the file, or in a row without one.
    pub fn no_landmarks(&self, of: String, row: Option<&LandmarkRow>) -> FaceError {
        let failed = |row: &LandmarkRow| format!("{of} (in row {} the tracker found no face)", row.line);
        FaceError::NoLandmarks { path: self.path.clone(), of: row.map_or_else(|| of.clone(), failed) }
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
            [LandmarkRow { line: 2, keys: ["a, b", "7", ""].map(String::from).into(), face: Some(face) }]
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

    #[test]
    fn faces_of_mediapipe_have_the_eyes_between_their_corners() {
        let mut points = [[30.0, 50.0]; 478];
        let corners = [(33, [18.0, 20.0]), (133, [26.0, 20.0]), (362, [38.0, 20.0]), (263, [46.0, 20.0])];
        for (point, place) in corners {
            points[point] = place;
        }
        let columns = |axis: &str| (0..478).map(|n| format!("{axis}_{n}")).collect::<Vec<_>>().join(",");
        let cells = |axis: usize| points.map(|point| point[axis].to_string()).join(",");
        let text = format!("{},{}\n{},{}\n", columns("x"), columns("y"), cells(0), cells(1));
        let table = read(&text, &[]).unwrap();
        let (_, face) = table.first().unwrap();
        assert_eq!(face.eyes, [[22.0, 20.0], [42.0, 20.0]]);
        assert_eq!(face.dlib.as_ref().map(|points| points[30]), Some([30.0, 50.0]));
    }

    #[test]
    fn eyes_named_as_the_subjects_are_swapped_with_a_note() {
        let eyes = "left_eye_x,left_eye_y,right_eye_x,right_eye_y";
        let table = read(&format!("{eyes}\n40,21,22,20\n22,20,40,21\n"), &[]).unwrap();
        for row in table.rows() {
            assert_eq!(row.face.as_ref().unwrap().eyes, [[22.0, 20.0], [40.0, 21.0]]);
        }
        let note = table.note().unwrap();
        assert!(
            note.contains("landmarks.csv: left_eye is to the right") && note.contains("1 of 2 rows"),
            "{note}"
        );
        assert_eq!(read(&format!("{eyes}\n22,20,40,21\n"), &[]).unwrap().note(), None);
    }

    #[test]
    fn rows_without_a_face_are_not_used() {
        let eyes = "pair,success,left_eye_x,left_eye_y,right_eye_x,right_eye_y";
        let table = read(&format!("{eyes}\na,0,0,0,0,0\nb,1,10,10,50,10\n"), &["pair"]).unwrap();
        assert_eq!(table.first().map(|(row, _)| row.line).unwrap(), 3);
        let error = table.of("a").unwrap_err().to_string();
        assert!(error.contains("no landmarks of a (in row 2 the tracker found no face)"), "{error}");
        let none =
            read(&format!("{eyes}\na,0,0,0,0,0\n"), &["pair"]).unwrap().first().unwrap_err().to_string();
        assert!(none.contains("expected a row of landmarks, found 1 in which"), "{none}");
        let hole = read(&format!("{eyes}\na,1,10,10,,10\n"), &["pair"]).unwrap_err().to_string();
        assert!(hole.contains("row 2, right_eye_x: expected a place in a frame"), "{hole}");
    }
}

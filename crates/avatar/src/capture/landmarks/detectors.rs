//! Landmarks in the files of other programs: OpenFace, MediaPipe and iBUG's annotations.

use std::path::{Path, PathBuf};

use srflow_core::{Size, excerpt};
use srflow_files::{FileError, FileKind, FileProblem, PointSet, PointTable, read_text};

use super::super::problem;
use super::{Face, LANDMARK_COUNT, Landmarks};

impl Landmarks {
    /// Adds the landmarks of one camera from a [`PointTable`] with a row for each frame: dlib's 68 in pixels, as OpenFace writes them
    /// (`FeatureExtraction -2Dfp`), or MediaPipe's 468 or 478, in pixels or as shares of the picture's width and height.
    ///
    /// `frame` gives the timestep; without it rows are counted. It counts from 0, but from 1 in a table of 68 landmarks without a frame 0,
    /// as OpenFace does. A frame whose row has no face is missing, and so is a landmark without a coordinate. Of several faces in a frame the one
    /// of highest `confidence` is taken, else the first.
    ///
    /// # Errors
    /// When the file cannot be read, columns are missing, or a value is not a number. The error names the line.
    pub fn add_table(
        &mut self,
        path: &Path,
        camera_index: u32,
        Size { width, height }: Size,
    ) -> Result<(), FileError> {
        let table = PointTable::read(path, &[], &["frame"])?;
        let in_file = |problem| FileError { path: path.to_owned(), problem };
        let is_zero = |cell: &String| cell.parse::<f64>().is_ok_and(|frame| frame == 0.0);
        let has_zero = || table.rows.iter().any(|row| row.keys.first().is_some_and(is_zero));
        let first_frame = match table.set {
            PointSet::Dlib => u8::from(!has_zero()),
            PointSet::MediaPipe => 0,
            PointSet::Eyes => {
                let expected = "the 68 landmarks of OpenFace or the 468 or 478 of MediaPipe";
                return Err(in_file(problem("header", expected, "the eyes alone")));
            }
        };
        // The edges of the picture are 0 and 1.
        let scale = |[x, y]: [f64; 2]| match table.is_relative {
            true => [x * width as f64 - 0.5, y * height as f64 - 0.5],
            false => [x, y],
        };
        let mut confidences = std::collections::BTreeMap::new();
        for (count, row) in table.rows.iter().enumerate() {
            let number = row.line;
            let counted = match row.keys.first().map_or("", String::as_str) {
                "" => count as f64,
                cell => {
                    let frame: Result<f64, _> = cell.parse();
                    let wrong = |_| {
                        let found = format!("{} in line {number}", excerpt(cell));
                        in_file(problem("row", "a number for frame", found))
                    };
                    frame.map_err(wrong)? - f64::from(first_frame)
                }
            };
            if !(0.0..=f64::from(u32::MAX)).contains(&counted) || counted.fract() != 0.0 {
                let found = format!("line {number} counts to {counted} after the first one");
                return Err(in_file(problem("frame", format!("whole numbers from {first_frame} on"), found)));
            }
            let timestep = counted as u32;
            let mut face: Face = [None; LANDMARK_COUNT];
            for (place, point) in face.iter_mut().zip(&row.points) {
                *place = point.map(scale);
            }
            if confidences.get(&timestep).is_none_or(|best| row.confidence > *best) {
                confidences.insert(timestep, row.confidence);
                self.insert(timestep, camera_index, face);
            }
        }
        Ok(())
    }

    /// Reads a folder of iBUG's annotations, one file for each picture: `00012_08.pts` for timestep 12 of camera 8, as the pictures
    /// of a capture are named. iBUG counts pixels from 1.
    ///
    /// # Errors
    /// When the folder or a file cannot be read, a name has another form, or a file does not have 68 points. The error names the
    /// line.
    pub fn read_points(dir: &Path) -> Result<Self, FileError> {
        let listed = std::fs::read_dir(dir).and_then(|entries| {
            entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<PathBuf>>>()
        });
        let mut files = listed.map_err(|error| FileError {
            path: dir.to_owned(),
            problem: FileProblem::Io { doing: "listing", error },
        })?;
        files.retain(|path| path.extension().is_some_and(|extension| extension == "pts"));
        files.sort();
        if files.is_empty() {
            let problem = problem("folder", "files like 00012_08.pts (timestep 12, camera 8)", "none");
            return Err(FileError { path: dir.to_owned(), problem });
        }
        let mut landmarks = Self::default();
        for path in files {
            let in_file = |problem| FileError { path: path.clone(), problem };
            let name = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
            let numbers = name.split_once('_').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
            let Some((timestep, camera)) = numbers else {
                let expected = "timestep_camera.pts, such as 00012_08.pts";
                return Err(in_file(problem("name", expected, excerpt(name))));
            };
            let face = points(&read_text(&path, FileKind::Table)?).map_err(in_file)?;
            if landmarks.get(timestep, camera).is_some() {
                let found = "another file of the same timestep and camera";
                return Err(in_file(problem("name", "one file for each picture", found)));
            }
            landmarks.insert(timestep, camera, face);
        }
        Ok(landmarks)
    }
}

/// The points of one annotation.
fn points(text: &str) -> Result<Face, FileProblem> {
    let mut face: Face = [None; LANDMARK_COUNT];
    let mut count = 0;
    let mut inside = false;
    for (number, line) in (1..).zip(text.lines()) {
        match line.trim_start_matches('\u{feff}').trim() {
            "{" => inside = true,
            "}" => inside = false,
            row if inside && !row.is_empty() => {
                let mut fields = row.split_whitespace().map(str::parse::<f64>);
                let (Some(Ok(x)), Some(Ok(y)), None) = (fields.next(), fields.next(), fields.next()) else {
                    let found = format!("{} in line {number}", excerpt(row));
                    return Err(problem("point", "x and y", found));
                };
                if let Some(place) = face.get_mut(count) {
                    *place = (x.is_finite() && y.is_finite()).then_some([x - 1.0, y - 1.0]);
                }
                count += 1;
            }
            _ => (),
        }
    }
    if count != LANDMARK_COUNT {
        return Err(problem("points", format!("{LANDMARK_COUNT} between {{ and }}"), count));
    }
    Ok(face)
}

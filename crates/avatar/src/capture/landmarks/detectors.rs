//! Landmarks in the files of other programs: OpenFace, MediaPipe and iBUG's annotations.

use std::path::{Path, PathBuf};

use srflow_core::{MEDIAPIPE_OF_DLIB, excerpt};
use srflow_files::{FileError, FileKind, FileProblem, read_text};

use super::super::problem;
use super::{Face, LANDMARK_COUNT, Landmarks};

/// Numbers of columns `x_*` that are understood: dlib's landmarks, and MediaPipe's without and with irises.
const COUNTS: [usize; 3] = [LANDMARK_COUNT, 468, 478];

impl Landmarks {
    /// Adds the landmarks of one camera from a table with a row for each frame and columns `x_0`, `x_1`, ..., `y_0`, `y_1`, ...:
    /// 68 of them as OpenFace writes them (`FeatureExtraction -2Dfp`), in pixels, or MediaPipe's 468 or 478, as shares of the
    /// picture's width and height.
    ///
    /// `frame` counts from 1 as OpenFace does if there are 68 landmarks, else from 0, and gives the timestep; without it rows are
    /// counted. A frame whose `success` is 0 is missing, and so is a coordinate that is empty or not finite. Of several faces in a
    /// frame the one of highest `confidence` is taken, else the first.
    ///
    /// # Errors
    /// When the file cannot be read, columns are missing, or a value is not a number. The error names the line.
    pub fn add_table(
        &mut self,
        path: &Path,
        camera_index: u32,
        (width, height): (usize, usize),
    ) -> Result<(), FileError> {
        let text = read_text(path, FileKind::Table)?;
        let in_file = |problem| FileError { path: path.to_owned(), problem };
        let mut lines = text.lines();
        let header: Vec<&str> = lines.next().unwrap_or_default().split(',').map(str::trim).collect();
        let table = Table::of(&header).map_err(in_file)?;
        let scale = |[x, y]: [f64; 2]| match table.x.len() {
            LANDMARK_COUNT => [x, y],
            // The edges of the picture are 0 and 1.
            _ => [x * width as f64 - 0.5, y * height as f64 - 0.5],
        };
        let mut confidences = std::collections::BTreeMap::new();
        for (row, (number, line)) in (2..).zip(lines).filter(|(_, line)| !line.trim().is_empty()).enumerate()
        {
            let cells: Vec<&str> = line.split(',').map(str::trim).collect();
            let value = |column: Option<usize>| -> Result<Option<f64>, FileError> {
                let Some(column) = column else { return Ok(None) };
                let Some(cell) = cells.get(column) else {
                    let found = format!("{} in line {number}", cells.len());
                    return Err(in_file(problem(
                        "row",
                        format!("{} values, as in the header", header.len()),
                        found,
                    )));
                };
                if cell.is_empty() {
                    return Ok(None);
                }
                let parsed: Result<f64, _> = cell.parse();
                parsed.map(|value| value.is_finite().then_some(value)).map_err(|_| {
                    let found = format!("{} in line {number}", excerpt(cell));
                    in_file(problem("row", format!("a number for {}", excerpt(header[column])), found))
                })
            };
            let counted = match value(table.frame)? {
                None => row as f64,
                Some(frame) if table.x.len() == LANDMARK_COUNT => frame - 1.0,
                Some(frame) => frame,
            };
            if !(0.0..=f64::from(u32::MAX)).contains(&counted) || counted.fract() != 0.0 {
                let first = if table.x.len() == LANDMARK_COUNT { 1 } else { 0 };
                let found = format!("line {number} counts to {counted} after the first one");
                return Err(in_file(problem("frame", format!("whole numbers from {first} on"), found)));
            }
            let timestep = counted as u32;
            let mut face: Face = [None; LANDMARK_COUNT];
            let seen = value(table.success)?.is_none_or(|success| success != 0.0);
            for (landmark, place) in face.iter_mut().enumerate() {
                let column =
                    if table.x.len() == LANDMARK_COUNT { landmark } else { MEDIAPIPE_OF_DLIB[landmark] };
                let (x, y) = (value(Some(table.x[column]))?, value(Some(table.y[column]))?);
                *place = x.zip(y).filter(|_| seen).map(|(x, y)| scale([x, y]));
            }
            let confidence = value(table.confidence)?.unwrap_or(0.0);
            if confidences.get(&timestep).is_none_or(|best| confidence > *best) {
                confidences.insert(timestep, confidence);
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

/// Places of columns.
struct Table {
    x: Vec<usize>,
    y: Vec<usize>,
    frame: Option<usize>,
    success: Option<usize>,
    confidence: Option<usize>,
}

impl Table {
    fn of(header: &[&str]) -> Result<Self, FileProblem> {
        let place: std::collections::HashMap<&str, usize> =
            header.iter().enumerate().rev().map(|(place, name)| (*name, place)).collect();
        let series = |axis: char| -> Vec<usize> {
            (0..).map_while(|number| place.get(format!("{axis}_{number}").as_str()).copied()).collect()
        };
        let (x, y) = (series('x'), series('y'));
        if x.len() != y.len() || !COUNTS.contains(&x.len()) {
            let expected = "the columns x_0, x_1, ... and y_0, y_1, ... of 68 landmarks (OpenFace) or of 468 or 478 (MediaPipe)";
            return Err(problem("header", expected, format!("{} of x and {} of y", x.len(), y.len())));
        }
        let of = |name: &str| place.get(name).copied();
        Ok(Self { x, y, frame: of("frame"), success: of("success"), confidence: of("confidence") })
    }
}

/// The points of one annotation.
fn points(text: &str) -> Result<Face, FileProblem> {
    let mut face: Face = [None; LANDMARK_COUNT];
    let mut count = 0;
    let mut inside = false;
    for (number, line) in (1..).zip(text.lines()) {
        match line.trim() {
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

//! Tables with the points of a face in each row, as trackers write them; see [`PointTable`].

use std::path::{Path, PathBuf};

use srflow_core::MEDIAPIPE_OF_DLIB;

use crate::{CsvRow, CsvTable, FileError, FileKind, FileProblem};

/// Larger coordinates, in pixels, are not in any frame of a face.
const MAX_COORDINATE: f64 = 65_536.0;

/// Where all coordinates of a face are smaller, they are shares of the frame's width and height: no face is so small, and no tracker
/// places one so far outside.
const MAX_SHARE: f64 = 1.5;

/// Numbers of columns `x_*`: dlib's points, and MediaPipe's without and with irises.
const COUNTS: [usize; 3] = [68, 468, 478];

const EYES: [&str; 4] = ["left_eye_x", "left_eye_y", "right_eye_x", "right_eye_y"];

/// Names by which other programs call `frame`.
const NUMBERS_OF_FRAMES: [&str; 11] = [
    "timestep",
    "frame_id",
    "frame_idx",
    "frame_index",
    "frame_no",
    "frame_nr",
    "frame_num",
    "frame_number",
    "frameid",
    "frame number",
    "frame id",
];

/// The points of a face that a [`PointTable`] has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointSet {
    /// The centres of the two eyes: `left_eye_x`, `left_eye_y`, `right_eye_x`, `right_eye_y`.
    Eyes,
    /// dlib's 68, as OpenFace writes them: `x_0` to `x_67` and `y_0` to `y_67`.
    Dlib,
    /// MediaPipe's 468, or 478 with irises, in columns named alike. Those nearest to dlib's 68 are kept.
    MediaPipe,
}

/// A CSV file with a face in each row: the points of a [`PointSet`], and columns beside them. In names of points, case counts: OpenFace's
/// `X_0` is in millimetres in space, and its `x_0` in pixels.
///
/// A row is without a face where its `success` is 0 or false, and where all of its points are missing or in one place, as some trackers
/// fill rows in which they found none.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTable {
    path: PathBuf,
    pub set: PointSet,
    /// Whether coordinates are shares of the frame's width and height, and not pixels; only MediaPipe's may be.
    pub is_relative: bool,
    pub rows: Vec<PointRow>,
}

/// A row of a [`PointTable`].
#[derive(Debug, Clone, PartialEq)]
pub struct PointRow {
    /// Line of the file, from 1.
    pub line: usize,
    /// Cells of the columns that were asked for, in their order; empty where the file lacks the column.
    pub keys: Vec<String>,
    /// The 2 or 68 points in order, `None` where a coordinate is missing; empty for a row without a face.
    pub points: Vec<Option<[f64; 2]>>,
    /// How sure the tracker is; 0 where the file does not say.
    pub confidence: f64,
}

impl PointTable {
    /// Reads a file. Beside the points it must have the columns `needed`; those of `optional` may be missing.
    ///
    /// # Errors
    /// When the file cannot be read, lacks columns, calls a column of `optional` otherwise, or a cell holds something other than a place in
    /// a frame. The error names the line.
    pub fn read(path: &Path, needed: &[&str], optional: &[&str]) -> Result<Self, FileError> {
        let mut table = CsvTable::open(path, FileKind::Table)?;
        let columns = Columns::of(&table, needed, optional)?;
        let in_file = |problem: FileProblem| problem.in_file(path);
        let mut rows = Vec::new();
        // Whether the first face is in shares of the frame, and its line.
        let mut first: Option<(bool, usize)> = None;
        let count = table.columns().len();
        while let Some(row) = table.next_row()? {
            let (read, is_relative) = columns.row(&row, count).map_err(in_file)?;
            match (first, is_relative) {
                (None, Some(is_relative)) => first = Some((is_relative, row.line)),
                (Some((before, line)), Some(now)) if before != now => {
                    let kind = |is_relative| if is_relative { "shares of the frame" } else { "pixels" };
                    let expected = format!("{}, as in row {line}", kind(before));
                    let found = format!("{} in row {}", kind(now), row.line);
                    return Err(in_file(FileProblem::field("coordinates", expected, found)));
                }
                _ => {}
            }
            rows.push(read);
        }
        let is_relative = first.is_some_and(|(is_relative, _)| is_relative);
        let read = Self { path: path.to_owned(), set: columns.set, is_relative, rows };
        if is_relative && read.set != PointSet::MediaPipe { read.in_pixels() } else { Ok(read) }
    }

    /// The table, if its coordinates are pixels.
    ///
    /// # Errors
    /// When they are not.
    pub fn in_pixels(self) -> Result<Self, FileError> {
        if !self.is_relative {
            return Ok(self);
        }
        let expected = "pixels (multiply x by the frame's width and y by its height)";
        let found = "numbers around 0 to 1, which are shares of the frame";
        Err(FileProblem::field("coordinates", expected, found).in_file(&self.path))
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All points of a row; `None` for a row without a face.
    ///
    /// # Errors
    /// When some of the points are missing.
    pub fn whole_face(&self, row: &PointRow) -> Result<Option<Vec<[f64; 2]>>, FileError> {
        if row.points.is_empty() {
            return Ok(None);
        }
        let missing = |number: usize| {
            let column = match self.set {
                PointSet::Eyes => EYES[2 * number.min(1)].to_owned(),
                PointSet::Dlib => format!("x_{number}"),
                PointSet::MediaPipe => format!("x_{}", MEDIAPIPE_OF_DLIB[number]),
            };
            let expected = "a place in a frame, in pixels".to_owned();
            let found = "none for it or its y".to_owned();
            FileProblem::Cell { row: row.line, column, expected, found }.in_file(&self.path)
        };
        let points =
            row.points.iter().enumerate().map(|(number, point)| point.ok_or_else(|| missing(number)));
        points.collect::<Result<_, _>>().map(Some)
    }
}

/// Places of columns.
struct Columns {
    set: PointSet,
    /// Of x and y of the points that are kept.
    points: Vec<[usize; 2]>,
    keys: Vec<Option<usize>>,
    success: Option<usize>,
    confidence: Option<usize>,
}

impl Columns {
    fn of(table: &CsvTable, needed: &[&str], optional: &[&str]) -> Result<Self, FileError> {
        let in_file = |problem: FileProblem| problem.in_file(table.path());
        let expected = || {
            let points = "x_0, y_0 to x_67, y_67 (dlib's points, as OpenFace writes them; MediaPipe's go on to \
                          467 or 477) or left_eye_x, left_eye_y, right_eye_x, right_eye_y";
            match needed {
                [] => format!("the columns {points}"),
                _ => format!("the columns {} and {points}", needed.join(", ")),
            }
        };
        let lacking = |found: String| in_file(FileProblem::field("header", expected(), found));
        let mut keys = Vec::new();
        for name in needed {
            let Some(place) = table.column(name)? else {
                return Err(lacking(format!("no {name} in {}", table.shown_columns())));
            };
            keys.push(Some(place));
        }
        for name in optional {
            let place = table.column(name)?;
            if place.is_none() && *name == "frame" {
                check_no_other_frame(table).map_err(in_file)?;
            }
            keys.push(place);
        }
        let (xs, ys) = (series(table, 'x'), series(table, 'y'));
        let is_whole = |axis: char, count: usize| count == count_of(table, axis);
        let (set, points): (PointSet, Vec<[usize; 2]>) = if xs.len() == ys.len()
            && COUNTS.contains(&xs.len())
            && is_whole('x', xs.len())
            && is_whole('y', ys.len())
        {
            let all: Vec<[usize; 2]> = xs.into_iter().zip(ys).map(<[usize; 2]>::from).collect();
            match all.len() {
                68 => (PointSet::Dlib, all),
                _ => (PointSet::MediaPipe, MEDIAPIPE_OF_DLIB.iter().map(|&point| all[point]).collect()),
            }
        } else if count_of(table, 'x') > 0 {
            let next =
                if xs.len() > ys.len() { format!("y_{}", ys.len()) } else { format!("x_{}", xs.len()) };
            let (x, y) = (count_of(table, 'x'), count_of(table, 'y'));
            let ends = match xs.len() == x && ys.len() == y && x == y {
                true => format!("they end before {next}"),
                false => format!("no {next}"),
            };
            return Err(lacking(format!("{x} of x and {y} of y: {ends}")));
        } else if table.column(EYES[0])?.or(table.column(EYES[2])?).is_some() {
            let mut places = [0; 4];
            for (place, name) in places.iter_mut().zip(EYES) {
                *place = table.column(name)?.ok_or_else(|| lacking(format!("no {name}")))?;
            }
            let [left_x, left_y, right_x, right_y] = places;
            (PointSet::Eyes, vec![[left_x, left_y], [right_x, right_y]])
        } else if table.columns().iter().any(|column| column == "X_0") {
            let found = "no x_0 but X_0, which is in millimetres in space (write pixels with `FeatureExtraction -2Dfp`)";
            return Err(lacking(found.to_owned()));
        } else {
            return Err(lacking(format!("0 of x and 0 of y in {}", table.shown_columns())));
        };
        let (success, confidence) = (table.column("success")?, table.column("confidence")?);
        Ok(Self { set, points, keys, success, confidence })
    }

    /// A row of a table of `count` columns, and whether its points are shares of the frame, if it has any.
    fn row(&self, row: &CsvRow, count: usize) -> Result<(PointRow, Option<bool>), FileProblem> {
        let surplus = (count..row.count()).any(|place| !row.text(place).is_empty());
        if row.count() < count || surplus {
            let found = format!("{} in line {}", row.count(), row.line);
            return Err(FileProblem::field("row", format!("{count} values, as in the header"), found));
        }
        let keys = self.keys.iter().map(|key| key.map_or("", |key| row.text(key)).to_owned()).collect();
        let confidence = self.confidence.map_or(Ok(None), |place| row.number(place))?.unwrap_or(0.0);
        let mut read = PointRow { line: row.line, keys, points: Vec::new(), confidence };
        if let Some(place) = self.success
            && !succeeded(row, place)?
        {
            return Ok((read, None));
        }
        let coordinate = |place: usize| -> Result<Option<f64>, FileProblem> {
            let wrong = || row.wrong(place, "a place in a frame, in pixels");
            match row.number(place).map_err(|_| wrong())? {
                Some(value) if value.abs() > MAX_COORDINATE => Err(wrong()),
                value => Ok(value),
            }
        };
        let point = |[x, y]: &[usize; 2]| Ok(coordinate(*x)?.zip(coordinate(*y)?).map(|(x, y)| [x, y]));
        let points = self.points.iter().map(point).collect::<Result<Vec<_>, FileProblem>>()?;
        let mut there = points.iter().flatten();
        let Some(one) = there.next() else { return Ok((read, None)) };
        // Two eyes in one place are a mistake.
        if self.set != PointSet::Eyes
            && points.len() == 1 + there.clone().filter(|point| *point == one).count()
        {
            return Ok((read, None));
        }
        let largest = points.iter().flatten().flatten().fold(0.0, |most: f64, value| most.max(value.abs()));
        read.points = points;
        Ok((read, Some(largest < MAX_SHARE)))
    }
}

/// Columns `x_0`, `x_1`, ... as far as they go on.
fn series(table: &CsvTable, axis: char) -> Vec<usize> {
    let mut places = std::collections::HashMap::new();
    for (place, name) in table.columns().iter().enumerate() {
        if let Some(number) = number_of(name, axis) {
            places.entry(number).or_insert(place);
        }
    }
    (0..).map_while(|number: usize| places.get(&number).copied()).collect()
}

/// Number of columns of this axis, of whatever number.
fn count_of(table: &CsvTable, axis: char) -> usize {
    table.columns().iter().filter(|name| number_of(name, axis).is_some()).count()
}

/// The number of the point in a name such as `x_12`.
fn number_of(name: &str, axis: char) -> Option<usize> {
    let digits = name.strip_prefix(axis)?.strip_prefix('_')?;
    let is_plain =
        digits.bytes().all(|digit| digit.is_ascii_digit()) && (digits == "0" || !digits.starts_with('0'));
    is_plain.then(|| digits.parse().ok()).flatten()
}

/// Rows must not be counted, or taken for those of any frame, where a column of another name numbers them.
fn check_no_other_frame(table: &CsvTable) -> Result<(), FileProblem> {
    let is_number = |name: &&String| NUMBERS_OF_FRAMES.iter().any(|other| name.eq_ignore_ascii_case(other));
    match table.columns().iter().find(is_number) {
        None => Ok(()),
        Some(other) => {
            let expected = "the number of the frame in a column `frame`; rename the column";
            Err(FileProblem::field("header", expected, other.clone()))
        }
    }
}

fn succeeded(row: &CsvRow, place: usize) -> Result<bool, FileProblem> {
    let text = row.text(place);
    let is = |words: [&str; 2]| words.iter().any(|word| text.eq_ignore_ascii_case(word));
    match row.number(place) {
        Ok(number) => Ok(number.is_none_or(|number| number != 0.0)),
        Err(_) if is(["true", "yes"]) => Ok(true),
        Err(_) if is(["false", "no"]) => Ok(false),
        Err(_) => Err(row.wrong(place, "0 or 1")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<PointTable, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, text).unwrap();
        PointTable::read(&path, &[], &["frame"]).map_err(|error| error.to_string())
    }

    /// A table of `count` points: point n of a row is at (start + n, 2 n) times `scale`.
    fn table(head: &str, axes: [char; 2], count: usize, rows: &[(&str, f64)], scale: f64) -> String {
        let names = |axis: char| (0..count).map(|n| format!(",{axis}_{n}")).collect::<String>();
        let mut text = format!("{head}{}{}\n", names(axes[0]), names(axes[1]));
        for (cells, start) in rows {
            text += cells;
            text.extend((0..count).map(|n| format!(",{}", (start + n as f64) * scale)));
            text.extend((0..count).map(|n| format!(",{}", 2.0 * n as f64 * scale)));
            text += "\n";
        }
        text
    }

    #[test]
    fn columns_of_space_are_not_those_of_the_picture() {
        let space = table("frame", ['X', 'Y'], 68, &[("1", 3.0)], 1.0);
        let error = read(&space).unwrap_err();
        assert!(error.contains("no x_0 but X_0") && error.contains("-2Dfp"), "{error}");
        // Both, in either order.
        let (pixels, row) = (table("x", ['x', 'y'], 68, &[("1", 3.0)], 1.0), "1");
        let both = |first: &str, second: &str| {
            let lines = first.lines().zip(second.lines()).map(|(a, b)| format!("{a},{b}\n"));
            read(&lines.collect::<String>()).unwrap()
        };
        let other = space.replace("frame", "z").replace(&format!("\n{row}"), "\n7");
        for read in [both(&other, &pixels), both(&pixels, &other)] {
            assert_eq!((read.set, read.rows[0].points[67]), (PointSet::Dlib, Some([70.0, 134.0])));
        }
    }

    #[test]
    fn points_of_mediapipe_are_taken_by_their_numbers() {
        for count in [468, 478] {
            let read = read(&table("frame", ['x', 'y'], count, &[("0", 10.0)], 1.0)).unwrap();
            assert_eq!((read.set, read.is_relative), (PointSet::MediaPipe, false));
            // The tip of the nose is 4, the corners of the left eye in the picture are 33 and 133.
            let points = [30, 36, 39].map(|point| read.rows[0].points[point]);
            assert_eq!(points, [Some([14.0, 8.0]), Some([43.0, 66.0]), Some([143.0, 266.0])]);
            let shares = self::read(&table("frame", ['x', 'y'], count, &[("0", 10.0)], 1e-3)).unwrap();
            assert!(shares.is_relative);
            assert!(shares.in_pixels().unwrap_err().to_string().contains("shares of the frame"));
        }
        for count in [67, 69, 98, 467] {
            let error = read(&table("frame", ['x', 'y'], count, &[], 1.0)).unwrap_err();
            assert!(error.contains(&format!("{count} of x and {count} of y")), "{error}");
        }
        let gap = table("frame", ['x', 'y'], 69, &[], 1.0).replace("x_5,", "x_05,");
        assert!(read(&gap).unwrap_err().contains("no x_5"));
        assert!(read("x_1,y_1\n").unwrap_err().contains("no x_0"));
    }

    #[test]
    fn shares_are_not_taken_for_pixels() {
        let shares = read(&table("frame", ['x', 'y'], 68, &[("1", 3.0)], 0.01)).unwrap_err();
        assert!(shares.contains("coordinates: expected pixels"), "{shares}");
        let mut mixed = table("frame", ['x', 'y'], 468, &[("0", 1.0)], 1e-3);
        mixed += table("frame", ['x', 'y'], 468, &[("1", 1.0)], 1.0).lines().nth(1).unwrap();
        let mixed = read(&mixed).unwrap_err();
        assert!(mixed.contains("shares of the frame, as in row 2, found pixels in row 3"), "{mixed}");
    }

    #[test]
    fn rows_in_which_the_tracker_failed_have_no_face() {
        let rows =
            [("1,1", 2.0), ("2,0", 2.0), ("3,False", 2.0), ("4,TRUE", 2.0), ("5,", 2.0), ("6,1.0", 2.0)];
        let with_success = read(&table("Frame,Success", ['x', 'y'], 68, &rows, 1.0)).unwrap();
        let has_face: Vec<bool> = with_success.rows.iter().map(|row| !row.points.is_empty()).collect();
        assert_eq!(has_face, [true, false, false, true, true, true]);
        assert_eq!(with_success.rows[5].keys, ["6"]);
        assert!(
            read(&table("success", ['x', 'y'], 68, &[("maybe", 2.0)], 1.0)).unwrap_err().contains("0 or 1")
        );

        let header = table("frame", ['x', 'y'], 68, &[], 1.0);
        let fill = |cell: &str| format!("{header}1{}\n", format!(",{cell}").repeat(136));
        for cell in ["0", "-1", "nan", ""] {
            let read = read(&fill(cell)).unwrap();
            assert_eq!((read.rows[0].points.len(), read.is_relative), (0, false), "{cell:?}");
        }
        assert!(read(&fill("70000")).unwrap_err().contains("row 2, x_0: expected a place in a frame"));
    }

    #[test]
    fn a_column_that_numbers_frames_by_another_name_is_refused() {
        for name in ["timestep", "Frame_Number"] {
            let error = read(&table(name, ['x', 'y'], 68, &[("1", 1.0)], 1.0)).unwrap_err();
            assert!(error.contains("a column `frame`") && error.contains(name), "{error}");
        }
    }

    #[test]
    fn rows_of_other_lengths_are_refused_unless_the_rest_is_empty() {
        let eyes = "left_eye_x,left_eye_y,right_eye_x,right_eye_y";
        assert_eq!(read(&format!("{eyes}\n1,2,31,2,,\n")).unwrap().rows.len(), 1);
        for row in ["1,2,31", "1,2,31,2,5"] {
            let error = read(&format!("{eyes}\n{row}\n")).unwrap_err();
            assert!(error.contains("4 values, as in the header") && error.contains("in line 2"), "{error}");
        }
    }
}

//! Files that hold optical flow: one module per format, and the choice between them.

mod claim;
mod flo;
pub(crate) mod npy;
mod samples;

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::str::FromStr;

use crate::{FileError, FileProblem, FlowField, write_atomically};

pub(crate) use claim::{MAX_PIXELS, check_deflated, check_size, read_all};

/// A format of flow files.
///
/// Every format keeps every value and every unknown pixel; those of 16-bit PNG keep values on their own grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FlowFormat {
    /// Middlebury `.flo`: 32-bit floats; unknown pixels hold 1e10.
    Flo,
    /// `.npy` of shape (H, W, 2); unknown pixels hold NaN.
    Npy,
}

impl FlowFormat {
    /// Every format.
    pub const ALL: [Self; 2] = [Self::Flo, Self::Npy];

    /// The extension of its files, which is also its name.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Flo => "flo",
            Self::Npy => "npy",
        }
    }

    /// The format that a file's name speaks of.
    pub fn from_path(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?;
        Self::ALL.into_iter().find(|format| format.extension().eq_ignore_ascii_case(extension))
    }

    /// The format that a file's first bytes speak of.
    fn from_magic(start: &[u8]) -> Option<Self> {
        let magics: [(&[u8], Self); 2] = [(flo::MAGIC, Self::Flo), (npy::MAGIC, Self::Npy)];
        magics.into_iter().find(|(magic, _)| start.starts_with(magic)).map(|(_, format)| format)
    }

    fn names() -> String {
        Self::ALL.map(Self::extension).join(", ")
    }
}

impl fmt::Display for FlowFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.extension())
    }
}

impl FromStr for FlowFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|format| format.extension() == name)
            .ok_or_else(|| format!("no flow format `{name}`; there are {}", Self::names()))
    }
}

/// Reads a flow file of any format: its first bytes say which; when they say nothing, its extension.
///
/// # Errors
/// When the file cannot be opened, is of no known format, or does not hold what its header promises.
pub fn read_flow(path: &Path) -> Result<FlowField, FileError> {
    read_with(path, |reader, len| {
        let start = reader.fill_buf().map_err(FileProblem::reading)?;
        let format =
            FlowFormat::from_magic(start).or_else(|| FlowFormat::from_path(path)).ok_or_else(|| {
                FileProblem::field(
                    "format",
                    format!("a flow file ({})", FlowFormat::names()),
                    format!("neither such an extension nor such a start: {}", quote(start)),
                )
            })?;
        decode(format, reader, len)
    })
}

/// Reads a flow file of a given format.
///
/// # Errors
/// As [`read_flow`].
pub fn read_flow_as(path: &Path, format: FlowFormat) -> Result<FlowField, FileError> {
    read_with(path, |reader, len| decode(format, reader, len))
}

/// Writes a flow file in the format of its extension; see [`write_flow_as`].
///
/// # Errors
/// When the extension is that of no format, the format cannot hold a pixel's value, or the file cannot be written.
pub fn write_flow(path: &Path, flow: &FlowField) -> Result<(), FileError> {
    let format = FlowFormat::from_path(path).ok_or_else(|| {
        let found = path.extension().map_or("none".to_owned(), |extension| format!("{extension:?}"));
        FileProblem::field("extension", format!("a flow format ({})", FlowFormat::names()), found)
            .in_file(path)
    })?;
    write_flow_as(path, flow, format)
}

/// Writes a flow file in a given format, whole or not at all (see [`write_atomically`]).
///
/// # Errors
/// When the format cannot hold a pixel's value or the file cannot be written.
pub fn write_flow_as(path: &Path, flow: &FlowField, format: FlowFormat) -> Result<(), FileError> {
    check_finite_or_unknown(flow).map_err(|problem| problem.in_file(path))?;
    match format {
        FlowFormat::Flo => {
            flo::check_range(flow).map_err(|problem| problem.in_file(path))?;
            write_atomically(path, |writer| flo::encode(flow, writer))
        }
        FlowFormat::Npy => {
            let (width, height) = flow.size();
            write_atomically(path, |writer| {
                npy::encode(&[height, width, 2], flow.pixels().as_flattened(), writer)
            })
        }
    }
}

fn decode(format: FlowFormat, reader: &mut dyn Read, len: u64) -> Result<FlowField, FileProblem> {
    match format {
        FlowFormat::Flo => flo::decode(reader, len),
        FlowFormat::Npy => npy::decode_flow(reader, len),
    }
}

/// Opens a file and hands it over with its length in bytes.
pub(crate) fn read_with<T>(
    path: &Path,
    read: impl FnOnce(&mut BufReader<File>, u64) -> Result<T, FileProblem>,
) -> Result<T, FileError> {
    let opened = |error| FileProblem::Io { doing: "opening", error };
    let decode = || {
        let file = File::open(path).map_err(opened)?;
        let metadata = file.metadata().map_err(opened)?;
        if metadata.is_dir() {
            return Err(FileProblem::field("file", "a file", "a folder"));
        }
        read(&mut BufReader::with_capacity(1 << 16, file), metadata.len())
    };
    decode().map_err(|problem| problem.in_file(path))
}

/// # Errors
/// When a pixel is neither known (both components finite) nor unknown (both NaN).
fn check_finite_or_unknown(flow: &FlowField) -> Result<(), FileProblem> {
    check_pixels(flow, "finite numbers, or NaN twice where the flow is unknown", |[u, v]| {
        (u.is_finite() && v.is_finite()) || (u.is_nan() && v.is_nan())
    })
}

/// # Errors
/// Names the first pixel that is not `fine`.
fn check_pixels(
    flow: &FlowField,
    expected: &'static str,
    fine: impl Fn([f32; 2]) -> bool,
) -> Result<(), FileProblem> {
    match flow.pixels().iter().position(|pixel| !fine(*pixel)) {
        None => Ok(()),
        Some(index) => {
            let (x, y) = (index % flow.width(), index / flow.width());
            let [u, v] = flow.pixels()[index];
            Err(FileProblem::Pixel { x, y, expected, found: format!("({u}, {v})") })
        }
    }
}

/// The first bytes of a file as text a person can compare.
fn quote(start: &[u8]) -> String {
    match start.get(..start.len().min(8)) {
        None | Some([]) => "an empty file".to_owned(),
        Some(start) => format!("\"{}\"", start.escape_ascii()),
    }
}

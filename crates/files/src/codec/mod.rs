//! Flow files: one module per format, and the choice between them.

mod checks;
mod claim;
mod flo;
mod flo5;
pub(crate) mod hdf5;
mod jpeg_outline;
mod kitti_png;
pub(crate) mod npy;
pub(crate) mod npz;
mod npz16;
mod pfm;
mod png_outline;
mod samples;

use std::io::{self, BufRead, Cursor, Read, Seek, Write};
use std::path::Path;

use crate::{FileError, FileKind, FileProblem, write_atomically};
use srflow_core::{FlowField, named, printable};

pub(crate) use checks::read_with;
pub(crate) use claim::{MAX_PIXELS, check_size, read_all};
pub(crate) use jpeg_outline::{JpegOutline, truncated};
pub(crate) use png_outline::{PNG_MAGIC, PngOutline};

use checks::{check_finite_or_unknown, quote};

/// A format of flow files.
///
/// Values and unknown pixels are stored exactly, except in 16-bit PNG and `.npz16`, which round components to the nearest
/// step. No format stores infinities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FlowFormat {
    /// Middlebury `.flo`: 32-bit floats; unknown pixels are 1e10, and known ones are at most 1e9.
    Flo,
    /// KITTI's 16-bit PNG with validity: steps of 1/64 pixel (an error of at most 1/128), from -512 to 511.98 pixels.
    KittiPng,
    /// The same with steps of 1/128 pixel (an error of at most 1/256), from -256 to 255.99 pixels. The extension is `.png128`;
    /// with the extension `.png`, read it with [`read_flow_as`], since its content looks like KITTI's.
    Png128,
    /// Portable float map with three channels as in FlyingThings3D; unknown pixels have 1 in the third.
    Pfm,
    /// Spring's `.flo5`: HDF5 with the compressed dataset `flow`; unknown pixels are NaN.
    Flo5,
    /// NumPy's `.npy` of shape (H, W, 2), written as `<f4`; unknown pixels are NaN.
    Npy,
    /// NumPy's `.npz` with one such array, compressed and named `flow`.
    Npz,
    /// A NumPy archive of differences on a grid of 1/256 pixel (an error of at most 1/512), coarser when a component exceeds
    /// 127.99 pixels: the format of SRFlow datasets. About 3 MB for a flow of 2200x3208.
    Npz16,
}

named!(FlowFormat, "a flow format", {
    Flo => "flo",
    KittiPng => "png",
    Png128 => "png128",
    Pfm => "pfm",
    Flo5 => "flo5",
    Npy => "npy",
    Npz => "npz",
    Npz16 => "npz16",
});

srflow_core::serialize_as_text!(FlowFormat);

impl FlowFormat {
    /// The file extension, which is also the name.
    pub fn extension(self) -> &'static str {
        self.name()
    }

    /// The format of a file name's extension.
    pub fn from_path(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?;
        Self::ALL.into_iter().find(|format| format.extension().eq_ignore_ascii_case(extension))
    }

    /// The format detected from the first bytes.
    fn from_magic(start: &[u8]) -> Option<Self> {
        let magics: [(&[u8], Self); 6] = [
            (flo::MAGIC, Self::Flo),
            (PNG_MAGIC, Self::KittiPng),
            (pfm::MAGIC, Self::Pfm),
            (flo5::MAGIC, Self::Flo5),
            (npy::MAGIC, Self::Npy),
            (npz::MAGIC, Self::Npz),
        ];
        magics.into_iter().find(|(magic, _)| start.starts_with(magic)).map(|(_, format)| format)
    }

    fn names() -> String {
        Self::ALL.map(Self::extension).join(", ")
    }
}

/// Reads a flow file. The format is detected from the first bytes, or else from the extension.
///
/// # Errors
/// When the file cannot be opened, has no known format, or does not match its header.
pub fn read_flow(path: &Path) -> Result<FlowField, FileError> {
    read_with(path, FileKind::Flow, |reader, len| detect_and_decode(path, reader, len))
}

pub(crate) fn detect_and_decode(
    name: &Path,
    reader: &mut impl BufRead,
    len: u64,
) -> Result<FlowField, FileProblem> {
    let start = reader.fill_buf().map_err(FileProblem::reading)?;
    let format = match (FlowFormat::from_magic(start), FlowFormat::from_path(name)) {
        (Some(FlowFormat::KittiPng), Some(FlowFormat::Png128)) => FlowFormat::Png128, // both have the same magic
        (Some(format), _) | (None, Some(format)) => format,
        (None, None) => {
            let expected = format!("a flow file ({})", FlowFormat::names());
            let found = format!("an unknown extension and unknown first bytes: {}", quote(start));
            return Err(FileProblem::field("format", expected, found));
        }
    };
    decode(format, name, reader, len)
}

/// Reads a flow file in the given format.
///
/// # Errors
/// As [`read_flow`].
pub fn read_flow_as(path: &Path, format: FlowFormat) -> Result<FlowField, FileError> {
    read_with(path, FileKind::Flow, |reader, len| decode(format, path, reader, len))
}

/// Writes a flow file in the format of its extension; see [`write_flow_as`].
///
/// # Errors
/// When the extension is no flow format, and as [`write_flow_as`].
pub fn write_flow(path: &Path, flow: &FlowField) -> Result<(), FileError> {
    let format = FlowFormat::from_path(path).ok_or_else(|| {
        let found = path.extension().map_or("none".to_owned(), |extension| format!("{extension:?}"));
        FileProblem::field("extension", format!("a flow format ({})", FlowFormat::names()), found)
            .in_file(path)
    })?;
    write_flow_as(path, flow, format)
}

/// Writes a flow file in the given format, whole or not at all (see [`write_atomically`]).
///
/// # Errors
/// When the flow is empty or has more than 2^27 pixels, the format cannot represent a value, or the file cannot be written.
pub fn write_flow_as(path: &Path, flow: &FlowField, format: FlowFormat) -> Result<(), FileError> {
    check_writable(flow, format).map_err(|problem| problem.in_file(path))?;
    write_atomically(path, |writer| encode(flow, format, writer))
}

/// The bytes of a flow file in the given format.
///
/// # Errors
/// When the flow is empty or has more than 2^27 pixels, or the format cannot represent a value.
pub fn encode_flow(flow: &FlowField, format: FlowFormat) -> Result<Vec<u8>, FileProblem> {
    check_writable(flow, format)?;
    let mut bytes = Cursor::new(Vec::new());
    encode(flow, format, &mut bytes)
        .map_err(|error| FileProblem::Io { doing: "encoding the flow", error })?;
    Ok(bytes.into_inner())
}

/// The bytes of a `.npy` file of shape (H, W, 2) of float16, little-endian, NaN where the flow is unknown. Components are rounded to the
/// nearest of 11 significant bits: an error of at most 1/256 px below 16 px, 1/32 px below 128 px and 1/8 px below 512 px.
///
/// # Errors
/// When the flow is empty or has more than 2^27 pixels, or a component reaches 512 px.
pub fn encode_flow_half(flow: &FlowField) -> Result<Vec<u8>, FileProblem> {
    check_writable(flow, FlowFormat::Npy)?;
    npy::check_half_range(flow)?;
    Ok(npy::encode_flow_half(flow))
}

fn encode(flow: &FlowField, format: FlowFormat, writer: &mut (impl Write + Seek)) -> io::Result<()> {
    match format {
        FlowFormat::Flo => flo::encode(flow, writer),
        FlowFormat::KittiPng => kitti_png::encode(flow, kitti_png::KITTI, writer),
        FlowFormat::Png128 => kitti_png::encode(flow, kitti_png::PNG128, writer),
        FlowFormat::Pfm => pfm::encode(flow, writer),
        FlowFormat::Flo5 => flo5::encode(flow, writer),
        FlowFormat::Npy => npy::encode_flow(flow, writer),
        FlowFormat::Npz => npz::encode(flow, writer),
        FlowFormat::Npz16 => npz16::encode(flow, writer),
    }
}

fn check_writable(flow: &FlowField, format: FlowFormat) -> Result<(), FileProblem> {
    check_size(flow.width() as i64, flow.height() as i64)?; // what is written must be readable
    check_finite_or_unknown(flow)?;
    match format {
        FlowFormat::Flo => flo::check_range(flow),
        FlowFormat::KittiPng => kitti_png::check_range(flow, kitti_png::KITTI),
        FlowFormat::Png128 => kitti_png::check_range(flow, kitti_png::PNG128),
        FlowFormat::Npz16 => npz16::check_range(flow),
        FlowFormat::Pfm | FlowFormat::Flo5 | FlowFormat::Npy | FlowFormat::Npz => Ok(()),
    }
}

/// `name` is for a note on what follows the flow.
fn decode(
    format: FlowFormat,
    name: &Path,
    reader: &mut dyn Read,
    len: u64,
) -> Result<FlowField, FileProblem> {
    let (flow, more) = match format {
        FlowFormat::Flo => flo::decode(reader, len)?,
        FlowFormat::KittiPng => kitti_png::decode(reader, len, kitti_png::KITTI)?,
        FlowFormat::Png128 => kitti_png::decode(reader, len, kitti_png::PNG128)?,
        FlowFormat::Pfm => pfm::decode(reader, len)?,
        FlowFormat::Flo5 => (flo5::decode(reader, len)?, 0),
        FlowFormat::Npy => (npy::decode_flow(reader, len)?, 0),
        FlowFormat::Npz | FlowFormat::Npz16 => (npz::decode(reader, len)?, 0),
    };
    if more > 0 {
        log::warn!("{}: {more} bytes after the flow are not read", printable(&name.to_string_lossy()));
    }
    Ok(flow)
}

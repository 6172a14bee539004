//! NumPy's `.npz`: a zip archive of `.npy` files. The array named `flow` is read, or the only one in the archive, or `u` and `v`; an archive
//! with the arrays of [`super::npz16`] is read as that format. [`Npz`] reads the arrays of any archive by name, and
//! [`write_npz`] writes several arrays, including text, for Python programs.

use std::io::{self, Cursor, Read, Seek, Write};
use std::path::{Path, PathBuf};

use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::checks::{broken, read_with};
use super::claim::{check_deflated, read_all};
use super::npy::Array;
use super::{npy, npz16};
use crate::{FileError, FileKind, FileProblem, write_atomically};
use srflow_core::{FlowField, excerpts};

pub(super) const MAGIC: &[u8] = b"PK\x03\x04";

const NAME: &str = "flow.npy";

pub(super) fn decode(reader: &mut dyn Read, len: u64) -> Result<FlowField, FileProblem> {
    let mut archive = open_arrays(read_all(reader, len)?)?;
    let names = archive.file_names().map(|name| name.map(|name| name.into_owned()));
    let names: Vec<String> = names.collect::<Result<_, _>>().map_err(broken)?;
    if npz16::is_this(&names) {
        return npz16::decode(&mut archive);
    }
    let has = |wanted: &str| names.iter().any(|name| name == wanted);
    match &names[..] {
        [only] => entry(&mut archive, only, npy::decode_flow),
        _ if has(NAME) => entry(&mut archive, NAME, npy::decode_flow),
        // As of VIPER.
        _ if has("u.npy") && has("v.npy") => {
            let u = entry(&mut archive, "u.npy", npy::decode)?;
            npy::flow_of_components(u, entry(&mut archive, "v.npy", npy::decode)?)
        }
        _ => {
            let arrays = names.iter().map(|name| name.strip_suffix(".npy").unwrap_or(name));
            let found = if names.is_empty() { "none".to_owned() } else { excerpts(arrays, 12) };
            Err(FileProblem::field("arrays", "one, or one named `flow`, or `u` and `v`", found))
        }
    }
}

/// Decodes an entry, whose checksum is verified at the end of its data.
fn entry<T>(
    archive: &mut ZipArchive<Cursor<Vec<u8>>>,
    name: &str,
    decode: fn(&mut dyn Read, u64) -> Result<T, FileProblem>,
) -> Result<T, FileProblem> {
    let mut array = archive.by_name(name).map_err(broken)?;
    let size = array.size();
    check_deflated(size, array.compressed_size())?;
    let decoded = decode(&mut array, size)?;
    match array.read(&mut [0]).map_err(FileProblem::reading)? {
        0 => Ok(decoded),
        _ => Err(FileProblem::field("array size", format!("{size} bytes according to the archive"), "more")),
    }
}

/// Opens a zip archive whose directory is inside the file. The caller limits the inflated size of its entries.
///
/// # Errors
/// When it does not end where the file does, is a zip64 archive, or is corrupt.
pub fn open_zip(bytes: Vec<u8>) -> Result<ZipArchive<Cursor<Vec<u8>>>, FileProblem> {
    check_end(&bytes)?;
    let sound = |error: ZipError| FileProblem::field("archive", "a valid zip archive", error.to_string());
    ZipArchive::new(Cursor::new(bytes)).map_err(sound)
}

/// The first entry of an archive that has this file name, in whatever folder.
pub fn zip_entry_named(archive: &ZipArchive<Cursor<Vec<u8>>>, file_name: &str) -> Option<String> {
    let mut entries = archive.file_names().flatten();
    entries.find(|entry| entry.rsplit('/').next() == Some(file_name)).map(|entry| entry.into_owned())
}

/// The bytes of an entry of an archive of this `kind`, such as `a .sog file`; at most `most` of them.
///
/// # Errors
/// When there is no such entry, or it is larger, or claims more than its bytes can hold.
pub fn zip_entry(
    archive: &mut ZipArchive<Cursor<Vec<u8>>>,
    name: &str,
    kind: &str,
    most: u64,
) -> Result<Vec<u8>, FileProblem> {
    let expected = || format!("`{}`, as in {kind}", srflow_core::excerpt(name));
    let missing = || FileProblem::field("entries", expected(), "none");
    let entry = archive.by_name(name).map_err(|_| missing())?;
    let (stored, len) = (entry.compressed_size(), entry.size());
    // Deflate holds a thousand bytes in one.
    if len > most || len > stored.saturating_mul(1032) {
        let found = format!("{len} bytes in {stored}");
        return Err(FileProblem::field("entry", "a size that its bytes can hold", found));
    }
    let mut bytes = Vec::new();
    entry.take(len).read_to_end(&mut bytes).map_err(FileProblem::reading)?;
    Ok(bytes)
}

/// Opens an archive of arrays.
fn open_arrays(bytes: Vec<u8>) -> Result<ZipArchive<Cursor<Vec<u8>>>, FileProblem> {
    if is_torch_save(&bytes) {
        let found = "a file of torch.save; save the arrays with numpy.savez";
        return Err(FileProblem::field("format", "an .npz archive", found));
    }
    open_zip(bytes)
}

/// Whether the first entry is the pickle of a checkpoint of PyTorch.
fn is_torch_save(bytes: &[u8]) -> bool {
    const NAME_LENGTH_AT: usize = 26;
    const NAME_AT: usize = 30;
    let length = bytes.get(NAME_LENGTH_AT..NAME_LENGTH_AT + 2);
    let length = length.map_or(0, |length| u16::from_le_bytes([length[0], length[1]]).into());
    let name = bytes.get(NAME_AT..NAME_AT + length).filter(|_| bytes.starts_with(MAGIC));
    name.is_some_and(|name| name == b"data.pkl" || name.ends_with(b"/data.pkl"))
}

/// The archive must end where the file does, and must not be zip64: the reader would trust its number of entries before
/// looking at them. No readable flow needs zip64.
fn check_end(bytes: &[u8]) -> Result<(), FileProblem> {
    const END: &[u8] = b"PK\x05\x06";
    const END_BYTES: usize = 22;
    const END_64: &[u8] = b"PK\x06\x07";
    const END_64_BYTES: usize = 20;
    let last = &bytes[bytes.len().saturating_sub(END_BYTES + usize::from(u16::MAX))..];
    let ends_the_file = |end: &[u8]| {
        let comment =
            end.get(END_BYTES - 2..END_BYTES).map(|length| u16::from_le_bytes([length[0], length[1]]));
        end.starts_with(END) && comment.is_some_and(|comment| END_BYTES + usize::from(comment) == end.len())
    };
    let Some(end) = (0..last.len()).rev().find(|at| ends_the_file(&last[*at..])) else {
        let found = "none: the file is truncated or has extra data";
        return Err(FileProblem::field("end of archive", "a record at the end of the file", found));
    };
    let before = &bytes[..bytes.len() - last.len() + end];
    if before.len() >= END_64_BYTES && before[before.len() - END_64_BYTES..].starts_with(END_64) {
        return Err(FileProblem::field("end of archive", "a plain zip record", "a zip64 record"));
    }
    Ok(())
}

/// A `.npz` archive of named arrays, as NumPy's `savez` and `savez_compressed` write it. Arrays are decoded one by one when they
/// are asked for; others may have types that are not read, such as text or pickled objects.
#[derive(Debug)]
pub struct Npz {
    path: PathBuf,
    archive: ZipArchive<Cursor<Vec<u8>>>,
    names: Vec<String>,
}

impl Npz {
    /// Opens an archive.
    ///
    /// # Errors
    /// When the file cannot be read or is not a zip archive.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        read_with(path, FileKind::Array, |reader, len| {
            let archive = open_arrays(read_all(reader, len)?)?;
            let files = archive.file_names().map(|name| name.map(|name| name.into_owned()));
            let files: Vec<String> = files.collect::<Result<_, _>>().map_err(damaged)?;
            let names =
                files.iter().filter_map(|file| file.strip_suffix(".npy")).map(str::to_owned).collect();
            Ok(Self { path: path.to_owned(), archive, names })
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names of the arrays, in file order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    pub fn has(&self, name: &str) -> bool {
        self.names.iter().any(|known| known == name)
    }

    /// The array called `name`, converted to `f32` as by [`read_npy`](super::npy::read_npy).
    ///
    /// # Errors
    /// When the archive has no such array, or it is corrupt or does not hold numbers.
    pub fn array(&mut self, name: &str) -> Result<Array, FileError> {
        self.decode(name, npy::decode).map_err(|problem| problem.in_file(&self.path))
    }

    /// The texts of the array called `name`, row-major; one for a scalar.
    ///
    /// # Errors
    /// When the archive has no such array, or it is corrupt or does not hold Unicode text (`<U`).
    pub fn texts(&mut self, name: &str) -> Result<Vec<String>, FileError> {
        self.decode(name, npy::decode_texts).map_err(|problem| problem.in_file(&self.path))
    }

    fn decode<T>(
        &mut self,
        name: &str,
        decode: impl Fn(&mut dyn Read, u64) -> Result<T, FileProblem>,
    ) -> Result<T, FileProblem> {
        if !self.has(name) {
            let found = format!("the arrays {}", excerpts(self.names.iter().map(String::as_str), 20));
            return Err(FileProblem::field("array", format!("one called `{name}`"), found));
        }
        let mut file = self.archive.by_name(&format!("{name}.npy")).map_err(damaged)?;
        let size = file.size();
        check_deflated(size, file.compressed_size())?;
        let array = decode(&mut file, size).map_err(|problem| match problem {
            FileProblem::Field { field, expected, found } => {
                FileProblem::field(field, expected, format!("{found} in the array `{name}`"))
            }
            problem => problem,
        })?;
        // The archive's checksum is verified at the end of the data.
        match file.read(&mut [0]).map_err(FileProblem::reading)? {
            0 => Ok(array),
            _ => {
                let expected = format!("{size} bytes according to the archive");
                Err(FileProblem::field("array size", expected, format!("more in the array `{name}`")))
            }
        }
    }
}

fn damaged(error: ZipError) -> FileProblem {
    FileProblem::field("archive", "a valid .npz archive", error.to_string())
}

/// An array of a `.npz` archive: its shape, empty for a scalar, and its values, row-major.
#[derive(Debug, Clone)]
pub enum NpzArray<'a> {
    Float(&'a [usize], &'a [f32]),
    Integer(&'a [usize], &'a [i64]),
    /// Unicode, as wide as the longest text (`<U`), which NumPy reads without pickle.
    Text(&'a [usize], &'a [&'a str]),
}

/// Writes named arrays as one compressed `.npz` archive for `numpy.load`, whole or not at all (see [`write_atomically`]).
///
/// # Errors
/// When an array's shape does not match its number of values, or the file cannot be written.
pub fn write_npz(path: &Path, arrays: &[(&str, NpzArray)]) -> Result<(), FileError> {
    for (_, array) in arrays {
        let (shape, found) = array.extent();
        if shape.iter().try_fold(1_usize, |count, side| count.checked_mul(*side)) != Some(found) {
            let found = format!("{found} values");
            return Err(FileProblem::field("shape", format!("values for {shape:?}"), found).in_file(path));
        }
    }
    write_atomically(path, |writer| {
        write_zip(writer, |archive| {
            for (name, array) in arrays {
                let options = options().large_file(array.bytes() > MAX_PLAIN_BYTES);
                archive.start_file(format!("{name}.npy"), options)?;
                array.encode(archive)?;
            }
            Ok(())
        })
    })
}

/// Writes a zip archive to `writer`, whose entries `fill` writes.
///
/// # Errors
/// Those of `fill` and of the writer.
pub fn write_zip<W: Write + Seek>(
    writer: W,
    fill: impl FnOnce(&mut ZipWriter<W>) -> io::Result<()>,
) -> io::Result<()> {
    let mut archive = ZipWriter::new(writer);
    if let Err(error) = fill(&mut archive) {
        // Dropped, it would try to end the archive, and print that it cannot.
        std::mem::forget(archive);
        return Err(error);
    }
    archive.finish()?;
    Ok(())
}

/// Longer arrays are written as zip64.
const MAX_PLAIN_BYTES: usize = 0xF000_0000;

impl NpzArray<'_> {
    fn extent(&self) -> (&[usize], usize) {
        match self {
            Self::Float(shape, values) => (shape, values.len()),
            Self::Integer(shape, values) => (shape, values.len()),
            Self::Text(shape, values) => (shape, values.len()),
        }
    }

    fn bytes(&self) -> usize {
        let each = match self {
            Self::Float(..) => 4,
            Self::Integer(..) => 8,
            Self::Text(_, values) => 4 * width(values),
        };
        self.extent().1.saturating_mul(each)
    }

    fn encode(&self, writer: &mut impl Write) -> io::Result<()> {
        match self {
            Self::Float(shape, values) => npy::encode(shape, values, writer),
            Self::Integer(shape, values) => {
                writer.write_all(&npy::header_bytes("<i8", shape))?;
                values.iter().try_for_each(|value| writer.write_all(&value.to_le_bytes()))
            }
            Self::Text(shape, values) => {
                let width = width(values);
                writer.write_all(&npy::header_bytes(&format!("<U{width}"), shape))?;
                for text in *values {
                    let padded = text.chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
                    let bytes: Vec<u8> = padded.flat_map(u32::to_le_bytes).collect();
                    writer.write_all(&bytes)?;
                }
                Ok(())
            }
        }
    }
}

/// Length of the longest text in characters; NumPy has no empty text type.
fn width(texts: &[&str]) -> usize {
    texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1)
}

fn options() -> SimpleFileOptions {
    SimpleFileOptions::default().compression_method(CompressionMethod::Deflated).compression_level(Some(1))
}

pub(super) fn encode(flow: &FlowField, writer: &mut (impl Write + Seek)) -> io::Result<()> {
    write_zip(writer, |archive| {
        archive.start_file(NAME, options())?;
        npy::encode_flow(flow, archive)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_numbers_and_text_have_numpys_format() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let arrays = [
            ("x", NpzArray::Float(&[2, 1], &[0.5, -1.0])),
            ("y", NpzArray::Integer(&[2], &[7, -1])),
            ("name", NpzArray::Text(&[2], &["aé", ""])),
            ("one", NpzArray::Text(&[], &["{}"])),
        ];
        write_npz(&path, &arrays).unwrap();
        let mut archive = ZipArchive::new(std::fs::File::open(&path).unwrap()).unwrap();
        let mut read = |name: &str| {
            let mut bytes = Vec::new();
            archive.by_name(name).unwrap().read_to_end(&mut bytes).unwrap();
            let (header, values) = bytes.split_at(128.min(bytes.len()).next_multiple_of(64));
            (String::from_utf8_lossy(header).into_owned(), values.to_vec())
        };
        let (header, values) = read("x.npy");
        assert!(header.contains("'<f4'") && header.contains("(2, 1)"), "{header}");
        assert_eq!(values, [0.5_f32.to_le_bytes(), (-1.0_f32).to_le_bytes()].concat());
        let (header, values) = read("y.npy");
        assert!(header.contains("'<i8'") && header.contains("(2,)"), "{header}");
        assert_eq!(values, [7_i64.to_le_bytes(), (-1_i64).to_le_bytes()].concat());
        let (header, values) = read("name.npy");
        assert!(header.contains("'<U2'"), "{header}");
        assert_eq!(values, [0x61_u32, 0xE9, 0, 0].map(u32::to_le_bytes).concat());
        assert!(read("one.npy").0.contains("'shape': ()"));

        let mut back = Npz::open(&path).unwrap();
        assert_eq!(back.names(), ["x", "y", "name", "one"]);
        assert_eq!(back.array("x").unwrap(), Array { shape: vec![2, 1], values: vec![0.5, -1.0] });
        assert_eq!(back.array("y").unwrap().values, [7.0, -1.0]);
        let missing = back.array("z").unwrap_err().to_string();
        assert!(missing.contains("one called `z`, found the arrays x, y, name, one"), "{missing}");
        assert_eq!(back.texts("name").unwrap(), ["aé", ""]);
        assert_eq!(back.texts("one").unwrap(), ["{}"]);
        let numbers = back.texts("x").unwrap_err().to_string();
        assert!(numbers.contains("text (<U)") && numbers.contains("<f4"), "{numbers}");
        let text = back.array("name").unwrap_err().to_string();
        assert!(text.contains("'<U2' in the array `name`"), "{text}");

        let wrong = write_npz(&path, &[("x", NpzArray::Float(&[3], &[0.0]))]).unwrap_err().to_string();
        assert!(wrong.contains("values for [3], found 1 values"), "{wrong}");
    }
}

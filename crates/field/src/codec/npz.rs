//! NumPy's `.npz`: a zip archive of `.npy` files. The array named `flow` is read, or the only one there is; an archive of
//! the arrays of [`super::npz16`] is read as such.

use std::io::{self, Cursor, Read, Seek, Write};

use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::claim::{check_deflated, read_all};
use super::{npy, npz16};
use crate::{FileProblem, FlowField};

pub(super) const MAGIC: &[u8] = b"PK\x03\x04";

const NAME: &str = "flow.npy";

pub(super) fn decode(reader: &mut dyn Read, len: u64) -> Result<FlowField, FileProblem> {
    let bytes = read_all(reader, len)?;
    check_end(&bytes)?;
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(broken)?;
    let names = archive.file_names().map(|name| name.map(|name| name.into_owned()));
    let names: Vec<String> = names.collect::<Result<_, _>>().map_err(broken)?;
    if npz16::is_this(&names) {
        return npz16::decode(&mut archive);
    }
    let name = if let [name] = &names[..] { name } else { NAME };
    let mut array = archive.by_name(name).map_err(broken)?;
    let size = array.size();
    check_deflated(size, array.compressed_size())?;
    let flow = npy::decode_flow(&mut array, size)?;
    // The archive's check sum is compared at the end of the data.
    match array.read(&mut [0]).map_err(FileProblem::reading)? {
        0 => Ok(flow),
        _ => Err(FileProblem::field("array size", format!("{size} bytes, as the archive says"), "more")),
    }
}

/// The archive must end where the file does, and not be of the kind with 64-bit counts: a lie about the number of entries
/// would be believed before they are looked at. No flow that can be read needs that kind.
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
        let found = "none: the file is cut short or something follows it";
        return Err(FileProblem::field("end of archive", "its record at the end of the file", found));
    };
    let before = &bytes[..bytes.len() - last.len() + end];
    if before.len() >= END_64_BYTES && before[before.len() - END_64_BYTES..].starts_with(END_64) {
        return Err(FileProblem::field("end of archive", "a plain zip record", "one of zip64"));
    }
    Ok(())
}

pub(super) fn broken(error: ZipError) -> FileProblem {
    let expected = "a sound .npz file of one array, or with one named `flow`, or an .npz16 file";
    FileProblem::field("archive", expected, error.to_string())
}

pub(super) fn encode(flow: &FlowField, writer: &mut (impl Write + Seek)) -> io::Result<()> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .compression_level(Some(1));
    let mut archive = ZipWriter::new(writer);
    archive.start_file(NAME, options)?;
    npy::encode_flow(flow, &mut archive)?;
    archive.finish()?;
    Ok(())
}

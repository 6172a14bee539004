//! Checks of a header's claims against the file before memory is allocated.

use std::io::Read;

use srflow_core::Size;

use crate::FileProblem;

/// Maximum number of pixels in a file: 2^27, a flow of 1 GiB (16384x8192).
pub(crate) const MAX_PIXELS: u64 = 1 << 27;

/// Maximum expansion of a deflate stream, bytes per byte (zlib's documentation, "Maximum Expansion Factor").
const MAX_DEFLATE_RATIO: u64 = 1032;

/// The size in memory.
///
/// # Errors
/// When one is zero or negative, or their product exceeds [`MAX_PIXELS`].
pub(crate) fn check_size(width: i64, height: i64) -> Result<Size, FileProblem> {
    for (field, claim) in [("width", width), ("height", height)] {
        if claim <= 0 {
            return Err(FileProblem::field(field, "at least 1 pixel", claim.to_string()));
        }
    }
    match width.checked_mul(height) {
        Some(pixels) if pixels as u64 <= MAX_PIXELS => Ok(Size::new(width as usize, height as usize)),
        _ => Err(FileProblem::field(
            "size",
            format!("at most {MAX_PIXELS} pixels"),
            format!("{width}x{height} (WIDTHxHEIGHT)"),
        )),
    }
}

/// # Errors
/// When the file has `found` bytes, but its header describes a file of `promised` bytes.
pub(crate) fn check_file_size(promised: u64, found: u64) -> Result<(), FileProblem> {
    if promised == found {
        return Ok(());
    }
    let what = if found < promised { "the file is truncated" } else { "something follows the data" };
    Err(FileProblem::field(
        "file size",
        format!("{promised} bytes according to the header"),
        format!("{found} bytes: {what}"),
    ))
}

/// How many bytes of a file of `found` bytes follow the `promised` ones. Programs that read up to the end of the data accept a few.
///
/// # Errors
/// When bytes are missing, or so many follow that the header may name fewer rows than there are; a row has `row` bytes.
pub(crate) fn check_end(promised: u64, found: u64, row: u64) -> Result<u64, FileProblem> {
    match found.checked_sub(promised) {
        Some(more) if more < row => Ok(more),
        _ => check_file_size(promised, found).map(|()| 0),
    }
}

/// # Errors
/// When `compressed` bytes of deflate cannot expand to the `promised` bytes.
pub(crate) fn check_deflated(promised: u64, compressed: u64) -> Result<(), FileProblem> {
    if promised / MAX_DEFLATE_RATIO <= compressed {
        return Ok(());
    }
    Err(FileProblem::field(
        "compressed data",
        format!("enough for the {promised} bytes that the header claims"),
        format!("{compressed} bytes: the file is truncated or its size is wrong"),
    ))
}

/// `len` blank values, or an error instead of an abort when there is not enough memory.
pub(crate) fn blank<T: Clone + bytemuck::Zeroable>(len: usize) -> Result<Vec<T>, FileProblem> {
    bytemuck::allocation::try_zeroed_vec(len).map_err(|()| {
        let bytes = len.saturating_mul(size_of::<T>());
        FileProblem::field("size", "memory for it", format!("{bytes} bytes, more than is available"))
    })
}

/// Reads a whole file of `len` bytes.
pub(crate) fn read_all(reader: &mut dyn Read, len: u64) -> Result<Vec<u8>, FileProblem> {
    let len_in_memory = usize::try_from(len)
        .map_err(|_| FileProblem::field("file size", "a file that fits in memory", format!("{len} bytes")))?;
    let mut bytes = blank::<u8>(len_in_memory)?;
    reader.read_exact(&mut bytes).map_err(FileProblem::reading)?;
    Ok(bytes)
}

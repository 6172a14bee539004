//! What a header claims, held against the file before any memory is taken for it.

use std::io::Read;

use crate::FileProblem;

/// The most pixels that a file may hold: 2^27, a flow of 1 GiB (16384x8192).
pub(crate) const MAX_PIXELS: u64 = 1 << 27;

/// The most bytes that one byte of a deflate stream can become (zlib's documentation, "Maximum Expansion Factor").
const MAX_DEFLATE_RATIO: u64 = 1032;

/// Width and height as sizes in memory.
///
/// # Errors
/// When one is zero or negative, or both together pass [`MAX_PIXELS`].
pub(crate) fn check_size(width: i64, height: i64) -> Result<(usize, usize), FileProblem> {
    for (field, claim) in [("width", width), ("height", height)] {
        if claim <= 0 {
            return Err(FileProblem::field(field, "at least 1 pixel", claim.to_string()));
        }
    }
    match width.checked_mul(height) {
        Some(pixels) if pixels as u64 <= MAX_PIXELS => Ok((width as usize, height as usize)),
        _ => Err(FileProblem::field(
            "size",
            format!("at most {MAX_PIXELS} pixels"),
            format!("{width}x{height} (WIDTHxHEIGHT)"),
        )),
    }
}

/// # Errors
/// When a file of `found` bytes cannot be the one that a header of `promised` bytes in all speaks of.
pub(crate) fn check_file_size(promised: u64, found: u64) -> Result<(), FileProblem> {
    if promised == found {
        return Ok(());
    }
    let what = if found < promised { "the file is cut short" } else { "something follows the data" };
    Err(FileProblem::field(
        "file size",
        format!("{promised} bytes, as the header promises"),
        format!("{found} bytes: {what}"),
    ))
}

/// # Errors
/// When `compressed` bytes of deflate cannot become the `promised` bytes, whatever they hold.
pub(crate) fn check_deflated(promised: u64, compressed: u64) -> Result<(), FileProblem> {
    if promised / MAX_DEFLATE_RATIO <= compressed {
        return Ok(());
    }
    Err(FileProblem::field(
        "compressed data",
        format!("enough for the {promised} bytes that the header promises"),
        format!("{compressed} bytes: the file is cut short or its size is wrong"),
    ))
}

/// `len` blank values, or an error instead of the process's end when there is no memory for them.
pub(crate) fn blank<T: Clone + bytemuck::Zeroable>(len: usize) -> Result<Vec<T>, FileProblem> {
    bytemuck::allocation::try_zeroed_vec(len).map_err(|()| {
        let bytes = len.saturating_mul(size_of::<T>());
        FileProblem::field("size", "memory for it", format!("{bytes} bytes, more than the system gives"))
    })
}

/// All of a file of `len` bytes.
pub(crate) fn read_all(reader: &mut dyn Read, len: u64) -> Result<Vec<u8>, FileProblem> {
    let len_in_memory = usize::try_from(len).map_err(|_| {
        FileProblem::field("file size", "a file that fits into memory", format!("{len} bytes"))
    })?;
    let mut bytes = blank::<u8>(len_in_memory)?;
    reader.read_exact(&mut bytes).map_err(FileProblem::reading)?;
    Ok(bytes)
}

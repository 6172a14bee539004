use super::checks::quote;
use super::claim::{check_deflated, check_file_size, check_size};
use crate::FileProblem;
use srflow_core::Size;

pub(crate) const PNG_MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Properties of a PNG file that are known before decompression.
#[derive(Debug, PartialEq)]
pub(crate) struct PngOutline {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) bit_depth: u8,
    /// 0 grey, 2 RGB, 3 palette, 4 grey with alpha, 6 RGB with alpha.
    pub(crate) color_type: u8,
    pub(crate) interlaced: bool,
    /// How many bytes follow the last chunk.
    pub(crate) more: u64,
}

impl PngOutline {
    /// Walks the chunks of a whole file.
    ///
    /// # Errors
    /// When the file ends before its last chunk, or is too small for the size that it claims.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, FileProblem> {
        let mut rest = bytes
            .strip_prefix(PNG_MAGIC)
            .ok_or_else(|| FileProblem::field("magic", "the start of a PNG file", quote(bytes)))?;
        let mut header = None;
        let mut compressed = 0;
        loop {
            let Some((&[l0, l1, l2, l3, t0, t1, t2, t3], after)) = rest.split_first_chunk() else {
                return Err(FileProblem::field(
                    "IEND",
                    "this chunk at the end",
                    "none: the file is truncated",
                ));
            };
            let length = u64::from(u32::from_be_bytes([l0, l1, l2, l3]));
            let promised = (bytes.len() - after.len()) as u64 + length + 4; // a checksum follows
            if promised > bytes.len() as u64 {
                check_file_size(promised, bytes.len() as u64)?;
            }
            let (data, after) = after.split_at(length as usize);
            rest = &after[4..];
            match &[t0, t1, t2, t3] {
                b"IHDR" => header = Some(data),
                b"IDAT" => compressed += length,
                b"IEND" => break,
                _ => {}
            }
        }
        let outline = Self { more: rest.len() as u64, ..Self::parse(header)? };
        check_deflated(outline.raw_bytes(), compressed)?;
        Ok(outline)
    }

    fn parse(header: Option<&[u8]>) -> Result<Self, FileProblem> {
        let Some(&[w0, w1, w2, w3, h0, h1, h2, h3, bit_depth, color_type, _, _, interlace]) = header else {
            return Err(FileProblem::field("IHDR", "a chunk of 13 bytes", "none"));
        };
        let side = |bytes| i64::from(u32::from_be_bytes(bytes));
        let Size { width, height } = check_size(side([w0, w1, w2, w3]), side([h0, h1, h2, h3]))?;
        Ok(Self { width, height, bit_depth, color_type, interlaced: interlace != 0, more: 0 })
    }

    /// Lower bound of the number of bytes after decompression.
    fn raw_bytes(&self) -> u64 {
        let channels = match self.color_type {
            2 => 3,
            4 => 2,
            6 => 4,
            _ => 1,
        };
        self.width as u64 * self.height as u64 * channels * u64::from(self.bit_depth) / 8
    }
}

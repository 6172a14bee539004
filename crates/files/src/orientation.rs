//! How a picture is to be turned to be upright, as its EXIF data says.

use std::io::{self, BufRead, Read as _, Seek};

use image::codecs::webp::WebPDecoder;
use image::metadata::Orientation;
use image::{ImageDecoder as _, ImageFormat};

use crate::codec::PNG_MAGIC;

/// The turn that EXIF data in a JPEG (APP1), PNG (eXIf) or WebP file asks for, or the directory of a TIFF file, which is the same; none in other formats and where the data is damaged.
/// `reader` is at the start of the file, and is left anywhere.
///
/// # Errors
/// When reading fails.
pub(crate) fn orientation_of(
    reader: &mut (impl BufRead + Seek),
    format: ImageFormat,
) -> io::Result<Orientation> {
    let exif = match format {
        ImageFormat::Jpeg => exif_of_jpeg(reader),
        ImageFormat::Png => exif_of_png(reader),
        // What it finds broken, reading the picture reports.
        ImageFormat::WebP => {
            Ok(WebPDecoder::new(reader).and_then(|mut decoder| decoder.exif_metadata()).unwrap_or_default())
        }
        ImageFormat::Tiff => {
            let mut whole = Vec::new();
            reader.read_to_end(&mut whole).map(|_| Some(whole))
        }
        _ => Ok(None),
    };
    match exif {
        Ok(exif) => {
            Ok(exif.and_then(|exif| Orientation::from_exif_chunk(&exif)).unwrap_or(Orientation::NoTransforms))
        }
        // The decoder reports what is missing.
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(Orientation::NoTransforms),
        Err(error) => Err(error),
    }
}

/// Whether width and height change places.
pub(crate) fn swaps_sides(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate90FlipH | Rotate270 | Rotate270FlipH)
}

/// The orientation is near the start of EXIF data, in its first directory.
const MOST_EXIF: u64 = 1 << 16;

fn exif_of_jpeg(reader: &mut (impl BufRead + Seek)) -> io::Result<Option<Vec<u8>>> {
    const APP1: u8 = 0xe1;
    const START: &[u8] = b"Exif\0\0";
    loop {
        let mut byte = [0];
        while byte != [0xff] {
            reader.read_exact(&mut byte)?;
        }
        while byte == [0xff] {
            reader.read_exact(&mut byte)?;
        }
        let marker = byte[0];
        match marker {
            0x00 | 0x01 | 0xd0..=0xd8 => continue,
            0xd9 | 0xda => return Ok(None), // the end, or a scan
            _ => {}
        }
        let mut length = [0; 2];
        reader.read_exact(&mut length)?;
        let length = i64::from(u16::from_be_bytes(length)).saturating_sub(2).max(0);
        if marker != APP1 {
            reader.seek_relative(length)?;
            continue;
        }
        let mut segment = vec![0; length as usize];
        reader.read_exact(&mut segment)?;
        if let Some(exif) = segment.strip_prefix(START) {
            return Ok(Some(exif.to_vec()));
        }
    }
}

fn exif_of_png(reader: &mut (impl BufRead + Seek)) -> io::Result<Option<Vec<u8>>> {
    reader.seek_relative(PNG_MAGIC.len() as i64)?;
    loop {
        let mut head = [0; 8];
        reader.read_exact(&mut head)?;
        let [l0, l1, l2, l3, name @ ..] = head;
        let length = u32::from_be_bytes([l0, l1, l2, l3]);
        match &name {
            b"eXIf" => {
                let mut exif = Vec::new();
                reader.take(u64::from(length).min(MOST_EXIF)).read_to_end(&mut exif)?;
                return Ok(Some(exif));
            }
            b"IEND" => return Ok(None),
            _ => reader.seek_relative(i64::from(length) + 4)?, // a checksum follows
        }
    }
}

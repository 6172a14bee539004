//! Images, masks and labels on disk.

use std::io::{self, BufRead, Cursor, Seek, Write};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::codec::{MAX_PIXELS, PngOutline, check_size, read_all, read_with};
use crate::{FileError, FileKind, FileProblem, write_atomically};
use srflow_core::{Image, Labels, Mask, Plane};

/// File extensions of [`read_image`], in lower case.
pub const IMAGE_EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "ppm", "pgm", "pnm", "bmp"];

/// Reads a PNG, JPEG, PPM/PGM or BMP file, detected by its first bytes. 16-bit channels are rounded to 8 bits, grey becomes
/// three equal channels, alpha is dropped.
///
/// # Errors
/// When the file cannot be read, has another format, or is corrupt.
pub fn read_image(path: &Path) -> Result<Image, FileError> {
    read_with(path, FileKind::Image, |reader, len| image_of(&read_all(reader, len)?))
}

pub(crate) fn image_of(bytes: &[u8]) -> Result<Image, FileProblem> {
    let pixels = decode(bytes)?.into_rgb8();
    let (width, height) = (pixels.width() as usize, pixels.height() as usize);
    Ok(Image::from_buffer(width, height, pixels.as_raw().as_chunks().0.to_vec()))
}

/// Width and height of an image file, from its header alone.
///
/// # Errors
/// When the file cannot be read, has another format, or its header is corrupt.
pub fn read_image_size(path: &Path) -> Result<(usize, usize), FileError> {
    read_with(path, FileKind::Image, |reader, _| image_size_of(reader))
}

pub(crate) fn image_size_of(reader: &mut (impl BufRead + Seek)) -> Result<(usize, usize), FileProblem> {
    let mut start = [0; 64];
    let mut len = 0;
    while let read @ 1.. = reader.read(&mut start[len..]).map_err(FileProblem::reading)? {
        len += read;
    }
    let format = format_of(&start[..len])?;
    reader.rewind().map_err(FileProblem::reading)?;
    let (width, height) =
        ImageReader::with_format(reader, format).into_dimensions().map_err(|error| broken(format, error))?;
    check_size(width.into(), height.into())
}

/// Reads a mask from an image in any format of [`read_image`]: `true` where the luminance is over 127.
///
/// # Errors
/// As [`read_image`].
pub fn read_mask(path: &Path) -> Result<Mask, FileError> {
    read_with(path, FileKind::Image, |reader, len| mask_of(&read_all(reader, len)?))
}

pub(crate) fn mask_of(bytes: &[u8]) -> Result<Mask, FileProblem> {
    let pixels = decode(bytes)?.into_luma8();
    let (width, height) = (pixels.width() as usize, pixels.height() as usize);
    Ok(Mask::from_buffer(width, height, pixels.as_raw().iter().map(|value| *value > 127).collect()))
}

/// Reads labels from an 8-bit grey image: the values as they are stored.
///
/// # Errors
/// As [`read_image`], and when the image is not grey with 8 bits. Indexed images are not: their colours are stored, and the numbers of
/// the colours have no fixed meaning.
pub fn read_labels(path: &Path) -> Result<Labels, FileError> {
    read_with(path, FileKind::Image, |reader, len| labels_of(&read_all(reader, len)?))
}

pub(crate) fn labels_of(bytes: &[u8]) -> Result<Labels, FileProblem> {
    match decode(bytes)? {
        DynamicImage::ImageLuma8(pixels) => {
            let (width, height) = (pixels.width() as usize, pixels.height() as usize);
            Ok(Labels::from_buffer(width, height, pixels.into_raw()))
        }
        other => {
            let expected = "8-bit grey values, one label per pixel (convert the image)";
            Err(FileProblem::field("pixels", expected, format!("{:?}", other.color())))
        }
    }
}

/// Reads a 16-bit grey image: the values as they are stored, 0 to 65535.
///
/// # Errors
/// As [`read_image`], and when the image is not grey with 16 bits.
pub fn read_grey16(path: &Path) -> Result<Plane, FileError> {
    read_with(path, FileKind::Image, |reader, len| grey16_of(&read_all(reader, len)?))
}

pub(crate) fn grey16_of(bytes: &[u8]) -> Result<Plane, FileProblem> {
    match decode(bytes)? {
        DynamicImage::ImageLuma16(pixels) => {
            let (width, height) = (pixels.width() as usize, pixels.height() as usize);
            Ok(Plane::from_buffer(width, height, pixels.iter().copied().map(f32::from).collect()))
        }
        other => Err(FileProblem::field("pixels", "16-bit grey values", format!("{:?}", other.color()))),
    }
}

/// Writes an image as PNG with fast compression, whole or not at all (see [`write_atomically`]).
///
/// # Errors
/// When the file cannot be written.
pub fn write_image_png(path: &Path, image: &Image) -> Result<(), FileError> {
    write_atomically(path, |writer| {
        encode_png(writer, image.size(), png::ColorType::Rgb, image.pixels().as_flattened())
    })
}

/// Writes a mask as a grey PNG: 255 where it is `true`, 0 elsewhere; see [`write_image_png`].
///
/// # Errors
/// When the file cannot be written.
pub fn write_mask_png(path: &Path, mask: &Mask) -> Result<(), FileError> {
    let grey: Vec<u8> = mask.pixels().iter().map(|inside| if *inside { 255 } else { 0 }).collect();
    write_atomically(path, |writer| encode_png(writer, mask.size(), png::ColorType::Grayscale, &grey))
}

/// Writes labels as a grey PNG with the values as they are; see [`write_image_png`].
///
/// # Errors
/// When the file cannot be written.
pub fn write_labels_png(path: &Path, labels: &Labels) -> Result<(), FileError> {
    write_atomically(path, |writer| {
        encode_png(writer, labels.size(), png::ColorType::Grayscale, labels.pixels())
    })
}

fn encode_png(
    writer: &mut impl Write,
    (width, height): (usize, usize),
    color: png::ColorType,
    bytes: &[u8],
) -> io::Result<()> {
    let side = |side| u32::try_from(side).map_err(|_| io::Error::other("a side is beyond 2^32 pixels"));
    let mut encoder = png::Encoder::new(writer, side(width)?, side(height)?);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fastest);
    let mut rows = encoder.write_header()?;
    rows.write_image_data(bytes)?;
    rows.finish()?;
    Ok(())
}

/// The format detected from the first bytes.
fn format_of(start: &[u8]) -> Result<ImageFormat, FileProblem> {
    match image::guess_format(start).ok() {
        Some(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Pnm | ImageFormat::Bmp)) => {
            Ok(format)
        }
        _ => {
            let start = start[..start.len().min(8)].escape_ascii();
            Err(FileProblem::field("magic", "a PNG, JPEG, PPM or BMP file", format!("\"{start}\"")))
        }
    }
}

fn broken(format: ImageFormat, error: image::ImageError) -> FileProblem {
    FileProblem::field("image", format!("a valid {} file", name(format)), error.to_string())
}

fn decode(bytes: &[u8]) -> Result<DynamicImage, FileProblem> {
    let format = format_of(bytes)?;
    let broken = |error| broken(format, error);
    match format {
        ImageFormat::Png => PngOutline::read(bytes).map(drop)?,
        ImageFormat::Jpeg => check_end_of_jpeg(bytes)?,
        _ => {}
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(12 * MAX_PIXELS); // 16-bit RGBA and the decoder's row buffers
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    DynamicImage::from_decoder(decoder).map_err(broken)
}

/// The decoder fills missing parts of a JPEG with grey, like others do; here a truncated file is an error.
fn check_end_of_jpeg(bytes: &[u8]) -> Result<(), FileProblem> {
    const START_OF_SCAN: u8 = 0xda;
    const END_OF_IMAGE: u8 = 0xd9;
    // Inside a scan a byte 0xff is always escaped, so the last of these markers is the real one.
    let last = bytes
        .windows(2)
        .rev()
        .find(|pair| pair[0] == 0xff && matches!(pair[1], START_OF_SCAN | END_OF_IMAGE));
    match last {
        Some([_, END_OF_IMAGE]) => Ok(()),
        _ => Err(FileProblem::field("end of image", "the marker ff d9", "none: the file is truncated")),
    }
}

fn name(format: ImageFormat) -> &'static str {
    match format {
        ImageFormat::Png => "PNG",
        ImageFormat::Jpeg => "JPEG",
        ImageFormat::Bmp => "BMP",
        _ => "PPM",
    }
}

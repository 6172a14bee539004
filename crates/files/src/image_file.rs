//! Images, masks and labels on disk.
//!
//! Images and masks are turned upright as their EXIF data says, as viewers, OpenCV and ffmpeg do. Labels and 16-bit values are read as they
//! are stored.

use std::io::{self, BufRead, Cursor, Seek, Write};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::codec::{JpegOutline, MAX_PIXELS, PngOutline, check_size, read_all, read_with, truncated};
use crate::orientation::{orientation_of, swaps_sides};
use crate::{FileError, FileKind, FileProblem, write_atomically};
use srflow_core::{Image, Labels, Mask, Plane, Size};

/// File extensions of [`read_image`], in lower case.
pub const IMAGE_EXTENSIONS: [&str; 12] =
    ["png", "jpg", "jpeg", "jpe", "jfif", "ppm", "pgm", "pnm", "bmp", "webp", "tif", "tiff"];

/// The formats, and their names in messages.
const NAMES: [(ImageFormat, &str); 6] = [
    (ImageFormat::Png, "PNG"),
    (ImageFormat::Jpeg, "JPEG"),
    (ImageFormat::Pnm, "PPM"),
    (ImageFormat::Bmp, "BMP"),
    (ImageFormat::WebP, "WebP"),
    (ImageFormat::Tiff, "TIFF"),
];

/// Most pixels that a WebP or TIFF file of any length may claim, and per byte: an even 4K frame takes next to nothing, and deflate holds a
/// thousand bytes in one.
const PIXELS_OF_ANY_FILE: u64 = 1 << 24;
const PIXELS_PER_BYTE: u64 = 1024;

/// Reads a PNG, JPEG, PPM/PGM, BMP, WebP or TIFF file, detected by its first bytes. 16-bit channels are rounded to 8 bits, grey becomes
/// three equal channels, alpha is dropped. The image is turned upright as its EXIF data says.
///
/// # Errors
/// When the file cannot be read, has another format, holds several pictures, or is corrupt.
pub fn read_image(path: &Path) -> Result<Image, FileError> {
    read_with(path, FileKind::Image, |reader, len| image_of(&read_all(reader, len)?))
}

pub(crate) fn image_of(bytes: &[u8]) -> Result<Image, FileProblem> {
    let pixels = upright(bytes)?.into_rgb8();
    let (width, height) = (pixels.width() as usize, pixels.height() as usize);
    Ok(Image::from_buffer(width, height, pixels.as_raw().as_chunks().0.to_vec()))
}

/// Size and pixels of a picture with its alpha, as it is stored.
///
/// # Errors
/// As [`read_image`].
pub fn rgba_of_image(bytes: &[u8]) -> Result<(Size, Vec<[u8; 4]>), FileProblem> {
    let pixels = decode(bytes)?.into_rgba8();
    let size = Size::new(pixels.width() as usize, pixels.height() as usize);
    Ok((size, pixels.as_raw().as_chunks().0.to_vec()))
}

/// Size of an upright image, from the header of its file alone.
///
/// # Errors
/// When the file cannot be read, has another format, or its header is corrupt.
pub fn read_image_size(path: &Path) -> Result<Size, FileError> {
    read_with(path, FileKind::Image, |reader, _| image_size_of(reader))
}

pub(crate) fn image_size_of(reader: &mut (impl BufRead + Seek)) -> Result<Size, FileProblem> {
    let mut start = [0; 64];
    let mut len = 0;
    while let read @ 1.. = reader.read(&mut start[len..]).map_err(FileProblem::reading)? {
        len += read;
    }
    let format = format_of(&start[..len])?;
    reader.rewind().map_err(FileProblem::reading)?;
    let orientation = orientation_of(reader, format).map_err(FileProblem::reading)?;
    reader.rewind().map_err(FileProblem::reading)?;
    let (width, height) =
        ImageReader::with_format(reader, format).into_dimensions().map_err(|error| broken(format, error))?;
    let size = check_size(width.into(), height.into())?;
    Ok(if swaps_sides(orientation) { Size::new(size.height, size.width) } else { size })
}

/// Reads a mask from an image in any format of [`read_image`]: `true` where a pixel's value is over 127.
///
/// The value is the alpha if that varies, else the luminance. Where all pixels have the value 0 or another one, such as in masks of 0 and
/// 1, the other one is `true`.
///
/// # Errors
/// As [`read_image`], and when no value is over 127 although the values differ otherwise, as in a map of classes.
pub fn read_mask(path: &Path) -> Result<Mask, FileError> {
    read_with(path, FileKind::Image, |reader, len| mask_of(&read_all(reader, len)?))
}

pub(crate) fn mask_of(bytes: &[u8]) -> Result<Mask, FileProblem> {
    let Coverage { width, height, values } = Coverage::read(bytes)?;
    let largest = values.iter().copied().max().unwrap_or_default();
    let threshold = if largest > 127 {
        127
    } else if values.iter().all(|value| [0, largest].contains(value)) && (values.contains(&0) || largest == 1)
    {
        0
    } else {
        let expected = "white (over 127) inside and black outside, or 0 and one other value";
        let found = format!("values up to {largest}: write 255 where the mask is true");
        return Err(FileProblem::field("pixels", expected, found));
    };
    Ok(Mask::from_buffer(width, height, values.iter().map(|value| *value > threshold).collect()))
}

/// Reads how much of each pixel is covered, 0 to 1, from an image in any format of [`read_image`]: its alpha if that varies, else its
/// luminance. Where all pixels are 0 or 1, 1 is fully covered.
///
/// # Errors
/// As [`read_image`].
pub fn read_alpha(path: &Path) -> Result<Plane, FileError> {
    read_with(path, FileKind::Image, |reader, len| {
        let Coverage { width, height, values } = Coverage::read(&read_all(reader, len)?)?;
        let most = if values.iter().all(|value| *value <= 1) { 1.0 } else { 255.0 };
        Ok(Plane::from_buffer(width, height, values.iter().map(|value| f32::from(*value) / most).collect()))
    })
}

/// What an image of a mask holds, with 8 bits a pixel.
struct Coverage {
    width: usize,
    height: usize,
    values: Vec<u8>,
}

impl Coverage {
    fn read(bytes: &[u8]) -> Result<Self, FileProblem> {
        let picture = upright(bytes)?;
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let sixteen_bits = picture.color().bytes_per_pixel() / picture.color().channel_count() > 1;
        let values = match (picture.color().has_alpha(), sixteen_bits) {
            (false, false) => picture.into_luma8().into_raw(),
            (false, true) => eight_bits(&picture.into_luma16().into_raw()),
            (true, false) => {
                let pixels = picture.into_luma_alpha8();
                of_alpha_or_luminance(pixels.as_raw().as_chunks().0)
            }
            (true, true) => {
                let pixels = picture.into_luma_alpha16();
                eight_bits(&of_alpha_or_luminance(pixels.as_raw().as_chunks().0))
            }
        };
        Ok(Self { width, height, values })
    }
}

/// The second channel if it varies, else the first.
fn of_alpha_or_luminance<T: Copy + PartialEq>(pixels: &[[T; 2]]) -> Vec<T> {
    let varies = pixels.iter().any(|[_, alpha]| *alpha != pixels[0][1]);
    pixels.iter().map(|[luminance, alpha]| if varies { *alpha } else { *luminance }).collect()
}

/// Values of 16 bits rounded to 8; as they are if they fit, as in a mask of 0 and 1, or of 0 and 255, that is stored with 16 bits.
fn eight_bits(values: &[u16]) -> Vec<u8> {
    let fit = values.iter().all(|value| *value <= 255);
    values
        .iter()
        .map(|value| if fit { *value as u8 } else { ((u32::from(*value) + 128) / 257) as u8 })
        .collect()
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
    Size { width, height }: Size,
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
    let guessed = image::guess_format(start).ok();
    if let Some(format) = guessed.filter(|format| NAMES.iter().any(|(known, _)| known == format)) {
        return Ok(format);
    }
    let known = match guessed {
        Some(ImageFormat::Gif) => Some("a GIF"),
        Some(ImageFormat::Avif) => Some("an AVIF"),
        _ => is_heif(start).then_some("a HEIF (HEIC)"),
    };
    let found = match known {
        Some(known) => format!("{known} file: convert it to PNG"),
        None => format!("\"{}\"", start[..start.len().min(8)].escape_ascii()),
    };
    Err(FileProblem::field("magic", "a PNG, JPEG, PPM, BMP, WebP or TIFF file", found))
}

/// Whether these are the first bytes of a picture of a phone.
fn is_heif(start: &[u8]) -> bool {
    let brand = start.get(8..12).filter(|_| start.get(4..8) == Some(b"ftyp"));
    brand.is_some_and(|brand| {
        [b"heic", b"heix", b"heim", b"hevc", b"mif1", b"msf1"].iter().any(|known| brand == *known)
    })
}

fn broken(format: ImageFormat, error: image::ImageError) -> FileProblem {
    FileProblem::field("image", format!("a valid {} file", name(format)), error.to_string())
}

/// The picture as it is stored.
fn decode(bytes: &[u8]) -> Result<DynamicImage, FileProblem> {
    let format = format_of(bytes)?;
    match format {
        ImageFormat::Png => PngOutline::read(bytes).map(drop)?,
        ImageFormat::Jpeg => return decode_jpeg(bytes),
        ImageFormat::WebP if riff_is_cut(bytes) => return Err(truncated()),
        ImageFormat::Tiff | ImageFormat::WebP if several_pictures(bytes) => {
            return Err(FileProblem::field(
                "image",
                "one picture",
                "several: write each to a file of its own",
            ));
        }
        _ => {}
    }
    decode_as(format, bytes)
}

/// The picture turned as its EXIF data says.
fn upright(bytes: &[u8]) -> Result<DynamicImage, FileProblem> {
    let mut picture = decode(bytes)?;
    let orientation =
        orientation_of(&mut Cursor::new(bytes), format_of(bytes)?).map_err(FileProblem::reading)?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

fn decode_as(format: ImageFormat, bytes: &[u8]) -> Result<DynamicImage, FileProblem> {
    let broken = |error| broken(format, error);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(12 * MAX_PIXELS); // 16-bit RGBA and the decoder's row buffers
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    let pixels = u64::from(width) * u64::from(height);
    if matches!(format, ImageFormat::WebP | ImageFormat::Tiff)
        && pixels > PIXELS_OF_ANY_FILE.max(PIXELS_PER_BYTE * bytes.len() as u64)
    {
        let found = format!("{width}x{height} pixels in {} bytes", bytes.len());
        return Err(FileProblem::field("size", "as many pixels as the file can hold", found));
    }
    let picture = DynamicImage::from_decoder(decoder).map_err(broken)?;
    match picture {
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            Err(FileProblem::field("pixels", "8 or 16 bits a channel", "floating-point numbers"))
        }
        picture => Ok(picture),
    }
}

/// Whether a WebP file is shorter than the length in its first bytes, whose pixels the decoder makes up.
fn riff_is_cut(bytes: &[u8]) -> bool {
    let length = bytes.get(4..8).and_then(|length| Some(u32::from_le_bytes(length.try_into().ok()?)));
    length.is_none_or(|length| (bytes.len() as u64) < 8 + u64::from(length))
}

/// Whether a file holds more than one picture, of which the decoder would give the first: a WebP file that says that it is animated, or a
/// TIFF file of several directories. TIFF files beyond 4 GB (BigTIFF) are not looked into.
fn several_pictures(bytes: &[u8]) -> bool {
    const ANIMATED: u8 = 2;
    if bytes.get(12..16) == Some(b"VP8X") {
        return bytes.get(20).is_some_and(|flags| flags & ANIMATED != 0);
    }
    let big = bytes.starts_with(b"MM\0*");
    let number = |at: usize, len: usize| {
        let bytes = bytes.get(at..at.checked_add(len)?)?;
        let digit = |sum: usize, byte: &u8| sum << 8 | usize::from(*byte);
        Some(if big { bytes.iter().fold(0, digit) } else { bytes.iter().rev().fold(0, digit) })
    };
    let next = || {
        let first = number(4, 4)?;
        number(first + 2 + 12 * number(first, 2)?, 4)
    };
    (big || bytes.starts_with(b"II*\0")) && next().is_some_and(|next| next != 0)
}

/// The decoder fills missing parts of a JPEG with grey, as others do; here a truncated file is an error.
fn decode_jpeg(bytes: &[u8]) -> Result<DynamicImage, FileProblem> {
    let outline = JpegOutline::read(bytes);
    if let Some(end) = outline.end {
        return decode_as(ImageFormat::Jpeg, &bytes[..end]);
    }
    let decode = |bytes: &Vec<u8>| decode_as(ImageFormat::Jpeg, bytes);
    let [bare, filled @ ..] = outline.with_endings(bytes)?;
    let picture = decode(&bare)?;
    if filled.iter().all(|filled| decode(filled).is_ok_and(|other| other == picture)) {
        return Ok(picture);
    }
    Err(truncated())
}

fn name(format: ImageFormat) -> &'static str {
    NAMES.iter().find(|(known, _)| *known == format).map_or("picture", |(_, name)| name)
}

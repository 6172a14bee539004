//! Single-channel planes as grey PNG.

use std::io;
use std::path::Path;

use srflow_core::{LUMA, Plane, Size};
use srflow_data::region_map::HeadPart;
use srflow_files::{FileError, write_atomically};
use srflow_splat::Frame;

use crate::parts::PartWeights;

/// Depth units per metre in a depth picture; 0 is no depth.
pub const DEPTH_UNITS_PER_METRE: f32 = 10_000.0;

/// Writes alpha with 8 bits, rounded: 0 is 0, 255 is 1. The mask, alpha above one half, is exactly 128 and above.
pub fn write_alpha(path: &Path, alpha: &Plane, bytes: &mut Vec<u8>) -> Result<(), FileError> {
    bytes.clear();
    bytes.extend(alpha.pixels().iter().map(|&alpha| {
        let rounded = (alpha * 255.0 + 0.5) as u8;
        if alpha > 0.5 { rounded.max(128) } else { rounded.min(127) }
    }));
    write_grey(path, alpha.size(), png::BitDepth::Eight, bytes)
}

/// Writes the depth of the mask with 16 bits in tenths of a millimetre, up to 6.5535 m; 0 outside of the mask.
pub fn write_depth(path: &Path, frame: &Frame, bytes: &mut Vec<u8>) -> Result<(), FileError> {
    bytes.clear();
    let pixels = frame.depth.pixels().iter().zip(frame.alpha.pixels());
    bytes.extend(pixels.flat_map(|(depth, &alpha)| {
        let depth = if alpha > 0.5 { depth * DEPTH_UNITS_PER_METRE + 0.5 } else { 0.0 };
        (depth as u16).to_be_bytes()
    }));
    write_grey(path, frame.depth.size(), png::BitDepth::Sixteen, bytes)
}

/// Writes how much brighter the head becomes, with 16 bits: 32768, and 128 times the change of the luma in levels of 255. In `frame` the
/// colours are a half and half of the change, in front of a background of one half.
pub fn write_shading_change(path: &Path, frame: &Frame, bytes: &mut Vec<u8>) -> Result<(), FileError> {
    bytes.clear();
    bytes.extend(frame.color.iter().flat_map(|color| {
        let change: f32 = color.iter().zip(LUMA).map(|(channel, share)| 2.0 * (channel - 0.5) * share).sum();
        ((32_768.5 + 128.0 * 255.0 * change) as u16).to_be_bytes()
    }));
    write_grey(path, Size::new(frame.width, frame.height), png::BitDepth::Sixteen, bytes)
}

/// Writes the region map of the head that `alpha` is of: the label of the part with the largest weight inside of the mask, 0 elsewhere.
pub fn write_regions(
    path: &Path,
    weights: &PartWeights,
    alpha: &Plane,
    bytes: &mut Vec<u8>,
) -> Result<(), FileError> {
    bytes.clear();
    bytes.extend(weights.parts(alpha).map(|part| part.map_or(0, HeadPart::label)));
    write_grey(path, alpha.size(), png::BitDepth::Eight, bytes)
}

fn write_grey(
    path: &Path,
    Size { width, height }: Size,
    bits: png::BitDepth,
    bytes: &[u8],
) -> Result<(), FileError> {
    let side = |side| u32::try_from(side).map_err(|_| io::Error::other("a side is beyond 2^32 pixels"));
    write_atomically(path, |writer| {
        let mut encoder = png::Encoder::new(writer, side(width)?, side(height)?);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(bits);
        encoder.set_compression(png::Compression::Fastest);
        let mut rows = encoder.write_header()?;
        rows.write_image_data(bytes)?;
        rows.finish()?;
        Ok(())
    })
}

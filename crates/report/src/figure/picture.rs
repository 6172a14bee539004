//! Pictures compressed without loss, once for SVG and PDF alike: what a PNG holds between its headers is what a PDF calls Flate
//! with a PNG predictor.

use srflow_core::Image;

use super::layout::FigureError;

/// A picture as PNG.
pub struct Png {
    bytes: Vec<u8>,
}

impl Png {
    pub fn of(image: &Image) -> Result<Self, FigureError> {
        let size = image.size();
        let encode = || -> Result<Vec<u8>, png::EncodingError> {
            let side = |pixels: usize| u32::try_from(pixels).unwrap_or(0); // 0 is refused by the encoder
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, side(size.width), side(size.height));
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(image.pixels().as_flattened())?;
            writer.finish()?;
            Ok(bytes)
        };
        let failed = |error: png::EncodingError| FigureError::Encode { size, reason: error.to_string() };
        Ok(Self { bytes: encode().map_err(failed)? })
    }

    /// The file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The zlib stream of filtered rows: the content of all IDAT chunks.
    pub fn stream(&self) -> Vec<u8> {
        const SIGNATURE: usize = 8;
        let mut stream = Vec::with_capacity(self.bytes.len());
        let mut rest = &self.bytes[SIGNATURE..];
        // Length, type, data and checksum.
        while let Some((length, after)) = rest.split_first_chunk() {
            let length = u32::from_be_bytes(*length) as usize;
            if after.starts_with(b"IDAT") {
                stream.extend_from_slice(&after[4..4 + length]);
            }
            rest = &after[4 + length + 4..];
        }
        stream
    }
}

//! Pictures embedded in the page as data URIs.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use maud::{Markup, html};
use srflow_core::{Image, Plane, Size};

/// An encoded picture.
#[derive(Debug, Clone)]
pub struct Picture {
    pub(super) uri: String,
    pub(super) size: Size,
    /// Alternative text.
    pub(super) alt: String,
}

/// A picture that cannot be encoded.
#[derive(Debug, thiserror::Error)]
#[error("encoding the picture `{alt}` of {size}: {reason}")]
pub struct PictureError {
    /// Alternative text.
    pub alt: String,
    pub size: Size,
    /// The encoder's message.
    pub reason: String,
}

impl Picture {
    /// A JPEG of quality 86 without colour subsampling: for rendered or photographed frames and flow colours.
    ///
    /// # Errors
    /// When a side is 0 or over 65535 pixels.
    pub fn jpeg(image: &Image, alt: &str) -> Result<Self, PictureError> {
        let error = |reason: String| Self::error(image.size(), alt, reason);
        let side = |pixels: usize| u32::try_from(pixels).ok().filter(|side| (1..=65_535).contains(side));
        let (Some(width), Some(height)) = (side(image.width()), side(image.height())) else {
            return Err(error("a JPEG has 1 to 65535 pixels a side".to_owned()));
        };
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 86)
            .write_image(image.pixels().as_flattened(), width, height, ExtendedColorType::Rgb8)
            .map_err(|reason| error(reason.to_string()))?;
        Ok(Self::of("image/jpeg", &bytes, image.size(), alt))
    }

    /// A grey PNG of shares, 0 black and 1 white: for masks.
    ///
    /// # Errors
    /// When a side is 0 or beyond what PNG holds.
    pub fn grey(shares: &Plane, alt: &str) -> Result<Self, PictureError> {
        let grey: Vec<u8> = shares.pixels().iter().map(|share| (share * 255.0 + 0.5) as u8).collect();
        Self::png(&grey, shares.size(), png::ColorType::Grayscale, alt)
    }

    /// A lossless colour PNG: for small pictures and hard edges.
    ///
    /// # Errors
    /// When a side is 0 or beyond what PNG holds.
    pub fn exact(image: &Image, alt: &str) -> Result<Self, PictureError> {
        Self::png(image.pixels().as_flattened(), image.size(), png::ColorType::Rgb, alt)
    }

    fn png(data: &[u8], size: Size, colour: png::ColorType, alt: &str) -> Result<Self, PictureError> {
        let write = || -> Result<Vec<u8>, png::EncodingError> {
            let side = |pixels: usize| u32::try_from(pixels).unwrap_or(0); // 0 is refused by the encoder
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, side(size.width), side(size.height));
            encoder.set_color(colour);
            encoder.set_depth(png::BitDepth::Eight);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(data)?;
            writer.finish()?;
            Ok(bytes)
        };
        let bytes = write().map_err(|reason| Self::error(size, alt, reason.to_string()))?;
        Ok(Self::of("image/png", &bytes, size, alt))
    }

    fn of(mime: &str, bytes: &[u8], size: Size, alt: &str) -> Self {
        let uri = format!("data:{mime};base64,{}", BASE64_STANDARD.encode(bytes));
        Self { uri, size, alt: alt.to_owned() }
    }

    fn error(size: Size, alt: &str, reason: String) -> PictureError {
        PictureError { alt: alt.to_owned(), size, reason }
    }

    /// The `img` element.
    pub(super) fn img(&self) -> Markup {
        html! { img src=(self.uri) width=(self.size.width) height=(self.size.height) alt=(self.alt); }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_keeps_every_pixel() {
        let image = Image::from_fn(7, 5, |x, y| [x as u8 * 30, y as u8 * 40, 200]);
        let picture = Picture::exact(&image, "test").unwrap();
        let encoded = picture.uri.strip_prefix("data:image/png;base64,").unwrap();
        let bytes = BASE64_STANDARD.decode(encoded).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut decoded = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut decoded).unwrap();
        assert_eq!(decoded, image.pixels().as_flattened());
    }

    #[test]
    fn empty_pictures_are_errors_that_name_them() {
        let empty = Image::new(0, 0);
        assert!(Picture::jpeg(&empty, "nothing").unwrap_err().to_string().contains("nothing"));
        assert!(Picture::exact(&empty, "nothing").is_err());
        let wide = Image::new(70_000, 1);
        assert!(Picture::jpeg(&wide, "wide").unwrap_err().to_string().contains("65535"));
    }
}

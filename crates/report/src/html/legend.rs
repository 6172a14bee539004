use maud::html;
use srflow_core::Image;

use super::charts::number;
use super::{Figure, Picture, PictureError};
use crate::{ColorMap, color_wheel};

/// The legend of [`heat`](crate::heat()): its colours from 0 to `max` pixels, and a note.
///
/// # Errors
/// When the ramp cannot be encoded.
pub fn heat_legend(max: f64, words: &str) -> Result<Figure, PictureError> {
    let ramp = Image::from_fn(256, 1, |x, _| ColorMap::Inferno.color(x as f32 / 255.0));
    let words = format!("0 to {} px and more. {words}", number(max));
    ramp_legend(&ramp, "error colours, from black to light yellow", &words)
}

/// The legend of a colour scale: `ramp` is one pixel high, its colours from the lower to the upper end.
///
/// # Errors
/// When the ramp cannot be encoded.
pub fn ramp_legend(ramp: &Image, alt: &str, words: &str) -> Result<Figure, PictureError> {
    let ramp = Picture::exact(ramp, alt)?;
    Ok(Figure(html! { div.legend { img.ramp src=(ramp.uri) alt=(ramp.alt); span { (words) } } }))
}

/// The legend of flow colours: a disc whose rim is `max` pixels of motion, and a note.
///
/// # Errors
/// When the disc cannot be encoded.
pub fn wheel_legend(max: f64, words: &str) -> Result<Figure, PictureError> {
    let wheel = Picture::exact(&color_wheel(), "colour wheel of flow directions")?;
    Ok(Figure(html! {
        div.legend {
            img.wheel src=(wheel.uri) alt=(wheel.alt);
            span { "Hue is the direction of motion, saturation its length; the rim is " (number(max)) " px. " (words) }
        }
    }))
}

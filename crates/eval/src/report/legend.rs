use maud::html;
use srflow_field::Image;

use super::charts::number;
use super::heat::colour;
use super::{Figure, Picture, PictureError};

/// The key of [`heat`](super::heat): its colours from 0 to `max` pixels, and what to read from it.
///
/// # Errors
/// When the ramp cannot be encoded.
pub fn heat_legend(max: f64, words: &str) -> Result<Figure, PictureError> {
    let ramp = Image::from_fn(256, 1, |x, _| colour(x as f32 / 255.0));
    let ramp = Picture::exact(&ramp, "error colours, from black to light yellow")?;
    Ok(Figure(html! {
        div.legend {
            img.ramp src=(ramp.uri) alt=(ramp.alt);
            span { "0 to " (number(max)) " px and more. " (words) }
        }
    }))
}

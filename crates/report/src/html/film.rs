use maud::html;
use srflow_core::Image;

use super::panels::title_and_note;
use super::{Figure, Picture, PictureError};

/// A short animation: its frames side by side in one picture, which the style sheet steps through.
#[derive(Debug, Clone)]
pub struct Film {
    strip: Picture,
    frames: usize,
    title: String,
    note: String,
}

impl Film {
    /// Joins frames of one size.
    ///
    /// # Errors
    /// When there are no frames, or together they are wider than a JPEG can be (65535 pixels).
    pub fn new(frames: &[Image], title: &str, note: &str) -> Result<Self, PictureError> {
        let size = frames.first().map(Image::size).unwrap_or_default();
        let mut strip = Vec::with_capacity(size.pixels() * frames.len());
        for y in 0..size.height {
            for frame in frames.iter().filter(|frame| frame.size() == size) {
                strip.extend_from_slice(frame.row(y));
            }
        }
        let strip = Image::from_pixels(size.width * frames.len(), size.height, strip).map_err(|error| {
            PictureError {
                alt: title.to_owned(),
                size: error.size,
                reason: "the frames of a film must have one size".to_owned(),
            }
        })?;
        let mut strip = Picture::jpeg(&strip, title)?;
        strip.size = size;
        Ok(Self { strip, frames: frames.len(), title: title.to_owned(), note: note.to_owned() })
    }
}

/// Animations that run in sync, back and forth, at `frames_per_second`.
pub fn films(films: &[Film], frames_per_second: f64, caption: &str) -> Figure {
    let style = |film: &Film| {
        let seconds = film.frames as f64 / frames_per_second.max(0.1);
        format!(
            "aspect-ratio:{}/{};background-size:{}% 100%;background-image:url({});\
             animation-duration:{seconds:.2}s;animation-timing-function:steps({},jump-none)",
            film.strip.size.width,
            film.strip.size.height,
            100 * film.frames,
            film.strip.uri,
            film.frames.max(2),
        )
    };
    Figure(html! {
        figure {
            div.grid style="--least:200px" {
                @for film in films {
                    div.panel style={ "max-width:" (film.strip.size.width) "px" } {
                        div.film role="img" aria-label=(film.strip.alt) style=(style(film)) {}
                        (title_and_note(&film.title, &film.note))
                    }
                }
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}

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
        let (width, height) = frames.first().map_or((0, 0), Image::size);
        let mut strip = Vec::with_capacity(width * height * frames.len());
        for y in 0..height {
            for frame in frames.iter().filter(|frame| frame.size() == (width, height)) {
                strip.extend_from_slice(frame.row(y));
            }
        }
        let strip =
            Image::from_pixels(width * frames.len(), height, strip).map_err(|error| PictureError {
                alt: title.to_owned(),
                width: error.width,
                height: error.height,
                reason: "the frames of a film must have one size".to_owned(),
            })?;
        let mut strip = Picture::jpeg(&strip, title)?;
        strip.width = width;
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
            film.strip.width,
            film.strip.height,
            100 * film.frames,
            film.strip.uri,
            film.frames.max(2),
        )
    };
    Figure(html! {
        figure {
            div.grid style="--least:200px" {
                @for film in films {
                    div.panel style={ "max-width:" (film.strip.width) "px" } {
                        div.film role="img" aria-label=(film.strip.alt) style=(style(film)) {}
                        (title_and_note(&film.title, &film.note))
                    }
                }
            }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    })
}

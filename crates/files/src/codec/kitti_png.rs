//! Flow in 16-bit PNG as in KITTI and HD1K: red is `u * 64 + 32768`, green the same for `v`, blue is 1 where the flow is known
//! and 0 elsewhere (KITTI 2015 development kit, `io_flow.h`). ptlflow's variant `png128` has a factor of 128 in place of 64.

use std::io::{self, Cursor, Read, Write};

use super::checks::check_pixels;
use super::claim::{blank, read_all};
use super::png_outline::PngOutline;
use crate::FileProblem;
use srflow_core::{FlowField, Size};

const ZERO: f32 = 32768.0;

/// The quantization of the components, in steps per pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    steps: f32,
    range: &'static str,
}

pub(super) const KITTI: Grid =
    Grid { steps: 64.0, range: "components from -512 to 511.98 pixels (other formats have a larger range)" };
pub(super) const PNG128: Grid =
    Grid { steps: 128.0, range: "components from -256 to 255.99 pixels (other formats have a larger range)" };

impl Grid {
    fn component(self, step: u16) -> f32 {
        (f32::from(step) - ZERO) / self.steps
    }

    /// The nearest step; `None` when it is out of the range of 16 bits.
    fn step(self, component: f32) -> Option<u16> {
        let step = (component * self.steps).round() + ZERO;
        (0.0..=65535.0).contains(&step).then_some(step as u16)
    }
}

/// Also returns how many bytes follow the flow.
pub(super) fn decode(reader: &mut dyn Read, len: u64, grid: Grid) -> Result<(FlowField, u64), FileProblem> {
    let bytes = read_all(reader, len)?;
    let outline = PngOutline::read(&bytes)?;
    if (outline.bit_depth, outline.color_type, outline.interlaced) != (16, 2, false) {
        let expected =
            "KITTI's flow format, 16-bit RGB without interlacing (a colour picture of a flow cannot be read)";
        let found = format!("{} bits, colour type {}", outline.bit_depth, outline.color_type);
        return Err(FileProblem::field("pixel format", expected, found));
    }
    let broken = |error: png::DecodingError| FileProblem::field("PNG", "a valid file", error.to_string());
    let mut decoder = png::Decoder::new(Cursor::new(&bytes));
    decoder.set_ignore_text_chunk(true);
    let mut rows = decoder.read_info().map_err(broken)?;

    let PngOutline { width, height, .. } = outline;
    let mut flow = FlowField::from_buffer(width, height, blank(width * height)?);
    for pixels in flow.pixels_mut().chunks_exact_mut(width) {
        let row = rows.next_row().map_err(broken)?;
        let row = row.ok_or_else(|| FileProblem::field("PNG", format!("{height} rows"), "fewer"))?;
        for (pixel, [u0, u1, v0, v1, known @ ..]) in pixels.iter_mut().zip(row.data().as_chunks::<6>().0) {
            *pixel = match known {
                [0, 0] => [f32::NAN; 2],
                _ => [[*u0, *u1], [*v0, *v1]].map(|step| grid.component(u16::from_be_bytes(step))),
            };
        }
    }
    rows.finish().map_err(broken)?;
    Ok((flow, outline.more))
}

/// # Errors
/// When a known component is out of range.
pub(super) fn check_range(flow: &FlowField, grid: Grid) -> Result<(), FileProblem> {
    check_pixels(flow, grid.range, |[u, v]| u.is_nan() || (grid.step(u).is_some() && grid.step(v).is_some()))
}

pub(super) fn encode(flow: &FlowField, grid: Grid, writer: &mut impl Write) -> io::Result<()> {
    let Size { width, height } = flow.size();
    let mut encoder = png::Encoder::new(writer, width as u32, height as u32); // at most MAX_PIXELS
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.set_compression(png::Compression::Fast);
    let mut encoder = encoder.write_header()?;
    let mut rows = encoder.stream_writer()?;
    let mut row = Vec::with_capacity(6 * width);
    for y in 0..height {
        row.clear();
        for component in flow.row(y) {
            let rgb = match component.map(|component| grid.step(component)) {
                [Some(u), Some(v)] => [u, v, 1],
                _ => [0; 3],
            };
            row.extend(rgb.map(u16::to_be_bytes).as_flattened());
        }
        rows.write_all(&row)?;
    }
    rows.finish()?;
    Ok(encoder.finish()?)
}

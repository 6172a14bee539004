use std::ops::Range;

use srflow_core::{FlowField, Image, Mask, Plane, Size};

/// The outputs to write. Others stay empty (size 0x0) and cost nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outputs {
    /// [`Frame::image`].
    pub image: bool,
    /// [`Frame::color`].
    pub color: bool,
    /// [`Frame::alpha`].
    pub alpha: bool,
    /// [`Frame::depth`].
    pub depth: bool,
    /// [`Frame::flow`]; needs a next frame.
    pub flow: bool,
    /// [`Frame::depth_next`]; needs a next frame.
    pub depth_next: bool,
}

impl Outputs {
    /// All outputs.
    pub const ALL: Self =
        Self { image: true, color: true, alpha: true, depth: true, flow: true, depth_next: true };
    /// Nothing.
    pub const NONE: Self =
        Self { image: false, color: false, alpha: false, depth: false, flow: false, depth_next: false };
    /// The 8-bit image alone.
    pub const IMAGE: Self = Self { image: true, ..Self::NONE };
}

impl Default for Outputs {
    fn default() -> Self {
        Self::ALL
    }
}

/// The result of a rendering, row-major. Pass it to the next rendering to reuse its buffers.
///
/// With `w` the blending weight of a Gaussian at a pixel (its alpha times the transmittance before it):
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// [`Frame::color`] clamped to 0..1 and rounded to 8 bits. Colours of a 3DGS avatar are sRGB values already.
    pub image: Image,
    /// `sum w * colour` plus the visible part of the background, before clamping; 0..1 is the displayable range.
    pub color: Vec<[f32; 3]>,
    /// `sum w`, in 0..1.
    pub alpha: Plane,
    /// Expected depth `sum w * z / sum w` in scene units, z being the centre's depth in this camera; 0 where nothing is visible.
    pub depth: Plane,
    /// `sum w * displacement` in pixels, not divided by alpha (SRFlow paper, section III-B).
    pub flow: FlowField,
    /// Expected depth of the same Gaussians, with the same weights, after their motion and in the next camera; 0 where nothing
    /// is visible. A pixel whose `depth_next` is larger than the next frame's own depth at the flow's target is occluded there.
    pub depth_next: Plane,
    pub statistics: Statistics,
}

/// Counts of one rendering.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Gaussians that can touch a pixel.
    pub visible: usize,
    /// Blended (Gaussian, pixel) pairs.
    pub blended: u64,
    /// Visible Gaussians without a displacement, because their next centre is not in front of the next camera's near plane or
    /// is not finite. They are drawn with a displacement of zero.
    pub without_displacement: usize,
}

impl Default for Frame {
    fn default() -> Self {
        Self {
            width: 0,
            height: 0,
            image: Image::new(0, 0),
            color: Vec::new(),
            alpha: Plane::new(0, 0),
            depth: Plane::new(0, 0),
            flow: FlowField::new(0, 0),
            depth_next: Plane::new(0, 0),
            statistics: Statistics::default(),
        }
    }
}

impl Frame {
    /// An empty frame.
    pub fn new() -> Self {
        Self::default()
    }

    /// `true` where alpha is over one half. Needs [`Outputs::alpha`].
    pub fn mask(&self) -> Mask {
        let Size { width, height } = self.alpha.size();
        let pixels: Vec<bool> = self.alpha.pixels().iter().map(|&alpha| alpha > 0.5).collect();
        Mask::from_pixels(width, height, pixels).unwrap_or_else(|_| Mask::new(width, height))
    }

    /// The flow divided by alpha: the mean displacement of the visible Gaussians; zero where nothing is visible. Needs
    /// [`Outputs::flow`] and [`Outputs::alpha`].
    pub fn flow_normalized(&self) -> FlowField {
        let mut normalized = self.flow.clone();
        for ([u, v], &alpha) in normalized.pixels_mut().iter_mut().zip(self.alpha.pixels()) {
            if alpha > 0.0 {
                *u /= alpha;
                *v /= alpha;
            }
        }
        normalized
    }

    /// Resizes the requested buffers and empties the others, keeping their memory.
    pub(crate) fn prepare(&mut self, size: Size, outputs: Outputs) {
        macro_rules! fit {
            ($field:ident, $type:ident, $blank:expr) => {
                let size = if outputs.$field { size } else { Size::default() };
                if self.$field.size() != size {
                    let mut pixels = std::mem::replace(&mut self.$field, $type::new(0, 0)).into_pixels();
                    pixels.resize(size.pixels(), $blank);
                    self.$field = match $type::from_pixels(size.width, size.height, pixels) {
                        Ok(grid) => grid,
                        Err(_) => unreachable!("resized to fit"),
                    };
                }
            };
        }
        fit!(image, Image, [0; 3]);
        fit!(alpha, Plane, 0.0);
        fit!(depth, Plane, 0.0);
        fit!(flow, FlowField, [0.0; 2]);
        fit!(depth_next, Plane, 0.0);
        self.color.resize(if outputs.color { size.pixels() } else { 0 }, [0.0; 3]);
        Size { width: self.width, height: self.height } = size;
        self.statistics = Statistics::default();
    }
}

/// A band of rows of a frame, written by one thread. Outputs that were not requested are empty.
pub(crate) struct FrameRows<'a> {
    pub width: usize,
    pub height: usize,
    pub image: &'a mut [[u8; 3]],
    pub color: &'a mut [[f32; 3]],
    pub alpha: &'a mut [f32],
    pub depth: &'a mut [f32],
    pub flow: &'a mut [[f32; 2]],
    pub depth_next: &'a mut [f32],
}

impl<'a> FrameRows<'a> {
    /// All rows of a prepared frame.
    pub(crate) fn all(frame: &'a mut Frame) -> Self {
        Self {
            width: frame.width,
            height: frame.height,
            image: frame.image.pixels_mut(),
            color: &mut frame.color,
            alpha: frame.alpha.pixels_mut(),
            depth: frame.depth.pixels_mut(),
            flow: frame.flow.pixels_mut(),
            depth_next: frame.depth_next.pixels_mut(),
        }
    }

    /// Splits into the rows before `row` and the others.
    pub(crate) fn split_at(self, row: usize) -> (Self, Self) {
        let width = self.width;
        let middle = row * width;
        macro_rules! split {
            ($($output:ident),*) => {
                let ($($output),*) = ($(self.$output.split_at_mut(middle.min(self.$output.len()))),*);
                (
                    Self { width, height: row, $($output: $output.0),* },
                    Self { width, height: self.height - row, $($output: $output.1),* },
                )
            };
        }
        split! { image, color, alpha, depth, flow, depth_next }
    }

    /// Fills columns `columns` of every row with the background.
    pub(crate) fn fill_background(&mut self, columns: Range<usize>, background: [f32; 3]) {
        if columns.is_empty() {
            return;
        }
        for y in 0..self.height {
            let span = y * self.width + columns.start..y * self.width + columns.end;
            fill(self.image, span.clone(), background.map(to_byte));
            fill(self.color, span.clone(), background);
            fill(self.alpha, span.clone(), 0.0);
            fill(self.depth, span.clone(), 0.0);
            fill(self.flow, span.clone(), [0.0; 2]);
            fill(self.depth_next, span, 0.0);
        }
    }
}

fn fill<T: Copy>(output: &mut [T], span: Range<usize>, value: T) {
    if let Some(pixels) = output.get_mut(span) {
        pixels.fill(value);
    }
}

/// 0..1 to 0..=255, clamped, rounded.
#[inline(always)]
pub(crate) fn to_byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

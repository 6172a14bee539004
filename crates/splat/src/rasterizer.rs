use crate::{Camera, Frame, Gaussians, Outputs, PixelConvention, RasterizeError, reference};

/// How to render.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Colour behind the Gaussians, 0..1.
    pub background: [f32; 3],
    /// Pixels of what the flow counts.
    pub convention: PixelConvention,
    /// What to write.
    pub outputs: Outputs,
}

impl Default for Options {
    /// Black background, [`PixelConvention::Splat`], every output.
    fn default() -> Self {
        Self { background: [0.0; 3], convention: PixelConvention::Splat, outputs: Outputs::ALL }
    }
}

/// The frame that the flow leads to: the same Gaussians after they moved, and the camera that sees them.
#[derive(Debug, Clone, Copy)]
pub struct Next<'a> {
    /// The moved Gaussians, in the order of the first set. Only their positions are used.
    pub gaussians: &'a Gaussians,
    /// The next camera, of the same image size.
    pub camera: &'a Camera,
}

/// The Gaussian and Flow Rasterizer. It holds working memory that is reused from one rendering to the next; the result
/// does not depend on what was rendered before, on the number of threads or on the processor.
#[derive(Debug, Default)]
pub struct Rasterizer {}

impl Rasterizer {
    /// A rasterizer.
    pub fn new() -> Self {
        Self::default()
    }

    /// Renders `gaussians` as `camera` sees them into `frame`, with the flow towards `next` when there is one.
    /// Runs on the threads of the current rayon pool.
    ///
    /// # Errors
    /// When the lists of a set do not fit together, the two sets differ in count, a camera is not valid
    /// ([`Camera::validate`]), or the two cameras' images differ in size. A Gaussian that cannot be drawn (behind the
    /// near plane, not finite) is no error: it is left out.
    pub fn render(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        next: Option<Next<'_>>,
        options: &Options,
        frame: &mut Frame,
    ) -> Result<(), RasterizeError> {
        let pixels = reference::render(gaussians, camera, next, options)?;
        let mut outputs = options.outputs;
        outputs.flow &= next.is_some();
        outputs.depth_next &= next.is_some();
        frame.prepare(camera.width, camera.height, outputs);
        for (i, pixel) in pixels.iter().enumerate() {
            let color = pixel.color.map(|c| c as f32);
            if outputs.color {
                frame.color[i] = color;
            }
            if outputs.image {
                frame.image.pixels_mut()[i] = color.map(|c| (c * 255.0 + 0.5) as u8);
            }
            if outputs.alpha {
                frame.alpha.pixels_mut()[i] = pixel.alpha as f32;
            }
            if outputs.depth {
                frame.depth.pixels_mut()[i] = pixel.depth as f32;
            }
            if outputs.flow {
                frame.flow.pixels_mut()[i] = pixel.flow.map(|c| c as f32);
            }
            if outputs.depth_next {
                frame.depth_next.pixels_mut()[i] = pixel.depth_next as f32;
            }
            frame.statistics.blended += u64::from(pixel.blended);
        }
        Ok(())
    }
}

/// Checks what every engine relies on.
pub(crate) fn validate(
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
) -> Result<(), RasterizeError> {
    gaussians.validate("the Gaussians")?;
    camera.validate()?;
    let Some(next) = next else { return Ok(()) };
    if next.gaussians.len() != gaussians.len() {
        return Err(RasterizeError::CountMismatch { first: gaussians.len(), next: next.gaussians.len() });
    }
    next.camera.validate()?;
    let (first, next) = ((camera.width, camera.height), (next.camera.width, next.camera.height));
    if first != next {
        return Err(RasterizeError::SizeMismatch { first, next });
    }
    Ok(())
}

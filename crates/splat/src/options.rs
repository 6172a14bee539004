//! What a rendering is asked for.

use crate::{Camera, Gaussians, Outputs, PixelConvention, RasterizeError};

/// Rendering options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Background colour, 0..1.
    pub background: [f32; 3],
    /// Pixel convention of the flow.
    pub convention: PixelConvention,
    /// The order in which the Gaussians at a pixel are blended.
    pub sorting: Sorting,
    pub outputs: Outputs,
}

/// The order in which the Gaussians at a pixel are blended, front to back. Gradients take it as given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sorting {
    /// By the depth of their centres: one order for the whole image, as in the 3DGS reference. Where the centres of two
    /// Gaussians change places, all pixels that see both change at once ("popping").
    #[default]
    Global,
    /// At each pixel by the depth at which the Gaussian is densest along the ray through the pixel's centre, equal depths in the
    /// order of [`Sorting::Global`]. Nothing pops: where two Gaussians intersect, the edge between them moves. This is the full
    /// per-pixel sort of StopThePop (Radl et al. 2024). About five times slower for the small Gaussians of an avatar, more where
    /// many large ones overlap.
    ///
    /// The density is that of the Gaussian after a low-pass filter as wide in space as that of the image is at its centre: `0.3
    /// z^2 / (fx fy)` is added to each variance. So the depth is well defined for flat Gaussians that are seen from their edge
    /// too, where the ray and the disc's plane meet anywhere. (StopThePop limits standard deviations to at least 0.001 world units,
    /// which in a world of metres is more than the size of a head's Gaussians. It also drops a Gaussian that is densest
    /// behind the camera; here it is in front of the others.)
    PerPixel,
}

impl Default for Options {
    /// Black background, [`PixelConvention::Splat`], [`Sorting::Global`], every output.
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            convention: PixelConvention::Splat,
            sorting: Sorting::Global,
            outputs: Outputs::ALL,
        }
    }
}

/// The target of the flow: the same Gaussians after their motion, and the camera that sees them.
#[derive(Debug, Clone, Copy)]
pub struct Next<'a> {
    /// The moved Gaussians, in the order of the first set. Only their positions are used.
    pub gaussians: &'a Gaussians,
    /// The next camera, of the same image size.
    pub camera: &'a Camera,
}

/// Checks the preconditions of every implementation.
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
    let (first, next) = (camera.size(), next.camera.size());
    if first != next {
        return Err(RasterizeError::SizeMismatch { first, next });
    }
    Ok(())
}

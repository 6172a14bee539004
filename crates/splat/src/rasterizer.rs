use srflow_core::Spares;
use srflow_simd::{Isa, dispatch};

use crate::backward::{self, Rendering};
use crate::frame::FrameRows;
use crate::ordering::{Bins, DepthOrder, Drawn};
use crate::pixel_order::{Peaks, PixelOrder};
use crate::projection::{Placement, Splat, TILE, project};
use crate::replay::Replay;
use crate::strip::{Scene, render};
use crate::{Camera, Frame, Gaussians, Outputs, PixelConvention, RasterizeError, Statistics};

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

/// The Gaussian and Flow Rasterizer. Its buffers are reused between renderings; the result does not depend on earlier
/// renderings, the number of threads, or the processor.
#[derive(Debug, Default)]
pub struct Rasterizer {
    /// The widest, unless a test chooses another.
    pub(crate) isa: Option<Isa>,
    pub(crate) splats: Vec<Splat>,
    pub(crate) placements: Vec<Placement>,
    pub(crate) peaks: Peaks,
    order: DepthOrder,
    pub(crate) strips: Bins<Drawn>,
    tiles: Vec<Bins<u32>>,
    /// One for each thread that has sorted per pixel.
    sorters: Spares<(PixelOrder, Replay)>,
    pub(crate) backward: backward::Buffers,
}

impl Rasterizer {
    /// A rasterizer that uses the widest instruction set of this processor.
    pub fn new() -> Self {
        Self::default()
    }

    #[cfg(test)]
    pub(crate) fn on(isa: Isa) -> Self {
        Self { isa: Some(isa), ..Self::default() }
    }

    /// Renders `gaussians` as seen by `camera` into `frame`, with the flow towards `next` if there is one. Runs on the threads
    /// of the current rayon pool. The returned [`Rendering`] can be differentiated.
    ///
    /// # Errors
    /// When the lists of a set do not match, the two sets differ in number, a camera is not valid ([`Camera::validate`]), or the
    /// two cameras' images differ in size. A Gaussian that cannot be drawn (behind the near plane, not finite) is no error: it
    /// is skipped.
    pub fn render<'a>(
        &'a mut self,
        gaussians: &'a Gaussians,
        camera: &Camera,
        next: Option<Next<'a>>,
        options: &Options,
        frame: &mut Frame,
    ) -> Result<Rendering<'a>, RasterizeError> {
        validate(gaussians, camera, next)?;
        let has_next = next.is_some();
        let wanted = options.outputs;
        let outputs =
            Outputs { flow: wanted.flow && has_next, depth_next: wanted.depth_next && has_next, ..wanted };
        frame.prepare(camera.width, camera.height, outputs);

        let without_displacement =
            project(gaussians, camera, next, options, &mut self.splats, &mut self.placements);
        if options.sorting == Sorting::PerPixel {
            self.peaks.find(gaussians, camera, &self.splats, &self.placements);
        }
        let order = self.order.sort(&self.placements);
        let strips = camera.height.div_ceil(TILE);
        self.strips.deal(strips, order.iter().map(|drawn| (*drawn, drawn.rows)));
        self.tiles.resize_with(strips, Bins::default);

        let pass = Pass {
            isa: self.isa.unwrap_or_else(Isa::best),
            scene: Scene::new(&self.splats, &self.peaks, options),
            strips: &self.strips,
            sorters: &self.sorters,
            motion: outputs.flow || outputs.depth_next,
        };
        let blended = pass.render(0, FrameRows::all(frame), &mut self.tiles);
        frame.statistics = Statistics { visible: order.len(), blended, without_displacement };
        Ok(Rendering {
            rasterizer: self,
            gaussians,
            camera: *camera,
            next: next.map(|next| (next.gaussians, *next.camera)),
            options: *options,
        })
    }
}

/// The blending stage of one rendering.
struct Pass<'a> {
    isa: Isa,
    scene: Scene<'a>,
    strips: &'a Bins<Drawn>,
    sorters: &'a Spares<(PixelOrder, Replay)>,
    /// Whether displacements and next depths are blended too.
    motion: bool,
}

impl Pass<'_> {
    /// Renders the strips of `rows`, starting with strip number `strip`; `tiles` holds the buffers of each. The rows are halved
    /// recursively among threads, which balances the load without allocating. Returns the number of blended pairs.
    fn render(&self, strip: usize, rows: FrameRows<'_>, tiles: &mut [Bins<u32>]) -> u64 {
        if tiles.len() > 1 {
            let half = tiles.len() / 2;
            let (upper, lower) = rows.split_at(half * TILE);
            let (upper_tiles, lower_tiles) = tiles.split_at_mut(half);
            let (a, b) = rayon::join(
                || self.render(strip, upper, upper_tiles),
                || self.render(strip + half, lower, lower_tiles),
            );
            return a + b;
        }
        let [tiles] = tiles else { return 0 };
        if self.motion { self.strip::<7>(strip, rows, tiles) } else { self.strip::<4>(strip, rows, tiles) }
    }

    fn strip<const CHANNELS: usize>(
        &self,
        strip: usize,
        mut rows: FrameRows<'_>,
        tiles: &mut Bins<u32>,
    ) -> u64 {
        let drawn = self.strips.get(strip);
        let mut sorter = self.scene.peaks.and_then(|_| self.sorters.take()).unwrap_or_default();
        let blended =
            render_strip::<CHANNELS>(self.isa, self.scene, strip, drawn, tiles, &mut sorter, &mut rows);
        if self.scene.peaks.is_some() {
            self.sorters.put(sorter);
        }
        blended
    }
}

dispatch! {
    /// See [`render`].
    fn render_strip<const CHANNELS: usize> = render(
        scene: Scene<'_>,
        strip: usize,
        drawn: &[Drawn],
        tiles: &mut Bins<u32>,
        sorter: &mut (PixelOrder, Replay),
        rows: &mut FrameRows<'_>,
    ) -> u64
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
    let (first, next) = ((camera.width, camera.height), (next.camera.width, next.camera.height));
    if first != next {
        return Err(RasterizeError::SizeMismatch { first, next });
    }
    Ok(())
}

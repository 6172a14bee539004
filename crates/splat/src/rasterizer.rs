use srflow_core::Spares;
use srflow_simd::{Isa, dispatch};

use crate::backward::entries::Buffers;
use crate::frame::FrameRows;
use crate::options::{Next, Options, Sorting, validate};
use crate::ordering::{Bins, DepthOrder, Drawn};
use crate::pixel_order::{Peaks, PixelOrder};
use crate::projection::{Placement, Splat, TILE, project};
use crate::replay::Replay;
use crate::strip::{Scene, render};
use crate::{Camera, Frame, Gaussians, Outputs, RasterizeError, Statistics};

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
    pub(crate) backward: Buffers,
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
        frame.prepare(camera.size(), outputs);

        let isa = self.isa.unwrap_or_else(Isa::best);
        let without_displacement =
            project(isa, gaussians, camera, next, options, &mut self.splats, &mut self.placements);
        if options.sorting == Sorting::PerPixel {
            self.peaks.find(gaussians, camera, &self.splats, &self.placements);
        }
        let order = self.order.sort(&self.placements);
        let strips = camera.height.div_ceil(TILE);
        self.strips.deal(strips, order.iter().map(|drawn| (*drawn, drawn.rows)));
        self.tiles.resize_with(strips, Bins::default);

        let pass = Pass {
            isa,
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

/// A rendering that was just made, with all that its backward needs.
#[derive(Debug)]
pub struct Rendering<'a> {
    pub(crate) rasterizer: &'a mut Rasterizer,
    pub(crate) gaussians: &'a Gaussians,
    pub(crate) camera: Camera,
    pub(crate) next: Option<(&'a Gaussians, Camera)>,
    pub(crate) options: Options,
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

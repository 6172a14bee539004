//! The rasterizer on a GPU: the stages of [`crate::Rasterizer`] as kernels of CubeCL, which run on Vulkan and CUDA.
//!
//! Gaussians are projected, one thread each; sorted by depth; listed for each tile in that order, by sorting pairs of a tile and a splat
//! by tile; and blended, one thread per pixel. No stage depends on the order in which threads run: the result is the same each
//! time on one device. Devices round differently; the tests hold all of them to [`mod@crate::reference`].

mod blending;
mod buffer;
mod projection;
mod sorting;
#[cfg(test)]
mod tests;
mod tiles;

use cubecl::client::Client;
use cubecl::features::TypeUsage;
use cubecl::ir::{ElemType, FloatKind};
use cubecl::server::ServerError;

use crate::options::validate;
use crate::projection::TILE;
use crate::{Camera, Frame, Gaussians, Next, Options, Outputs, RasterizeError, Sorting, Statistics};
use blending::Pixels;
use buffer::Buffer;
use projection::Projected;
use tiles::{Area, Ordered};

/// Pairs of a splat and a tile that are listed at a time: 256 MiB in four arrays, which are each within the 128 MiB that every device
/// binds.
const MAX_PAIRS: usize = 1 << 24;

/// See [`crate::DeviceRasterizer`].
pub(crate) struct GpuRasterizer {
    client: Client,
    /// Whether Gaussians are projected in `f64`.
    in_f64: bool,
    max_pairs: usize,
}

impl GpuRasterizer {
    pub(crate) fn new(device: &cubecl::Device) -> Self {
        let client = device.client();
        let f64 = ElemType::Float(FloatKind::F64);
        let in_f64 = client.properties().type_usage(f64).contains(TypeUsage::Arithmetic);
        Self { client, in_f64, max_pairs: MAX_PAIRS }
    }

    /// [`crate::Rasterizer::render`], which cannot be differentiated.
    pub(crate) fn render(
        &self,
        gaussians: &Gaussians,
        camera: &Camera,
        next: Option<Next<'_>>,
        options: &Options,
        frame: &mut Frame,
    ) -> Result<(), RasterizeError> {
        validate(gaussians, camera, next)?;
        if options.sorting == Sorting::PerPixel {
            return Err(RasterizeError::SortingOnDevice);
        }
        let (wanted, has_next) = (options.outputs, next.is_some());
        let outputs =
            Outputs { flow: wanted.flow && has_next, depth_next: wanted.depth_next && has_next, ..wanted };
        frame.prepare(camera.size(), outputs);
        let pixels = Pixels::new(&self.client, [camera.width, camera.height], outputs, options.background);
        let statistics = self.draw(gaussians, camera, next, options, &pixels);
        let failed = |error: ServerError| RasterizeError::Device(error.to_string());
        frame.statistics = statistics.map_err(failed)?;
        pixels.read(&self.client, frame).map_err(failed)
    }

    fn draw(
        &self,
        gaussians: &Gaussians,
        camera: &Camera,
        next: Option<Next<'_>>,
        options: &Options,
        pixels: &Pixels,
    ) -> Result<Statistics, ServerError> {
        let client = &self.client;
        let tiles = |side: usize| side.div_ceil(TILE) as u32;
        let area = Area { rows: [0, tiles(camera.height)], columns: [0, tiles(camera.width)] };
        let mut statistics = Statistics::default();
        if gaussians.is_empty() {
            let (splats, list) = (Buffer::empty(client, 0), Buffer::empty(client, 0));
            let ranges = Buffer::of(client, &vec![0_u32; 2 * area.tiles()]);
            pixels.blend(client, &splats, &list, &ranges, area);
            return Ok(statistics);
        }
        let Projected { splats, mut depth_bits, boxes, without_displacement } =
            projection::project(client, self.in_f64, gaussians, camera, next, options);
        let mut order = tiles::indices(client, gaussians.len());
        sorting::sort(client, u32::BITS as usize, &mut depth_bits, &mut order);
        let ordered = Ordered { depth_bits, splats: order };
        let visible = tiles::visible(client, &ordered);
        let without_displacement = sorting::exclusive_sums(client, &without_displacement);

        let mut areas = vec![area];
        while let Some(area) = areas.pop() {
            let starts = tiles::counts(client, &ordered, &boxes, area);
            let total = sorting::exclusive_sums(client, &starts);
            let [[pairs], [visible], [without_displacement]] =
                Buffer::read(client, [&total, &visible, &without_displacement])?.map(|read| [read[0]]);
            (statistics.visible, statistics.without_displacement) =
                (visible as usize, without_displacement as usize);
            let pairs = pairs as usize;
            if pairs > self.max_pairs
                && let Some(halves) = area.split()
            {
                areas.extend(halves);
                continue;
            }
            let [mut keys, mut list] = tiles::pairs(client, &ordered, &boxes, area, &starts, pairs);
            let ranges = if pairs > 0 {
                let bits = usize::BITS - (area.tiles() - 1).leading_zeros();
                sorting::sort(client, bits as usize, &mut keys, &mut list);
                tiles::ranges(client, &keys, area.tiles())
            } else {
                Buffer::of(client, &vec![0_u32; 2 * area.tiles()])
            };
            let blended = pixels.blend(client, &splats, &list, &ranges, area);
            let [blended] = Buffer::read(client, [&blended])?;
            statistics.blended += blended.into_iter().map(u64::from).sum::<u64>();
        }
        Ok(statistics)
    }
}

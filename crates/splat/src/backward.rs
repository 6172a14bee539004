//! The fast backward: the same strips and tiles as the forward. Each strip writes, into memory of its own, one entry for every
//! splat that it shows; then each Gaussian adds its entries, strip by strip from the top, and continues through its
//! projection. So every sum has a fixed order, and no two threads write to one place.

pub(crate) mod entries;
mod projection;
mod tile;

use rayon::prelude::*;
use srflow_core::Size;
use srflow_simd::{Isa, MAX_LANES, Simd, dispatch};

use crate::gradients::{CameraGradient, FrameGradients, GaussianGradients, GaussianGradientsChunk};
use crate::ordering::Drawn;
use crate::pixel_order::PixelOrder;
use crate::projection::TILE;
use crate::replay::{Place, Replay};
use crate::strip::Scene;
use crate::{RasterizeError, Rasterizer, Rendering};
use entries::{CHUNK, NO_SLOT, Partial, Strip, sort_by_chunk};
use projection::ViewBackward;
use tile::TileGradients;

impl Rendering<'_> {
    /// Whether each Gaussian can touch a pixel. There are [`Statistics::visible`](crate::Statistics::visible) such ones.
    pub fn visible(&self) -> impl ExactSizeIterator<Item = bool> {
        self.rasterizer.placements.iter().map(|placement| !placement.is_hidden())
    }

    /// The gradients of a loss, given its gradients with respect to the frame. Writes all of `out`, whose memory is reused.
    /// [`reference::backward`](crate::reference::backward) is the definition. Runs on the threads of the current rayon pool,
    /// whose number does not change a bit.
    ///
    /// The gradients of outputs that were not requested count too; those of flow and next depth need a next frame.
    ///
    /// # Errors
    /// When a list of `gradients` does not fit the image.
    pub fn backward(
        &mut self,
        gradients: &FrameGradients,
        out: &mut GaussianGradients,
    ) -> Result<(), RasterizeError> {
        gradients.validate(self.camera.size())?;
        let motion = self.next.is_some() && !(gradients.flow.is_empty() && gradients.depth_next.is_empty());
        if motion {
            self.strips::<7>(gradients);
        } else if !gradients.depth.is_empty() {
            self.strips::<4>(gradients);
        } else {
            self.strips::<3>(gradients);
        }
        self.gather(out);
        Ok(())
    }

    /// Fills the buffers of the strips. `CHANNELS` features have gradients.
    fn strips<const CHANNELS: usize>(&mut self, gradients: &FrameGradients) {
        let Rasterizer { isa, splats, peaks, strips: lists, backward, .. } = &mut *self.rasterizer;
        let isa = isa.unwrap_or_else(Isa::best);
        let pass = Pass {
            scene: Scene::new(splats, peaks, &self.options),
            size: self.camera.size(),
            gradients,
            chunks: splats.len().div_ceil(CHUNK),
        };
        backward.strips.resize_with(self.camera.height.div_ceil(TILE), Strip::default);
        backward.strips.par_iter_mut().enumerate().for_each_init(
            Default::default,
            |buffers, (number, strip)| {
                fill_strip::<CHANNELS>(isa, pass, number, lists.get(number), strip, buffers);
            },
        );
    }

    /// Adds the entries of the strips for each Gaussian, and continues through the projection.
    fn gather(&self, out: &mut GaussianGradients) {
        let view = ViewBackward::new(self.gaussians, &self.camera, self.next, &self.options);
        let (splats, strips) = (&self.rasterizer.splats, &self.rasterizer.backward.strips);
        out.prepare(self.gaussians, self.next.is_some());
        let zero = [0.0; MAX_LANES - 1];
        let cameras: Vec<[CameraGradient; 2]> = out
            .chunks(CHUNK, self.gaussians.sh_len())
            .into_par_iter()
            .enumerate()
            .map_init(
                || (vec![zero; CHUNK], vec![false; CHUNK]),
                |(sums, touched), (chunk, mut out): (usize, GaussianGradientsChunk<'_>)| {
                    let first = chunk * CHUNK;
                    sums.fill(zero);
                    touched.fill(false);
                    for strip in strips {
                        for entry in &strip.sorted[strip.starts[chunk]..strip.starts[chunk + 1]] {
                            let at = entry.splat as usize - first;
                            touched[at] = true;
                            for (total, sum) in sums[at].iter_mut().zip(&entry.sums) {
                                *total += sum;
                            }
                        }
                    }
                    let mut cameras = [CameraGradient::default(); 2];
                    for at in 0..out.positions.len() {
                        let index = first + at;
                        if touched[at] {
                            let splat = &splats[index];
                            view.gaussian(
                                self.gaussians,
                                index,
                                splat,
                                &sums[at],
                                &mut out,
                                at,
                                &mut cameras,
                            );
                        } else {
                            out.clear(at);
                        }
                    }
                    cameras
                },
            )
            .collect();
        let mut totals = [CameraGradient::default(); 2];
        for chunk in cameras {
            for (total, camera) in totals.iter_mut().zip(chunk) {
                *total += camera;
            }
        }
        [out.camera, out.next_camera] = totals;
    }
}

/// Data shared by the strips of one backward.
#[derive(Clone, Copy)]
struct Pass<'a> {
    scene: Scene<'a>,
    /// Of the image.
    size: Size,
    gradients: &'a FrameGradients,
    /// Number of chunks of Gaussians.
    chunks: usize,
}

dispatch! {
    /// See [`fill`].
    fn fill_strip<const CHANNELS: usize> = fill(
        pass: Pass<'_>,
        number: usize,
        drawn: &[Drawn],
        strip: &mut Strip,
        buffers: &mut (Replay, PixelOrder),
    )
}

/// Fills strip number `number`, in which `drawn` were drawn.
#[inline(always)]
fn fill<const CHANNELS: usize>(
    s: impl Simd,
    pass: Pass<'_>,
    number: usize,
    drawn: &[Drawn],
    strip: &mut Strip,
    (replay, order): &mut (Replay, PixelOrder),
) {
    let Pass { scene: Scene { splats, peaks, background }, size: Size { width, height }, gradients, chunks } =
        pass;
    let Strip { tiles, slots, entries, sorted, starts } = strip;
    let columns = width.div_ceil(TILE);
    let positions = drawn.iter().enumerate();
    tiles.deal(columns, positions.map(|(position, drawn)| (position as u32, drawn.columns)));
    slots.clear();
    slots.resize(drawn.len(), NO_SLOT);
    entries.clear();
    for column in 0..columns {
        let list = tiles.get(column);
        if list.is_empty() {
            continue;
        }
        let (left, top) = (column * TILE, number * TILE);
        let (inner_width, inner_height) = (TILE.min(width - left), TILE.min(height - top));
        let place = Place { image_width: width, left, top, width: inner_width, height: inner_height };
        let transmittance = match peaks {
            None => replay.forward(s, splats, drawn, list, place),
            Some(peaks) => {
                let index = |position: u32| drawn[position as usize].splat as usize;
                order.forward(s, (splats, peaks), list, index, place, replay)
            }
        };
        if replay.is_empty() {
            continue;
        }
        let shown = (splats, drawn);
        let mut tile =
            TileGradients::<CHANNELS>::new(s, gradients, background, shown, replay, &transmittance, place);
        let order = peaks.map(|_| &mut *order);
        replay.backward(s, splats, drawn, place, &mut tile, order, |position, sums| {
            let slot = &mut slots[position as usize];
            if *slot == NO_SLOT {
                *slot = entries.len() as u32;
                entries.push(Partial { splat: drawn[position as usize].splat, sums: [0.0; MAX_LANES - 1] });
            }
            entries[*slot as usize].add(sums);
        });
    }
    sort_by_chunk(entries, chunks, sorted, starts);
}

//! How exact the flow is that an avatar gives as a label: its distance from the true flow of the head that the avatar was trained on.
//!
//! Flow is what `srflow render` writes: at each pixel the displacements of the Gaussians' centres, blended by alpha and not divided by
//! it. The true flow is that of the true head; it is compared inside of its mask, where its alpha is above one half. Where
//! the avatar's is not, the avatar has no label: such pixels are missing and counted apart.

use serde::Serialize;
use srflow_avatar::capture::{Capture, CaptureSplit, CaptureView};
use srflow_avatar::{Avatar, PosedHead, SEEN_THROUGH_METRES};
use srflow_data::region_map::HeadPart;
use srflow_head::HeadPose;
use srflow_splat::{Camera, DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs, RasterizeError};

use crate::RenderError;
use crate::capture::TrueCapture;
use crate::parts::PartWeights;

/// A head that moves from one pose to the next, and the camera that sees it in each.
#[derive(Debug, Clone, Copy)]
pub struct MovingHead<'a> {
    pub avatar: &'a Avatar,
    pub poses: [&'a HeadPose; 2],
    pub cameras: [&'a Camera; 2],
}

/// The true flow of a head beside the flow of its avatar. Keeps its buffers.
#[derive(Default)]
pub struct FlowComparison {
    truth: Frame,
    avatar: Frame,
    /// Of the true head.
    parts: PartWeights,
    rasterizer: DeviceRasterizer,
    head: PosedHead,
    now: Gaussians,
    next: Gaussians,
}

impl FlowComparison {
    /// Renders the flow of both: of the true head as `srflow render` does, of the avatar with `options`, whose outputs do not matter.
    ///
    /// # Errors
    /// When a camera is refused.
    pub fn render(
        &mut self,
        truth: MovingHead<'_>,
        avatar: MovingHead<'_>,
        options: &Options,
    ) -> Result<(), RasterizeError> {
        let outputs = Outputs { flow: true, alpha: true, depth: true, ..Outputs::NONE };
        let true_options = Options { outputs, ..Options::default() };
        let Self { rasterizer, head, now, next, .. } = self;
        for (moving, options, frame) in [
            (truth, true_options, &mut self.truth),
            (avatar, Options { outputs, ..*options }, &mut self.avatar),
        ] {
            moving.avatar.gaussians_into(moving.poses[1], head, next);
            moving.avatar.gaussians_into(moving.poses[0], head, now);
            let next = Next { gaussians: next, camera: moving.cameras[1] };
            rasterizer.render(now, moving.cameras[0], Some(next), &options, frame)?;
        }
        truth.avatar.gaussians_into(truth.poses[0], head, now);
        self.parts.render(rasterizer, truth.avatar, now, truth.cameras[0])
    }

    /// Flow, alpha and depth of the true head.
    pub fn truth(&self) -> &Frame {
        &self.truth
    }

    /// Flow, alpha and depth of the avatar.
    pub fn avatar(&self) -> &Frame {
        &self.avatar
    }

    /// The part of the head at each pixel, row-major; `None` outside of the true head's mask.
    pub fn parts(&self) -> impl Iterator<Item = Option<HeadPart>> {
        self.parts.parts(&self.truth.alpha)
    }

    /// The end-point error of each pixel, row-major; NaN outside of the true head's mask, and where the avatar is missing.
    pub fn errors(&self) -> impl Iterator<Item = f32> {
        let masked = self.truth.alpha.pixels().iter().zip(self.avatar.alpha.pixels());
        let flows = self.truth.flow.pixels().iter().zip(self.avatar.flow.pixels());
        masked.zip(flows).map(|((&truth, &avatar), (a, b))| match truth > 0.5 && avatar > 0.5 {
            true => distance(*a, *b),
            false => f32::NAN,
        })
    }
}

fn distance([u, v]: [f32; 2], [true_u, true_v]: [f32; 2]) -> f32 {
    let (du, dv) = (u - true_u, v - true_v);
    (du * du + dv * dv).sqrt()
}

/// End-point errors over many pixels, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ErrorStatistics {
    pub mean: f64,
    /// To within 0.4 %, as is the percentile.
    pub median: f64,
    pub percentile_95: f64,
    pub max: f64,
    /// Share of pixels with an error above 1 px.
    pub over_1_px: f64,
    /// Mean length of the true flow, which is the mean error of zero flow.
    pub true_length: f64,
}

/// Errors of the flow on the head, or on one of its parts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PartError {
    /// Pixels of the part in the mask of the true head.
    pub pixels: u64,
    /// Those where the avatar's alpha is not above one half.
    pub missing: u64,
    /// Those that are not missing where the avatar's depth is more than 10 mm behind the true one: it is seen through.
    pub seen_through: u64,
    /// Over the pixels that are not missing; `None` without one.
    pub errors: Option<ErrorStatistics>,
    /// Mean error over the missing pixels, of the flow that the avatar has there nevertheless.
    pub missing_mean: Option<f64>,
}

/// Errors of an avatar's flow over some pairs of frames.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LabelError {
    pub pairs: u64,
    pub head: PartError,
    /// Its parts, whose pixels make up the head's.
    pub skin: PartError,
    pub eyes: PartError,
    pub mouth: PartError,
    pub hair: PartError,
    pub neck: PartError,
    /// Pixels outside of the true head's mask where the avatar's alpha is above one half.
    pub surplus: u64,
}

impl LabelError {
    /// The whole head and its parts, by name.
    pub fn parts(&self) -> [(&'static str, &PartError); 6] {
        let Self { head, skin, eyes, mouth, hair, neck, .. } = self;
        [("head", head), ("skin", skin), ("eyes", eyes), ("mouth", mouth), ("hair", hair), ("neck", neck)]
    }
}

/// Sums over pairs; [`LabelErrorSum::result`] gives the errors.
#[derive(Debug, Clone, Default)]
pub struct LabelErrorSum {
    pairs: u64,
    /// In the order of [`HeadPart::ALL`].
    parts: [PartSum; HeadPart::ALL.len()],
    surplus: u64,
}

impl LabelErrorSum {
    /// Adds the pixels of a pair.
    pub fn add(&mut self, pair: &FlowComparison) {
        self.pairs += 1;
        let FlowComparison { truth, avatar, .. } = pair;
        for (pixel, part) in pair.parts().enumerate() {
            let shown = avatar.alpha.pixels()[pixel] > 0.5;
            let Some(part) = part else {
                self.surplus += u64::from(shown);
                continue;
            };
            let sum = &mut self.parts[part as usize];
            sum.add(shown, truth.flow.pixels()[pixel], avatar.flow.pixels()[pixel]);
            let behind = avatar.depth.pixels()[pixel] - truth.depth.pixels()[pixel];
            sum.seen_through += u64::from(shown && behind > SEEN_THROUGH_METRES as f32);
        }
    }

    /// The errors over all pairs.
    pub fn result(&self) -> LabelError {
        let mut head = PartSum::default();
        self.parts.iter().for_each(|part| head.merge(part));
        let [skin, eyes, mouth, hair, neck] = &self.parts;
        LabelError {
            pairs: self.pairs,
            head: head.result(),
            skin: skin.result(),
            eyes: eyes.result(),
            mouth: mouth.result(),
            hair: hair.result(),
            neck: neck.result(),
            surplus: self.surplus,
        }
    }
}

/// Sums over the pixels of a part.
#[derive(Debug, Clone, Default)]
struct PartSum {
    shown: u64,
    missing: u64,
    seen_through: u64,
    over_1_px: u64,
    errors: f64,
    max: f32,
    true_lengths: f64,
    missing_errors: f64,
    /// Number of pixels for each value of the error's first bits, see [`bin`]; empty without pixels.
    histogram: Vec<u64>,
}

/// Bits of an error that its bin leaves out: eight bits of the fraction are left, so that bins are at most 0.4 % wide.
const DROPPED_BITS: u32 = 15;

/// Bins ascend with the error, which is not negative.
fn bin(error: f32) -> usize {
    (error.to_bits() >> DROPPED_BITS) as usize
}

/// The least error of a bin.
fn edge(bin: usize) -> f64 {
    f64::from(f32::from_bits((bin as u32) << DROPPED_BITS))
}

impl PartSum {
    fn add(&mut self, shown: bool, truth: [f32; 2], avatar: [f32; 2]) {
        let error = distance(avatar, truth);
        if !shown {
            self.missing += 1;
            self.missing_errors += f64::from(error);
            return;
        }
        if self.histogram.is_empty() {
            self.histogram.resize(1 << (u32::BITS - DROPPED_BITS), 0);
        }
        self.histogram[bin(error)] += 1;
        self.shown += 1;
        self.over_1_px += u64::from(error > 1.0);
        self.errors += f64::from(error);
        self.max = self.max.max(error);
        self.true_lengths += f64::from(distance(truth, [0.0; 2]));
    }

    fn merge(&mut self, other: &Self) {
        self.shown += other.shown;
        self.missing += other.missing;
        self.seen_through += other.seen_through;
        self.over_1_px += other.over_1_px;
        self.errors += other.errors;
        self.max = self.max.max(other.max);
        self.true_lengths += other.true_lengths;
        self.missing_errors += other.missing_errors;
        if self.histogram.len() < other.histogram.len() {
            self.histogram.resize(other.histogram.len(), 0);
        }
        for (count, more) in self.histogram.iter_mut().zip(&other.histogram) {
            *count += more;
        }
    }

    fn result(&self) -> PartError {
        let share = |sum: f64, count: u64| (count > 0).then(|| sum / count as f64);
        let statistics = |mean: f64| ErrorStatistics {
            mean,
            median: self.quantile(0.5),
            percentile_95: self.quantile(0.95),
            max: f64::from(self.max),
            over_1_px: self.over_1_px as f64 / self.shown as f64,
            true_length: self.true_lengths / self.shown as f64,
        };
        PartError {
            pixels: self.shown + self.missing,
            missing: self.missing,
            seen_through: self.seen_through,
            errors: share(self.errors, self.shown).map(statistics),
            missing_mean: share(self.missing_errors, self.missing),
        }
    }

    /// The error below which this share of the pixels is, linear between the edges of its bin.
    fn quantile(&self, share: f64) -> f64 {
        let wanted = share * self.shown as f64;
        let mut below = 0.0;
        for (number, &count) in self.histogram.iter().enumerate().filter(|(_, count)| **count > 0) {
            let count = count as f64;
            if below + count >= wanted {
                let within = ((wanted - below) / count).clamp(0.0, 1.0);
                let found = edge(number) + (edge(number + 1) - edge(number)) * within;
                return found.min(f64::from(self.max));
            }
            below += count;
        }
        0.0
    }
}

/// Two pictures by one camera, between which the flow is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct FlowPair {
    pub camera: u32,
    pub timesteps: [u32; 2],
}

/// The pairs of pictures of a split that one camera took `step` timesteps apart, by timestep and camera.
pub fn flow_pairs(capture: &Capture, split: CaptureSplit, step: u32) -> Vec<FlowPair> {
    let is_of_split = |timestep: u32, camera: u32| {
        capture.view_at(timestep, camera).is_some_and(|view| view.split == split)
    };
    let pair = |view: &CaptureView| {
        let next = view.timestep.checked_add(step)?;
        let pair = FlowPair { camera: view.camera_index, timesteps: [view.timestep, next] };
        is_of_split(next, view.camera_index).then_some(pair)
    };
    capture.of(split).filter_map(pair).collect()
}

/// An avatar, the capture that it was trained on, and the truth of the latter.
#[derive(Debug, Clone, Copy)]
pub struct TestedAvatar<'a> {
    pub avatar: &'a Avatar,
    /// Its pose at each timestep of `capture`; see [`Capture::poses_of`].
    pub poses: &'a [HeadPose],
    pub capture: &'a Capture,
    /// Of `capture`, or of the capture whose pictures it shows.
    pub truth: &'a TrueCapture,
    /// How the avatar is rendered; the outputs do not matter.
    pub options: Options,
    /// See [`CaptureView::camera_for`].
    pub faithful: bool,
}

impl TestedAvatar<'_> {
    /// Compares the flow in these pairs, one by one to `on_pair`. The true head is seen by the true cameras, the avatar by those of its
    /// capture.
    ///
    /// # Errors
    /// When the truth lacks a picture of a pair or it has another size there, or a view cannot be rendered.
    pub fn label_error(
        &self,
        pairs: &[FlowPair],
        mut on_pair: impl FnMut(&FlowPair, &FlowComparison),
    ) -> Result<LabelError, RenderError> {
        let (true_timesteps, timesteps) = (self.truth.capture.timesteps(), self.capture.timesteps());
        let mut comparison = FlowComparison::default();
        let mut sum = LabelErrorSum::default();
        for pair in pairs {
            let true_views = self.views(&self.truth.capture, pair)?;
            let views = self.views(self.capture, pair)?;
            let size = |view: &CaptureView| view.camera.size();
            if true_views.map(size) != views.map(size) {
                return Err(
                    self.no_truth(format!("the pictures of camera {} have another size there", pair.camera))
                );
            }
            let true_cameras = true_views.map(|view| view.camera);
            let cameras = views.map(|view| view.camera_for(self.faithful));
            let truth = MovingHead {
                avatar: &self.truth.avatar,
                poses: self.at(&true_timesteps, &self.truth.poses, pair)?,
                cameras: true_cameras.each_ref(),
            };
            let avatar = MovingHead {
                avatar: self.avatar,
                poses: self.at(&timesteps, self.poses, pair)?,
                cameras: cameras.each_ref(),
            };
            comparison.render(truth, avatar, &self.options).map_err(|error| {
                let [first, second] = pair.timesteps;
                RenderError::Rasterize {
                    frame: format!("camera {}, timesteps {first} and {second}", pair.camera),
                    error,
                }
            })?;
            sum.add(&comparison);
            on_pair(pair, &comparison);
        }
        Ok(sum.result())
    }

    fn no_truth(&self, reason: String) -> RenderError {
        RenderError::NoTruth { dir: self.truth.capture.dir().to_owned(), reason }
    }

    fn views<'a>(&self, capture: &'a Capture, pair: &FlowPair) -> Result<[&'a CaptureView; 2], RenderError> {
        let view = |timestep: u32| {
            capture.view_at(timestep, pair.camera).ok_or_else(|| {
                self.no_truth(format!("no picture of camera {} at timestep {timestep}", pair.camera))
            })
        };
        Ok([view(pair.timesteps[0])?, view(pair.timesteps[1])?])
    }

    fn at<'a>(
        &self,
        timesteps: &[u32],
        poses: &'a [HeadPose],
        pair: &FlowPair,
    ) -> Result<[&'a HeadPose; 2], RenderError> {
        let pose = |timestep: u32| {
            let place = timesteps.binary_search(&timestep).ok();
            place
                .and_then(|place| poses.get(place))
                .ok_or_else(|| self.no_truth(format!("no pose at timestep {timestep}")))
        };
        Ok([pose(pair.timesteps[0])?, pose(pair.timesteps[1])?])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_those_of_the_errors() {
        let mut sum = PartSum::default();
        for i in 0..1000 {
            sum.add(true, [3.0, 4.0], [3.0, 4.0 + 0.002 * i as f32]);
        }
        sum.add(false, [1.0, 0.0], [0.5, 0.0]);
        let found = sum.result();
        let errors = found.errors.unwrap();
        assert_eq!((found.pixels, found.missing, found.missing_mean), (1001, 1, Some(0.5)));
        assert!((errors.mean - 0.999).abs() < 1e-4 && (errors.true_length - 5.0).abs() < 1e-6, "{errors:?}");
        assert!(
            (errors.median - 1.0).abs() < 0.004 && (errors.percentile_95 - 1.9).abs() < 0.008,
            "{errors:?}"
        );
        assert!((errors.over_1_px - 0.499).abs() < 0.002, "{errors:?}");
        let none = PartSum::default().result();
        assert_eq!(
            none,
            PartError { pixels: 0, missing: 0, seen_through: 0, errors: None, missing_mean: None }
        );
    }
}

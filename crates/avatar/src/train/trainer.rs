//! The loop of training: one picture at a time, from the pose to the step of Adam.

use std::f64::consts::FRAC_1_SQRT_2;
use std::path::{Path, PathBuf};

use glam::DVec2;
use rayon::prelude::*;
use srflow_core::random::Key;
use srflow_core::{Image, median};
use srflow_files::{FileError, FileProblem};
use srflow_splat::{
    Camera, Frame, FrameGradients, GaussianGradients, Gaussians, Options, RasterizeError, Rasterizer,
};

use super::checkpoint::{self, Checkpoint};
use super::image_loss::{ImageLossError, ImageLossValue};
use super::mcmc::{relocate, wander};
use super::{
    ConfigError, DensityChange, DensityScene, DensityStatistics, GaussianAdam, ImageLoss, ParameterGradients,
    PoseAdam, RegularizerValue, Score, Scorer, Strategy, TrainConfig, camera_extent, change_density,
    initial_gaussians, scene_extent,
};
use crate::capture::{Capture, CaptureSplit, CaptureView, HeadRecord};
use crate::surface::{Depths, opaque_triangles};
use crate::{Avatar, AvatarError, BoundGradients, PosedHead, SEEN_THROUGH_METRES};
use srflow_head::{HeadGradient, HeadModel, HeadParameters, HeadPose, PoseParameters, TriangleFrame};

/// Why an avatar could not be trained or scored.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A file of the capture could not be read, or of the avatar written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The head model does not fit the capture.
    #[error("{}: {error}", .dir.display())]
    Avatar { dir: PathBuf, error: AvatarError },
    /// No picture to train on.
    #[error("{}: a capture with pictures for training was expected, found {found}, all held out; see transforms_train.json", .dir.display())]
    NoPictures { dir: PathBuf, found: usize },
    /// A view cannot be rendered.
    #[error("{}: {error}", .image.display())]
    Render { image: PathBuf, error: RasterizeError },
    #[error(transparent)]
    Loss(#[from] ImageLossError),
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// What one iteration did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepReport {
    /// From 1.
    pub iteration: u64,
    pub image: ImageLossValue,
    pub regularizers: RegularizerValue,
    /// If Gaussians were added and removed.
    pub change: Option<DensityChange>,
}

/// Learns the Gaussians of an avatar from the pictures of a capture, as GaussianAvatars does (Qian et al. 2024; `train.py`), and
/// corrects its poses. Pictures are read one at a time. Equal configurations and captures give equal bits, for any number of
/// threads and on any processor.
#[derive(Debug)]
pub struct Trainer {
    config: TrainConfig,
    capture: Capture,
    /// Numbers of the views for training, in the order of the epoch that `epoch` names.
    order: Vec<usize>,
    epoch: Option<u64>,
    timesteps: Vec<u32>,
    parameters: HeadParameters,
    poses: Vec<HeadPose>,
    avatar: Avatar,
    adam: GaussianAdam,
    pose_adam: PoseAdam,
    statistics: DensityStatistics,
    /// Of the views and parameters of the capture.
    fingerprint: String,
    /// Iterations done.
    iteration: u64,
    /// Of the cameras for training, metres.
    extent: f64,
    /// Metres per local unit of each triangle, of the head at rest.
    units_at_rest: Vec<f32>,
    /// Triangles that hide what is behind them, with [`TrainConfig::opaque_mesh`].
    opaque: Vec<[u32; 3]>,
    buffers: Buffers,
}

/// Memory that is reused between pictures.
#[derive(Debug, Default)]
struct Buffers {
    rasterizer: Rasterizer,
    frame: Frame,
    head: PosedHead,
    world: Gaussians,
    loss: ImageLoss,
    frame_gradients: FrameGradients,
    world_gradients: GaussianGradients,
    bound_gradients: BoundGradients,
    visible: Vec<bool>,
}

impl Trainer {
    /// A training of `model`, with the parameters of the capture, from one Gaussian per triangle.
    ///
    /// # Errors
    /// When the configuration is out of range, the capture has no pictures for training, one of its pictures is missing, its parameters
    /// cannot be read, they do not fit the model, or the first picture shows another colour than the background outside its mask, and that
    /// is to be replaced.
    pub fn new(capture: Capture, model: HeadModel, config: TrainConfig) -> Result<Self, TrainError> {
        config.check()?;
        let dir = || capture.dir().to_owned();
        let views = capture.views();
        let training: Vec<usize> =
            (0..views.len()).filter(|&number| views[number].split == CaptureSplit::Train).collect();
        if training.is_empty() {
            return Err(TrainError::NoPictures { dir: dir(), found: views.len() });
        }
        capture.check_pictures(config.apply_masks || config.random_background)?;
        if config.random_background && !config.apply_masks {
            check_background(&capture, &views[training[0]], config.background)?;
        }
        let parameters = capture.parameters()?;
        let start = initial_gaussians(model.triangles.len(), config.initial_opacity(), config.seed);
        let local = Gaussians { antialiased: config.antialiased, ..start.local().clone() };
        let triangles = start.triangles().to_vec();
        let avatar = Avatar::with_gaussians(model, parameters.clone(), local, triangles)
            .map_err(|error| TrainError::Avatar { dir: dir(), error })?;
        let (model, at_rest) = (avatar.model(), &avatar.shaped().vertices);
        let unit = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|vertex| at_rest[vertex as usize]);
            TriangleFrame::of(a, b, c).scale
        };
        let timesteps = capture.timesteps();
        let cameras = training.iter().map(|&number| {
            let pose = &parameters.poses[views[number].timestep_place(&timesteps)];
            (&views[number].camera, pose.translation.as_dvec3())
        });
        let mut buffers = Buffers::default();
        buffers.loss.ssim_weight = config.ssim_weight;
        Ok(Self {
            units_at_rest: model.triangles.iter().map(unit).collect(),
            opaque: if config.opaque_mesh { opaque_triangles(model) } else { Vec::new() },
            poses: parameters.poses.iter().map(|pose| pose.pose(model)).collect(),
            extent: if config.faithful {
                camera_extent(cameras.map(|(camera, _)| camera))
            } else {
                scene_extent(&cameras.collect::<Vec<_>>())
            },
            timesteps,
            adam: GaussianAdam::new(avatar.bound().local()),
            pose_adam: PoseAdam::new(&parameters.poses, config.pose_rates),
            statistics: DensityStatistics::new(avatar.bound().len()),
            order: training,
            epoch: None,
            fingerprint: fingerprint(views, &parameters),
            iteration: 0,
            buffers,
            config,
            capture,
            parameters,
            avatar,
        })
    }

    /// The training that [`Trainer::write_checkpoint`] wrote to `path`, to go on as if it had never stopped.
    ///
    /// # Errors
    /// As [`Trainer::new`]; also when the file cannot be read, is damaged, or belongs to another configuration or capture.
    pub fn resume(
        capture: Capture,
        model: HeadModel,
        config: TrainConfig,
        path: &Path,
    ) -> Result<Self, TrainError> {
        let mut trainer = Self::new(capture, model, config)?;
        let older = || older_fingerprint(trainer.capture.views(), &trainer.parameters);
        let mut checkpoint = Checkpoint::open(path, &trainer.config, &trainer.fingerprint, older)?;
        let mut bound = checkpoint.gaussians(trainer.units_at_rest.len())?;
        bound.local_mut().antialiased = trainer.config.antialiased;
        trainer.adam = GaussianAdam::load(bound.local(), &mut checkpoint)?;
        trainer.statistics = DensityStatistics::load(bound.len(), &mut checkpoint)?;
        trainer.pose_adam.load(&mut trainer.parameters.poses, &mut checkpoint)?;
        *trainer.avatar.bound_mut() = bound;
        let model = trainer.avatar.model();
        trainer.poses = trainer.parameters.poses.iter().map(|pose| pose.pose(model)).collect();
        trainer.iteration = checkpoint.iteration;
        Ok(trainer)
    }

    /// Writes the whole state of the training, for [`Trainer::resume`].
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_checkpoint(&self, path: &Path) -> Result<(), FileError> {
        let mut lists = checkpoint::lists_of(self.avatar.bound());
        lists.extend(self.adam.lists());
        lists.extend(self.statistics.lists());
        lists.extend(self.pose_adam.lists(&self.parameters.poses));
        checkpoint::write(path, &self.config, &self.fingerprint, self.iteration, &lists)
    }

    /// Iterations done.
    pub fn iteration(&self) -> u64 {
        self.iteration
    }

    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    /// The avatar as it is now. Its own motion is that of the capture; the corrected poses are in [`Trainer::parameters`].
    pub fn avatar(&self) -> &Avatar {
        &self.avatar
    }

    /// The parameters of the head as they are now, its poses in the order of [`Capture::timesteps`].
    pub fn parameters(&self) -> &HeadParameters {
        &self.parameters
    }

    /// Writes the avatar as it is now; see [`Avatar::write`].
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write_avatar(&self, dir: &Path, head: Option<&HeadRecord>) -> Result<(), FileError> {
        self.avatar.write(dir, &self.parameters, head)
    }

    /// Trains on one picture.
    ///
    /// # Errors
    /// When the picture cannot be read or its view not be rendered; the avatar then looks as before.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let iteration = self.iteration + 1;
        let view = self.view_of(iteration);
        let view = &self.capture.views()[view];
        let background = self.config.background_at(iteration);
        let degree = self.config.sh_degree_at(iteration);
        if degree > self.avatar.bound().local().sh_degree {
            self.adam.raise_sh_degree(self.avatar.bound_mut().local_mut(), degree);
        }

        let Self { config, avatar, buffers, .. } = self;
        let camera = view.camera_for(config.faithful);
        let size = camera.size();
        let timestep = view.timestep_place(&self.timesteps);
        let pose = &self.poses[timestep];
        let Buffers { head, world, .. } = buffers;
        let pose_gaussians = || {
            avatar.gaussians_into(pose, head, world);
            if config.opaque_mesh {
                let (surface, _) = avatar.model().surface(head.vertices());
                hide_behind(&Depths::of(surface, &self.opaque, &camera), &camera, world);
            }
        };
        let read_picture = || picture(&self.capture, view, config, background);
        let (target, ()) = rayon::join(read_picture, pose_gaussians);
        let (target, background) = target?;
        let cannot = |error| TrainError::Render { image: view.image.clone(), error };
        let Buffers { rasterizer, frame, world, loss, .. } = buffers;
        let options = Options { background, ..config.rendering() };
        let mut rendering = rasterizer.render(world, &camera, None, &options, frame).map_err(cannot)?;
        let image = loss.backward(&frame.color, &target, size, &mut buffers.frame_gradients.color)?;
        buffers.visible.clear();
        buffers.visible.extend(rendering.visible());
        rendering.backward(&buffers.frame_gradients, &mut buffers.world_gradients).map_err(cannot)?;
        let bound_gradients = &mut buffers.bound_gradients;
        let bound = avatar.bound();
        let (head, world_gradients) = (&buffers.head, &buffers.world_gradients);
        let of_head = if config.finetune_head {
            Some(avatar.backward(&self.parameters.shape, pose, head, world_gradients, bound_gradients))
        } else {
            bound.backward(head.frames(), world_gradients, bound_gradients);
            None
        };
        let regularizers = config.regularizers.backward(
            bound.local(),
            &buffers.visible,
            &mut bound_gradients.positions,
            &mut bound_gradients.scales,
        );

        let control = config.density;
        let mcmc = control.strategy == Strategy::Mcmc;
        if mcmc {
            control.mcmc.backward(
                avatar.bound().local(),
                &mut buffers.world_gradients.opacities,
                &mut buffers.bound_gradients.scales,
            );
        } else if iteration < control.until {
            self.statistics.add(control.strategy, &buffers.world_gradients, &buffers.visible, size);
        }
        if let Some(gradient) = of_head {
            self.pose_step(iteration, timestep, &gradient);
        }
        let change = if self.config.faithful {
            let change = self.change_density(iteration);
            let resets = self.reset_opacities(iteration);
            if change.is_none() && iteration < self.config.iterations {
                self.adam_step(iteration, resets);
            }
            change
        } else {
            self.adam_step(iteration, false);
            self.wander(iteration);
            let change = self.change_density(iteration);
            self.reset_opacities(iteration);
            change
        };
        self.iteration = iteration;
        Ok(StepReport { iteration, image, regularizers, change })
    }

    /// The scores of all pictures of a split, in the order of the capture, one by one to `on_view`, and their mean; `None` for a
    /// split without pictures.
    ///
    /// # Errors
    /// When a picture cannot be read or its view not be rendered.
    pub fn score(
        &mut self,
        split: CaptureSplit,
        mut on_view: impl FnMut(&CaptureView, &Score),
    ) -> Result<Option<Score>, TrainError> {
        let mut scorer = Scorer::new(self.config);
        let mut scores = Vec::new();
        for view in self.capture.of(split) {
            let pose = &self.poses[view.timestep_place(&self.timesteps)];
            let score = scorer.score(&self.avatar, pose, &self.capture, view)?;
            on_view(view, &score);
            scores.push(score);
        }
        Ok(Score::mean(&scores))
    }

    /// The picture of a view as it is trained on, and the avatar as it is now in the same view.
    ///
    /// # Errors
    /// When the picture cannot be read or its view not be rendered.
    pub fn truth_and_rendering(&self, view: &CaptureView) -> Result<[Image; 2], TrainError> {
        let mut scorer = Scorer::new(self.config);
        let pose = &self.poses[view.timestep_place(&self.timesteps)];
        scorer.draw(&self.avatar, pose, &self.capture, view)?;
        Ok(scorer.images())
    }

    /// The number of the view of an iteration: all views for training come once in each epoch, in an order of its own.
    fn view_of(&mut self, iteration: u64) -> usize {
        let count = self.order.len() as u64;
        let epoch = (iteration - 1) / count;
        if self.epoch != Some(epoch) {
            self.order.sort_unstable();
            Key::new(self.config.seed).scene(epoch as u32).stream("views").shuffle(&mut self.order);
            self.epoch = Some(epoch);
        }
        self.order[((iteration - 1) % count) as usize]
    }

    /// Moves the Gaussians against the gradients of the last picture; not their opacities if they were just reset.
    fn adam_step(&mut self, iteration: u64, just_reset: bool) {
        if just_reset {
            self.buffers.world_gradients.opacities.fill(0.0);
        }
        let Buffers { world_gradients, bound_gradients, .. } = &self.buffers;
        let gradients = ParameterGradients {
            positions: &bound_gradients.positions,
            scales: &bound_gradients.scales,
            rotations: &bound_gradients.rotations,
            opacities: &world_gradients.opacities,
            sh: &world_gradients.sh,
        };
        let rates = self.config.rates.at(iteration, self.extent);
        self.avatar.bound_mut().step(&mut self.adam, gradients, &rates);
    }

    /// Moves the pose of a timestep against its gradient at the last picture.
    fn pose_step(&mut self, iteration: u64, timestep: usize, gradient: &HeadGradient) {
        let Self { config, avatar, parameters: HeadParameters { poses, .. }, pose_adam, .. } = self;
        let model = avatar.model();
        if !config.faithful {
            pose_adam.step(model, timestep, &mut poses[timestep], gradient);
            self.poses[timestep] = poses[timestep].pose(model);
        } else if iteration < config.iterations {
            pose_adam.step_all(model, timestep, poses, gradient);
            self.poses = poses.iter().map(|pose| pose.pose(model)).collect();
        }
    }

    fn change_density(&mut self, iteration: u64) -> Option<DensityChange> {
        let TrainConfig { seed, density: control, faithful, .. } = self.config;
        if !control.is_due(iteration) {
            return None;
        }
        let key = Key::new(seed).scene(iteration as u32);
        let (bound, adam, triangles) = (self.avatar.bound_mut(), &mut self.adam, self.units_at_rest.len());
        if control.strategy == Strategy::Mcmc {
            let mut stream = key.stream("relocate");
            let change = relocate(bound, adam, &control.mcmc, control.least_opacity, triangles, &mut stream);
            self.statistics = DensityStatistics::new(bound.len());
            return Some(change);
        }
        let last: Vec<f32>;
        let units = if faithful {
            last = self.buffers.head.frames().iter().map(|frame| frame.scale).collect();
            &last
        } else {
            &self.units_at_rest
        };
        let scene = DensityScene {
            units,
            extent: self.extent as f32,
            prune_large: iteration > control.reset_interval,
            faithful,
        };
        let mut stream = key.stream("split");
        Some(change_density(bound, adam, &mut self.statistics, &control, &scene, &mut stream))
    }

    /// The random steps of MCMC.
    fn wander(&mut self, iteration: u64) {
        let TrainConfig { seed, density: control, rates, .. } = self.config;
        if control.strategy == Strategy::Mcmc {
            let share = rates.at(iteration, 1.0).positions / rates.at(0, 1.0).positions;
            let mut stream = Key::new(seed).scene(iteration as u32).stream("wander");
            let local = self.avatar.bound_mut().local_mut();
            wander(local, control.mcmc.noise * share, control.least_opacity, &mut stream);
        }
    }

    /// Lowers the opacities if they are due; returns whether.
    fn reset_opacities(&mut self, iteration: u64) -> bool {
        let due = self.config.resets_opacities(iteration);
        if due {
            let opacity = self.config.density.reset_opacity;
            self.adam.reset_opacities(self.avatar.bound_mut().local_mut(), opacity);
        }
        due
    }
}

/// Names what a training learns from, except for the pixels: cameras, splits, names of files, and the parameters of the head. A version,
/// and the hash of their values as JSON; names of fields do not matter.
fn fingerprint(views: &[CaptureView], parameters: &HeadParameters) -> String {
    let mut hasher = crc32fast::Hasher::new();
    let mut add = |json: serde_json::Result<String>| {
        hasher.update(json.expect("numbers and text").as_bytes());
        hasher.update(b"\n");
    };
    for CaptureView { split, timestep, camera_index, camera, image, mask, parameters } in views {
        let Camera { width, height, fx, fy, cx, cy, camera_from_world } = camera;
        let text = |path: &Path| path.to_string_lossy().into_owned();
        let files = (text(image), mask.as_deref().map(text), parameters.as_deref().map(text));
        let camera = (width, height, [fx, fy, cx, cy], camera_from_world.to_cols_array());
        add(serde_json::to_string(&(split.name(), timestep, camera_index, camera, files)));
    }
    let HeadParameters { shape, static_offset, poses } = parameters;
    add(serde_json::to_string(&(shape, static_offset)));
    for pose in poses {
        let PoseParameters { expr, rotation, neck, jaw, eyes, other_joints, translation, dynamic_offset } =
            pose;
        let joints = (rotation, neck, jaw, eyes, other_joints);
        add(serde_json::to_string(&(expr, joints, translation, dynamic_offset)));
    }
    format!("2:{:08x}", hasher.finalize())
}

/// The same in checkpoints that were written before [`fingerprint`] had a version.
fn older_fingerprint(views: &[CaptureView], parameters: &HeadParameters) -> String {
    let mut hasher = crc32fast::Hasher::new();
    for view in views {
        hasher.update(format!("{view:?}\n").as_bytes());
    }
    hasher.update(format!("{parameters:?}").as_bytes());
    format!("{:08x}", hasher.finalize())
}

/// Hides the Gaussians that lie wholly behind the surface.
fn hide_behind(surface: &Depths, camera: &Camera, gaussians: &mut Gaussians) {
    const DEVIATIONS: f64 = 3.0;
    let is_behind = |at: DVec2, depth: f64| surface.hides(at, depth - SEEN_THROUGH_METRES);
    let diagonal = DVec2::splat(FRAC_1_SQRT_2);
    let directions = [DVec2::X, diagonal].map(|at| [at, at.perp(), -at, -at.perp()]);
    let Gaussians { positions, scales, opacities, .. } = gaussians;
    let gaussians = positions.par_iter().zip(scales).zip(opacities).with_min_len(2048);
    gaussians.for_each(|((position, scale), opacity)| {
        let Some((pixel, depth)) = camera.project(position.as_dvec3()) else { return };
        let radius = DEVIATIONS * f64::from(scale.max_element()) * camera.fx.max(camera.fy) / depth;
        let rim =
            || directions.iter().flatten().all(|direction| is_behind(pixel + *direction * radius, depth));
        if is_behind(pixel, depth) && rim() {
            *opacity = 0.0;
        }
    });
}

/// Checks that a picture shows `background` where its mask is empty, since training replaces that colour.
fn check_background(capture: &Capture, view: &CaptureView, background: [f32; 3]) -> Result<(), FileError> {
    const APART: f64 = 0.1;
    // A picture that cannot be read stops the step that needs it.
    let (Ok(Some(mask)), Ok(image)) = (capture.mask(view), capture.image(view)) else { return Ok(()) };
    let outside: Vec<[u8; 3]> = image
        .pixels()
        .iter()
        .zip(mask.pixels())
        .filter(|(_, alpha)| **alpha == 0.0)
        .map(|(p, _)| *p)
        .collect();
    if outside.is_empty() {
        return Ok(());
    }
    let shown = [0, 1, 2].map(|c| median(outside.iter().map(|pixel| f64::from(pixel[c]) / 255.0)));
    if shown.iter().zip(background).all(|(shown, given)| (shown - f64::from(given)).abs() < APART) {
        return Ok(());
    }
    let expected = format!(
        "{background:?} outside the mask (or set apply_masks, or set background to the colour in the picture)"
    );
    let found = format!("[{:.2}, {:.2}, {:.2}]", shown[0], shown[1], shown[2]);
    Err(FileProblem::field("background", expected, found).in_file(&capture.dir().join(&view.image)))
}

/// The picture of a view before `background`, 0..1, row-major, and the colour that is behind the head in it: that of the
/// configuration if the picture has no mask.
pub(super) fn picture(
    capture: &Capture,
    view: &CaptureView,
    config: &TrainConfig,
    background: [f32; 3],
) -> Result<(Vec<[f32; 3]>, [f32; 3]), FileError> {
    let image = capture.image(view)?;
    let mut picture: Vec<[f32; 3]> =
        image.pixels().iter().map(|pixel| pixel.map(|channel| f32::from(channel) / 255.0)).collect();
    if !config.apply_masks && background == config.background {
        return Ok((picture, background));
    }
    let Some(mask) = capture.mask(view)? else {
        if !config.apply_masks {
            return Ok((picture, config.background));
        }
        let expected = "the mask of every picture, since apply_masks is set";
        let found = format!("none for {}", view.image.display());
        return Err(FileProblem::field("fg_mask_path", expected, found).in_file(capture.dir()));
    };
    // A picture whose mask is applied already shows `config.background` where the mask is below one.
    let kept = |alpha: f32| if config.apply_masks { alpha } else { 1.0 };
    let behind = if config.apply_masks { [0.0; 3] } else { config.background };
    for (pixel, &alpha) in picture.iter_mut().zip(mask.pixels()) {
        *pixel =
            std::array::from_fn(|i| kept(alpha) * pixel[i] + (1.0 - alpha) * (background[i] - behind[i]));
    }
    Ok((picture, background))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use srflow_core::Size;

    use super::*;

    #[test]
    fn gaussians_wholly_behind_the_surface_are_hidden() {
        let camera = Camera::centred(Size::new(100, 100), [100.0; 2]);
        // The left half of the picture, a metre away.
        let corners = [(-9.0, -9.0), (0.0, -9.0), (-9.0, 9.0), (0.0, 9.0)];
        let vertices = corners.map(|(x, y)| Vec3::new(x, y, 1.0));
        let surface = Depths::of(&vertices, &[[0, 1, 2], [1, 2, 3]], &camera);
        let scale = 0.01;
        let cases = [
            (Vec3::new(-0.2, 0.0, 1.1), true),
            (Vec3::new(-0.2, 0.0, 1.005), false),
            // Three deviations reach beyond the surface, and beyond the picture.
            (Vec3::new(-0.02, 0.0, 1.1), false),
            (Vec3::new(-0.54, 0.0, 1.1), false),
            (Vec3::new(0.2, 0.0, 1.1), false),
            (Vec3::new(-0.2, 0.0, -1.1), false),
        ];
        let mut gaussians = Gaussians {
            positions: cases.iter().map(|(position, _)| *position).collect(),
            scales: vec![Vec3::splat(scale); cases.len()],
            opacities: vec![0.5; cases.len()],
            ..Gaussians::default()
        };
        hide_behind(&surface, &camera, &mut gaussians);
        let expected: Vec<f32> = cases.iter().map(|(_, hidden)| if *hidden { 0.0 } else { 0.5 }).collect();
        assert_eq!(gaussians.opacities, expected);
    }

    #[test]
    fn fingerprints_have_a_version_and_change_with_the_parameters() {
        let view = CaptureView {
            split: CaptureSplit::Train,
            timestep: 1,
            camera_index: 8,
            camera: Camera::centred(Size::new(4, 6), [1.5, 2.5]),
            image: "images/a.png".into(),
            mask: None,
            parameters: Some("a.npz".into()),
        };
        let pose = PoseParameters { expr: vec![0.1], ..PoseParameters::default() };
        let parameters = HeadParameters { shape: vec![0.5], static_offset: Vec::new(), poses: vec![pose] };
        let views = [view];
        let rest = HeadParameters::default();
        assert!(fingerprint(&views, &parameters).starts_with("2:"));
        assert_ne!(fingerprint(&views, &parameters), fingerprint(&views, &rest));
        assert_ne!(older_fingerprint(&views, &parameters), older_fingerprint(&views, &rest));
    }
}

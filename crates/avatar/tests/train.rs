//! Training on a small capture of the built-in head shows it from cameras that it was not trained on.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use glam::{DMat3, DVec3, Vec3};
use srflow_avatar::capture::{Capture, CaptureSplit, CaptureView, HeadRecord, write_transforms};
use srflow_avatar::train::{
    DensityControl, Scorer, SplitScore, StepReport, Strategy, TrainConfig, TrainError, Trainer, ViewScore,
};
use srflow_avatar::{Avatar, AvatarFiles, PosedHead};
use srflow_core::{Image, Size};
use srflow_files::write_image_png;
use srflow_head::{HeadModel, HeadParameters, HeadPose, PoseParameters};
use srflow_splat::{Camera, Frame, Gaussians, Options, Outputs, Rasterizer};

const SIZE: Size = Size::new(96, 128);

/// The head is 1 m in front of each camera; they are this many degrees to its side.
const CAMERAS: [f64; 4] = [-35.0, 0.0, 35.0, 15.0];

struct Made {
    /// Removed when the tests end.
    folder: tempfile::TempDir,
    avatar: Avatar,
}

/// Two timesteps by four cameras, of which the last is held out; a third timestep is held out too.
static MADE: LazyLock<Made> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let avatar = Avatar::builtin(1).expect("an avatar");
    write_capture(folder.path(), &avatar);
    Made { folder, avatar }
});

fn camera(degrees: f64, middle: DVec3) -> Camera {
    let turn = DMat3::from_rotation_y(degrees.to_radians());
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let camera = Camera { cx: 45.0, ..Camera::centred(SIZE, [340.0, 335.0]) };
    camera.placed(turn * facing, middle + turn * DVec3::Z)
}

fn write_capture(dir: &Path, avatar: &Avatar) {
    let vertices = &avatar.shaped().vertices;
    let (low, high) = vertices
        .iter()
        .fold((Vec3::MAX, Vec3::MIN), |(low, high), &vertex| (low.min(vertex), high.max(vertex)));
    let middle = (0.5 * (low + high)).as_dvec3();
    for folder in ["images", "flame_param", "masks"] {
        std::fs::create_dir(dir.join(folder)).expect("a folder");
    }
    let outputs = Outputs { alpha: true, ..Outputs::IMAGE };
    let options = Options { background: [1.0; 3], outputs, ..Options::default() };
    let (mut rasterizer, mut frame) = (Rasterizer::new(), Frame::new());
    let (mut head, mut gaussians) = (PosedHead::default(), Gaussians::default());
    let mut views = Vec::new();
    for timestep in 0..3 {
        let mut pose = HeadPose::default();
        pose.translation.x = 0.01 * timestep as f32;
        pose.expressions = vec![0.1 * timestep as f32; avatar.model().expressions.len()];
        let parameters = HeadParameters {
            poses: vec![PoseParameters::of(avatar.model(), &pose)],
            ..avatar.identity().clone()
        };
        let file = PathBuf::from(format!("flame_param/{timestep:05}.npz"));
        parameters.write(&dir.join(&file), vertices.len(), false).expect("parameters");
        avatar.gaussians_into(&pose, &mut head, &mut gaussians);
        for (camera_index, degrees) in (0..).zip(CAMERAS) {
            let camera = camera(degrees, middle);
            rasterizer.render(&gaussians, &camera, None, &options, &mut frame).expect("a picture");
            let image = PathBuf::from(format!("images/{timestep:05}_{camera_index:02}.png"));
            write_image_png(&dir.join(&image), &frame.image).expect("a picture");
            let byte = |x: usize, y: usize| [(255.0 * frame.alpha.row(y)[x]).round() as u8; 3];
            let alpha = Image::from_fn(SIZE.width, SIZE.height, byte);
            write_image_png(&dir.join(mask_of(&image)), &alpha).expect("a mask");
            let split = match (timestep, camera_index) {
                (2, _) => CaptureSplit::Test,
                (_, 3) => CaptureSplit::Val,
                _ => CaptureSplit::Train,
            };
            let parameters = Some(file.clone());
            views.push(CaptureView { split, timestep, camera_index, camera, image, mask: None, parameters });
        }
    }
    write_transforms(dir, &views).expect("cameras");
}

/// The true alpha of a picture, which the capture does not name.
fn mask_of(image: &Path) -> PathBuf {
    Path::new("masks").join(image.file_name().expect("a name"))
}

/// Everything early, as in a training of a hundred iterations.
fn config() -> TrainConfig {
    let mut config = TrainConfig { iterations: 60, sh_interval: 20, ..TrainConfig::default() };
    config.rates.position_steps = 60;
    config.rates.sh_0 = 0.02;
    config.density =
        DensityControl { from: 10, until: 50, interval: 20, reset_interval: 1000, ..config.density };
    // Not the reset before white at `from`, which would cost the few iterations of this test.
    config.density.reset_opacity = 1.0;
    config
}

fn trainer(config: TrainConfig) -> Trainer {
    let capture = Capture::read(MADE.folder.path()).expect("a capture");
    Trainer::new(capture, MADE.avatar.model().clone(), config).expect("a trainer")
}

fn train(trainer: &mut Trainer, steps: u64) -> Vec<StepReport> {
    (0..steps).map(|_| trainer.step().expect("a step")).collect()
}

#[test]
fn held_out_cameras_and_timesteps_come_to_look_like_their_pictures() {
    let mut trainer = trainer(config());
    let score = |trainer: &mut Trainer, split, count| {
        let mut views = 0;
        let score = trainer.score(split, |_, _| views += 1).expect("scores").expect("held-out pictures");
        assert_eq!(views, count);
        score
    };
    let before = [(CaptureSplit::Val, 2), (CaptureSplit::Test, 4)]
        .map(|(split, count)| score(&mut trainer, split, count));
    let reports = train(&mut trainer, 60);
    let after = [(CaptureSplit::Val, 2), (CaptureSplit::Test, 4)]
        .map(|(split, count)| score(&mut trainer, split, count));
    for (before, after) in before.iter().zip(&after) {
        assert!(after.psnr > before.psnr + 6.0 && after.ssim > before.ssim, "{before:?}, {after:?}");
    }
    let changes: Vec<u64> =
        reports.iter().filter(|report| report.change.is_some()).map(|report| report.iteration).collect();
    assert_eq!(changes, [20, 40]);
    let bound = trainer.avatar().bound();
    let given = Capture::read(MADE.folder.path()).unwrap().parameters().unwrap().poses;
    let learned = &trainer.parameters().poses;
    assert!(learned[0] != given[0] && learned[1] != given[1], "poses are corrected");
    assert_eq!(learned[2], given[2], "where pictures are for training");
    let mut has_one = vec![false; trainer.avatar().model().triangles.len()];
    bound.triangles().iter().for_each(|&triangle| has_one[triangle as usize] = true);
    assert!(has_one.iter().all(|has_one| *has_one), "a Gaussian on every triangle");
    assert_eq!(bound.local().sh_degree, 3);

    let folder = tempfile::tempdir().unwrap();
    trainer.write_avatar(folder.path(), None).unwrap();
    let read = AvatarFiles::read(folder.path()).unwrap().on(MADE.avatar.model().clone()).unwrap();
    assert_eq!((read.bound().len(), read.own_motion()), (bound.len(), &trainer.parameters().poses[..]));

    let capture = Capture::read(MADE.folder.path()).unwrap();
    let poses = capture.poses_of(&read).unwrap();
    let mut scorer = Scorer::new(config());
    let mut scores = Vec::new();
    for view in capture.of(CaptureSplit::Test) {
        let score = scorer.score(&read, &poses[view.timestep as usize], &capture, view).unwrap();
        scores.push(ViewScore::new(view, score));
        assert_eq!(scorer.rendered().len(), SIZE.pixels());
    }
    let of_files = SplitScore::of(CaptureSplit::Test, &scores).unwrap();
    // Opacities and scales go through their logarithms in the file.
    assert!((of_files.mean.psnr - after[1].psnr).abs() < 1e-3, "{of_files:?}, {after:?}");
    assert_eq!(of_files.cameras.iter().map(|of| of.camera).collect::<Vec<_>>(), [0, 1, 2, 3]);
}

#[test]
fn an_avatar_is_scored_on_the_capture_that_it_was_trained_on_alone() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_capture(dir, &MADE.avatar);
    let capture = Capture::read(dir).unwrap();
    let bound = MADE.avatar.bound();
    let avatar_with = |model: &HeadModel, parameters: HeadParameters| {
        let (local, triangles) = (bound.local().clone(), bound.triangles().to_vec());
        Avatar::with_gaussians(model.clone(), parameters, local, triangles).unwrap()
    };
    let refusal = |avatar: &Avatar| capture.poses_of(avatar).unwrap_err().to_string();
    let model = MADE.avatar.model();
    let parameters = capture.parameters().unwrap();
    assert_eq!(capture.poses_of(&avatar_with(model, parameters.clone())).unwrap().len(), 3);

    let fewer = HeadParameters { poses: parameters.poses[..2].to_vec(), ..parameters.clone() };
    let error = refusal(&avatar_with(model, fewer));
    assert!(error.contains("it has 3 timesteps, and the motion of the avatar 2"), "{error}");
    let offset = vec![Vec3::X; model.template.len()];
    let other = HeadParameters { static_offset: offset, ..parameters.clone() };
    assert!(refusal(&avatar_with(model, other)).contains("static_offset"));

    HeadRecord::new("builtin".to_owned(), 1, model).write(dir).unwrap();
    assert!(capture.poses_of(&avatar_with(model, parameters.clone())).is_ok());
    let error = refusal(&avatar_with(&HeadModel::builtin(2), parameters));
    assert!(error.contains("it shows the head builtin of seed 1"), "{error}");
}

#[test]
fn training_has_the_same_bits_for_any_number_of_threads_and_others_for_another_seed() {
    let run = |threads: usize, seed: u64, faithful: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut config = TrainConfig { seed, faithful, ..config() };
        config.density.strategy = Strategy::AbsGs;
        config.density.from = 0;
        config.density.interval = 5;
        config.density.gradient_threshold = Some(1e-5);
        let mut trainer = trainer(config);
        let reports = pool.install(|| train(&mut trainer, 12));
        assert!(reports.iter().any(|report| report.change.is_some_and(|change| change.split > 0)));
        let bound = trainer.avatar().bound();
        (reports, bound.triangles().to_vec(), bound.local().clone())
    };
    let expected = run(1, 4, false);
    assert!(run(3, 4, false) == expected);
    assert!(run(2, 5, false).2 != expected.2);
    assert!(run(2, 4, true).2 != expected.2);
}

/// All that a training has learned.
fn learned(trainer: &Trainer) -> (Gaussians, Vec<u32>, HeadParameters) {
    let bound = trainer.avatar().bound();
    (bound.local().clone(), bound.triangles().to_vec(), trainer.parameters().clone())
}

/// A configuration of each strategy, and the reference's way, whose Gaussians change every ten iterations.
fn busy_configs() -> Vec<TrainConfig> {
    let strategies = [Strategy::Default, Strategy::AbsGs, Strategy::Mcmc, Strategy::Default];
    let mut configs: Vec<TrainConfig> = Vec::new();
    for (number, strategy) in strategies.into_iter().enumerate() {
        let mut config = TrainConfig { faithful: number == 3, ..config() };
        config.density = DensityControl { strategy, from: 0, interval: 10, ..config.density };
        config.density.gradient_threshold = Some(1e-5);
        config.density.reset_interval = 12;
        config.density.reset_opacity = 0.3;
        config.antialiased = number == 1;
        configs.push(config);
    }
    configs
}

#[test]
fn a_resumed_training_goes_on_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.npz");
    for config in busy_configs() {
        let mut whole = trainer(config);
        train(&mut whole, 17);
        whole.write_checkpoint(&path).unwrap();
        let reports = train(&mut whole, 14);
        assert!(reports.iter().any(|report| report.change.is_some_and(|change| change.cloned > 0)));

        let capture = Capture::read(MADE.folder.path()).unwrap();
        let mut resumed = Trainer::resume(capture, MADE.avatar.model().clone(), config, &path).unwrap();
        assert_eq!(resumed.iteration(), 17);
        assert_eq!(train(&mut resumed, 14), reports, "{:?}", config.density.strategy);
        assert!(learned(&resumed) == learned(&whole));
    }
}

#[test]
fn checkpoints_of_other_trainings_and_broken_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.npz");
    let resume = |dir: &Path, config: TrainConfig| {
        let capture = Capture::read(dir).unwrap();
        Trainer::resume(capture, MADE.avatar.model().clone(), config, &path)
            .map(|trainer| trainer.iteration())
    };
    let mut begun = trainer(config());
    train(&mut begun, 2);
    begun.write_checkpoint(&path).unwrap();
    assert_eq!(resume(MADE.folder.path(), config()).unwrap(), 2);

    let other = resume(MADE.folder.path(), TrainConfig { seed: 9, ..config() }).unwrap_err().to_string();
    assert!(other.contains("seed is 0") && other.contains("found 9"), "{other}");
    // The same capture with a camera moved.
    let moved = tempfile::tempdir().unwrap();
    write_capture(moved.path(), &MADE.avatar);
    let mut views = Capture::read(moved.path()).unwrap().views().to_vec();
    views[0].camera.fx += 1.0;
    write_transforms(moved.path(), &views).unwrap();
    let other = resume(moved.path(), config()).unwrap_err().to_string();
    assert!(other.contains("fingerprint"), "{other}");

    let bytes = std::fs::read(&path).unwrap();
    for len in [0, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..len]).unwrap();
        assert!(resume(MADE.folder.path(), config()).is_err(), "{len} of {} bytes", bytes.len());
    }
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 0x10;
    std::fs::write(&path, flipped).unwrap();
    assert!(resume(MADE.folder.path(), config()).is_err());
    std::fs::remove_file(&path).unwrap();
    let missing = resume(MADE.folder.path(), config()).unwrap_err().to_string();
    assert!(missing.contains("checkpoint.npz"), "{missing}");
}

#[test]
fn markov_chains_grow_to_their_limit_and_learn_as_well() {
    let mut config = config();
    let triangles = MADE.avatar.model().triangles.len();
    config.density =
        DensityControl { strategy: Strategy::Mcmc, from: 0, interval: 5, until: 100, ..config.density };
    config.density.mcmc.most_gaussians = triangles + triangles / 10;
    let mut trainer = trainer(config);
    let before = trainer.score(CaptureSplit::Val, |_, _| ()).unwrap().unwrap();
    train(&mut trainer, 60);
    let after = trainer.score(CaptureSplit::Val, |_, _| ()).unwrap().unwrap();
    assert!(after.psnr > before.psnr + 6.0, "{before:?}, {after:?}");
    assert_eq!(trainer.avatar().bound().len(), config.density.mcmc.most_gaussians);
}

#[test]
fn what_is_behind_the_head_can_be_covered_by_the_masks() {
    let folder = tempfile::tempdir().unwrap();
    write_capture(folder.path(), &MADE.avatar);
    let score = |apply_masks: bool| {
        let capture = Capture::read(folder.path()).unwrap();
        let config = TrainConfig { apply_masks, background: [0.0; 3], ..config() };
        let mut trainer = Trainer::new(capture, MADE.avatar.model().clone(), config).unwrap();
        trainer.score(CaptureSplit::Val, |_, _| ())
    };
    let without = score(true).unwrap_err().to_string();
    assert!(without.contains("apply_masks"), "{without}");
    // Masks of nothing: the pictures become the background, as that of the trainer where no Gaussian is.
    let mut views = Capture::read(folder.path()).unwrap().views().to_vec();
    write_image_png(&folder.path().join("empty.png"), &Image::new(SIZE.width, SIZE.height)).unwrap();
    views.iter_mut().for_each(|view| view.mask = Some("empty.png".into()));
    write_transforms(folder.path(), &views).unwrap();
    let (with, without) = (score(true).unwrap().unwrap(), score(false).unwrap().unwrap());
    assert!(with.psnr > without.psnr + 1.0, "{with:?}, {without:?}");
    // The pictures are white where the masks are empty.
    let config = TrainConfig { random_background: true, background: [0.0; 3], ..config() };
    let capture = Capture::read(folder.path()).unwrap();
    let refused = Trainer::new(capture, MADE.avatar.model().clone(), config).unwrap_err().to_string();
    assert!(refused.contains("set apply_masks"), "{refused}");
}

#[test]
fn the_colour_behind_a_masked_head_can_change_in_each_iteration() {
    let folder = tempfile::tempdir().unwrap();
    write_capture(folder.path(), &MADE.avatar);
    let trained = |random_background: bool| {
        let capture = Capture::read(folder.path()).unwrap();
        let config = TrainConfig { random_background, ..config() };
        let mut trainer = Trainer::new(capture, MADE.avatar.model().clone(), config).unwrap();
        let losses: Vec<f64> = train(&mut trainer, 60).iter().map(|step| step.image.l1).collect();
        (trainer.score(CaptureSplit::Val, |_, _| ()).unwrap().unwrap(), losses)
    };
    let (white, before_white) = trained(false);
    assert_eq!(trained(true), (white, before_white.clone()), "without masks, pictures stay as they are");

    let mut views = Capture::read(folder.path()).unwrap().views().to_vec();
    views.iter_mut().for_each(|view| view.mask = Some(mask_of(&view.image)));
    write_transforms(folder.path(), &views).unwrap();
    let (random, before_random) = trained(true);
    assert_ne!(before_random, before_white);
    // Picture and rendering show the same colour beside the head: what differs is on it, which is a part of the picture.
    let covered = |view: &CaptureView| {
        let mask = Capture::read(folder.path()).unwrap().mask(view).unwrap().unwrap();
        f64::from(mask.pixels().iter().sum::<f32>()) / mask.pixels().len() as f64
    };
    let most = views.iter().map(covered).fold(0.0, f64::max);
    assert!(most < 0.8 && before_random[0] < 0.5 * most, "{} on {most}", before_random[0]);
    assert!(random.psnr > white.psnr - 1.0, "{random:?}, {white:?}");
}

#[test]
fn captures_without_pictures_for_training_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_capture(folder.path(), &MADE.avatar);
    let capture = Capture::read(folder.path()).unwrap();
    let trained = |capture| Trainer::new(capture, MADE.avatar.model().clone(), config());
    std::fs::remove_file(folder.path().join("images/00002_01.png")).unwrap();
    let error = trained(capture.clone()).unwrap_err().to_string();
    assert!(error.contains("1 missing, such as images/00002_01.png"), "{error}");
    let held_out: Vec<CaptureView> = capture
        .views()
        .iter()
        .map(|view| CaptureView { split: CaptureSplit::Test, ..view.clone() })
        .collect();
    write_transforms(folder.path(), &held_out).unwrap();
    let capture = Capture::read(folder.path()).unwrap();
    let error = trained(capture).unwrap_err();
    assert!(matches!(error, TrainError::NoPictures { found: 12, .. }), "{error}");
}

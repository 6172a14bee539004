//! Gradients of a batch on any number of devices and parts, and whole runs.

use std::path::Path;

use burn::tensor::Device;
use srflow_core::random::Key;
use srflow_core::{FlowField, Mask};
use srflow_data::flow::Sample;
use srflow_files::{RunMode, write_flow, write_image_png};
use srflow_nets::Architecture;
use srflow_ops::Precision;
use srflow_train::batch::Batch;
use srflow_train::config::{Config, Starts};
use srflow_train::loss::{LossConfig, SEQUENCE_LOSSES};
use srflow_train::replica::Replicas;
use srflow_train::training_log::Record;
use srflow_train::training_set::{TrainingSample, TrainingSet};
use srflow_train::{BatchLosses, Event, Pass, PassSettings, TrainError, only_files, train};

use crate::pairs::{frame, make_pairs};

/// Pairs with different motions and with head masks; the flow of the last pair is unknown at some pixels.
fn batch(count: usize) -> Batch {
    const SIZE: usize = 64;
    let samples: Vec<TrainingSample> = (0..count)
        .map(|i| {
            let shift = 0.5 + i as f32;
            let known = |x: usize| i + 1 < count || !x.is_multiple_of(3);
            let flow = |x, _| if known(x) { [shift, 0.25] } else { [f32::NAN; 2] };
            let sample = Sample {
                frame1: frame(SIZE, i, 0.0),
                frame2: frame(SIZE, i, shift),
                flow: Some(FlowField::from_fn(SIZE, SIZE, flow)),
                mask: Some(Mask::from_fn(SIZE, SIZE, |x, y| x > 8 + i && y < 50)),
                occlusion: None,
            };
            TrainingSample { name: format!("pair {i}"), key: Key::new(1).frame(i as u32), sample }
        })
        .collect();
    Batch::new(&samples)
}

fn pass(
    architecture: Architecture,
    devices: usize,
    accumulate: usize,
    recompute: bool,
    batch: &Batch,
) -> (Pass, Vec<f32>) {
    pass_of_clips(architecture, devices, accumulate, recompute, std::slice::from_ref(batch))
}

fn pass_from(starts: Starts, recompute: bool, batch: &Batch) -> Pass {
    let settings = PassSettings {
        loss: LossConfig::default(),
        iterations: 2,
        starts,
        accumulate: 1,
        recompute,
        precision: Precision::F32,
    };
    let (replicas, _) =
        Replicas::new(|device| Architecture::RaftSmall.init(device), &[Device::flex()], 3, false, settings);
    replicas.pass(std::slice::from_ref(batch)).expect("a loss")
}

fn pass_at(precision: Precision, architecture: Architecture, batch: &Batch) -> Pass {
    let loss = LossConfig::default();
    let settings =
        PassSettings { loss, iterations: 3, starts: Starts::Own, accumulate: 1, recompute: false, precision };
    let (replicas, _) =
        Replicas::new(|device| architecture.init(device), &[Device::flex()], 3, false, settings);
    replicas.pass(std::slice::from_ref(batch)).expect("a loss")
}

fn pass_of_clips(
    architecture: Architecture,
    devices: usize,
    accumulate: usize,
    recompute: bool,
    pairs: &[Batch],
) -> (Pass, Vec<f32>) {
    let has_mixture = architecture.facts().mixture;
    let sequence = SEQUENCE_LOSSES.iter().find(|loss| loss.needs_mixture() == has_mixture);
    let sequence = sequence.expect("losses of both kinds");
    let loss = LossConfig { sequence, tvr: 0.05, fdr: 0.05, igvar: 0.1, ..LossConfig::default() };
    let settings = PassSettings {
        loss,
        iterations: 3,
        starts: Starts::Own,
        accumulate,
        recompute,
        precision: Precision::F32,
    };
    let devices = vec![Device::flex(); devices];
    let (replicas, mut values) =
        Replicas::new(|device| architecture.init(device), &devices, 3, false, settings);
    let pass = replicas.pass(pairs).expect("a loss");
    replicas.collect_statistics(&mut values);
    (pass, values)
}

fn assert_same(one: &Pass, other: &Pass, tolerance: f64) {
    assert_eq!(one.gradients.reached, other.gradients.reached);
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let pairs = || one.gradients.values.iter().zip(&other.gradients.values);
    let size = norm(&mut pairs().map(|(one, _)| f64::from(*one)));
    let apart = norm(&mut pairs().map(|(one, other)| f64::from(one - other)));
    assert!(size > 1e-3, "gradients of norm {size} check nothing");
    assert!(apart < tolerance * size, "{apart} apart, norm {size}");
    assert!((one.losses.total - other.losses.total).abs() < 1e-5 * one.losses.total.abs());
    let names = |pass: &Pass| pass.losses.parts.iter().map(|part| part.0).collect::<Vec<_>>();
    assert_eq!(names(one), names(other));
}

#[test]
fn gradients_do_not_depend_on_the_number_of_devices() {
    let batch = batch(3);
    let (one, _) = pass(Architecture::RaftSmall, 1, 1, false, &batch);
    assert_same(&one, &pass(Architecture::RaftSmall, 2, 1, false, &batch).0, 1e-4);
    // More devices than pairs.
    assert_same(&one, &pass(Architecture::RaftSmall, 4, 1, false, &batch).0, 1e-4);
}

/// Forward and backward: a descent goes nearly the same way.
#[test]
fn products_of_bfloat16_turn_the_gradient_a_little() {
    let batch = batch(2);
    for architecture in [Architecture::RaftSmall, Architecture::SkFlow] {
        let [exact, near] =
            [Precision::F32, Precision::Bf16].map(|precision| pass_at(precision, architecture, &batch));
        let product = |a: &Pass, b: &Pass| -> f64 {
            let pairs = a.gradients.values.iter().zip(&b.gradients.values);
            pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let cosine = product(&exact, &near) / (product(&exact, &exact) * product(&near, &near)).sqrt();
        assert!(cosine > 0.98 && cosine < 1.0 - 1e-9, "{}: cosine {cosine}", architecture.name());
        let apart = (exact.losses.total - near.losses.total).abs() / exact.losses.total;
        assert!(apart < 0.02, "{}: losses {apart} apart", architecture.name());
    }
}

/// The attention of GMA and SKFlow is initialized without effect (`gamma` is 0): all its other gradients are zero.
#[test]
fn recomputed_iterations_give_the_same_gradients() {
    let batch = batch(1);
    use Architecture::{Raft, RaftSmall, SeaRaftS, SkFlow};
    for architecture in [RaftSmall, Raft, SkFlow, SeaRaftS] {
        let (kept, _) = pass(architecture, 1, 1, false, &batch);
        let (recomputed, _) = pass(architecture, 1, 1, true, &batch);
        assert_same(&kept, &recomputed, 1e-3);
        assert!((kept.losses.epe - recomputed.losses.epe).abs() < 1e-3);
    }
}

/// Memory does not matter here: the attention of MemFlow is initialized without effect. `crates/nets/tests/nets/parity.rs` compares
/// gradients through memory with the reference.
/// The step decides what a batch starts from.
#[test]
fn recomputed_iterations_start_from_the_same_flow() {
    let mut others = 0;
    for step in 0..6 {
        let mut batch = batch(1);
        batch.keys = vec![Key::new(1).scene(step)];
        let [kept, recomputed] = [false, true].map(|recompute| pass_from(Starts::Varied, recompute, &batch));
        assert_same(&kept, &recomputed, 1e-3);
        let own = pass_from(Starts::Own, false, &batch);
        others += usize::from((own.losses.total - kept.losses.total).abs() > 1e-3);
    }
    assert!(others > 0, "steps with a start of their own");
}

#[test]
fn the_loss_of_clips_is_the_mean_of_their_pairs() {
    let mut second = batch(2);
    second.flow.iter_mut().for_each(|flow| *flow += 1.5);
    let pairs = [batch(2), second];
    for architecture in [Architecture::RaftSmall, Architecture::MemFlow] {
        let [first, second] = pairs.each_ref().map(|pairs| pass(architecture, 1, 1, false, pairs).0);
        let mut mean = Pass { losses: BatchLosses::default(), ..first.clone() };
        for (mean, second) in mean.gradients.values.iter_mut().zip(&second.gradients.values) {
            *mean = 0.5 * (*mean + second);
        }
        for pass in [&first, &second] {
            mean.losses.add(&pass.losses, 0.5);
        }
        for [devices, accumulate] in [[1, 1], [2, 1], [1, 2]] {
            let (clips, _) = pass_of_clips(architecture, devices, accumulate, false, &pairs);
            assert_same(&mean, &clips, 1e-3);
            // In parts, the end-point error weights samples equally, not their known pixels.
            assert!(devices * accumulate > 1 || (mean.losses.epe - clips.losses.epe).abs() < 1e-3);
        }
    }
}

/// Two videos in the structure of Sintel, of five frames and of two.
#[test]
fn clips_consist_of_consecutive_frames_with_one_augmentation() {
    let dir = tempfile::tempdir().unwrap();
    for (scene, frames) in [("alley_1", 5), ("bamboo_1", 2)] {
        let folder = |kind: &str| dir.path().join("training").join(kind).join(scene);
        for number in 1..=frames {
            for kind in ["clean", "final", "flow"] {
                std::fs::create_dir_all(folder(kind)).unwrap();
            }
            for kind in ["clean", "final"] {
                let path = folder(kind).join(format!("frame_{number:04}.png"));
                write_image_png(&path, &frame(160, 0, number as f32)).unwrap();
            }
            if number < frames {
                let path = folder("flow").join(format!("frame_{number:04}.flo"));
                write_flow(&path, &FlowField::filled(160, 160, [1.0, 0.0])).unwrap();
            }
        }
    }
    let text = |clip_frames: usize, kind: &str, architecture: &str| {
        format!(
            "[network]\narchitecture = \"{architecture}\"\n[data]\ntrain = \"{kind}:{}\"\ncrop = \"128x128\"\n\
             [augmentation]\ncolor = 0.0\neraser_probability = 0.0\n\
             [training]\nsteps = 1\nbatch = 2\niterations = 1\nclip_frames = {clip_frames}\n",
            dir.path().display()
        )
    };
    let config =
        |clip_frames: usize| Config::parse(&text(clip_frames, "sintel-clean", "memflow"), "test").unwrap();
    let set = TrainingSet::open(&config(3), &only_files).unwrap();
    assert_eq!(set.samples(), 3, "frames 1 to 3, 2 to 4 and 3 to 5 of the first scene");
    assert_eq!(TrainingSet::open(&config(2), &only_files).unwrap().samples(), 5);
    for step in 0..3 {
        let clip = set.sample(step, 0, 1).unwrap();
        let [first, second] = clip.as_slice() else { panic!("two pairs: {}", clip.len()) };
        assert!(first.name < second.name);
        assert!(first.sample.frame2 == second.sample.frame1, "one augmentation for the clip");
    }
    let Err(error) = TrainingSet::open(&config(6), &only_files) else { panic!("no clip of six frames") };
    assert!(error.to_string().contains("no 6 consecutive frames"), "{error}");
    let error = Config::parse(&text(3, "sintel-clean", "skflow"), "test").unwrap().check().unwrap_err();
    assert!(error.to_string().contains("training.clip_frames"), "{error}");

    let run = dir.path().join("run");
    let outcome = train(&config(3), &only_files, &[Device::flex()], &run, RunMode::New, &mut |_| {}).unwrap();
    assert_eq!((outcome.progress.step, outcome.progress.skipped), (1, 0));
}

#[test]
fn accumulated_gradients_match_those_of_the_whole_batch() {
    let batch = batch(3);
    let (one, _) = pass(Architecture::RaftSmall, 1, 1, false, &batch);
    assert_same(&one, &pass(Architecture::RaftSmall, 1, 2, false, &batch).0, 1e-4);
}

#[test]
fn a_batch_is_split_into_parts_of_nearly_equal_size() {
    let batch = batch(5);
    let parts = batch.split(3);
    assert_eq!(parts.iter().map(Batch::len).collect::<Vec<_>>(), [1, 2, 2]);
    let joined: Vec<f32> = parts.iter().flat_map(|part| part.flow.clone()).collect();
    assert_eq!(joined, batch.flow);
    assert_eq!(batch.split(9).len(), 5);
}

fn small_run(dir: &Path) -> Config {
    let text = format!(
        "[network]\narchitecture = \"raft-small\"\n[data]\ntrain = \"folder:{}\"\ncrop = \"64x64\"\n\
         [augmentation]\nkind = \"none\"\n[training]\nsteps = 4\nbatch = 2\niterations = 2\nlearning_rate = 4e-4\n\
         bad_steps = 2\n[checkpoints]\nevery = 2\n",
        dir.display()
    );
    Config::parse(&text, "test").expect("a configuration")
}

#[test]
fn a_run_from_weights_is_scored_before_its_first_step() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 3);
    let devices = [Device::flex()];
    let mut config = small_run(dir.path());
    let scored = |config: &Config, run: &str| {
        let mut steps = Vec::new();
        let mut seen = |event: Event<'_>| {
            if let Event::Recorded(Record::Validation(scores)) = event {
                steps.push(scores.step);
            }
        };
        train(config, &only_files, &devices, &dir.path().join(run), RunMode::New, &mut seen)
            .expect("a short run");
        steps
    };
    config.validation.data = config.data.train.clone();
    config.validation.every = 4;
    assert_eq!(scored(&config, "random"), [4]);
    config.network.weights = dir.path().join("random/last.safetensors");
    assert_eq!(scored(&config, "continued"), [0, 4]);
    assert!(dir.path().join("continued/best.safetensors").is_file());
}

/// Replaces the last weight in a file of weights by infinity. Returns the file's bytes.
fn break_weights(path: &Path) -> Vec<u8> {
    let mut bytes = std::fs::read(path).unwrap();
    let at = bytes.len() - 4;
    bytes[at..].copy_from_slice(&f32::INFINITY.to_le_bytes());
    std::fs::write(path, &bytes).unwrap();
    bytes
}

/// With an infinite weight every step is skipped. The error names the pairs and the last checkpoint, which stays.
#[test]
fn non_finite_losses_end_the_run() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 3);
    let run = dir.path().join("run");
    let mut config = small_run(dir.path());
    let devices = [Device::flex()];
    train(&config, &only_files, &devices, &run, RunMode::New, &mut |_| {}).expect("a short run");

    let [good, last] = ["step-00000002", "step-00000004"].map(|step| run.join("checkpoints").join(step));
    std::fs::remove_dir_all(&last).unwrap();
    let model = good.join("model.safetensors");
    let bytes = break_weights(&model);
    // The hashes would name the change first.
    std::fs::remove_file(good.join("SHA256SUMS")).unwrap();
    let result = train(&config, &only_files, &devices, &run, RunMode::Resume, &mut |_| {});
    let Err(TrainError::NotFinite { step: 4, in_a_row: 2, last_checkpoint, .. }) = &result else {
        panic!("{result:?}")
    };
    assert_eq!(last_checkpoint, &format!("The last good checkpoint is {}", good.display()));
    assert_eq!(std::fs::read(&model).unwrap(), bytes);
    assert!(!last.exists(), "no checkpoint of a skipped step");

    config.network.weights = run.join("last.safetensors");
    break_weights(&config.network.weights);
    let mut skipped = Vec::new();
    let other = dir.path().join("other");
    let result = train(&config, &only_files, &devices, &other, RunMode::New, &mut |event| {
        if let Event::Recorded(Record::Skipped(record)) = event {
            skipped.push(record.clone());
        }
    });
    let Err(error @ TrainError::NotFinite { step: 2, in_a_row: 2, .. }) = result else {
        panic!("{result:?}")
    };
    assert_eq!(skipped.len(), 2);
    assert_eq!(skipped[1].samples.len(), 2);
    for sample in &skipped[1].samples {
        assert!(error.to_string().contains(sample), "{sample} in {error}");
    }
    assert!(error.to_string().contains("no checkpoint yet"), "{error}");
}

#[test]
fn a_run_gives_the_same_weights_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 3);
    for architecture in [Architecture::RaftSmall, Architecture::SkFlow] {
        let mut config = small_run(dir.path());
        config.network.architecture = architecture;
        config.training.steps = 2;
        config.loss = LossConfig { tvr: 0.05, fdr: 0.05, igvar: 0.1, ..LossConfig::default() };
        let weights = |threads: usize| {
            let run = dir.path().join(format!("{architecture:?}-{threads}"));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let train = || train(&config, &only_files, &[Device::flex()], &run, RunMode::New, &mut |_| {});
            pool.install(train).expect("a short run");
            std::fs::read(run.join("last.safetensors")).expect("weights")
        };
        assert!(weights(1) == weights(3), "{architecture:?}");
    }
}

//! One iteration of training an avatar's Gaussians, stage by stage: 100,000 of those of the built-in head, with spherical harmonics
//! of degree 3, at 550x802.
//!
//! `cargo bench -p srflow-avatar` uses all threads; set `RAYON_NUM_THREADS` for fewer.

use std::time::Instant;

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use srflow_avatar::train::{GaussianAdam, ImageLoss, LearningRates, ParameterGradients};
use srflow_avatar::{Avatar, BoundGaussians, BoundGradients};
use srflow_core::Size;
use srflow_head::{HeadPose, TriangleFrame};
use srflow_splat::{
    Camera, Frame, FrameGradients, GaussianGradients, Gaussians, Options, Outputs, Rasterizer,
};

const SIZE: Size = Size::new(550, 802);
const COUNT: usize = 100_000;
const SH_DEGREE: usize = 3;
const RUNS: usize = 30;
const STAGES: [&str; 7] = ["pose", "world", "forward", "loss", "backward", "backward of the binding", "Adam"];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let avatar = Avatar::builtin(1)?;
    let (model, shaped) = (avatar.model(), avatar.shaped());
    let mut bound = selection(avatar.bound(), model.triangles.len())?;
    let camera = camera(&shaped.vertices);
    let options = Options { outputs: Outputs { color: true, ..Outputs::NONE }, ..Options::default() };
    let mut adam = GaussianAdam::new(bound.local());
    let rates = LearningRates { positions: 5e-5, ..LearningRates::default() };
    let mut loss = ImageLoss::default();
    let mut rasterizer = Rasterizer::new();
    let (mut frame, mut gaussians) = (Frame::new(), Gaussians::default());
    let (mut vertices, mut frames) = (Vec::new(), Vec::new());
    let mut gradients = FrameGradients::default();
    let (mut world, mut local) = (GaussianGradients::default(), BoundGradients::default());
    let mut target = Vec::new();

    let mut times: Vec<[f64; STAGES.len()]> = Vec::new();
    let mut losses = Vec::new();
    for run in 0..=RUNS {
        let mut clock = Instant::now();
        let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();
        let mut pose = HeadPose::default();
        pose.translation.x = 1e-4 * (run % 7) as f32;
        model.vertices(shaped, &pose, &mut vertices);
        let corners = |triangle: &[u32; 3]| triangle.map(|vertex| vertices[vertex as usize]);
        model
            .triangles
            .par_iter()
            .with_min_len(2048)
            .map(corners)
            .map(|[a, b, c]| TriangleFrame::of(a, b, c))
            .collect_into_vec(&mut frames);
        let posed = lap();
        bound.world_into(&frames, &mut gaussians);
        let placed = lap();
        let mut rendering = rasterizer.render(&gaussians, &camera, None, &options, &mut frame)?;
        let rendered = lap();
        if run == 0 {
            // What is learned: another head's colours.
            target = frame.color.iter().map(|color| color.map(|channel| 0.8 * channel * channel)).collect();
        }
        let value = loss.backward(&frame.color, &target, SIZE, &mut gradients.color)?;
        let compared = lap();
        rendering.backward(&gradients, &mut world)?;
        let differentiated = lap();
        bound.backward(&frames, &world, &mut local);
        let unbound = lap();
        let slopes = ParameterGradients {
            positions: &local.positions,
            scales: &local.scales,
            rotations: &local.rotations,
            opacities: &world.opacities,
            sh: &world.sh,
        };
        bound.step(&mut adam, slopes, &rates);
        let times_of_run = [posed, placed, rendered, compared, differentiated, unbound, lap()];
        losses.push(value.total);
        if run > 0 {
            times.push(times_of_run);
        }
    }

    println!(
        "{COUNT} Gaussians of degree {SH_DEGREE}, {SIZE}, {:.1} million pairs blended, {} threads; loss {:.4} to {:.4} in {RUNS} steps",
        frame.statistics.blended as f64 * 1e-6,
        rayon::current_num_threads(),
        losses[0],
        losses[RUNS],
    );
    let statistics = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        format!("median {:6.1} ms, least {:6.1} ms", 1e3 * values[RUNS / 2], 1e3 * values[0])
    };
    for (i, stage) in STAGES.iter().enumerate() {
        println!("{stage:>24}: {}", statistics(times.iter().map(|run| run[i]).collect()));
    }
    println!("{:>24}: {}", "all", statistics(times.iter().map(|run| run.iter().sum()).collect()));
    Ok(())
}

/// Evenly spread Gaussians of an avatar, with spherical harmonics of a higher degree.
fn selection(
    bound: &BoundGaussians,
    triangles: usize,
) -> Result<BoundGaussians, srflow_avatar::BindingError> {
    let (all, len) = (bound.local(), bound.len());
    let numbers: Vec<usize> = (0..COUNT).map(|i| i * len / COUNT).collect();
    let mut local = Gaussians {
        positions: numbers.iter().map(|&i| all.positions[i]).collect(),
        scales: numbers.iter().map(|&i| all.scales[i]).collect(),
        rotations: numbers.iter().map(|&i| all.rotations[i]).collect(),
        opacities: numbers.iter().map(|&i| all.opacities[i]).collect(),
        sh_degree: SH_DEGREE,
        sh: Vec::new(),
        antialiased: false,
    };
    local.sh = vec![[0.0; 3]; COUNT * local.sh_len()];
    for (i, &number) in numbers.iter().enumerate() {
        let first = i * local.sh_len();
        local.sh[first] = all.sh[number * all.sh_len()];
        local.sh[first + 1] = [0.02, -0.01, 0.03];
    }
    BoundGaussians::new(local, numbers.iter().map(|&i| bound.triangles()[i]).collect(), triangles)
}

/// One metre in front of the head, which fills most of the picture's height.
fn camera(vertices: &[Vec3]) -> Camera {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &vertex in vertices {
        (low, high) = (low.min(vertex), high.max(vertex));
    }
    let center = (0.5 * (low + high)).as_dvec3();
    let focal = 0.95 * SIZE.height as f64 / f64::from(high.y - low.y);
    let facing = DMat3::from_cols(DVec3::X, -DVec3::Y, -DVec3::Z);
    Camera::centred(SIZE, [focal; 2]).placed(facing, center + DVec3::Z)
}

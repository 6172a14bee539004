//! Times the rasterizer on the built-in head at 2200x3208: colour, flow, alpha, depth and next depth of a frame pair.
//!
//! `cargo run --release -p srflow-render --example time_rasterizer` uses all threads; set `RAYON_NUM_THREADS` for fewer.

use std::time::Instant;

use glam::{DMat4, DVec4, Quat, Vec3};
use srflow_avatar::{Avatar, HeadPose, PosedHead};
use srflow_splat::{Camera, Frame, Gaussians, Next, Options, Outputs, Rasterizer};

const RUNS: usize = 15;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let avatar = Avatar::builtin(1)?;
    let mut posed = PosedHead::default();
    let (mut first, mut second) = (Gaussians::default(), Gaussians::default());
    avatar.gaussians_into(&HeadPose::default(), &mut posed, &mut first);
    let mut turned = HeadPose { translation: Vec3::new(0.003, 0.002, 0.0), ..HeadPose::default() };
    *turned.joint_mut(0) = Quat::from_rotation_y(0.03);
    avatar.gaussians_into(&turned, &mut posed, &mut second);

    // One metre in front of the centre of the head, facing it.
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &vertex in &avatar.shaped().vertices {
        (low, high) = (low.min(vertex), high.max(vertex));
    }
    let center = (0.5 * (low + high)).as_dvec3();
    let camera = Camera {
        width: 2200,
        height: 3208,
        fx: 7600.0,
        fy: 7600.0,
        cx: 1099.5,
        cy: 1603.5,
        camera_from_world: DMat4::from_cols(
            DVec4::X,
            -DVec4::Y,
            -DVec4::Z,
            DVec4::new(-center.x, center.y, center.z + 1.0, 1.0),
        ),
    };

    let options = Options { outputs: Outputs { color: false, ..Outputs::ALL }, ..Options::default() };
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::new();
    let mut times = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        let next = Next { gaussians: &second, camera: &camera };
        rasterizer.render(&first, &camera, Some(next), &options, &mut frame)?;
        times.push(start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    let covered = frame.mask().pixels().iter().filter(|covered| **covered).count();
    let blended = frame.statistics.blended as f64;
    println!(
        "{} Gaussians, {} visible, {:.1} million pairs blended, mask {:.0} % of the image, {} threads",
        first.len(),
        frame.statistics.visible,
        blended * 1e-6,
        100.0 * covered as f64 / (camera.width * camera.height) as f64,
        rayon::current_num_threads(),
    );
    println!(
        "best {:.1} ms, median {:.1} ms, {:.3} ns per blended pair (best)",
        times[0] * 1e3,
        times[RUNS / 2] * 1e3,
        times[0] * 1e9 / blended,
    );
    Ok(())
}

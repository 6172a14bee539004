//! Frame pairs of a head-like cloud: both projections, sorting, and blending of colour, flow, alpha and depth. Then the
//! gradients of the same outputs.
//!
//! `cargo bench -p srflow-splat` runs all sizes; `-- 150k` selects one, `-- gradients` the gradients. Besides criterion's
//! times, the summary prints nanoseconds per blended (Gaussian, pixel) pair.

use std::cell::Cell;
use std::time::{Duration, Instant};

use criterion::Criterion;
use glam::{DMat4, DVec3, EulerRot, Quat, Vec3};
use srflow_core::Size;
use srflow_core::random::Key;
use srflow_splat::{
    Camera, Frame, FrameGradients, GaussianGradients, Gaussians, Next, Options, Outputs, Rasterizer, Sorting,
};

const SIZES: [Size; 3] = [Size::new(512, 512), Size::new(1600, 1200), Size::new(2200, 3208)];
const COUNTS: [usize; 4] = [10_000, 100_000, 150_000, 1_000_000];
/// Colour, flow, alpha and depth, as in the dataset.
const OUTPUTS: Outputs =
    Outputs { image: true, color: false, alpha: true, depth: true, flow: true, depth_next: true };

/// Semi-axes of the head in metres.
const HALF_AXES: Vec3 = Vec3::new(0.08, 0.115, 0.1);

fn main() {
    let mut criterion = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args();
    for count in COUNTS {
        let head = head(count);
        let next = moved(&head);
        for size in SIZES {
            let camera = camera(size);
            for threads in [1, 2] {
                let name = format!("{}k/{size}", count / 1000);
                bench_pair(&mut criterion, &name, threads, &head, &next, &camera);
            }
        }
    }
    let head = head(100_000);
    let next = moved(&head);
    for (sorting, sorted) in [(Sorting::Global, ""), (Sorting::PerPixel, ", sorted per pixel")] {
        for threads in [1, 2] {
            bench_gradients(&mut criterion, &format!("colour{sorted}"), threads, &head, None, sorting);
            let name = format!("all outputs{sorted}");
            bench_gradients(&mut criterion, &name, threads, &head, Some(&next), sorting);
        }
    }
    criterion.final_summary();
}

fn bench_pair(
    criterion: &mut Criterion,
    name: &str,
    threads: usize,
    gaussians: &Gaussians,
    next: &Gaussians,
    camera: &Camera,
) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::new();
    let options = Options { background: [1.0; 3], outputs: OUTPUTS, ..Options::default() };
    let best = Cell::new(Duration::MAX);
    criterion.bench_function(&format!("{name}, {threads} threads"), |bencher| {
        bencher.iter_custom(|iterations| {
            let mut total = Duration::ZERO;
            for _ in 0..iterations {
                let start = Instant::now();
                pool.install(|| {
                    rasterizer
                        .render(
                            gaussians,
                            camera,
                            Some(Next { gaussians: next, camera }),
                            &options,
                            &mut frame,
                        )
                        .expect("a valid scene");
                });
                let time = start.elapsed();
                best.set(best.get().min(time));
                total += time;
            }
            total
        });
    });
    if frame.statistics.blended > 0 {
        println!(
            "{name}, {threads} threads: best {:.1} ms, {:.3} ns per blended pair ({:.1} million pairs)",
            best.get().as_secs_f64() * 1e3,
            best.get().as_nanos() as f64 / frame.statistics.blended as f64,
            frame.statistics.blended as f64 * 1e-6,
        );
    }
}

/// A rendering at the size of the avatars' training pictures and its backward, in turn: of colour alone, or with a next frame
/// of everything.
fn bench_gradients(
    criterion: &mut Criterion,
    name: &str,
    threads: usize,
    gaussians: &Gaussians,
    next: Option<&Gaussians>,
    sorting: Sorting,
) {
    let size = Size::new(550, 802);
    let camera = camera(size);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::new();
    let all = Outputs { image: false, ..Outputs::ALL };
    let outputs = if next.is_some() { all } else { Outputs { color: true, ..Outputs::NONE } };
    let options = Options { outputs, sorting, ..Options::default() };
    let mut stream = Key::new(2).stream("gradients");
    let color = (0..size.pixels()).map(|_| std::array::from_fn(|_| stream.normal())).collect();
    let mut gradients = FrameGradients { color, ..FrameGradients::default() };
    if next.is_some() {
        let mut numbers = || (0..size.pixels()).map(|_| stream.normal()).collect();
        gradients.alpha = numbers();
        gradients.depth = numbers();
        gradients.depth_next = numbers();
        gradients.flow = gradients.alpha.iter().zip(&gradients.depth).map(|(u, v)| [*u, *v]).collect();
    }
    let mut out = GaussianGradients::default();
    let (mut forward, mut backward) = (Vec::new(), Vec::new());
    criterion.bench_function(&format!("gradients of {name}, {threads} threads"), |bencher| {
        bencher.iter_custom(|iterations| {
            let start = Instant::now();
            for _ in 0..iterations {
                pool.install(|| {
                    let start = Instant::now();
                    let next = next.map(|gaussians| Next { gaussians, camera: &camera });
                    let mut rendering = rasterizer
                        .render(gaussians, &camera, next, &options, &mut frame)
                        .expect("a valid scene");
                    let middle = Instant::now();
                    rendering.backward(&gradients, &mut out).expect("gradients that fit");
                    forward.push(middle - start);
                    backward.push(middle.elapsed());
                });
            }
            start.elapsed()
        });
    });
    if let (Some(forward), Some(backward)) = (forward.iter().min(), backward.iter().min()) {
        println!(
            "gradients of {name}, {threads} threads: forward {:.1} ms, backward {:.1} ms (least), ratio {:.2}; {:.1} million \
             pairs",
            forward.as_secs_f64() * 1e3,
            backward.as_secs_f64() * 1e3,
            backward.as_secs_f64() / forward.as_secs_f64(),
            frame.statistics.blended as f64 * 1e-6,
        );
    }
}

/// A camera one metre in front of the head's centre, with the head filling half of the image (or as much as fits).
fn camera(size: Size) -> Camera {
    let (w, h) = (size.width as f64, size.height as f64);
    let (a, b) = (f64::from(HALF_AXES.x), f64::from(HALF_AXES.y));
    let half = (0.5 * w * h / (std::f64::consts::PI * a * b)).sqrt();
    let focal = half.min(0.49 * h / b).min(0.49 * w / a);
    Camera { camera_from_world: DMat4::from_translation(DVec3::Z), ..Camera::centred(size, [focal; 2]) }
}

/// Flat Gaussians all over an ellipsoid, like those of an avatar on its mesh: standard deviations of 0.35 to 1.05 times the
/// distance between neighbours, opacity about 0.9.
fn head(count: usize) -> Gaussians {
    let mut stream = Key::new(1).stream("head");
    let area = 4.0 * std::f32::consts::PI * (HALF_AXES.x * HALF_AXES.y * HALF_AXES.z).powf(2.0 / 3.0);
    let spacing = (area / count as f32).sqrt();
    let mut gaussians = Gaussians::default();
    for _ in 0..count {
        let normal = Vec3::new(stream.normal(), stream.normal(), stream.normal()).normalize_or(Vec3::X);
        let surface = (normal / HALF_AXES).normalize();
        let mut scale = || spacing * stream.uniform(0.35, 1.05);
        gaussians.scales.push(Vec3::new(scale(), scale(), 0.1 * scale()));
        let twist = Quat::from_rotation_z(stream.uniform(0.0, 3.1));
        gaussians.rotations.push(Quat::from_rotation_arc(Vec3::Z, surface) * twist);
        gaussians.positions.push(normal * HALF_AXES);
        gaussians.opacities.push(stream.uniform(0.8, 1.0));
        gaussians.sh.push(std::array::from_fn(|_| stream.uniform(-1.0, 1.5)));
    }
    gaussians
}

/// The head rotated by two degrees.
fn moved(head: &Gaussians) -> Gaussians {
    let turn = Quat::from_euler(EulerRot::YXZ, 0.03, 0.015, 0.005);
    let mut next = head.clone();
    next.positions.iter_mut().for_each(|position| *position = turn * *position);
    next.rotations.iter_mut().for_each(|rotation| *rotation = turn * *rotation);
    next
}

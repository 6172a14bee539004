//! Results do not depend on the processor, the number of threads, or earlier renderings.

use glam::DVec3;
use srflow_core::Size;
use srflow_simd::{Isa, Portable};

use super::scenes::{camera, jittered, moved, random};
use crate::{Camera, Frame, Next, Options, Outputs, Rasterizer, Sorting};

fn wide() -> Camera {
    Camera { width: 333, height: 217, fx: 300.0, fy: 310.0, cx: 150.0, cy: 110.0, ..camera() }
}

fn render(rasterizer: &mut Rasterizer, seed: u64, camera: &Camera, outputs: Outputs, frame: &mut Frame) {
    render_sorted(rasterizer, Sorting::Global, seed, camera, outputs, frame);
}

fn render_sorted(
    rasterizer: &mut Rasterizer,
    sorting: Sorting,
    seed: u64,
    camera: &Camera,
    outputs: Outputs,
    frame: &mut Frame,
) {
    let gaussians = random(seed, 600, 3);
    let moved_gaussians = jittered(&gaussians, seed, 0.03);
    let second = moved(*camera, 0.03, 0.02, DVec3::new(0.1, 0.0, 0.05));
    let options = Options { background: [0.2, 0.4, 0.6], sorting, outputs, ..Options::default() };
    let next = Next { gaussians: &moved_gaussians, camera: &second };
    rasterizer.render(&gaussians, camera, Some(next), &options, frame).unwrap();
}

fn fresh(isa: Isa) -> Frame {
    fresh_sorted(isa, Sorting::Global)
}

fn fresh_sorted(isa: Isa, sorting: Sorting) -> Frame {
    let mut frame = Frame::new();
    render_sorted(&mut Rasterizer::on(isa), sorting, 1, &wide(), Outputs::ALL, &mut frame);
    frame
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    for sorting in [Sorting::Global, Sorting::PerPixel] {
        let portable = fresh_sorted(Isa::Portable(Portable), sorting);
        assert!(portable.statistics.blended > 100_000);
        for isa in Isa::to_test() {
            assert!(fresh_sorted(isa, sorting) == portable, "{isa:?} differs");
        }
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    for sorting in [Sorting::Global, Sorting::PerPixel] {
        let frames = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fresh_sorted(Isa::best(), sorting))
        });
        assert!(frames[0] == frames[1] && frames[1] == frames[2]);
    }
}

#[test]
fn earlier_renderings_leave_no_trace() {
    let expected = fresh(Isa::best());
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::new();
    render(&mut rasterizer, 2, &Camera { width: 500, height: 400, ..wide() }, Outputs::ALL, &mut frame);
    render(&mut rasterizer, 3, &camera(), Outputs::IMAGE, &mut frame);
    render_sorted(&mut rasterizer, Sorting::PerPixel, 3, &camera(), Outputs::IMAGE, &mut frame);
    assert_eq!(frame.image.size(), Size::new(83, 57));
    assert!(frame.alpha.pixels().is_empty() && frame.color.is_empty());
    render(&mut rasterizer, 1, &wide(), Outputs::ALL, &mut frame);
    assert!(frame == expected);
}

#[test]
fn an_output_does_not_depend_on_the_others() {
    let expected = fresh(Isa::best());
    let none = Outputs { image: false, ..Outputs::IMAGE };
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::new();
    render(&mut rasterizer, 1, &wide(), Outputs::IMAGE, &mut frame);
    assert!(frame.image == expected.image);
    render(&mut rasterizer, 1, &wide(), Outputs { alpha: true, depth: true, ..none }, &mut frame);
    assert!(frame.alpha == expected.alpha && frame.depth == expected.depth);
    render(&mut rasterizer, 1, &wide(), Outputs { flow: true, color: true, ..none }, &mut frame);
    assert!(frame.flow == expected.flow && frame.color == expected.color);
    assert_eq!(frame.depth_next.size(), Size::default());
}

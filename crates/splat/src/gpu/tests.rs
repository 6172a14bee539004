//! What the tests of the rasterizer do not show: long lists, and that the result is the same each time. They need the device of
//! `SRFLOW_TEST_DEVICE`.

use cubecl::client::Client;
use glam::DVec3;
use srflow_core::random::Key;

use super::GpuRasterizer;
use super::buffer::Buffer;
use super::sorting::{exclusive_sums, sort};
use crate::tests::scenes::{camera, jittered, moved, random, test_device};
use crate::{Frame, Next, Options};

fn gpu() -> Option<GpuRasterizer> {
    let gpu = test_device().and_then(|device| device.gpu.map(|gpu| GpuRasterizer::new(&gpu)));
    if gpu.is_none() {
        eprintln!("skipped: gpu: SRFLOW_TEST_DEVICE names no device");
    }
    gpu
}

fn read(client: &Client, buffer: &Buffer<u32>) -> Vec<u32> {
    let [numbers] = Buffer::read(client, [buffer]).expect("the device works");
    numbers
}

#[test]
fn sums_of_any_length_are_right_and_stop_at_the_largest_number() {
    let Some(GpuRasterizer { client, .. }) = gpu() else { return };
    let mut stream = Key::new(5).stream("numbers");
    for (len, largest) in [(1, 9), (2048, 9), (2049, 9), (300_000, 9), (5000, u32::MAX)] {
        let numbers: Vec<u32> =
            (0..len).map(|_| (f64::from(stream.unit()) * f64::from(largest)) as u32).collect();
        let mut expected = vec![0_u32];
        for number in &numbers {
            expected.push(expected[expected.len() - 1].saturating_add(*number));
        }
        let sums = Buffer::<u32>::of(&client, &numbers);
        let total = exclusive_sums(&client, &sums);
        assert_eq!(Some(read(&client, &total)[0]), expected.pop(), "{len} numbers up to {largest}");
        assert_eq!(read(&client, &sums), expected, "{len} numbers up to {largest}");
    }
}

#[test]
fn sorting_is_stable_at_any_length() {
    let Some(GpuRasterizer { client, .. }) = gpu() else { return };
    let mut stream = Key::new(6).stream("keys");
    for (len, bits) in [(1, 3), (2047, 32), (2049, 5), (300_000, 13), (70_000, 32)] {
        let keys: Vec<u32> = (0..len).map(|_| stream.bits() >> (32 - bits)).collect();
        let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
        expected.sort_by_key(|(key, _)| *key);
        let values: Vec<u32> = (0..len).collect();
        let (mut keys, mut values) = (Buffer::of(&client, &keys), Buffer::of(&client, &values));
        sort(&client, bits, &mut keys, &mut values);
        let sorted: Vec<(u32, u32)> = read(&client, &keys).into_iter().zip(read(&client, &values)).collect();
        assert_eq!(sorted, expected, "{len} keys of {bits} bits");
    }
}

#[test]
fn a_frame_is_the_same_each_time_and_in_parts_and_nearly_so_without_f64() {
    let Some(mut gpu) = gpu() else { return };
    let in_f64 = gpu.in_f64;
    let gaussians = random(3, 400, 2);
    let moved_gaussians = jittered(&gaussians, 3, 0.02);
    let second = moved(camera(), 0.05, -0.03, DVec3::new(0.05, 0.02, -0.1));
    let next = Next { gaussians: &moved_gaussians, camera: &second };
    let mut render = |in_f64, max_pairs| {
        let mut frame = Frame::new();
        (gpu.in_f64, gpu.max_pairs) = (in_f64, max_pairs);
        gpu.render(&gaussians, &camera(), Some(next), &Options::default(), &mut frame).expect("renders");
        frame
    };
    let whole = render(in_f64, usize::MAX);
    assert!(whole.statistics.blended > 10_000);
    for max_pairs in [usize::MAX, 900, 0] {
        assert_eq!(render(in_f64, max_pairs), whole, "at most {max_pairs} pairs at a time");
    }

    // As on a device without f64.
    let coarse = render(false, usize::MAX);
    assert_eq!(coarse.statistics.visible, whole.statistics.visible);
    for ((a, b), alpha) in coarse.flow.pixels().iter().zip(whole.flow.pixels()).zip(whole.alpha.pixels()) {
        let far = a.iter().zip(b).any(|(a, b)| (a - b).abs() > 0.01);
        assert!(!(*alpha > 0.5 && far), "{a:?} and {b:?}");
    }
    let colors = |frame: &Frame| frame.color.as_flattened().to_vec();
    for (a, b) in colors(&coarse).into_iter().zip(colors(&whole)) {
        assert!((a - b).abs() < 2.0 / 255.0, "{a} and {b}");
    }
}

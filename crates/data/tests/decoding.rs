//! Every reader decodes its dataset's files in the right order and on the image's grid.

use std::fs;
use std::path::Path;

use rayon::prelude::*;
use srflow_core::{FlowField, Image, Labels, Mask};
use srflow_data::flow::{DatasetSpec, FlowDataset, Sample, Split};
use srflow_files::{write_flow, write_image_png, write_labels_png, write_mask_png, write_npy};
use tempfile::TempDir;

const WIDTH: usize = 6;
const HEIGHT: usize = 4;

fn frame(number: u8) -> Image {
    Image::from_fn(WIDTH, HEIGHT, |x, y| [number, x as u8, y as u8])
}

/// A flow with distinct pixels; all values are multiples of 1/64, which 16-bit PNG stores exactly.
fn flow(number: u8) -> FlowField {
    FlowField::from_fn(WIDTH, HEIGHT, |x, y| [f32::from(number) + x as f32 / 64.0, 0.5 - y as f32 / 2.0])
}

fn put_frame(dir: &Path, file: &str, number: u8) {
    write_image_png(&made(dir, file), &frame(number)).unwrap();
}

fn put_flow(dir: &Path, file: &str, flow: &FlowField) {
    write_flow(&made(dir, file), flow).unwrap();
}

/// The path of `file`, whose folder is created.
fn made(dir: &Path, file: &str) -> std::path::PathBuf {
    let path = dir.join(file);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    path
}

fn open(kind: &str, dir: &Path) -> FlowDataset {
    FlowDataset::open(&DatasetSpec { kind: kind.to_owned(), dir: dir.to_owned() }, Some(Split::All)).unwrap()
}

fn samples(kind: &str, dir: &Path) -> Vec<Sample> {
    let dataset = open(kind, dir);
    dataset.entries().par_iter().map(|entry| dataset.read(entry).unwrap()).collect()
}

/// Fails unless the frames are `frame1` and `frame2` and the flow is `flow`, unknown pixels included.
#[track_caller]
fn assert_holds(sample: &Sample, frame1: u8, frame2: u8, flow: &FlowField) {
    assert_eq!((&sample.frame1, &sample.frame2), (&frame(frame1), &frame(frame2)));
    let bits = |flow: &FlowField| flow.pixels().iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    assert_eq!(bits(sample.flow.as_ref().unwrap()), bits(flow));
}

fn with_pixel(mut flow: FlowField, x: usize, y: usize, value: [f32; 2]) -> FlowField {
    flow.set(x, y, value);
    flow
}

const UNKNOWN: [f32; 2] = [f32::NAN; 2];

fn corner_mask() -> Mask {
    Mask::from_fn(WIDTH, HEIGHT, |x, y| x < 2 && y < 3)
}

#[test]
fn a_plain_folder_in_every_flow_format() {
    for ending in ["flo", "npy", "npz", "pfm", "flo5", "png", "png128"] {
        let dir = TempDir::new().unwrap();
        for n in 0..3 {
            put_frame(dir.path(), &format!("frames/{n}.png"), n);
        }
        let published = with_pixel(flow(5), 1, 1, UNKNOWN);
        put_flow(dir.path(), &format!("flow/0.{ending}"), &published);
        put_flow(dir.path(), &format!("flow/1.{ending}"), &flow(7));
        write_mask_png(&made(dir.path(), "mask/0.png"), &corner_mask()).unwrap();
        let found = samples("folder", dir.path());
        assert_holds(&found[0], 0, 1, &published);
        assert_holds(&found[1], 1, 2, &flow(7));
        assert_eq!((&found[0].mask, &found[1].mask), (&Some(corner_mask()), &None));
    }
}

#[test]
fn region_maps_have_the_size_of_their_frames() {
    let dir = TempDir::new().unwrap();
    (0..3).for_each(|n| put_frame(dir.path(), &format!("frames/{n}.png"), n));
    let map = Labels::from_fn(WIDTH, HEIGHT, |x, _| x as u8);
    write_labels_png(&made(dir.path(), "regions/0.png"), &map).unwrap();
    let read = || open("folder", dir.path()).entries()[0].read_regions().map_err(|error| error.to_string());
    assert_eq!(read().unwrap(), Some(map.clone()));
    assert_eq!(open("folder", dir.path()).entries()[1].read_regions().unwrap(), None);
    let path = dir.path().join("regions/0.png");
    write_labels_png(&path, &map.crop(0, 0, WIDTH, 3)).unwrap();
    let error = read().unwrap_err();
    for part in ["regions/0.png: expected 6x4 (WIDTHxHEIGHT) to go with", "frames/0.png, found 6x3"] {
        assert!(error.contains(part), "{error}");
    }
    write_labels_png(&path, &Labels::filled(WIDTH, HEIGHT, 200)).unwrap();
    let error = read().unwrap_err();
    assert!(error.contains("regions/0.png: pixel (0, 0)") && error.contains("found 200"), "{error}");
}

#[test]
fn chairs() {
    let dir = TempDir::new().unwrap();
    for n in [1, 2] {
        let mut ppm = format!("P6\n{WIDTH} {HEIGHT}\n255\n").into_bytes();
        ppm.extend(frame(n).pixels().as_flattened());
        fs::write(made(dir.path(), &format!("data/00001_img{n}.ppm")), ppm).unwrap();
    }
    put_flow(dir.path(), "data/00001_flow.flo", &with_pixel(flow(1), 2, 0, [9999.0, 10_000.0]));
    assert_holds(&samples("chairs", dir.path())[0], 1, 2, &with_pixel(flow(1), 2, 0, UNKNOWN));
}

#[test]
fn things_into_the_past() {
    let dir = TempDir::new().unwrap();
    for n in [6, 7] {
        for part in ["TRAIN/A", "TEST/B"] {
            put_frame(dir.path(), &format!("frames_finalpass/{part}/0000/right/{n:04}.png"), n);
            let file = format!("optical_flow/{part}/0000/into_past/right/OpticalFlowIntoPast_{n:04}_R.pfm");
            put_flow(dir.path(), &file, &with_pixel(flow(n), 0, 0, [-1000.0, 0.0]));
        }
    }
    let found = samples("things-final-backward-right", dir.path());
    assert_eq!(found.len(), 2);
    assert_holds(&found[0], 7, 6, &with_pixel(flow(7), 0, 0, UNKNOWN));
}

#[test]
fn sintel() {
    let dir = TempDir::new().unwrap();
    for n in [1, 2] {
        put_frame(dir.path(), &format!("training/clean/alley_1/frame_000{n}.png"), n);
    }
    put_flow(dir.path(), "training/flow/alley_1/frame_0001.flo", &flow(1));
    write_mask_png(&made(dir.path(), "training/occlusions/alley_1/frame_0001.png"), &corner_mask()).unwrap();
    let found = samples("sintel", dir.path());
    assert_holds(&found[0], 1, 2, &flow(1));
    assert_eq!(found[0].occlusion, Some(corner_mask()));
}

#[test]
fn kitti_pixels_without_truth_are_unknown_and_those_not_visible_are_occluded() {
    for (kind, images) in [("kitti-2015", "image_2"), ("kitti-2012", "colored_0")] {
        let dir = TempDir::new().unwrap();
        put_frame(dir.path(), &format!("training/{images}/000000_10.png"), 10);
        put_frame(dir.path(), &format!("training/{images}/000000_11.png"), 11);
        let all = with_pixel(with_pixel(flow(3), 4, 2, UNKNOWN), 0, 3, [-512.0, 0.0]);
        let visible = with_pixel(all.clone(), 5, 1, UNKNOWN);
        put_flow(dir.path(), "training/flow_occ/000000_10.png", &all);
        put_flow(dir.path(), "training/flow_noc/000000_10.png", &visible);
        let found = samples(kind, dir.path());
        assert_holds(&found[0], 10, 11, &with_pixel(all, 0, 3, UNKNOWN));
        let hidden = Mask::from_fn(WIDTH, HEIGHT, |x, y| (x, y) == (5, 1));
        assert_eq!(found[0].occlusion, Some(hidden));
    }
}

#[test]
fn hd1k() {
    let dir = TempDir::new().unwrap();
    for n in [10, 11] {
        put_frame(dir.path(), &format!("hd1k_input/image_2/000004_00{n}.png"), n);
    }
    put_flow(dir.path(), "hd1k_flow_gt/flow_occ/000004_0010.png", &with_pixel(flow(3), 4, 2, UNKNOWN));
    assert_holds(&samples("hd1k", dir.path())[0], 10, 11, &with_pixel(flow(3), 4, 2, UNKNOWN));
}

#[test]
fn spring_takes_the_top_left_sample_of_each_pixel() {
    let dir = TempDir::new().unwrap();
    for n in [1, 2] {
        put_frame(dir.path(), &format!("train/0001/frame_left/frame_left_000{n}.png"), n);
    }
    let fine = FlowField::from_fn(2 * WIDTH, 2 * HEIGHT, |x, y| {
        if x % 2 == 0 && y % 2 == 0 { flow(1).get(x / 2, y / 2) } else { [77.0, 77.0] }
    });
    put_flow(dir.path(), "train/0001/flow_FW_left/flow_FW_left_0001.flo5", &fine);
    assert_holds(&samples("spring", dir.path())[0], 1, 2, &flow(1));
}

#[test]
fn facialflownet_masks_are_arrays_of_zeros_and_ones() {
    let dir = TempDir::new().unwrap();
    for n in [0, 1] {
        put_frame(dir.path(), &format!("image/facial/train/sad/7/{n}.png"), n);
    }
    for split in ["val", "test"] {
        fs::create_dir_all(dir.path().join("image/facial").join(split)).unwrap();
        fs::create_dir_all(dir.path().join("flow/facial").join(split)).unwrap();
    }
    put_flow(dir.path(), "flow/facial/train/sad/7/0.flo", &with_pixel(flow(2), 3, 3, [0.0, 1000.0]));
    let values: Vec<f32> = corner_mask().pixels().iter().map(|&inside| f32::from(u8::from(inside))).collect();
    let mask = made(dir.path(), "mask/train/sad/7/0.npy");
    write_npy(&mask, &[HEIGHT, WIDTH], &values).unwrap();
    let found = samples("facialflownet", dir.path());
    assert_holds(&found[0], 0, 1, &with_pixel(flow(2), 3, 3, UNKNOWN));
    assert_eq!(found[0].mask, Some(corner_mask()));

    write_npy(&mask, &[HEIGHT * WIDTH], &values).unwrap();
    let dataset = open("facialflownet", dir.path());
    let error = dataset.read(&dataset.entries()[0]).unwrap_err().to_string();
    assert!(error.contains("0.npy") && error.contains("[24]") && error.contains("(H, W)"), "{error}");
}

#[test]
fn every_file_must_be_of_the_frames_size() {
    let small = |file: &Path| match file.extension().unwrap().to_str().unwrap() {
        "flo" => write_flow(file, &FlowField::new(WIDTH, HEIGHT - 1)).unwrap(),
        _ => write_mask_png(file, &Mask::new(WIDTH, HEIGHT - 1)).unwrap(),
    };
    for wrong in ["a_img2.png", "a_flow.flo", "a_mask.png", "a_occlusion.png"] {
        let dir = TempDir::new().unwrap();
        put_frame(dir.path(), "a_img1.png", 1);
        put_frame(dir.path(), "a_img2.png", 2);
        put_flow(dir.path(), "a_flow.flo", &flow(1));
        small(&dir.path().join(wrong));
        let dataset = open("folder", dir.path());
        let error = dataset.read(&dataset.entries()[0]).unwrap_err().to_string();
        assert!(error.contains(wrong) && error.contains("a_img1.png"), "{error}");
        assert!(error.contains("expected 6x4") && error.contains("found 6x3"), "{error}");
    }
}

#[test]
fn a_file_cut_short_is_named() {
    for wrong in ["a_img1.png", "a_img2.png", "a_flow.flo", "a_mask.png", "a_occlusion.png"] {
        let dir = TempDir::new().unwrap();
        put_frame(dir.path(), "a_img1.png", 1);
        put_frame(dir.path(), "a_img2.png", 2);
        put_flow(dir.path(), "a_flow.flo", &flow(1));
        for part in ["mask", "occlusion"] {
            write_mask_png(&dir.path().join(format!("a_{part}.png")), &corner_mask()).unwrap();
        }
        let path = dir.path().join(wrong);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let dataset = open("folder", dir.path());
        let error = dataset.read(&dataset.entries()[0]).unwrap_err().to_string();
        assert!(error.contains(wrong), "{error}");
    }
}

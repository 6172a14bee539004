//! Images, masks and arrays on disk: round trips, files of other programs (`tools/golden/files.py`), corrupt files.

use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use srflow_core::{Image, Labels, Mask, Plane};
use srflow_files::{
    read_image, read_labels, read_mask, read_npy, read_npy_plane, write_image_png, write_labels_png,
    write_mask_png, write_npy, write_npy_plane,
};

fn data(name: &str) -> PathBuf {
    PathBuf::from("tests/data").join(name)
}

const KINDS: [&str; 8] = [
    "image.ppm",
    "image.bmp",
    "image.png",
    "image_16bit.png",
    "image_alpha.png",
    "image_grey.png",
    "image.jpg",
    "image_progressive.jpg",
];

#[test]
fn every_kind_of_image_is_read_as_rgb() {
    let expected = Image::from_fn(10, 7, |x, y| [25 * x as u8, 36 * y as u8, (3 * x * y) as u8]);
    for name in ["image.ppm", "image.bmp", "image.png", "image_16bit.png", "image_alpha.png"] {
        assert_eq!(read_image(&data(name)).unwrap(), expected, "{name}");
    }
    let grey = Image::from_fn(10, 7, |x, _| [25 * x as u8; 3]);
    assert_eq!(read_image(&data("image_grey.png")).unwrap(), grey);
    for name in ["image", "image_progressive"] {
        let ours = read_image(&data(&format!("{name}.jpg"))).unwrap();
        let golden = read_image(&data(&format!("{name}_jpg_decoded.png"))).unwrap();
        assert_eq!(ours.size(), golden.size());
        let channels = ours.pixels().as_flattened().iter().zip(golden.pixels().as_flattened());
        let largest = channels.map(|(a, b)| a.abs_diff(*b)).max();
        assert!(largest <= Some(4), "{name}: channels differ by up to {largest:?}");
    }
}

#[test]
fn a_mask_is_true_over_127() {
    let mask = read_mask(&data("image_grey.png")).unwrap();
    assert_eq!(mask, Mask::from_fn(10, 7, |x, _| 25 * x > 127));
}

#[test]
fn labels_are_the_grey_values_and_nothing_else_is_read_as_labels() {
    let labels = read_labels(&data("image_grey.png")).unwrap();
    assert_eq!(labels, Labels::from_fn(10, 7, |x, _| 25 * x as u8));
    for (name, found) in [("image.png", "Rgb8"), ("image_16bit.png", "Rgb16"), ("image.bmp", "Rgb8")] {
        let error = read_labels(&data(name)).unwrap_err().to_string();
        let expected = format!("{name}: pixels: expected 8-bit grey values");
        assert!(error.contains(&expected) && error.contains(found), "{error}");
    }
}

fn read_bytes(bytes: &[u8]) -> Result<Image, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.any");
    fs::write(&path, bytes).unwrap();
    let mask = read_mask(&path).map(|mask| mask.size());
    let labels = read_labels(&path).map(|labels| labels.size());
    let image = read_image(&path).map_err(|error| error.to_string());
    assert_eq!(mask.ok(), image.as_ref().ok().map(Image::size));
    assert!(labels.is_err() || labels.ok() == image.as_ref().ok().map(Image::size));
    image
}

#[test]
fn images_cut_short_are_refused() {
    for name in KINDS {
        let bytes = fs::read(data(name)).unwrap();
        for cut in (0..bytes.len()).step_by(5).chain([bytes.len() - 1]) {
            let message = read_bytes(&bytes[..cut]).expect_err(name);
            assert!(
                message.contains("image.any: ") && message.contains(": expected "),
                "{name} at {cut}: {message}"
            );
        }
    }
}

#[test]
fn other_files_are_refused() {
    let message = read_bytes(b"GIF89a and so on").unwrap_err();
    assert!(
        message.ends_with("image.any: magic: expected a PNG, JPEG, PPM or BMP file, found \"GIF89a a\""),
        "{message}"
    );
    let mut huge = fs::read(data("image.png")).unwrap();
    huge[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
    assert!(
        read_bytes(&huge).unwrap_err().contains("size: expected at most 134217728 pixels, found 65536x65536")
    );
    let huge = read_bytes(b"P6\n60000 60000\n255\n0").unwrap_err();
    assert!(huge.contains("size: expected at most 134217728 pixels, found 60000x60000"), "{huge}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn png_keeps_images_masks_and_labels(
        (width, height, pixels) in (1_usize..40, 1_usize..20).prop_flat_map(|(width, height)| {
            (Just(width), Just(height), prop::collection::vec(any::<[u8; 3]>(), width * height))
        }),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let mask = Mask::from_fn(width, height, |x, y| pixels[y * width + x][0] > 99);
        let labels = Labels::from_fn(width, height, |x, y| pixels[y * width + x][1]);
        let image = Image::from_pixels(width, height, pixels).unwrap();
        write_image_png(&path, &image).unwrap();
        prop_assert_eq!(&read_image(&path).unwrap(), &image);
        write_mask_png(&path, &mask).unwrap();
        prop_assert_eq!(&read_mask(&path).unwrap(), &mask);
        write_labels_png(&path, &labels).unwrap();
        prop_assert_eq!(&read_labels(&path).unwrap(), &labels);
    }

    #[test]
    fn changed_bytes_never_panic(
        kind in 0..KINDS.len(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = fs::read(data(KINDS[kind])).unwrap();
        for (index, byte) in &changes {
            let at = index.index(bytes.len());
            bytes[at] = *byte;
        }
        let _ = read_bytes(&bytes);
    }

    #[test]
    fn npy_keeps_arrays_of_any_shape(shape in prop::collection::vec(1_usize..6, 1..5), seed in any::<u32>()) {
        let count = shape.iter().product();
        let values: Vec<f32> = (0..count).map(|i| f32::from_bits(seed.wrapping_mul(i as u32 + 1))).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        write_npy(&path, &shape, &values).unwrap();
        let array = read_npy(&path).unwrap();
        prop_assert_eq!(array.shape, shape);
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&array.values), bits(&values));
    }
}

#[test]
fn planes_go_through_npy() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.npy");
    let depth = Plane::from_fn(5, 3, |x, y| x as f32 - 0.25 * y as f32);
    write_npy_plane(&path, &depth).unwrap();
    assert_eq!(read_npy_plane(&path).unwrap(), depth);
    assert_eq!(read_npy(&path).unwrap().shape, [3, 5]);
}

#[test]
fn npy_of_other_layouts_is_read_row_major() {
    let row_major = read_npy(&data("flow.npy")).unwrap();
    assert_eq!(row_major.shape, [9, 13, 2]);
    for name in ["flow_fortran.npy", "flow_f64_big_endian.npy"] {
        let other = read_npy(&data(name)).unwrap();
        assert_eq!(other.shape, row_major.shape);
        assert!(
            other.values.iter().zip(&row_major.values).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
        );
    }
}

#[test]
fn npy_errors_name_the_problem() {
    let message = read_npy_plane(&data("flow.npy")).unwrap_err().to_string();
    assert!(
        message.ends_with("flow.npy: shape: expected (H, W) of at least one pixel, found [9, 13, 2]"),
        "{message}"
    );
    let message = write_npy(Path::new("a.npy"), &[2, 3], &[0.0; 5]).unwrap_err().to_string();
    assert_eq!(message, "a.npy: shape: expected values for [2, 3], found 5 values");
    let message = write_npy(Path::new("a.npy"), &[usize::MAX, 3], &[0.0; 5]).unwrap_err().to_string();
    assert!(message.starts_with("a.npy: shape: expected values for"), "{message}");
}

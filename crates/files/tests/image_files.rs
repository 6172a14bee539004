//! Images, masks and arrays on disk: round trips, files of other programs (`tools/golden/files.py`), corrupt files.

use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use srflow_core::{Image, Labels, Mask, Plane, Size};
use srflow_files::{
    read_alpha, read_grey16, read_image, read_image_size, read_labels, read_mask, read_npy, read_npy_plane,
    write_image_png, write_labels_png, write_mask_png, write_npy, write_npy_plane,
};

fn data(name: &str) -> PathBuf {
    PathBuf::from("tests/data").join(name)
}

const KINDS: [&str; 11] = [
    "image.ppm",
    "image.bmp",
    "image.png",
    "image.tif",
    "image.webp",
    "image_16bit.png",
    "image_16bit.tif",
    "image_alpha.png",
    "image_grey.png",
    "image.jpg",
    "image_progressive.jpg",
];

#[test]
fn every_kind_of_image_is_read_as_rgb() {
    let expected = Image::from_fn(10, 7, |x, y| [25 * x as u8, 36 * y as u8, (3 * x * y) as u8]);
    for name in KINDS.iter().filter(|name| !name.ends_with(".jpg") && **name != "image_grey.png") {
        assert_eq!(read_image(&data(name)).unwrap(), expected, "{name}");
        assert_eq!(read_image_size(&data(name)).unwrap(), Size::new(10, 7), "{name}");
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

/// A picture of 6x4 pixels without symmetry.
fn lopsided() -> Image {
    Image::from_fn(6, 4, |x, y| [40 * x as u8, 60 * y as u8, if x < y { 200 } else { 10 }])
}

/// EXIF data that hold an orientation alone.
fn exif(orientation: u8, big_endian: bool) -> Vec<u8> {
    match big_endian {
        true => {
            [b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".as_slice(), &[orientation, 0, 0, 0, 0, 0, 0]]
                .concat()
        }
        false => {
            [b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".as_slice(), &[orientation, 0, 0, 0, 0, 0, 0, 0]]
                .concat()
        }
    }
}

fn jpeg(image: &Image) -> Vec<u8> {
    let mut bytes = Vec::new();
    let (width, height) = (image.width() as u32, image.height() as u32);
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95)
        .encode(image.pixels().as_flattened(), width, height, image::ExtendedColorType::Rgb8)
        .unwrap();
    bytes
}

/// A JPEG file with EXIF data behind its first segment.
fn jpeg_with(exif: &[u8], image: &Image) -> Vec<u8> {
    let bytes = jpeg(image);
    let at = 4 + usize::from(u16::from_be_bytes([bytes[4], bytes[5]]));
    let length = (8 + exif.len() as u16).to_be_bytes();
    [&bytes[..at], &[0xff, 0xe1], &length, b"Exif\0\0", exif, &bytes[at..]].concat()
}

/// A PNG file with EXIF data before or after its pixels.
fn png_with(exif: &[u8], after: bool, encode: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(&mut bytes);
    let at = if after { bytes.len() - 12 } else { 8 + 25 };
    let named = [b"eXIf", exif].concat();
    let chunk =
        [&(exif.len() as u32).to_be_bytes(), named.as_slice(), &crc32fast::hash(&named).to_be_bytes()]
            .concat();
    bytes.splice(at..at, chunk);
    bytes
}

fn png(
    bytes: &mut Vec<u8>,
    Size { width, height }: Size,
    color: png::ColorType,
    depth: png::BitDepth,
    values: &[u8],
) {
    let mut encoder = png::Encoder::new(bytes, width as u32, height as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(values).unwrap();
}

/// The place of each pixel of an upright picture in a stored one of 6x4 pixels.
fn stored_at(orientation: u8, x: usize, y: usize) -> (usize, usize) {
    match orientation {
        2 => (5 - x, y),
        3 => (5 - x, 3 - y),
        4 => (x, 3 - y),
        5 => (y, x),
        6 => (y, 3 - x),
        7 => (5 - y, 3 - x),
        8 => (5 - y, x),
        _ => (x, y),
    }
}

#[test]
fn images_and_masks_are_upright_as_their_exif_data_says() {
    let folder = tempfile::tempdir().unwrap();
    let stored = lopsided();
    for orientation in 0..=9 {
        let (width, height) = if (5..=8).contains(&orientation) { (4, 6) } else { (6, 4) };
        let upright = Image::from_fn(width, height, |x, y| {
            let (x, y) = stored_at(orientation, x, y);
            stored.get(x, y)
        });
        for (name, exif) in [("little", exif(orientation, false)), ("big", exif(orientation, true))] {
            let path = folder.path().join(format!("{name}.any"));
            let rgb = |bytes: &mut Vec<u8>| {
                let values = stored.pixels().as_flattened();
                png(bytes, Size::new(6, 4), png::ColorType::Rgb, png::BitDepth::Eight, values);
            };
            for after in [false, true] {
                fs::write(&path, png_with(&exif, after, rgb)).unwrap();
                assert_eq!(read_image(&path).unwrap(), upright, "{orientation} {name}");
                assert_eq!(read_image_size(&path).unwrap(), upright.size());
                let mask = Mask::from_fn(width, height, |x, y| upright.get(x, y)[2] > 127);
                let blue = |bytes: &mut Vec<u8>| {
                    let values: Vec<u8> = stored.pixels().iter().map(|pixel| pixel[2]).collect();
                    png(bytes, Size::new(6, 4), png::ColorType::Grayscale, png::BitDepth::Eight, &values);
                };
                fs::write(&path, png_with(&exif, after, blue)).unwrap();
                assert_eq!(read_mask(&path).unwrap(), mask);
                let labels = read_labels(&path).unwrap();
                assert_eq!(labels.size(), stored.size(), "labels are read as they are stored");
            }
            fs::write(&path, jpeg(&stored)).unwrap();
            let plain = read_image(&path).unwrap();
            fs::write(&path, jpeg_with(&exif, &stored)).unwrap();
            let turned = read_image(&path).unwrap();
            assert_eq!((turned.size(), read_image_size(&path).unwrap()), (upright.size(), upright.size()));
            assert_eq!(
                turned,
                Image::from_fn(width, height, |x, y| {
                    let (x, y) = stored_at(orientation, x, y);
                    plain.get(x, y)
                })
            );
        }
    }
}

#[test]
fn a_jpeg_may_have_a_video_behind_it_or_lack_its_last_marker() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    let image = Image::from_fn(40, 24, |x, y| [6 * x as u8, 10 * y as u8, (x * y) as u8]);
    let progressive = fs::read(data("image_progressive.jpg")).unwrap();
    for whole in [jpeg(&image), jpeg_with(&exif(6, false), &image), progressive] {
        fs::write(&path, &whole).unwrap();
        let expected = read_image(&path).unwrap();
        let with_video = [&whole, b"\0\0\0\x18ftypmp42\x01\xff\xda\x03\x04".as_slice()].concat();
        let end = whole.len();
        for readable in
            [&with_video, &whole[..end - 2], &whole[..end - 1], &[&whole[..end - 2], &[0xff; 3]].concat()]
        {
            fs::write(&path, readable).unwrap();
            assert_eq!(read_image(&path).unwrap(), expected);
        }
        for cut in [end - 4, end - 8, end - 20, end / 2 + 40] {
            fs::write(&path, &whole[..cut]).unwrap();
            let error = read_image(&path).unwrap_err().to_string();
            assert!(error.ends_with("found none: the file is truncated"), "{cut} of {end}: {error}");
        }
    }
}

#[test]
fn masks_of_other_programs_are_read_by_one_rule() {
    use png::{BitDepth, ColorType};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mask.png");
    let inside = Mask::from_fn(4, 2, |x, y| x > y);
    let write = |color, depth, values: &dyn Fn(bool) -> Vec<u8>| {
        let values: Vec<u8> = inside.pixels().iter().flat_map(|inside| values(*inside)).collect();
        let mut bytes = Vec::new();
        png(&mut bytes, Size::new(4, 2), color, depth, &values);
        fs::write(&path, bytes).unwrap();
    };
    for value in [1, 38, 100, 255] {
        write(ColorType::Grayscale, BitDepth::Eight, &|inside| vec![if inside { value } else { 0 }]);
        assert_eq!(read_mask(&path).unwrap(), inside, "0 and {value}");
        write(ColorType::Grayscale, BitDepth::Sixteen, &|inside| vec![0, if inside { value } else { 0 }]);
        assert_eq!(read_mask(&path).unwrap(), inside, "0 and {value} with 16 bits");
    }
    write(ColorType::Grayscale, BitDepth::Sixteen, &|inside| vec![if inside { 255 } else { 3 }, 7]);
    assert_eq!(read_mask(&path).unwrap(), inside);
    // In an alpha that varies, whatever the colours are.
    for opaque in [1, 255] {
        write(ColorType::Rgba, BitDepth::Eight, &|inside| vec![9, 9, 9, if inside { opaque } else { 0 }]);
        assert_eq!(read_mask(&path).unwrap(), inside, "alpha 0 and {opaque}");
        let alpha = read_alpha(&path).unwrap();
        assert_eq!(alpha, Plane::from_fn(4, 2, |x, y| f32::from(u8::from(x > y))));
    }
    write(ColorType::GrayscaleAlpha, BitDepth::Eight, &|inside| vec![if inside { 1 } else { 0 }, 255]);
    assert_eq!(read_mask(&path).unwrap(), inside);
    for (value, expected) in [(0, false), (1, true), (255, true)] {
        write(ColorType::Grayscale, BitDepth::Eight, &|_| vec![value]);
        assert_eq!(read_mask(&path).unwrap(), Mask::from_fn(4, 2, |_, _| expected));
    }
    write(ColorType::Grayscale, BitDepth::Eight, &|inside| vec![if inside { 102 } else { 51 }]);
    assert_eq!(read_alpha(&path).unwrap().get(3, 0), 0.4);
    let error = read_mask(&path).unwrap_err().to_string();
    assert!(error.ends_with("found values up to 102: write 255 where the mask is true"), "{error}");
    assert!(read_grey16(&path).is_err());
}

fn read_bytes(bytes: &[u8]) -> Result<Image, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.any");
    fs::write(&path, bytes).unwrap();
    let mask = read_mask(&path).map(|mask| mask.size());
    let labels = read_labels(&path).map(|labels| labels.size());
    let image = read_image(&path).map_err(|error| error.to_string());
    // Values may leave open where a mask is true.
    assert!(mask.is_err() || mask.ok() == image.as_ref().ok().map(Image::size));
    assert!(labels.is_err() || labels.ok() == image.as_ref().ok().map(Image::size));
    image
}

#[test]
fn images_cut_short_are_refused() {
    for name in KINDS {
        let bytes = fs::read(data(name)).unwrap();
        // A JPEG without its end-of-image marker is whole.
        let last = bytes.len() - if name.ends_with(".jpg") { 3 } else { 1 };
        for cut in (0..last).step_by(5).chain([last]) {
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
    for (bytes, found) in [
        (b"GIF89a and so on".as_slice(), "a GIF file: convert it to PNG"),
        (b"\0\0\0\x18ftypheic and so on", "a HEIF (HEIC) file: convert it to PNG"),
        (b"anything else", "\"anything\""),
    ] {
        let message = read_bytes(bytes).unwrap_err();
        let expected =
            format!("image.any: magic: expected a PNG, JPEG, PPM, BMP, WebP or TIFF file, found {found}");
        assert!(message.ends_with(&expected), "{message}");
    }
    let pages = read_image(&data("two_images.tif")).unwrap_err().to_string();
    assert!(
        pages.ends_with("image: expected one picture, found several: write each to a file of its own"),
        "{pages}"
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

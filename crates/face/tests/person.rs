//! The mask of a person: files that are refused, and MediaPipe's mask of a drawn person where its networks are installed.

use std::fs;
use std::path::PathBuf;

use srflow_core::{Image, Size};
use srflow_face::PersonMask;
use srflow_ops::golden::Golden;

const FILE: &str = "selfie_segmentation.tflite";

/// The picture of `tools/parity/face.py`.
fn drawn_person() -> Image {
    /// Colour; centre and half axes, across and down.
    const PARTS: [([u8; 3], [i32; 4]); 10] = [
        ([70, 45, 30], [108, 55, 34, 42]),
        ([40, 60, 120], [105, 160, 75, 52]),
        ([205, 160, 135], [108, 100, 13, 25]),
        ([215, 170, 145], [108, 62, 26, 34]),
        ([250, 250, 250], [98, 56, 5, 3]),
        ([250, 250, 250], [118, 56, 5, 3]),
        ([40, 30, 25], [98, 56, 2, 2]),
        ([40, 30, 25], [118, 56, 2, 2]),
        ([180, 120, 105], [108, 68, 3, 6]),
        ([160, 70, 70], [108, 82, 9, 3]),
    ];
    Image::from_fn(200, 150, |x, y| {
        let inside = |[cx, cy, across, down]: [i32; 4]| {
            let (x, y) = ((x as i32 - cx) * down, (y as i32 - cy) * across);
            x * x + y * y <= (across * down).pow(2)
        };
        let part = PARTS.iter().rev().find(|(_, ellipse)| inside(*ellipse));
        part.map_or([60 + y as u8 / 3, 90 + x as u8 / 4, 110 + y as u8 / 5], |(colour, _)| *colour)
    })
}

#[test]
fn the_mask_of_a_person_is_that_of_mediapipe() {
    let Some(models) = std::env::var_os("SRFLOW_FACE_MODELS").map(PathBuf::from) else {
        eprintln!("skipped: mediapipe: no package up to 0.10.21 is named by SRFLOW_FACE_MODELS");
        return;
    };
    let person = PersonMask::read(&models).unwrap();
    let mask = person.mask(&drawn_person()).unwrap();
    assert_eq!(mask.size(), Size::new(200, 150));
    let golden = Golden::read("tests/golden/person_mask.safetensors");
    assert_eq!(golden.shape("mask"), [38, 50]);
    let pixels = (0..38).flat_map(|y| (0..50).map(move |x| (4 * x, 4 * y)));
    let differences: Vec<f32> = pixels
        .zip(golden.values("mask"))
        .map(|((x, y), expected)| (mask.get(x, y) - expected).abs())
        .collect();
    let mean = differences.iter().sum::<f32>() / differences.len() as f32;
    let largest = differences.iter().copied().fold(0.0, f32::max);
    assert!(mean < 1e-5 && largest < 1e-3, "mean {mean}, largest {largest}");
    assert_eq!(person.mask(&Image::new(0, 7)).unwrap().size(), Size::new(0, 7));
}

#[test]
fn networks_that_are_missing_damaged_or_others_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let refused = || PersonMask::read(dir.path()).unwrap_err().to_string();
    let missing = refused();
    assert!(missing.contains("mediapipe==0.10.21") && missing.contains(&format!("no {FILE}")), "{missing}");
    let other = fs::read("tests/golden/person_operations.tflite").unwrap();
    // Where MediaPipe's package has it.
    let folder = dir.path().join("modules/selfie_segmentation");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join(FILE), &other[..4000]).unwrap();
    let damaged = refused();
    assert!(damaged.contains(FILE) && damaged.contains("the file is damaged at byte"), "{damaged}");
    fs::write(folder.join(FILE), &other).unwrap();
    assert!(
        refused().contains("expected a network for 256x256 pixels of 3 channels, found 18x13 pixels"),
        "{}",
        refused()
    );
}

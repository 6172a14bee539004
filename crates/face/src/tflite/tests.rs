use srflow_ops::golden::{Golden, name_hash, noise};

use super::Network;

/// MediaPipe's networks for faces have these operations.
const FACES: &[u8] = include_bytes!("../../tests/golden/operations.tflite");
/// Its network for persons has these.
const PERSON: &[u8] = include_bytes!("../../tests/golden/person_operations.tflite");

/// That for blend shapes has these.
const SHAPES: &[u8] = include_bytes!("../../tests/golden/shape_operations.tflite");

/// Compares the outputs of a file, which have these names, with those of TensorFlow Lite.
fn check(file: &[u8], golden: &str, names: &[&str]) {
    let network = Network::parse(file).unwrap();
    let [channels, height, width] = network.input();
    assert_eq!([channels, height, width], [3, 13, 18]);
    let seed = name_hash("picture");
    let at = |index: usize| {
        let (channel, pixel) = (index / (height * width), index % (height * width));
        noise((pixel * 3 + channel) as u32, seed)
    };
    let found = network.run(&(0..3 * height * width).map(at).collect::<Vec<_>>()).unwrap();
    let golden = Golden::read(golden);
    assert_eq!(found.len(), names.len());
    for (found, name) in found.iter().zip(names) {
        let expected = golden.values(name);
        assert_eq!(found.len(), expected.len());
        for (a, b) in found.iter().zip(expected) {
            assert!((a - b).abs() < 2e-6, "{name}: {a}, {b}");
        }
    }
}

#[test]
fn every_operation_gives_what_tensorflow_lite_gives() {
    check(FACES, "tests/golden/operations.safetensors", &["rows", "last"]);
    check(PERSON, "tests/golden/person_operations.safetensors", &["mask", "spread", "near"]);
    check(SHAPES, "tests/golden/shape_operations.safetensors", &["mixed", "centred", "row"]);
}

fn refused(bytes: &[u8]) -> String {
    Network::parse(bytes).map(|_| ()).unwrap_err()
}

#[test]
fn damaged_files_are_refused() {
    assert!(refused(b"").contains("expected a TFLite file"));
    for file in [FACES, PERSON, SHAPES] {
        assert!(refused(&file[..file.len() / 2]).contains("the file is damaged at byte"));
        for len in (0..file.len()).step_by(7) {
            refused(&file[..len]);
        }
        // No byte of a file leads outside of it, or to memory that it does not need. Weights may be any numbers.
        let mut refusals = 0;
        for at in 0..file.len() {
            for value in [0x00, 0x7f, 0xff] {
                let mut bytes = file.to_vec();
                bytes[at] = value;
                refusals += usize::from(Network::parse(&bytes).is_err());
            }
        }
        assert!(refusals > 1000, "{refusals}");
    }
}

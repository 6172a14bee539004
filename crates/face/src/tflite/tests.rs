use srflow_ops::golden::{Golden, name_hash, noise};

use super::Network;

const FILE: &[u8] = include_bytes!("../../tests/golden/operations.tflite");

#[test]
fn every_operation_gives_what_tensorflow_lite_gives() {
    let network = Network::parse(FILE).unwrap();
    let [height, width] = network.input();
    assert_eq!([height, width], [13, 18]);
    let seed = name_hash("picture");
    let at = |index: usize| {
        let (channel, pixel) = (index / (height * width), index % (height * width));
        noise((pixel * 3 + channel) as u32, seed)
    };
    let found = network.run(&(0..3 * height * width).map(at).collect::<Vec<_>>()).unwrap();
    let golden = Golden::read("tests/golden/operations.safetensors");
    assert_eq!(found.len(), 2);
    for (found, name) in found.iter().zip(["rows", "last"]) {
        let expected = golden.values(name);
        assert_eq!(found.len(), expected.len());
        for (a, b) in found.iter().zip(expected) {
            assert!((a - b).abs() < 2e-6, "{name}: {a}, {b}");
        }
    }
}

#[test]
fn damaged_files_are_refused() {
    let refused = |bytes: &[u8]| Network::parse(bytes).map(|_| ()).unwrap_err();
    assert!(refused(b"").contains("expected a TFLite file"));
    assert!(refused(&FILE[..FILE.len() / 2]).contains("the file is damaged at byte"));
    // No byte of a file leads outside of it, or to memory that it does not need. Weights may be any numbers.
    let mut refusals = 0;
    for at in 0..FILE.len() {
        for value in [0x00, 0x7f, 0xff] {
            let mut bytes = FILE.to_vec();
            bytes[at] = value;
            refusals += usize::from(Network::parse(&bytes).is_err());
        }
    }
    assert!(refusals > 1000, "{refusals}");
}

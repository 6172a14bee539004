//! Checkpoints as other programs save them. The files of `tests/checkpoints` are made by `tools/parity/checkpoints.py`.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use safetensors::tensor::{Dtype, TensorView};
use srflow_nets::{RaftConfig, WeightsError, load, parameter_infos, read_parameters};

fn checkpoint(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/checkpoints").join(name)
}

/// Names without prefix, no counter (`num_batches_tracked`), the shortcut's norm once.
const NAMES: [&str; 8] = [
    "conv1.bias",
    "conv1.weight",
    "downsample.0.bias",
    "downsample.0.weight",
    "downsample.1.bias",
    "downsample.1.running_mean",
    "downsample.1.running_var",
    "downsample.1.weight",
];

#[test]
fn every_form_of_a_pytorch_file_gives_the_same_parameters() {
    let expected = read_parameters(&checkpoint("zip.pth")).expect("zip.pth");
    assert_eq!(expected.keys().collect::<Vec<_>>(), NAMES);
    assert_eq!(expected["conv1.weight"].shape().as_slice(), [3, 2, 3, 3]);
    let values: Vec<f32> = expected["conv1.bias"].clone().try_to_vec().expect("f32");
    assert_eq!(values, [0.0, 0.125, 0.25]);
    for name in ["legacy.pth", "half.pt", "lightning.ckpt"] {
        let found = read_parameters(&checkpoint(name)).expect(name);
        assert!(found == expected, "{name}");
    }
}

#[test]
fn safetensors_are_told_apart_by_content() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("weights.bin");
    let bytes: Vec<u8> = [1.5_f32, -2.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let view = TensorView::new(Dtype::F32, vec![2], &bytes).expect("a view");
    std::fs::write(&path, safetensors::serialize([("module.a.bias", view)], None).expect("bytes"))
        .expect("written");
    let found = read_parameters(&path).expect("safetensors");
    let values: Vec<f32> = found["a.bias"].clone().try_to_vec().expect("f32");
    assert_eq!(values, [1.5, -2.0]);
}

#[test]
fn weights_of_another_network_are_named() {
    let network = RaftConfig::new().init(&Device::flex());
    let parameters = parameter_infos(&network).len();
    let error = load(network, &checkpoint("zip.pth")).expect_err("eight parameters are no RAFT");
    let message = error.to_string();
    assert!(message.contains("zip.pth"), "{message}");
    assert!(message.contains(&format!("{parameters} missing: fnet.conv1.weight")), "{message}");
    assert!(message.contains(&format!("and {} more", parameters - 10)), "{message}");
    assert!(message.contains("8 unknown: conv1.bias"), "{message}");
}

/// Whatever a file was cut to, or has in the place of its content, is an error and not a crash.
#[test]
fn broken_files_are_errors() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("broken");
    for name in ["zip.pth", "legacy.pth"] {
        let whole = std::fs::read(checkpoint(name)).expect(name);
        for len in (0..whole.len()).step_by(97) {
            std::fs::write(&path, &whole[..len]).expect("written");
            assert!(read_parameters(&path).is_err(), "{name} cut to {len} of {} bytes", whole.len());
        }
    }
    std::fs::write(&path, b"\xff\xff\xff\xff\xff\xff\xff\x7f{}").expect("written");
    assert!(matches!(read_parameters(&path), Err(WeightsError::Safetensors { .. })));
    std::fs::write(&path, b"not a checkpoint at all").expect("written");
    assert!(matches!(read_parameters(&path), Err(WeightsError::Pytorch { .. })));
    assert!(matches!(read_parameters(folder.path()), Err(WeightsError::Read { .. })));
}

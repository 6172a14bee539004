//! Reading checkpoints of other programs. `tools/parity/checkpoints.py` and `tools/parity/tensorflow_checkpoints.py` make the files
//! in `tests/checkpoints`.

use std::io::Write;
use std::path::{Path, PathBuf};

use burn::tensor::{Device, TensorData};
use burn_pack::{Bytes, DType};
use safetensors::tensor::{Dtype, TensorView};
use srflow_nn::layers::LinearConfig;
use srflow_nn::{
    Checkpoint, Format, Parameters, StoredAs, WeightsError, load, masked_crc32c, parameters, push_varint,
    read_parameters, save_parameters,
};
use tempfile::TempDir;
use zip::write::SimpleFileOptions;

fn checkpoint(name: &str) -> PathBuf {
    Path::new("tests/checkpoints").join(name)
}

/// A temporary folder, and the path of a file in it.
fn scratch() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("weights");
    (folder, path)
}

fn numbers(data: &TensorData) -> Vec<f32> {
    data.clone().try_to_vec().expect("f32")
}

fn bytes_of(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// Names without prefix, counters (`num_batches_tracked`) and the copy of the shortcut's norm.
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
fn all_kinds_of_pytorch_files_contain_the_same_parameters() {
    let expected = read_parameters(&checkpoint("zip.pth")).expect("zip.pth");
    assert_eq!(expected.keys().collect::<Vec<_>>(), NAMES);
    assert_eq!(expected["conv1.weight"].shape().as_slice(), [3, 2, 3, 3]);
    assert_eq!(numbers(&expected["conv1.bias"]), [0.0, 0.125, 0.25]);
    let whole_modules = ["module.pt", "script.pt"];
    for name in ["legacy.pth", "half.pt", "lightning.ckpt", "beside.pth", "without-checksums.pth"]
        .iter()
        .chain(&whole_modules)
    {
        let found = read_parameters(&checkpoint(name)).expect(name);
        assert!(found == expected, "{name}");
    }
}

#[test]
fn format_container_prefix_and_types_are_recognized() {
    let opened = |name: &str| {
        let file = Checkpoint::open(&checkpoint(name)).expect(name);
        let container = file.container().map(str::to_owned);
        (file.format(), container, file.prefix().to_owned(), file.types().join(" "))
    };
    let types = |types: &str| types.to_owned();
    assert_eq!(opened("zip.pth"), (Format::PytorchZip, None, "module.".into(), types("F32")));
    assert_eq!(opened("legacy.pth"), (Format::PytorchLegacy, None, "module.".into(), types("F32")));
    assert_eq!(opened("half.pt"), (Format::PytorchZip, None, String::new(), types("F16")));
    let state_dict = Some("state_dict".to_owned());
    assert_eq!(opened("lightning.ckpt"), (Format::PytorchZip, state_dict, "network.".into(), types("F32")));
}

/// Numbers in any encoding, but no other values, and nothing outside of the hyper-parameters.
#[test]
fn numeric_hyper_parameters_are_read() {
    let file = Checkpoint::open(&checkpoint("lightning.ckpt")).expect("lightning.ckpt");
    let expected = [
        ("corr_levels", 4.0),
        ("count", (1_u64 << 40) as f64),
        ("gamma", -0.5),
        ("lr", 1e-4),
        ("num_steps", 120_000.0),
        ("offset", -3.0),
        ("train_avg_length", 6624.0),
    ];
    let found: Vec<(&str, f64)> =
        file.hyper_parameters().iter().map(|(name, number)| (name.as_str(), *number)).collect();
    assert_eq!(found, expected);
    for name in ["zip.pth", "legacy.pth", "half.pt"] {
        assert!(Checkpoint::open(&checkpoint(name)).expect(name).hyper_parameters().is_empty(), "{name}");
    }
}

/// Configurations, lists and queues beside the weights are passed over, whatever their classes; arrays that are no weights are named.
#[test]
fn what_is_no_weight_is_counted() {
    let file = Checkpoint::open(&checkpoint("beside.pth")).expect("beside.pth");
    assert_eq!((file.prefix(), file.hyper_parameters().len()), ("model.", 0));
    let error = Checkpoint::open(&checkpoint("arrays.pth")).expect_err("arrays").to_string();
    for kind in [
        "1 arrays of NumPy",
        "1 numbers of NumPy",
        "1 tensors of float8_e4m3fn",
        "1 tensors of int64",
        "1 tensors on the device meta, which have no values",
    ] {
        assert!(error.contains(kind), "{error}");
    }
}

/// A flipped bit is an error where the file has checksums; one without them is read by the rest of the checks.
#[test]
fn checksums_are_compared_where_there_are_any() {
    let (_folder, path) = scratch();
    for (name, checked) in [("zip.pth", true), ("without-checksums.pth", false)] {
        let mut bytes = std::fs::read(checkpoint(name)).expect(name);
        let number = 0.125_f32.to_le_bytes();
        let at = bytes.windows(4).position(|window| window == number).expect("a number");
        bytes[at] ^= 1;
        std::fs::write(&path, &bytes).expect("written");
        match read_parameters(&path) {
            Err(error) => assert!(checked && error.to_string().contains("checksum"), "{name}: {error}"),
            Ok(_) => assert!(!checked, "{name}"),
        }
    }
}

/// Large models of Hugging Face are several files and an index.
#[test]
fn an_index_joins_several_files() {
    let (folder, _) = scratch();
    let path = folder.path().join("model.safetensors.index.json");
    let numbers_of = bytes_of(&[1.5, -2.0]);
    let view = || TensorView::new(Dtype::F32, vec![2], &numbers_of).expect("a view");
    let part = safetensors::serialize([("a.bias", view()), ("a.weight", view())], None).expect("bytes");
    std::fs::write(folder.path().join("1.safetensors"), part).expect("written");
    std::fs::copy(checkpoint("zip.pth"), folder.path().join("2.bin")).expect("copied");
    let read = |index: &str| {
        std::fs::write(&path, index).expect("written");
        read_parameters(&path).map_err(|error| error.to_string())
    };
    let index = r#"{"metadata": {"total_size": 20}, "weight_map": {"module.a.bias": "1.safetensors",
        "module.conv1.bias": "2.bin", "module.conv1.weight": "2.bin"}}"#;
    let error = read(index).expect_err("a name that is not there");
    assert!(error.contains("module.a.bias in 1.safetensors, which has no such tensor"), "{error}");
    let found = read(&index.replace("module.a.", "a.").replace("module.conv1.weight", "conv1.weight"));
    assert!(found.expect_err("not in it").contains("conv1.weight in 2.bin"));
    let found = read(&index.replace("module.a.", "a.")).expect("two files");
    assert_eq!(found.len(), 3, "{:?}", found.keys());
    assert!(found.contains_key("a.bias"));

    for (index, expected) in [
        ("{}", "weight_map"),
        ("[", "JSON"),
        (r#"{"weight_map": {"a": "../1.safetensors"}}"#, "beside it"),
        (r#"{"weight_map": {"a": "/etc/passwd"}}"#, "beside it"),
        (r#"{"weight_map": {"a": "model.safetensors.index.json"}}"#, "an index itself"),
        (r#"{"weight_map": {"a": "none.safetensors"}}"#, "none.safetensors"),
    ] {
        let error = read(index).expect_err(index);
        assert!(error.contains(expected), "{index}: {error}");
    }
}

#[test]
fn safetensors_and_burnpack_are_recognized_by_content() {
    let (_folder, path) = scratch();
    let bytes = bytes_of(&[1.5, -2.0]);
    let view = TensorView::new(Dtype::F32, vec![2], &bytes).expect("a view");
    std::fs::write(&path, safetensors::serialize([("module.a.bias", view)], None).expect("bytes"))
        .expect("written");
    let found = read_parameters(&path).expect("safetensors");
    assert_eq!(numbers(&found["a.bias"]), [1.5, -2.0]);

    // Names in burnpack start with the variant of an enum.
    std::fs::write(&path, burnpack("Raft.a.bias", &bytes)).expect("written");
    assert_eq!(Checkpoint::open(&path).expect("burnpack").format(), Format::Burnpack);
    let found = read_parameters(&path).expect("burnpack");
    assert_eq!(numbers(&found["a.bias"]), [1.5, -2.0]);
}

fn burnpack(name: &str, bytes: &[u8]) -> Vec<u8> {
    let bytes = Bytes::from_bytes_vec(bytes.to_vec());
    let tensor = burn_pack::Tensor::new(name.into(), DType::F32, vec![2], None, bytes);
    burn_pack::Writer::new(vec![tensor]).into_bytes().expect("a pack").to_vec()
}

/// 0, 0.125, 0.25 and so on.
fn eighths(count: usize) -> Vec<f32> {
    (0..count).map(|i| i as f32 / 8.0).collect()
}

/// Names and memory order become PyTorch's; optimizer state and counters are dropped.
#[test]
fn tensorflow_and_keras_checkpoints_are_converted_to_pytorchs_layout() {
    let found = read_parameters(&checkpoint("tensorflow.index")).expect("tensorflow.index");
    let expected: [(&str, &[usize]); 5] = [
        ("net1.conv1.bias", &[4]),
        ("net1.conv1.weight", &[4, 2, 3, 1]),
        ("net2.bn.running_var", &[3]),
        ("net2.deconv.weight", &[2, 1, 4, 4]),
        ("net2.half.bias", &[3]),
    ];
    assert_eq!(found.keys().collect::<Vec<_>>(), expected.map(|(name, _)| name));
    for (name, shape) in expected {
        assert_eq!(found[name].shape().as_slice(), shape, "{name}");
        assert_eq!(numbers(&found[name]), eighths(shape.iter().product()), "{name}");
    }
    let file = Checkpoint::open(&checkpoint("tensorflow.index")).expect("tensorflow.index");
    assert_eq!((file.format(), file.types().join(" ")), (Format::Tensorflow, "F16 F32".to_owned()));

    let expected: [(&str, &[usize]); 4] = [
        ("conv1.bias", &[4]),
        ("conv1.weight", &[4, 2, 3, 1]),
        ("deconv.bias", &[1]),
        ("deconv.weight", &[4, 1, 4, 4]),
    ];
    for file in ["keras.h5", "keras-model.h5"] {
        let found = read_parameters(&checkpoint(file)).expect(file);
        assert_eq!(found.keys().collect::<Vec<_>>(), expected.map(|(name, _)| name), "{file}");
        for (name, shape) in expected {
            assert_eq!(found[name].shape().as_slice(), shape, "{file}: {name}");
            assert_eq!(numbers(&found[name]), eighths(shape.iter().product()), "{file}: {name}");
        }
        assert_eq!(Checkpoint::open(&checkpoint(file)).expect(file).format(), Format::Keras);
    }
}

/// The error of reading a checkpoint after `change` was applied to its table and its tensors.
fn changed_tensorflow(change: impl FnOnce(&mut Vec<u8>, &mut Vec<u8>)) -> String {
    let folder = tempfile::tempdir().expect("folder");
    let read = |name: &str| std::fs::read(checkpoint(name)).expect(name);
    let (mut table, mut data) = (read("tensorflow.index"), read("tensorflow.data-00000-of-00001"));
    change(&mut table, &mut data);
    let path = folder.path().join("a.index");
    std::fs::write(&path, table).expect("written");
    if !data.is_empty() {
        std::fs::write(folder.path().join("a.data-00000-of-00001"), data).expect("written");
    }
    read_parameters(&path).expect_err("changed").to_string()
}

#[test]
fn broken_tensorflow_checkpoints_are_errors_with_advice() {
    let error = changed_tensorflow(|_, data| data.clear());
    assert!(error.contains("a.index") && error.contains("a.data-00000-of-00001"), "{error}");
    let error = changed_tensorflow(|_, data| data.truncate(100));
    assert!(error.contains("net1/conv1/kernel: it claims 96 bytes at 24"), "{error}");
    let error = changed_tensorflow(|_, data| data[30] ^= 1);
    assert!(error.contains("net1.conv1.weight: the checksum of its bytes is wrong"), "{error}");
    let error = changed_tensorflow(|table, _| table[8] ^= 1);
    assert!(error.contains("the checksum of a block of its table at 0 is wrong"), "{error}");

    let (folder, path) = scratch();
    std::fs::copy(checkpoint("tensorflow.index"), &path).expect("copied");
    let error = read_parameters(&path).expect_err("without its name").to_string();
    assert!(error.contains("its name must be NAME.index"), "{error}");
    let data = folder.path().join("a.data-00000-of-00001");
    std::fs::copy(checkpoint("tensorflow.data-00000-of-00001"), &data).expect("copied");
    let error = read_parameters(&data).expect_err("tensors alone").to_string();
    assert!(error.contains("pass its table instead, a.index"), "{error}");
}

/// The checksums are corrected after each change, so that the parser behind them is reached.
#[test]
fn corrupted_tables_with_valid_checksums_never_panic() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.index");
    let data = std::fs::read(checkpoint("tensorflow.data-00000-of-00001")).expect("tensors");
    std::fs::write(folder.path().join("a.data-00000-of-00001"), &data).expect("copied");
    let table = std::fs::read(checkpoint("tensorflow.index")).expect("a table");
    // The block of entries comes first, then one byte for the kind of compression, then the checksum.
    let masked = |bytes: &[u8]| masked_crc32c(bytes).to_le_bytes();
    let len =
        (0..table.len()).find(|&len| table[len + 1..len + 5] == masked(&table[..=len])).expect("a block");
    let mut errors = 0;
    for (at, change) in (0..len).flat_map(|at| [0x01, 0x02, 0x10, 0x80, 0xff].map(|change| (at, change))) {
        let mut changed = table.clone();
        changed[at] ^= change;
        let checksum = masked(&changed[..=len]);
        changed[len + 1..len + 5].copy_from_slice(&checksum);
        std::fs::write(&path, &changed).expect("written");
        match read_parameters(&path) {
            Ok(found) => assert!(byte_count(&found) <= 8 * (table.len() + data.len()), "byte {at}"),
            Err(error) => {
                errors += 1;
                assert!(error.to_string().len() < 4000, "{error}");
            }
        }
    }
    assert!(errors > len, "{errors} errors");
}

/// Compression is an option of TensorFlow.
#[test]
fn compressed_blocks_are_read() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.index");
    let table = std::fs::read(checkpoint("tensorflow.index")).expect("a table");
    std::fs::write(&path, compressed(&table)).expect("written");
    let data = "tensorflow.data-00000-of-00001";
    std::fs::copy(checkpoint(data), folder.path().join("a.data-00000-of-00001")).expect("copied");
    let found = read_parameters(&path).expect("compressed");
    assert!(found == read_parameters(&checkpoint("tensorflow.index")).expect("plain"));
}

/// A table with one block of entries, recompressed along with the index block.
fn compressed(table: &[u8]) -> Vec<u8> {
    fn varint(bytes: &[u8]) -> (usize, &[u8]) {
        let len = 1 + bytes.iter().take_while(|byte| **byte & 0x80 != 0).count();
        let number = bytes[..len].iter().rev().fold(0, |number, byte| number << 7 | usize::from(byte & 0x7f));
        (number, &bytes[len..])
    }
    fn to_varint(number: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        push_varint(&mut bytes, number as u64);
        bytes
    }
    let append = |file: &mut Vec<u8>, block: &[u8]| {
        let start = file.len();
        let mut stored = snap::raw::Encoder::new().compress_vec(block).expect("compressed");
        let len = stored.len();
        stored.push(1);
        let checksum = masked_crc32c(&stored);
        file.extend(stored);
        file.extend(checksum.to_le_bytes());
        [to_varint(start), to_varint(len)].concat()
    };
    let footer = &table[table.len() - 48..];
    let (_, rest) = varint(footer);
    let (_, rest) = varint(rest);
    let (index_start, rest) = varint(rest);
    let (index_len, _) = varint(rest);
    let index = &table[index_start..index_start + index_len];
    // An entry without shared prefix: lengths of key and value, then both.
    let (key_len, rest) = varint(&index[1..]);
    let (_, rest) = varint(rest);
    let (key, place) = rest.split_at(key_len);
    let (start, place) = varint(place);
    let (len, _) = varint(place);
    let mut file = Vec::new();
    let place = append(&mut file, &table[start..start + len]);
    let entry = [&[0], to_varint(key.len()).as_slice(), &to_varint(place.len()), key, &place].concat();
    let restarts = [0_u32, 1].map(u32::to_le_bytes).concat();
    let place = append(&mut file, &[entry, restarts].concat());
    let mut footer = [vec![0, 0], place].concat();
    footer.resize(40, 0);
    file.extend(footer);
    file.extend(&table[table.len() - 8..]);
    file
}

#[test]
fn saved_parameters_load_again() {
    let (folder, path) = scratch();
    let network = LinearConfig::new(3, 2).init(&Device::flex());
    save_parameters(&network, StoredAs::F32, None, &path).expect("saved");
    assert_eq!(Checkpoint::open(&path).expect("a checkpoint").format(), Format::Safetensors);
    let loaded = load(LinearConfig::new(3, 2).init(&Device::flex()), &path).expect("loaded");
    assert!(parameters(&loaded) == parameters(&network));
    let error = save_parameters(&network, StoredAs::F32, None, &folder.path().join("no/weights"))
        .expect_err("no folder");
    assert!(error.to_string().contains("no/weights: creating"), "{error}");
}

/// Valid files of every format.
fn whole_files() -> Vec<(&'static str, Vec<u8>)> {
    let bytes = bytes_of(&[1.5, -2.0]);
    let view = TensorView::new(Dtype::F32, vec![2], &bytes).expect("a view");
    let read = |name: &'static str| (name, std::fs::read(checkpoint(name)).expect(name));
    vec![
        read("zip.pth"),
        read("legacy.pth"),
        read("lightning.ckpt"),
        read("keras.h5"),
        ("safetensors", safetensors::serialize([("a.bias", view)], None).expect("bytes")),
        ("burnpack", burnpack("a.bias", &bytes)),
    ]
}

#[test]
fn truncated_files_are_errors() {
    let (_folder, path) = scratch();
    for (name, whole) in whole_files() {
        for len in (0..whole.len()).step_by(13) {
            std::fs::write(&path, &whole[..len]).expect("written");
            assert!(read_parameters(&path).is_err(), "{name} cut to {len} of {} bytes", whole.len());
        }
    }
}

/// Not every format detects a changed byte of a value, so reading may succeed; then the size of the result is bounded.
#[test]
fn corrupted_files_never_panic() {
    let (_folder, path) = scratch();
    for (name, whole) in whole_files() {
        let mut errors = 0;
        for (at, change) in (0..whole.len()).step_by(3).zip([0x01, 0x80, 0xff].into_iter().cycle()) {
            let mut changed = whole.clone();
            changed[at] ^= change;
            std::fs::write(&path, &changed).expect("written");
            match read_parameters(&path) {
                Ok(found) => assert!(byte_count(&found) <= 8 * whole.len(), "{name}, byte {at}"),
                Err(error) => {
                    errors += 1;
                    assert!(error.to_string().len() < 4000, "{error}");
                }
            }
        }
        assert!(errors > 0, "{name}");
    }
}

fn byte_count(parameters: &Parameters) -> usize {
    parameters.values().map(|data| data.as_bytes().len()).sum()
}

/// The error of reading a file with this content.
fn refused(content: &[u8]) -> String {
    let (_folder, path) = scratch();
    std::fs::write(&path, content).expect("written");
    let error = read_parameters(&path).expect_err("refused");
    error.to_string().split_once("weights: ").expect("the name of the file").1.to_owned()
}

#[test]
fn sizes_are_checked_against_the_length_of_the_file() {
    let error = read_parameters(&checkpoint("expanded.pth")).expect_err("a gigabyte").to_string();
    assert!(error.contains("its tensors claim 1073741824 bytes, the file has 1584"), "{error}");

    let error = refused(b"\xff\xff\xff\xff\xff\xff\xff\x7f{}");
    assert!(error.contains("its table claims 9223372036854775807 bytes, the file has 2 left"), "{error}");
    let safetensors =
        |table: &str| [&(table.len() as u64).to_le_bytes()[..], table.as_bytes(), &[0; 8]].concat();
    let error = refused(&safetensors(
        r#"{"a":{"dtype":"F32","shape":[1099511627776],"data_offsets":[0,4398046511104]}}"#,
    ));
    assert!(error.contains("its tensors claim 4398046511104 bytes, the file has 8 left"), "{error}");
    let error = refused(&safetensors(
        r#"{"a":{"dtype":"F32","shape":[4611686018427387904,4],"data_offsets":[0,8]}}"#,
    ));
    assert!(error.contains("overflow"), "{error}");

    let error = refused(b"NRUB\x01\x00\xff\xff\xff\x05");
    assert!(error.starts_with("expected a whole burnpack file"), "{error}");
}

/// A few kilobytes that inflate to a pickle of 32 MB.
#[test]
fn a_decompression_bomb_is_an_error() {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    archive.start_file("archive/data.pkl", SimpleFileOptions::default()).expect("an entry");
    let lists = vec![b']'; 1 << 20];
    for _ in 0..32 {
        archive.write_all(&lists).expect("deflated");
    }
    let bomb = archive.finish().expect("a zip file").into_inner();
    assert!(bomb.len() < 1 << 17);
    let error = refused(&bomb);
    assert!(error.contains("its data.pkl claims 33554432 bytes"), "{error}");
}

/// A megabyte of nested dictionaries, which would take a gigabyte when parsed.
#[test]
fn a_pickle_with_too_many_objects_is_an_error() {
    let mut pickle = b"\x80\x02".to_vec();
    for _ in 0..400 {
        pickle.extend(b"}X\x01\0\0\0a".repeat(900));
        pickle.extend(b"}");
        pickle.extend(b"s".repeat(900));
    }
    pickle.push(b'.');
    assert!(refused(&pickle).contains("at most 1000000 operations"));
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    archive.start_file("archive/data.pkl", SimpleFileOptions::default()).expect("an entry");
    archive.write_all(&pickle).expect("deflated");
    // Padding, so that the pickle passes the check against the length of the file.
    archive
        .start_file(
            "archive/data/0",
            SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored),
        )
        .expect("an entry");
    archive.write_all(&vec![0; 1 << 20]).expect("stored");
    let zip = archive.finish().expect("a zip file").into_inner();
    assert!(refused(&zip).contains("at most 1000000 operations"));
}

#[test]
fn other_files_are_described_in_the_error() {
    let error = refused(b"<!DOCTYPE html>\n<html>");
    assert!(error.contains("found a file that starts with `<!DOCTYPE html>\\n<html>`"), "{error}");
    assert!(refused(b"").contains("found an empty file"));
    let tar = [&[b'x'; 257][..], b"ustar"].concat();
    assert!(refused(&tar).contains("found a tar file, as PyTorch before 0.1.10 wrote"));
    let (folder, _) = scratch();
    assert!(matches!(read_parameters(folder.path()), Err(WeightsError::File(_))));
}

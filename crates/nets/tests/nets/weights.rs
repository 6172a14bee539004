//! Loading weights into the network that they belong to, and into others.

use std::path::Path;

use burn::tensor::{Device, TensorData};
use srflow_nets::{
    Architecture, Claim, Network, claim, fits, fits_of_file, load_network, load_to_train, save_network,
    save_network_pytorch,
};
use srflow_nn::{
    ParameterInfo, StoredAs, masked_crc32c, parameters, push_varint, safetensors_bytes, save_parameters,
    with_parameters,
};

/// Saves random parameters of a network and calls `check` with it and the file.
fn with_saved(architecture: Architecture, check: impl FnOnce(&Network, &Path)) {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("weights");
    let network = architecture.init(&Device::flex());
    save_parameters(&network, StoredAs::F32, None, &path).expect("saved");
    check(&network, &path);
}

#[test]
fn saved_weights_load_again_and_are_recognized() {
    for architecture in Architecture::ALL {
        let name = architecture.name();
        with_saved(architecture, |network, path| {
            let loaded = load_network(architecture, path, &Device::flex()).expect(name);
            assert!(parameters(&loaded) == parameters(network), "{name}");
            let fits = fits_of_file(path).expect(name);
            let facts = architecture.facts();
            let fit = fits.iter().find(|fit| fit.architecture == architecture).expect(name);
            let first = fits[0].architecture.facts();
            let same = first.lookalikes.contains(&facts.title) || facts.same_weights.contains(&first.name);
            assert!(first.name == name || same, "{name}: {first:?} comes first");
            assert_eq!(fit.difference, None, "{name}");
        });
    }
}

#[test]
fn errors_name_the_network_that_weights_fit() {
    let device = Device::flex();
    with_saved(Architecture::Gma, |_, path| {
        let error = load_network(Architecture::Raft, path, &device).expect_err("weights of GMA").to_string();
        assert!(error.contains("weights: the parameters do not fit the network"), "{error}");
        assert!(error.contains("unknown: att."), "{error}");
        assert!(error.ends_with("they are the parameters of gma"), "{error}");
    });

    let mut given = parameters(&Architecture::SkFlow.init(&device));
    given.remove("update_block.gru.pw.bias");
    let wrong = TensorData::new(vec![0.0_f32; 2], [2]);
    given.insert("fnet.conv1.bias".into(), wrong.clone());
    given.insert("\u{1b}[2J".into(), wrong);
    let infos: Vec<ParameterInfo> = given
        .iter()
        .map(|(name, data)| ParameterInfo { name: name.clone(), shape: data.shape().to_vec() })
        .collect();
    let nearest = fits(&infos).swap_remove(0);
    assert_eq!((nearest.architecture, nearest.expected - nearest.matching), (Architecture::SkFlow, 2));
    let error = with_parameters(Architecture::SkFlow.init(&device), given).expect_err("three are wrong");
    assert_eq!(error.missing, ["update_block.gru.pw.bias"]);
    assert_eq!(error.misshapen, ["fnet.conv1.bias (expected [64], found [2])"]);
    assert_eq!(error.unknown, ["\\u{1b}[2J"], "control characters are escaped");
    assert_eq!(nearest.difference, Some(error));
}

#[test]
fn errors_list_at_most_ten_names() {
    let device = Device::flex();
    let error = load_network(Architecture::Raft, Path::new("../nn/tests/checkpoints/zip.pth"), &device)
        .expect_err("not RAFT");
    let message = error.to_string();
    let count = parameters(&Architecture::Raft.init(&device)).len();
    assert!(message.contains("zip.pth"), "{message}");
    assert!(message.contains(&format!("{count} missing: fnet.conv1.weight")), "{message}");
    assert!(message.contains(&format!("and {} more", count - 10)), "{message}");
    assert!(message.contains("8 unknown: conv1.bias"), "{message}");
    assert!(
        message.ends_with("no network of srflow has parameters with these names and shapes"),
        "{message}"
    );
}

/// The parameters of MemFlow have the names and shapes of SKFlow's, so only the text of a file distinguishes them.
#[test]
fn weights_that_identify_a_lookalike_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let network = Architecture::SkFlow.init(&Device::flex());
    let [of_memflow, ambiguous] =
        ["MemFlow_things.safetensors", "best.safetensors"].map(|name| folder.path().join(name));
    for path in [&of_memflow, &ambiguous] {
        save_parameters(&network, StoredAs::F32, None, path).expect("weights");
    }
    let error =
        load_network(Architecture::SkFlow, &of_memflow, &Device::flex()).expect_err("MemFlow's").to_string();
    assert!(error.contains("MemFlow_things") && error.contains("those of MemFlow"), "{error}");
    assert!(load_network(Architecture::SkFlow, &ambiguous, &Device::flex()).is_ok());
    assert_eq!(claim(Architecture::SkFlow, &ambiguous).expect("readable"), Claim::Ambiguous(&["MemFlow"]));
    let error =
        load_network(Architecture::Raft, &of_memflow, &Device::flex()).expect_err("not RAFT").to_string();
    let hint =
        "they are the parameters of memflow (or of SKFlow, whose parameters have the same names and shapes)";
    assert!(error.ends_with(hint), "{error}");

    assert!(load_network(Architecture::MemFlow, &of_memflow, &Device::flex()).is_ok());
    let of_skflow = folder.path().join("skflow_things.safetensors");
    save_parameters(&network, StoredAs::F32, None, &of_skflow).expect("weights");
    let error =
        load_network(Architecture::MemFlow, &of_skflow, &Device::flex()).expect_err("SKFlow's").to_string();
    assert!(error.contains("skflow_things") && error.contains("those of SKFlow"), "{error}");
    assert!(
        load_to_train(Architecture::MemFlow, &of_skflow, &Device::flex()).is_ok(),
        "allowed as a start for training"
    );
    for (path, first) in [(&of_memflow, "memflow"), (&of_skflow, "skflow"), (&ambiguous, "skflow")] {
        let fits = fits_of_file(path).expect("readable");
        assert_eq!(fits[0].architecture.name(), first, "{}", path.display());
    }
}

/// Settings that a network was trained with are applied when its weights are loaded.
#[test]
fn settings_are_saved_with_the_weights() {
    let folder = tempfile::tempdir().expect("folder");
    let (plain, pytorch) = (folder.path().join("best.safetensors"), folder.path().join("best.ckpt"));
    for (architecture, name, value) in
        [(Architecture::RpkNet, "groups", 4), (Architecture::MemFlow, "train_avg_length", 1234)]
    {
        let mut network = architecture.init(&Device::flex());
        network.set(name, value).expect("allowed");
        save_network(&network, StoredAs::F32, &plain).expect("saved");
        let bytes = std::fs::read(&plain).expect("readable");
        save_network(&network, StoredAs::F32, &plain).expect("saved again");
        assert!(std::fs::read(&plain).expect("readable") == bytes, "the same bytes each time");
        save_network_pytorch(&network, &pytorch).expect("saved");
        for path in [&plain, &pytorch] {
            assert_eq!(
                claim(architecture, path).expect("readable"),
                Claim::Own,
                "its own name is in the file"
            );
            assert_eq!(fits_of_file(path).expect("readable")[0].architecture, architecture);
            let mut loaded = load_network(architecture, path, &Device::flex()).expect("its own weights");
            let found = loaded.settings().into_iter().find(|setting| setting.name == name);
            assert_eq!(found.map(|setting| *setting.value), Some(value), "{}", path.display());
        }
    }
}

/// Files of Hugging Face keep only one of the two names of a tensor that PyTorch stores twice.
#[test]
fn the_norm_of_a_shortcut_loads_by_its_second_name() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("model.safetensors");
    let network = Architecture::SeaRaftS.init(&Device::flex());
    let parameters = parameters(&network);
    let named = parameters.iter().map(|(name, data)| {
        let values = data.as_slice::<f32>().expect("f32");
        (name.replace(".downsample.1.", ".bn3."), data.shape().as_slice(), values)
    });
    std::fs::write(&path, safetensors_bytes(named, StoredAs::F32, None)).expect("written");
    let loaded = load_network(Architecture::SeaRaftS, &path, &Device::flex()).expect("its weights");
    assert!(srflow_nn::parameters(&loaded) == parameters);
}

/// Maps a name to that in the authors' TensorFlow checkpoint.
fn name_in_tensorflow(name: &str) -> String {
    let name = name.replace(".predict.", ".predict.conv.").replace("weight", "kernel").replace('.', "/");
    match name.split_once('/') {
        Some(("net1", rest)) if !rest.starts_with("features") => format!("net1/upper/{rest}"),
        Some(("net1", _)) => name,
        _ => name.replace("/features/", "/encoder/"),
    }
}

/// A checkpoint like those of `tf.train.Saver`: names, kernels `[height, width, inputs, outputs]`, and a separate table.
#[test]
fn a_tensorflow_checkpoint_of_flownet3_loads() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("snapshot-250000.index");
    let network = Architecture::FlowNet3Css.init(&Device::flex());
    let expected = parameters(&network);
    let mut entries = vec![(String::new(), vec![0x08, 1])];
    let mut tensors = Vec::new();
    for (name, data) in &expected {
        let numbers = data.as_slice::<f32>().expect("f32");
        let mut shape = data.shape().to_vec();
        let mut bytes: Vec<u8> = Vec::new();
        if let [outer, inner, height, width] = shape[..] {
            let taps = height * width;
            let order =
                (0..taps).flat_map(|tap| (0..inner).flat_map(move |i| (0..outer).map(move |o| (o, i, tap))));
            bytes.extend(order.flat_map(|(o, i, tap)| numbers[(o * inner + i) * taps + tap].to_le_bytes()));
            shape = vec![height, width, inner, outer];
        } else {
            bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        }
        let dimensions = shape.iter().flat_map(|&size| message(2, &number(1, size))).collect::<Vec<u8>>();
        let mut entry =
            [number(1, 1), message(2, &dimensions), number(4, tensors.len()), number(5, bytes.len())]
                .concat();
        entry.push(6 << 3 | 5);
        entry.extend(masked_crc32c(&bytes).to_le_bytes());
        entries.push((name_in_tensorflow(name), entry));
        tensors.extend(bytes);
    }
    entries.sort();
    std::fs::write(folder.path().join("snapshot-250000.data-00000-of-00001"), tensors).expect("tensors");
    let mut table = Vec::new();
    let place = block(&mut table, &entries);
    let index = block(&mut table, &[("z".to_owned(), place)]);
    let mut footer = [vec![0, 0], index].concat();
    footer.resize(40, 0);
    footer.extend(0xdb47_7524_8b80_fb57_u64.to_le_bytes());
    table.extend(footer);
    std::fs::write(&path, table).expect("a table");

    let loaded = load_network(Architecture::FlowNet3Css, &path, &Device::flex()).expect("its weights");
    assert!(parameters(&loaded) == expected);
    assert_eq!(fits_of_file(&path).expect("readable")[0].architecture, Architecture::FlowNet3Css);
}

fn varint(number: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    push_varint(&mut bytes, number as u64);
    bytes
}

/// A field of a protocol buffer.
fn number(field: u8, value: usize) -> Vec<u8> {
    [vec![field << 3], varint(value)].concat()
}

fn message(field: u8, content: &[u8]) -> Vec<u8> {
    [vec![field << 3 | 2], varint(content.len()), content.to_vec()].concat()
}

/// Appends a block of a LevelDB table, without shared prefixes, and returns its handle.
fn block(table: &mut Vec<u8>, entries: &[(String, Vec<u8>)]) -> Vec<u8> {
    let start = table.len();
    let mut bytes = Vec::new();
    for (key, value) in entries {
        bytes.push(0);
        bytes.extend(
            [varint(key.len()), varint(value.len()), key.as_bytes().to_vec(), value.clone()].concat(),
        );
    }
    bytes.extend([0_u32, 1].map(u32::to_le_bytes).concat());
    let len = bytes.len();
    bytes.push(0);
    let checksum = masked_crc32c(&bytes);
    table.extend(bytes);
    table.extend(checksum.to_le_bytes());
    [varint(start), varint(len)].concat()
}

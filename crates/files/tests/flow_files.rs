//! Flow files: written files are read back, files of other programs are read correctly, and broken files are refused with a
//! clear message.

use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use srflow_core::{FlowField, Size};
use srflow_files::{
    FileBytes, FlowFormat, NpzArray, encode_flow, encode_flow_half, read_flow, read_flow_as,
    read_npy_channels_first, write_flow, write_flow_as, write_npy, write_npz,
};

const FLOAT_FORMATS: [FlowFormat; 5] =
    [FlowFormat::Flo, FlowFormat::Pfm, FlowFormat::Flo5, FlowFormat::Npy, FlowFormat::Npz];

fn data(name: &str) -> PathBuf {
    PathBuf::from("tests/data").join(name)
}

fn flow_of(component: impl Strategy<Value = f32> + Clone) -> impl Strategy<Value = FlowField> {
    let pixel = prop_oneof![4 => [component.clone(), component], 1 => Just([f32::NAN; 2])];
    (1_usize..12, 1_usize..12).prop_flat_map(move |(width, height)| {
        prop::collection::vec(pixel.clone(), width * height)
            .prop_map(move |pixels| FlowField::from_pixels(width, height, pixels).unwrap())
    })
}

fn any_component() -> impl Strategy<Value = f32> + Clone {
    prop_oneof![
        -600.0_f32..600.0,
        prop::num::f32::NORMAL.prop_map(|x| x.clamp(-1e9, 1e9)),
        prop::num::f32::SUBNORMAL,
        Just(0.0),
        Just(-0.0),
    ]
}

/// Bit patterns, so that -0.0 and 0.0 differ; every NaN is the same.
fn bits(flow: &FlowField) -> Vec<[u32; 2]> {
    flow.pixels().iter().map(|pixel| pixel.map(|x| if x.is_nan() { u32::MAX } else { x.to_bits() })).collect()
}

/// The bytes of a file of this flow.
fn encoded(flow: &FlowField, format: FlowFormat) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("flow.{format}"));
    write_flow(&path, flow).unwrap();
    fs::read(path).unwrap()
}

fn read_bytes(folder: &Path, name: &str, bytes: &[u8]) -> Result<FlowField, String> {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    read_flow(&path).map_err(|error| error.to_string())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn float_formats_keep_every_bit(flow in flow_of(any_component())) {
        let folder = tempfile::tempdir().unwrap();
        for format in FLOAT_FORMATS {
            let again = read_bytes(folder.path(), "flow.any", &encoded(&flow, format)).unwrap();
            prop_assert_eq!(again.size(), flow.size());
            prop_assert_eq!(bits(&again), bits(&flow), "{}", format);
        }
    }

    #[test]
    fn png_keeps_every_step_of_its_grid(steps in flow_of((0_u16..=u16::MAX).prop_map(f32::from))) {
        for (format, per_pixel) in [(FlowFormat::KittiPng, 64.0), (FlowFormat::Png128, 128.0)] {
            let flow = FlowField::from_fn(steps.width(), steps.height(), |x, y| {
                steps.get(x, y).map(|step| (step - 32768.0) / per_pixel)
            });
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("flow.png");
            write_flow_as(&path, &flow, format).unwrap();
            prop_assert_eq!(bits(&read_flow_as(&path, format).unwrap()), bits(&flow));
        }
    }

    #[test]
    fn png_rounds_to_the_nearest_step(flow in flow_of(-200.0_f32..200.0)) {
        let folder = tempfile::tempdir().unwrap();
        for (format, largest_error) in [(FlowFormat::KittiPng, 1.0 / 128.0), (FlowFormat::Png128, 1.0 / 256.0)] {
            let path = folder.path().join(format!("flow.{format}"));
            write_flow(&path, &flow).unwrap();
            let again = read_flow(&path).unwrap();
            prop_assert_eq!(again.known(), flow.known());
            for (a, b) in again.pixels().as_flattened().iter().zip(flow.pixels().as_flattened()) {
                prop_assert!(b.is_nan() || (a - b).abs() <= largest_error, "{a} for {b}");
            }
        }
    }

    /// A file truncated anywhere is refused.
    #[test]
    fn truncated_files_are_refused(flow in flow_of(any_component()), cut in 0.0_f64..1.0) {
        let folder = tempfile::tempdir().unwrap();
        for format in FLOAT_FORMATS {
            let bytes = encoded(&flow, format);
            let left = &bytes[..(bytes.len() as f64 * cut) as usize];
            let error = read_bytes(folder.path(), &format!("cut.{format}"), left).unwrap_err();
            prop_assert!(error.contains(&format!("cut.{format}: ")), "{error}");
        }
    }

    #[test]
    fn extra_data_is_refused(flow in flow_of(-100.0_f32..100.0), tail in prop::collection::vec(any::<u8>(), 1..50)) {
        let folder = tempfile::tempdir().unwrap();
        for format in FlowFormat::ALL {
            let mut bytes = encoded(&flow, format);
            let whole = read_bytes(folder.path(), &format!("whole.{format}"), &bytes).unwrap();
            bytes.extend(&tail);
            let read = read_bytes(folder.path(), &format!("long.{format}"), &bytes);
            // Viewers accept bytes after these; less than a row, so that the size in the header is right.
            let accepted = match format {
                FlowFormat::KittiPng | FlowFormat::Png128 => true,
                FlowFormat::Flo => tail.len() < 8 * flow.width(),
                FlowFormat::Pfm => tail.len() < 12 * flow.width(),
                _ => false,
            };
            prop_assert_eq!(read.is_ok(), accepted, "{}", format);
            if let Ok(read) = read {
                prop_assert_eq!(bits(&read), bits(&whole), "{}", format);
            }
        }
    }

    /// Whatever bytes are changed, reading returns a flow of a size that the file can hold, or an error; it never panics.
    #[test]
    fn changed_bytes_never_panic(
        flow in flow_of(-100.0_f32..100.0),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let folder = tempfile::tempdir().unwrap();
        for format in FlowFormat::ALL {
            let mut bytes = encoded(&flow, format);
            for (index, byte) in &changes {
                let at = index.index(bytes.len());
                bytes[at] = *byte;
            }
            if let Ok(flow) = read_bytes(folder.path(), &format!("changed.{format}"), &bytes) {
                prop_assert!(flow.pixels().len() <= 1032 * bytes.len());
                prop_assert!(flow.pixels().iter().all(|[u, v]| u.is_finite() == v.is_finite()));
            }
        }
    }

    #[test]
    fn any_bytes_after_a_magic_never_panic(tail in prop::collection::vec(any::<u8>(), 0..300)) {
        let folder = tempfile::tempdir().unwrap();
        let one = FlowField::new(1, 1);
        for format in FlowFormat::ALL {
            let mut bytes = encoded(&one, format);
            bytes.truncate(8);
            bytes.extend(&tail);
            let _ = read_bytes(folder.path(), &format!("noise.{format}"), &bytes);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// The same for HDF5 files of h5py, which have more kinds of structures than ours.
    #[test]
    fn changed_bytes_of_hdf5_never_panic(
        which in 0_usize..4,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let name = ["spring.flo5", "shuffled.flo5", "latest.flo5", "contiguous_f16.flo5"][which];
        let mut bytes = fs::read(data(name)).unwrap();
        for (index, byte) in &changes {
            let at = index.index(bytes.len());
            bytes[at] = *byte;
        }
        let folder = tempfile::tempdir().unwrap();
        if let Ok(flow) = read_bytes(folder.path(), "changed.flo5", &bytes) {
            prop_assert!(flow.pixels().len() <= 1032 * bytes.len());
        }
    }
}

/// The flow that `tools/golden/files.py` wrote with every program.
fn golden() -> FlowField {
    read_flow(&data("flow.npy")).unwrap()
}

#[test]
fn files_of_other_programs_hold_the_same_flow() {
    let golden = golden();
    assert_eq!(golden.size(), Size::new(13, 9));
    let unknown: Vec<usize> =
        (0..golden.pixels().len()).filter(|i| golden.pixels()[*i][0].is_nan()).collect();
    assert_eq!(unknown, [2 * 13 + 5, 8 * 13 + 12]);
    let exact = [
        "flow_fortran.npy",
        "flow_f64_big_endian.npy",
        "flow.npz",
        "flow_compressed.npz",
        "flow_opencv.flo",
        "flow_kitti.png",
        "flow.pfm",
        "spring.flo5",
        "shuffled.flo5",
        "latest.flo5",
    ];
    for name in exact {
        let flow = read_flow(&data(name)).unwrap();
        assert_eq!(bits(&flow), bits(&golden), "{name}");
    }
    for name in ["flow_f16.npy", "contiguous_f16.flo5"] {
        let half = read_flow(&data(name)).unwrap();
        assert_eq!(half.known(), golden.known(), "{name}");
        for (a, b) in half.pixels().as_flattened().iter().zip(golden.pixels().as_flattened()) {
            assert!(b.is_nan() || (a - b).abs() <= b.abs() / 2048.0, "{name}: {a} for {b}");
        }
    }
    // Over 64 chunks: the index of one has two levels, that of the other is an array.
    for name in ["many_chunks.flo5", "many_chunks_latest.flo5"] {
        let flow = read_flow(&data(name)).unwrap();
        assert_eq!(bits(&flow), bits(&read_flow(&data("many_chunks.npy")).unwrap()), "{name}");
    }
}

#[test]
fn the_real_kitti_truth_has_its_known_statistics() {
    let path = Path::new("../../../shared/data/real-frames/kitti/flow_gt.png");
    if !path.exists() {
        eprintln!("skipped: shared-data: no {}", path.display());
        return;
    }
    let flow = read_flow(path).unwrap();
    let known: Vec<[f32; 2]> = flow.pixels().iter().copied().filter(|[u, _]| u.is_finite()).collect();
    let mean = |channel: usize| {
        known.iter().map(|pixel| f64::from(pixel[channel])).sum::<f64>() / known.len() as f64
    };
    // numpy: rgb = cv2.imread(path, -1)[..., ::-1]; ((rgb[..., :2][rgb[..., 2] > 0] - 32768.0) / 64).mean(0)
    assert_eq!((flow.size(), known.len()), (Size::new(1242, 375), 75_453));
    assert!(
        (mean(0) + 29.857_322_811_882_895).abs() < 1e-12 && (mean(1) - 14.984_259_033_769_366).abs() < 1e-12
    );
}

fn refusal(name: &str, bytes: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let error = read_bytes(folder.path(), name, bytes).unwrap_err();
    error.split_once(name).map(|(_, message)| message.to_owned()).unwrap_or(error)
}

fn flo(width: i32, height: i32, values: &[f32]) -> Vec<u8> {
    let mut bytes = b"PIEH".to_vec();
    bytes.extend(width.to_le_bytes());
    bytes.extend(height.to_le_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

#[test]
fn flo_errors_name_the_field() {
    let zeros = [0.0; 12];
    assert_eq!(refusal("a.flo", b""), ": header: expected 12 bytes, found a file of 0 bytes");
    assert_eq!(
        refusal("a.flo", b"HEIP\x01\0\0\0\x01\0\0\0\0\0\0\0\0\0\0\0"),
        ": magic: expected \"PIEH\", the start of a .flo file, found \"HEIP\""
    );
    assert_eq!(refusal("a.flo", &flo(0, 3, &[])), ": width: expected at least 1 pixel, found 0");
    assert_eq!(refusal("a.flo", &flo(2, -3, &zeros)), ": height: expected at least 1 pixel, found -3");
    let huge = refusal("a.flo", &flo(i32::MAX, i32::MAX, &zeros));
    assert_eq!(huge, ": size: expected at most 134217728 pixels, found 2147483647x2147483647 (WIDTHxHEIGHT)");
    assert_eq!(
        refusal("a.flo", &flo(3, 3, &zeros)),
        ": file size: expected 84 bytes according to the header, found 60 bytes: the file is truncated"
    );
    assert_eq!(
        refusal("a.flo", &flo(3, 1, &zeros)),
        ": file size: expected 36 bytes according to the header, found 60 bytes: something follows the data"
    );
}

#[test]
fn values_that_are_no_flow_are_named_by_their_pixel() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut values = [0.5; 12];
        values[2 * 4 + 1] = bad; // v of pixel 4: column 1 of row 1 at width 3
        let message = refusal("a.flo", &flo(3, 2, &values));
        assert!(message.starts_with(": pixel (1, 1): expected finite numbers"), "{message}");

        let mut pfm = b"PF\n2 2\n-1\n".to_vec();
        let bottom_right = [0., 0., 0., 1., bad, 0., 0., 0., 0., 0., 0., 0.];
        pfm.extend(bottom_right.iter().flat_map(|value| value.to_le_bytes()));
        let message = refusal("a.pfm", &pfm);
        assert!(message.starts_with(": pixel (1, 1): expected finite numbers"), "{message}");
    }
    let half_known = FlowField::from_pixels(2, 1, vec![[0.0, 0.0], [f32::NAN, 1.0]]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for format in FlowFormat::ALL {
        let path = folder.path().join(format!("flow.{format}"));
        let message = write_flow(&path, &half_known).unwrap_err().to_string();
        assert!(message.contains("pixel (1, 0): expected finite numbers, or NaN twice"), "{message}");
        assert!(!path.exists());
    }
}

#[test]
fn unrepresentable_values_are_reported_with_their_pixel() {
    let folder = tempfile::tempdir().unwrap();
    let beyond = [
        (FlowFormat::Flo, 1.1e9),
        (FlowFormat::KittiPng, 512.0),
        (FlowFormat::KittiPng, -512.01),
        (FlowFormat::Png128, 256.0),
    ];
    for (format, component) in beyond {
        let mut flow = FlowField::new(4, 3);
        flow.set(3, 2, [0.0, component]);
        let path = folder.path().join(format!("flow.{format}"));
        let message = write_flow(&path, &flow).unwrap_err().to_string();
        assert!(message.contains("pixel (3, 2): expected") && !path.exists(), "{message}");
    }
}

#[test]
fn a_checkpoint_is_no_archive_of_arrays() {
    for name in ["flow.npz", "flow.pt"] {
        let bytes = fs::read("../nn/tests/checkpoints/zip.pth").unwrap();
        let error = refusal(name, &bytes);
        assert!(error.contains("found a file of torch.save; save the arrays with numpy.savez"), "{error}");
    }
}

/// As of VIPER; other arrays are named.
#[test]
fn an_archive_may_hold_u_and_v() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let (u, v) = ([1.0, 2.0, f32::NAN, 4.0, 5.0, 6.0], [-1.0, -2.0, f32::NAN, -4.0, -5.0, -6.0]);
    let write = |arrays: &[(&str, NpzArray)]| write_npz(&path, arrays).unwrap();
    write(&[("u", NpzArray::Float(&[2, 3], &u)), ("v", NpzArray::Float(&[2, 3], &v))]);
    let flow = read_flow(&path).unwrap();
    assert_eq!((flow.width(), flow.height(), flow.get(1, 1)), (3, 2, [5.0, -5.0]));
    assert!(flow.get(2, 0)[0].is_nan());
    let error = || read_flow(&path).unwrap_err().to_string();
    write(&[("u", NpzArray::Float(&[2, 3], &u)), ("v", NpzArray::Float(&[3, 2], &v))]);
    assert!(error().contains("expected (H, W) of both u and v, found [2, 3] and [3, 2]"), "{}", error());
    write(&[("back", NpzArray::Float(&[2, 3], &u)), ("forth", NpzArray::Float(&[2, 3], &v))]);
    let expected = "arrays: expected one, or one named `flow`, or `u` and `v`, found back, forth";
    assert!(error().contains(expected), "{}", error());
}

#[test]
fn channels_may_come_first() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let values = [1.0, 2.0, 3.0, 4.0, 5.0, f32::NAN, -1.0, -2.0, -3.0, -4.0, -5.0, f32::NAN];
    for shape in [&[2, 2, 3][..], &[1, 2, 2, 3]] {
        write_npy(&path, shape, &values).unwrap();
        let flow = read_npy_channels_first(&path).unwrap();
        assert_eq!((flow.width(), flow.height()), (3, 2));
        assert_eq!((flow.get(0, 0), flow.get(1, 1)), ([1.0, -1.0], [5.0, -5.0]));
        assert!(flow.get(2, 1)[0].is_nan());
    }
    for (shape, expected) in [
        (&[2, 3, 2][..], "finite numbers, or NaN twice"),
        (&[3, 2, 2], "expected (2, H, W) for a flow, channels first, found [3, 2, 2]"),
        (&[12], "(2, H, W)"),
    ] {
        write_npy(&path, shape, &[&values[..6], &[0.0; 6]].concat()).unwrap();
        let error = read_npy_channels_first(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    write_npy(&path, &[2, 0, 3], &[]).unwrap();
    assert!(read_npy_channels_first(&path).is_err());
}

#[test]
fn npy_errors_name_the_field() {
    let with = |dictionary: &str| {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((dictionary.len() as u16).to_le_bytes());
        bytes.extend(dictionary.as_bytes());
        bytes.extend([0; 16]);
        refusal("a.npy", &bytes)
    };
    let message = with("{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2, 3), }");
    assert_eq!(message, ": shape: expected (H, W, 2) for a flow, found [1, 2, 3]");
    let message = with("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 1, 3), }");
    assert!(message.contains("`convert` has a setting for channels first"), "{message}");
    let message = with("{'descr': '<c8', 'fortran_order': False, 'shape': (1, 2, 2), }");
    assert_eq!(
        message,
        ": descr: expected real numbers, integers or booleans (save with dtype float32), found '<c8'"
    );
    let message = with("{'descr': '<f4', 'shape': (1, 2, 2), }");
    assert!(message.starts_with(": fortran_order: expected an entry"), "{message}");
    let message = with("{'descr': '<f4', 'fortran_order': False, 'shape': (18446744073709551615, 2, 2), }");
    assert!(message.starts_with(": size: expected at most"), "{message}");
    let message = with("{'descr': '<f4', 'fortran_order': False, 'shape': (1, -2, 2), }");
    assert!(message.starts_with(": shape: expected a tuple of lengths"), "{message}");
    assert_eq!(
        with("{'descr': '<f4', 'fortran_order': False, 'shape': (9, 9, 2), }"),
        ": file size: expected 720 bytes according to the header, found 88 bytes: the file is truncated"
    );
    let message = refusal("a.npy", b"\x93NUMPY\x01\x00\xff\xff{}");
    assert!(message.starts_with(": header length: expected"), "{message}");
}

#[test]
fn pfm_errors_name_the_field() {
    let message = refusal("a.pfm", b"Pf\n2 2\n-1.0\n0123456789abcdef");
    assert_eq!(message, ": magic: expected \"PF\", the start of a .pfm file of three channels, found \"Pf\"");
    let message = refusal("a.pfm", b"PF\n2 two\n-1.0\n");
    assert_eq!(message, ": height: expected a whole number, found \"two\"");
    let message = refusal("a.pfm", b"PF\n2 2\n0\n");
    assert_eq!(message, ": scale: expected a number whose sign is the byte order, such as -1.0, found \"0\"");
    let message = refusal("a.pfm", b"PF\n99999999999999999999 2\n-1\n");
    assert!(message.starts_with(": width: expected a whole number"), "{message}");
}

#[test]
fn white_space_and_comments_in_a_pfm_header_are_skipped() {
    let folder = tempfile::tempdir().unwrap();
    let values: Vec<u8> = [1.5_f32, -2.0, 0.0, 0.25, 4.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    for header in [
        "PF\n2 1\n-1.0\n",
        "PF\r\n2 1\r\n-1.0\r\n",
        "PF  2\t1\n\n-1.000000 \n",
        "PF\n# made by hand\n 2 1 \n-1\n",
    ] {
        let bytes = [header.as_bytes(), &values].concat();
        let flow = read_bytes(folder.path(), "a.pfm", &bytes).unwrap();
        assert_eq!(flow.pixels(), [[1.5, -2.0], [0.25, 4.0]], "{header:?}");
    }
}

/// `bytes` with the first place that holds `from` holding `to`.
fn replaced(mut bytes: Vec<u8>, from: &[u8], to: &[u8]) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|window| window == from).unwrap();
    bytes[at..at + to.len()].copy_from_slice(to);
    bytes
}

#[test]
fn flo5_errors_name_the_field() {
    let spring = || fs::read(data("spring.flo5")).unwrap();
    let contiguous = || fs::read(data("contiguous_f16.flo5")).unwrap();
    let message = refusal("a.flo5", &replaced(spring(), b"flow\0", b"flux\0"));
    assert_eq!(message, ": root group: expected a dataset `flow`, found no dataset of this name");
    let message = refusal("a.flo5", &spring()[..4000]);
    assert_eq!(
        message,
        ": end of file address: expected 4000, the size of the file, found 5071: the file is truncated"
    );

    let shape = |sides: [u64; 3]| sides.map(u64::to_le_bytes).concat();
    let huge = shape([8192, 16384, 2]);
    let message = refusal("a.flo5", &replaced(spring(), &shape([9, 13, 2]), &shape([9, 12, 2])));
    let expected = ": chunk shape: expected at least 1 and at most [9, 12, 2] values of 4 bytes, found [9, 13, 2] of 4 bytes";
    assert_eq!(message, expected);
    let message = refusal("a.flo5", &replaced(spring(), &shape([9, 13, 2]), &huge));
    let expected = ": chunks: expected chunks of [9, 13, 2] that tile [8192, 16384, 2], found 1 chunks, 1 of them at expected positions";
    assert_eq!(message, expected);
    let message = refusal("a.flo5", &replaced(contiguous(), &shape([9, 13, 2]), &huge));
    assert_eq!(
        message,
        ": file size: expected 536870912 bytes according to the header, found 468 bytes: the file is truncated"
    );
    let plane = replaced(contiguous(), &shape([9, 13, 2]), &shape([9, 26, 1]));
    let message = refusal("a.flo5", &plane);
    assert_eq!(message, ": shape of the dataset `flow`: expected (H, W, 2), found [9, 26, 1]");
}

/// A tree whose node is its own child would be traversed forever.
#[test]
fn a_loop_in_an_hdf5_file_is_refused() {
    let mut bytes = fs::read(data("many_chunks.flo5")).unwrap();
    let is_root = |at: &usize| bytes[*at..].starts_with(b"TREE\x01\x01"); // a chunk tree of level 1
    let root = (0..bytes.len()).find(is_root).unwrap();
    let first_child = root + 24 + 40;
    bytes[first_child..first_child + 8].copy_from_slice(&(root as u64).to_le_bytes());
    let message = refusal("a.flo5", &bytes);
    assert_eq!(message, ": chunk B-tree: expected a tree, found a cycle of nodes");
}

#[test]
fn a_flow_without_pixels_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    for format in FlowFormat::ALL {
        let path = folder.path().join(format!("flow.{format}"));
        let message = write_flow(&path, &FlowField::new(0, 5)).unwrap_err().to_string();
        assert!(
            message.ends_with(": width: expected at least 1 pixel, found 0") && !path.exists(),
            "{message}"
        );
    }
}

#[test]
fn pfm_of_either_byte_order_is_read_from_the_bottom() {
    let rows_from_below = [[3.0_f32, 4.0, 0.0], [1.0, 2.0, 0.0]];
    for (scale, big_endian) in [("-1.0", false), ("0.5", true)] {
        let mut bytes = format!("PF\n1 2\n{scale}\n").into_bytes();
        let values = rows_from_below.as_flattened().iter();
        bytes.extend(values.flat_map(|v| if big_endian { v.to_be_bytes() } else { v.to_le_bytes() }));
        let folder = tempfile::tempdir().unwrap();
        let flow = read_bytes(folder.path(), "a.pfm", &bytes).unwrap();
        assert_eq!(flow.pixels(), [[1.0, 2.0], [3.0, 4.0]], "{scale}");
    }
}

#[test]
fn a_picture_is_no_kitti_flow() {
    let message = fs::read(data("disc_flow_vis.png")).map(|bytes| refusal("a.png", &bytes)).unwrap();
    assert!(
        message.contains("pixel format: expected KITTI's flow format") && message.contains("found 8 bits"),
        "{message}"
    );
}

#[test]
fn a_png_that_claims_more_than_deflate_can_hold_is_refused() {
    let mut bytes = encoded(&FlowField::new(4, 4), FlowFormat::KittiPng);
    bytes[16..20].copy_from_slice(&10_000_u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&10_000_u32.to_be_bytes());
    let message = refusal("a.png", &bytes);
    assert!(message.starts_with(": compressed data: expected enough for the 600000000 bytes"), "{message}");
}

#[test]
fn an_unknown_kind_of_file_lists_the_formats() {
    let message = refusal("a.txt", b"hello there");
    assert_eq!(
        message,
        ": format: expected a flow file (flo, png, png128, pfm, flo5, npy, npz, npz16), found an unknown extension and unknown first \
         bytes: \"hello th\""
    );
    let missing = read_flow(Path::new("/nowhere/at/all.flo")).unwrap_err().to_string();
    assert!(missing.starts_with("/nowhere/at/all.flo: opening: "), "{missing}");
    let folder = tempfile::tempdir().unwrap();
    assert!(read_flow(folder.path()).unwrap_err().to_string().contains("found a folder"));
}

#[test]
fn the_start_of_a_file_says_more_than_its_extension() {
    let folder = tempfile::tempdir().unwrap();
    let flow = FlowField::filled(3, 2, [1.5, -2.0]);
    for format in FlowFormat::ALL.into_iter().filter(|format| *format != FlowFormat::Png128) {
        let path = folder.path().join("misnamed.flo");
        write_flow_as(&path, &flow, format).unwrap();
        assert_eq!(read_flow(&path).unwrap(), flow, "{format}");
    }
}

#[test]
fn float16_rounds_to_the_nearest_and_refuses_large_flow() {
    let read = |bytes: &[u8]| FileBytes { name: "a.npy".as_ref(), bytes }.flow().unwrap();
    let values = [0.0, -0.0, 0.1, -3.2109, 15.999, 16.001, 127.93, -511.7, 1e-9, f32::NAN];
    let flow = FlowField::from_fn(values.len(), 3, |x, y| {
        [values[x], if values[x].is_nan() { f32::NAN } else { y as f32 }]
    });
    let bytes = encode_flow_half(&flow).unwrap();
    assert_eq!(bytes.len() % 64, (2 * 2 * 3 * values.len()) % 64, "the values start at a multiple of 64");
    let found = read(&bytes);
    assert_eq!(found.size(), flow.size());
    for (found, value) in found.row(2).iter().zip(values) {
        let most = match value.abs() {
            length if length < 16.0 => 1.0 / 256.0,
            length if length < 128.0 => 1.0 / 32.0,
            _ => 1.0 / 8.0,
        };
        assert!(
            (found[0] - value).abs() <= most || (found[0].is_nan() && value.is_nan()),
            "{found:?} {value}"
        );
    }
    // What float16 holds stays as it is, and encoding again changes nothing.
    assert_eq!(encode_flow_half(&found).unwrap(), bytes);
    let far = FlowField::from_fn(2, 1, |x, _| [0.0, -512.0 * x as f32]);
    let error = encode_flow_half(&far).unwrap_err().to_string();
    assert!(
        error.contains("pixel (1, 0): expected components below 512 pixels") && error.contains("float32"),
        "{error}"
    );
}

#[test]
fn flow_in_memory_is_flow_in_files() {
    let folder = tempfile::tempdir().unwrap();
    let flow = FlowField::from_fn(7, 5, |x, y| [0.25 * x as f32 - 1.0, 0.5 * y as f32]);
    for format in FlowFormat::ALL {
        let path = folder.path().join(format!("a.{}", format.extension()));
        write_flow(&path, &flow).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(encode_flow(&flow, format).unwrap(), bytes, "{format}");
        assert_eq!(FileBytes { name: &path, bytes: &bytes }.flow().unwrap(), flow, "{format}");
    }
}

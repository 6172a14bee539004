use std::io::{Read as _, Write as _};
use std::path::PathBuf;

use flate2::read::GzDecoder;
use glam::{DMat3, DQuat, DVec3, EulerRot};

use super::*;
use crate::sh;
use crate::tests::scenes::random;

/// A file of four Gaussians, as `tools/parity/splats.mjs` wrote it with the programs of the formats.
fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("src/files/golden").join(name)
}

fn written(gaussians: &Gaussians, name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    write_gaussians(&path, gaussians).unwrap();
    (folder, path)
}

/// Largest differences that a format may make.
struct Tolerance {
    position: f32,
    /// Of the logarithm.
    scale: f32,
    /// Degrees.
    rotation: f64,
    opacity: f32,
    color: f32,
    /// Spherical harmonics of degree 1, and above.
    rest: [f32; 2],
}

const EXACT: Tolerance =
    Tolerance { position: 0.0, scale: 1e-5, rotation: 1e-4, opacity: 1e-6, color: 0.0, rest: [0.0; 2] };
/// Half a step of each list: 2^-20 in position, 1/16 in ln(scale), 1/255 in opacity, 8/128 and 16/128 in the harmonics (and a rounding).
const SPZ: Tolerance = Tolerance {
    position: 5e-7,
    scale: 0.0313,
    rotation: 0.27,
    opacity: 0.002,
    color: 0.0132,
    rest: [0.0352, 0.0664],
};

/// The angle between two rotations, in degrees.
fn apart(a: Quat, b: Quat) -> f64 {
    let (a, b) = (a.as_dquat().normalize(), b.as_dquat().normalize());
    let chord = (a - b).length().min((a + b).length());
    4.0 * (chord / 2.0).asin().to_degrees()
}

#[track_caller]
fn assert_near(a: &Gaussians, b: &Gaussians, most: &Tolerance) {
    assert_eq!((a.len(), a.sh_degree, a.antialiased), (b.len(), b.sh_degree, b.antialiased));
    for i in 0..a.len() {
        let moved = (a.positions[i] - b.positions[i]).abs().max_element();
        assert!(moved <= most.position, "position {i}: {moved}");
        for (s, t) in a.scales[i].to_array().into_iter().zip(b.scales[i].to_array()) {
            assert!((s.ln() - t.ln()).abs() <= most.scale, "scale {i}: {s} {t}");
        }
        let angle = apart(a.rotations[i], b.rotations[i]);
        assert!(angle <= most.rotation, "rotation {i}: {angle} degrees");
        let (o, p) = (a.opacities[i], b.opacities[i]);
        assert!((o - p).abs() <= most.opacity, "opacity {i}: {o} {p}");
        let of = |set: &Gaussians| set.sh[i * set.sh_len()..][..set.sh_len()].to_vec();
        for (k, (c, d)) in of(a).into_iter().zip(of(b)).enumerate() {
            let limit = match k {
                0 => most.color,
                1..4 => most.rest[0],
                _ => most.rest[1],
            };
            for channel in 0..3 {
                assert!((c[channel] - d[channel]).abs() <= limit, "coefficient {k} of {i}: {c:?} {d:?}");
            }
        }
    }
}

/// Within the range of every format: no zero scale, coefficients within 0.9.
fn moderate(degree: usize) -> Gaussians {
    let mut gaussians = random(degree as u64, 40, degree);
    gaussians.opacities[..2].copy_from_slice(&[0.0, 1.0]);
    gaussians.antialiased = degree % 2 == 1;
    gaussians.scales.iter_mut().for_each(|scale| *scale = scale.max(Vec3::splat(1e-4)));
    gaussians.sh.iter_mut().flatten().for_each(|channel| *channel = channel.clamp(-0.9, 0.9));
    gaussians
}

#[test]
fn every_format_is_read_again() {
    for degree in 0..=3 {
        let gaussians = moderate(degree);
        for (name, tolerance) in [("a.PLY", &EXACT), ("a.glb", &EXACT), ("a.spz", &SPZ)] {
            let (_folder, path) = written(&gaussians, name);
            assert_near(&gaussians, &read_gaussians(&path).unwrap(), tolerance);
        }
    }
}

/// A `.splat` keeps positions and scales, and 8 bits of the rest, in the order of importance.
#[test]
fn a_splat_keeps_what_it_can() {
    let gaussians = moderate(2);
    let (_folder, path) = written(&gaussians, "a.splat");
    assert_eq!(std::fs::metadata(&path).unwrap().len(), 40 * 32);
    let read = read_gaussians(&path).unwrap();
    assert_eq!((read.len(), read.sh_degree, read.antialiased), (40, 0, false));
    let mut places = Vec::new();
    for i in 0..40 {
        let found = read.positions.iter().position(|position| *position == gaussians.positions[i]).unwrap();
        places.push((gaussians.scales[i].element_product() * gaussians.opacities[i], found));
        assert_eq!(read.scales[found], gaussians.scales[i]);
        assert!((read.opacities[found] - gaussians.opacities[i]).abs() <= 0.002);
        assert!(apart(read.rotations[found], gaussians.rotations[i]) <= 1.2);
        for (c, d) in read.sh[found].into_iter().zip(gaussians.sh[9 * i]) {
            assert!((c - d).abs() <= 0.007, "{c} {d}");
        }
    }
    places.sort_by_key(|(_, found)| *found);
    assert!(places.is_sorted_by(|a, b| a.0 >= 0.999 * b.0), "{places:?}");
}

#[test]
fn splat_bytes_are_those_of_antimatter15() {
    let (_folder, path) = written(&read_ply(&golden("tiny.ply")).unwrap(), "a.splat");
    assert_eq!(std::fs::read(path).unwrap(), std::fs::read(golden("tiny.splat")).unwrap());
}

#[test]
fn spz_lists_are_those_of_the_reference() {
    let mut gaussians = read_ply(&golden("tiny.ply")).unwrap();
    gaussians.antialiased = true;
    let mut expected = Vec::new();
    let file = std::fs::File::open(golden("tiny-v3.spz")).unwrap();
    GzDecoder::new(file).read_to_end(&mut expected).unwrap();
    assert_eq!(spz::pack(&gaussians).unwrap(), expected);

    // A coordinate of 1500 leaves 12 fractional bits, as the reference always takes.
    let coarse = Tolerance { position: 1.3e-4, ..SPZ };
    assert_near(&gaussians, &read_gaussians(&golden("tiny-v3.spz")).unwrap(), &coarse);
    let eight_bits = Tolerance { rotation: 12.5, ..coarse };
    assert_near(&gaussians, &read_gaussians(&golden("tiny-v2.spz")).unwrap(), &eight_bits);
}

#[test]
fn glb_of_splat_transform_is_read() {
    let mut gaussians = read_ply(&golden("tiny.ply")).unwrap();
    let [ply, glb] = ["a.ply", "a.glb"].map(|name| SplatFormat::of(name.as_ref()).unwrap());
    let turn = ply.turn_to(Up::MinusY, glb, Up::PlusY).unwrap();
    assert_eq!(glb.turn_to(Up::PlusY, ply, Up::MinusY), Some(turn));
    assert_eq!(glb.turn_to(Up::PlusY, ply, Up::PlusY), None);
    gaussians.half_turn(turn);
    // Its own axes are turned too, which is the same Gaussian.
    let own = DQuat::from_rotation_z(std::f64::consts::PI);
    gaussians.rotations.iter_mut().for_each(|rotation| *rotation = (rotation.as_dquat() * own).as_quat());
    let tolerance = Tolerance { position: 1e-4, color: 1e-6, rest: [1e-6; 2], ..EXACT };
    assert_near(&gaussians, &read_gaussians(&golden("tiny.glb")).unwrap(), &tolerance);
}

#[test]
fn compressed_ply_of_supersplat_is_read() {
    let [found, expected] =
        ["tiny.compressed.ply", "tiny-decompressed.ply"].map(|name| read_ply(&golden(name)).unwrap());
    assert_near(&expected, &found, &Tolerance { position: 1e-4, color: 1e-6, rest: [1e-6; 2], ..EXACT });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.compressed.ply");
    let whole = std::fs::read(golden("tiny.compressed.ply")).unwrap();
    for (from, to, expected) in [
        ("element chunk 1", "element chunk 2", "bytes for 2 of chunk, 4 of vertex, 4 of sh"),
        ("element sh 4", "element sh 3", "bytes for 1 of chunk, 4 of vertex, 3 of sh"),
        ("float max_scale_z", "float other_limit", "`max_scale_z` of a compressed file"),
        ("uint packed_color", "uint packed_paint", "`packed_color` of a compressed file"),
        ("uchar f_rest_44", "uchar f_rest_99", "`f_rest_44` of a compressed file"),
    ] {
        let at = whole.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut broken = whole.clone();
        broken.splice(at..at + from.len(), to.bytes());
        std::fs::write(&path, broken).unwrap();
        let error = read_ply(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn sog_of_splat_transform_is_read() {
    let [found, expected] =
        ["tiny.sog", "tiny-of-sog.ply"].map(|name| read_gaussians(&golden(name)).unwrap());
    assert_near(&expected, &found, &Tolerance { position: 1e-4, color: 1e-6, rest: [1e-6; 2], ..EXACT });
}

/// Files are read in full; what their description claims is compared with their pictures and their size.
#[test]
fn a_sog_with_another_description_is_refused() {
    use std::io::{Read as _, Write as _};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sog");
    let with = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut whole = zip::ZipArchive::new(std::fs::File::open(golden("tiny.sog")).unwrap()).unwrap();
        let mut out = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
        for at in 0..whole.len() {
            let mut entry = whole.by_index(at).unwrap();
            let name = entry.name().unwrap().to_string();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            if name == "meta.json" {
                let mut meta = serde_json::from_slice(&bytes).unwrap();
                change(&mut meta);
                bytes = meta.to_string().into_bytes();
            }
            out.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
            out.write_all(&bytes).unwrap();
        }
        out.finish().unwrap();
        read_gaussians(&path).map_err(|error| error.to_string())
    };
    assert_eq!(with(&|_| ()).unwrap().len(), 4);
    assert_eq!(with(&|meta| meta["count"] = 3.into()).unwrap().len(), 3);
    // A list that lacks its first number.
    assert!(with(&|meta| meta["scales"]["codebook"][0] = serde_json::Value::Null).is_ok());
    type Change<'a> = &'a dyn Fn(&mut serde_json::Value);
    let cases: [(Change, &str); 6] = [
        (&|meta| meta["count"] = 100.into(), "one pixel for each of 100 Gaussians"),
        (&|meta| meta["count"] = (1_u64 << 40).into(), "count: expected at most"),
        (&|meta| meta["version"] = 3.into(), "version: expected 1 or 2, found 3"),
        (&|meta| meta["quats"]["files"][0] = "none.webp".into(), "expected `none.webp`, as in a .sog file"),
        (&|meta| meta["shN"]["bands"] = 2.into(), "shN: expected a picture of 64 centroids"),
        (
            &|meta| meta["sh0"]["codebook"] = serde_json::json!([1.0, 2.0]),
            "sh0: expected a codebook of 256 numbers",
        ),
    ];
    for (change, expected) in cases {
        let error = with(change).unwrap_err();
        assert!(error.contains(expected), "{error}");
    }
}

/// The nodes of a scene turn, enlarge and move their Gaussians, and sets of several degrees become one.
#[test]
fn nodes_place_their_gaussians() {
    let (small, large) = (moderate(1), moderate(3));
    let mut builder = crate::gltf::GltfBuilder::new();
    builder.add_gaussians(&small).unwrap();
    builder.add_gaussians(&large).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    builder.write(&path).unwrap();
    let turn = DQuat::from_euler(EulerRot::XYZ, 0.4, -1.1, 2.0);
    let placed = format!(
        r#"{{"mesh":1,"name":"splats","rotation":[{},{},{},{}],"scale":[2.0,2.0,2.0],"translation":[1.0,2.0,3.0]}}"#,
        turn.x, turn.y, turn.z, turn.w
    );
    let text = r#"{"mesh":1,"name":"splats"}"#;
    edit(&path, |json| json.replace(text, &placed));
    let read = read_gaussians(&path).unwrap();
    let mut expected = large.clone();
    for i in 0..expected.len() {
        expected.positions[i] =
            (turn * expected.positions[i].as_dvec3() * 2.0).as_vec3() + Vec3::new(1.0, 2.0, 3.0);
        expected.scales[i] *= 2.0;
        expected.rotations[i] = (turn * expected.rotations[i].as_dquat()).as_quat();
    }
    sh::rotate(3, &mut expected.sh, DMat3::from_quat(turn));
    let tail = |set: &Gaussians| Gaussians {
        positions: set.positions[40..].to_vec(),
        scales: set.scales[40..].to_vec(),
        rotations: set.rotations[40..].to_vec(),
        opacities: set.opacities[40..].to_vec(),
        sh: set.sh[40 * 16..].to_vec(),
        ..set.clone()
    };
    expected.antialiased = true;
    let near = Tolerance { position: 1e-5, color: 1e-6, rest: [1e-6; 2], ..EXACT };
    assert_near(&expected, &tail(&read), &near);
    assert_eq!(read.sh[..4], small.sh[..4]);
    assert_eq!(read.sh[4..16], [[0.0; 3]; 12]);

    let stretched = placed.replace("[2.0,2.0,2.0]", "[2.0,1.0,2.0]");
    edit(&path, |json| json.replace(&placed, &stretched));
    let error = read_gaussians(&path).unwrap_err().to_string();
    assert!(error.contains("a.glb: coordinates: expected a rotation"), "{error}");
}

/// Rewrites the JSON of a `.glb` file.
fn edit(path: &Path, change: impl Fn(String) -> String) {
    let bytes = std::fs::read(path).unwrap();
    let end = 20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let old = String::from_utf8(bytes[20..end].to_vec()).unwrap();
    let mut new = change(old.clone());
    assert_ne!(old, new);
    while !new.len().is_multiple_of(4) {
        new.push(' ');
    }
    let mut edited = bytes[..8].to_vec();
    edited.extend(((bytes.len() - old.len() + new.len()) as u32).to_le_bytes());
    edited.extend((new.len() as u32).to_le_bytes());
    edited.extend(&bytes[16..20]);
    edited.extend(new.as_bytes());
    edited.extend(&bytes[end..]);
    std::fs::write(path, edited).unwrap();
}

#[test]
fn turning_twice_changes_nothing() {
    let gaussians = moderate(3);
    for turn in [HalfTurn::X, HalfTurn::Z] {
        let mut turned = gaussians.clone();
        turned.half_turn(turn);
        assert_ne!(gaussians, turned);
        turned.half_turn(turn);
        assert_eq!(gaussians, turned);
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn decode_spz(bytes: &[u8]) -> Result<Gaussians, String> {
    spz::decode(bytes, bytes.len() as u64, &mut Vec::new()).map_err(|error| error.to_string())
}

fn spz_error(packed: &[u8]) -> String {
    decode_spz(&gzip(packed)).unwrap_err()
}

#[test]
fn a_header_of_spz_is_believed_only_as_far_as_the_file_goes() {
    let packed = spz::pack(&moderate(1)).unwrap();
    let with = |at: usize, bytes: &[u8]| {
        let mut packed = packed.clone();
        packed[at..at + bytes.len()].copy_from_slice(bytes);
        packed
    };
    for (packed, expected) in [
        (with(0, b"PSGN"), "magic: expected NGSP"),
        (with(4, &[1]), "version: expected 2 or 3"),
        (with(4, &[4]), "version: expected 2 or 3"),
        (with(8, &[255; 4]), "at most 10000000, found 4294967295"),
        (with(8, &9_000_000_u32.to_le_bytes()), "at most what a file of"),
        (with(8, &39_u32.to_le_bytes()), "bytes for 39 Gaussians, found more"),
        (with(8, &41_u32.to_le_bytes()), "bytes for 41 Gaussians, found fewer"),
        (with(12, &[4]), "degree of the spherical harmonics: expected 0 to 3, found 4"),
        (with(13, &[25]), "fractional bits: expected 0 to 24, found 25"),
        (packed[..packed.len() - 1].to_vec(), "found fewer"),
    ] {
        let error = spz_error(&packed);
        assert!(error.contains(expected), "{error}");
    }
    // Records may follow the lists, where the flags say so.
    let mut extended = with(14, &[2]);
    extended.extend([7, 0, 0, 0, 3, 0, 0, 0, 1, 2, 3]);
    let mut unknown = Vec::new();
    spz::decode(&gzip(&extended)[..], 1 << 20, &mut unknown).unwrap();
    assert_eq!(unknown, ["0x00000007"]);
    extended.push(0);
    assert!(spz_error(&extended).contains("extensions: expected whole records"));
    extended[14] = 0;
    assert!(spz_error(&extended).contains("found more"));

    let whole = gzip(&packed);
    let error = decode_spz(&whole[..whole.len() / 2]).unwrap_err();
    assert!(error.contains("gzip: expected a whole gzip stream"), "{error}");
    // What expands without end is read no further than the lists go.
    let bomb = gzip(&[packed.clone(), vec![0; 64 << 20]].concat());
    assert!(decode_spz(&bomb).unwrap_err().contains("found more"));
}

/// The files of versions 3 and 4 differ in the compression alone; records of extensions turn what they say.
#[test]
fn spz_streams_of_zstandard_are_read() {
    let read = |name: &str| read_gaussians(&golden(name)).unwrap();
    assert_eq!(read("tiny-v4.spz"), read("tiny-v3.spz"));
    let mut expected = read("tiny-of-v4-lfu.ply");
    expected.antialiased = true;
    let near = Tolerance { position: 1e-4, color: 1e-6, rest: [1e-6; 2], ..EXACT };
    let mut found = read("tiny-v4-lfu.spz");
    // Half a turn about an own axis leaves a Gaussian as it is.
    for (found, expected) in found.rotations.iter_mut().zip(&expected.rotations) {
        let half_turns =
            [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let all = half_turns.map(|turn| *found * Quat::from_array(turn));
        *found =
            all.into_iter().min_by(|a, b| apart(*a, *expected).total_cmp(&apart(*b, *expected))).unwrap();
    }
    assert_near(&expected, &found, &near);

    let whole = std::fs::read(golden("tiny-v4-lfu.spz")).unwrap();
    let with = |at: usize, bytes: &[u8]| {
        let mut bad = whole.clone();
        bad[at..at + bytes.len()].copy_from_slice(bytes);
        bad
    };
    for (bad, expected) in [
        (with(4, &[5]), "version: expected 4"),
        (with(4, &[3]), "version: expected 4"),
        (with(8, &[5]), "size of a list: expected 45 for 5 Gaussians, found 36"),
        (with(8, &[255; 4]), "at most what a file of"),
        (with(12, &[4]), "degree of the spherical harmonics"),
        (with(15, &[5]), "streams: expected one for each of 6 lists"),
        (with(15, &[7]), "streams: expected one for each of 6 lists"),
        (with(16, &[255; 4]), "file size"),
        (with(16, &[31]), "file size"),
        (with(60, &[9]), "coordinate system: expected 0 to 8 or 11 to 14"),
        (with(60, &[0, 0, 0, 1]), "coordinate system"),
        (with(56, &[5]), "extensions: expected whole records"),
        (with(64, &[255; 8]), "file size"),
        (with(64 + 96, &[0; 4]), "Zstandard: expected a stream of 36 bytes"),
        (whole[..whole.len() - 1].to_vec(), "file size"),
        ([&whole[..], &[0]].concat(), "file size"),
        (whole[..40].to_vec(), "file size"),
        (b"NGSP".to_vec(), "file size"),
    ] {
        let error = decode_spz(&bad).unwrap_err();
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

/// The axes that a record names, and where a Gaussian on the first, the second and the third then is.
#[test]
fn axes_of_spz_are_those_of_their_names() {
    let direction = |letter: u8| match letter {
        b'R' => Vec3::X,
        b'L' => -Vec3::X,
        b'U' => Vec3::Y,
        b'D' => -Vec3::Y,
        b'B' => Vec3::Z,
        _ => -Vec3::Z,
    };
    let names = ["LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF", "", "", "LFU", "RFU", "LBD", "RBD"];
    for (number, name) in (1_u32..).zip(names).filter(|(_, name)| !name.is_empty()) {
        let before = moderate(3);
        let mut after = before.clone();
        after.positions[..3].copy_from_slice(&[Vec3::X, Vec3::Y, Vec3::Z]);
        spz::turn(&mut after, number).unwrap();
        let axes: Vec<Vec3> = name.bytes().map(direction).collect();
        assert_eq!(after.positions[..3], axes[..], "{name}");
        // Covariances and colours move with them.
        let to = |v: DVec3| (0..3).map(|axis| v[axis] * axes[axis].as_dvec3()).sum::<DVec3>();
        let seen = |of: &Gaussians, i: usize, along: DVec3| {
            let own = of.rotations[i].as_dquat().inverse() * along;
            let color = sh::color(3, &of.sh[16 * i..][..16], along);
            ((own * of.scales[i].as_dvec3()).length(), color)
        };
        for (i, along) in [(5, DVec3::new(0.3, -0.5, 0.8)), (9, DVec3::new(-0.9, 0.1, 0.4))] {
            let (a, b) = (seen(&before, i, along), seen(&after, i, to(along)));
            assert!((a.0 - b.0).abs() < 1e-6, "{name}: {a:?} {b:?}");
            assert!(a.1.iter().zip(b.1).all(|(a, b)| (a - b).abs() < 1e-5), "{name}: {a:?} {b:?}");
        }
    }
}

#[test]
fn ksplats_of_gaussiansplats3d_are_read() {
    let mut expected = read_ply(&golden("tiny.ply")).unwrap();
    expected.sh_degree = 2;
    expected.sh = expected.sh.chunks(16).flat_map(|of_one| &of_one[..9]).copied().collect();
    // Colours are bytes, and harmonics of level 2 within 1.5.
    for color in expected.sh.iter_mut().step_by(9) {
        *color = color.map(|channel| channel.clamp(-1.7725, 1.7725));
    }
    let level_0 = Tolerance { opacity: 0.004, color: 0.0141, ..EXACT };
    let level_1 = Tolerance { position: 8e-5, scale: 1e-3, rotation: 0.1, rest: [5e-4; 2], ..level_0 };
    let level_2 = Tolerance { rest: [0.006; 2], ..level_1 };
    for (level, tolerance) in [level_0, level_1, level_2].iter().enumerate() {
        let found = read_gaussians(&golden(&format!("tiny-{level}.ksplat"))).unwrap();
        // Buckets have changed their order.
        let places = expected.positions.iter().map(|position| {
            let near = |place: &usize| (found.positions[*place] - *position).length() < 1e-3;
            (0..found.len()).find(near).unwrap()
        });
        let mut sorted = Gaussians { sh_degree: 2, ..Gaussians::default() };
        for place in places {
            sorted.positions.push(found.positions[place]);
            sorted.scales.push(found.scales[place]);
            sorted.rotations.push(found.rotations[place]);
            sorted.opacities.push(found.opacities[place]);
            sorted.sh.extend(&found.sh[9 * place..][..9]);
        }
        assert_near(&expected, &sorted, tolerance);
    }
}

#[test]
fn headers_of_ksplats_are_believed_only_as_far_as_the_file_goes() {
    let whole = std::fs::read(golden("tiny-1.ksplat")).unwrap();
    let with = |at: usize, bytes: &[u8]| {
        let mut bad = whole.clone();
        bad[at..at + bytes.len()].copy_from_slice(bytes);
        bad
    };
    let section = 4096;
    let most = [255; 4];
    for (bad, expected) in [
        (with(1, &[2]), "version: expected 0.1, found 0.2"),
        (with(20, &[3]), "compression: expected level 0, 1 or 2"),
        (with(4, &most), "file size"),
        (with(16, &[3]), "number of Gaussians: expected the 4 of its sections"),
        (with(section, &[5]), "number of Gaussians: expected the 5 of its sections"),
        (with(section + 4, &[3]), "room for 4 Gaussians"),
        (with(section + 4, &most), "file size"),
        (with(section + 12, &most), "file size"),
        (with(section + 32, &most), "buckets: expected"),
        (with(section + 36, &most), "buckets: expected"),
        (with(section + 40, &[4]), "degree of the spherical harmonics"),
        (with(section + 20, &[0]), "buckets: expected"),
        (whole[..whole.len() - 1].to_vec(), "file size"),
        (whole[..100].to_vec(), "file size"),
        (Vec::new(), "file size"),
    ] {
        let error = ksplat::decode(&bad, &mut Invisible::default()).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn what_has_no_form_in_a_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = |name: &str, change: &dyn Fn(&mut Gaussians)| {
        let mut gaussians = moderate(0);
        change(&mut gaussians);
        write_gaussians(&folder.path().join(name), &gaussians).unwrap_err().to_string()
    };
    for format in SPLAT_FORMATS.iter().filter(|format| format.is_written()) {
        let name = format!("a.{}", format.extension);
        assert!(error(&name, &|g| g.positions[3].x = f32::NAN).contains("position: expected finite numbers"));
        assert!(error(&name, &|g| g.scales[3].x = -1.0).contains("scale: expected finite lengths"));
        assert!(error(&name, &|g| g.opacities[3] = 1.5).contains("opacity: expected 0 to 1"));
        assert!(error(&name, &|g| _ = g.sh.pop()).contains("lists"));
    }
    assert!(error("a.spz", &|g| g.positions[0].y = 1e9).contains("coordinates up to 8388607"));
    assert!(error("a.glb", &|g| *g = Gaussians::default()).contains("one or more"));
    for other in ["ksplat", "sog"] {
        let error = error(&format!("a.{other}"), &|_| ());
        assert!(error.contains(&format!("expected .ply, .splat, .spz, .glb, found {other}")), "{error}");
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
}

#[test]
fn broken_splats_are_refused() {
    let good = std::fs::read(golden("tiny.splat")).unwrap();
    let decode = |bytes: &[u8]| splat::decode(&mut &*bytes, bytes.len() as u64, &mut Invisible::default());
    let error = |bytes: &[u8]| decode(bytes).unwrap_err().to_string();
    assert!(error(&[]).contains("a multiple of 32 bytes"));
    assert!(error(&good[..127]).contains("found 127 bytes"));
    let with = |at: usize, bytes: &[u8]| {
        let mut bad = good.clone();
        bad[at..at + bytes.len()].copy_from_slice(bytes);
        error(&bad)
    };
    assert!(with(76, &(-1.0_f32).to_le_bytes()).contains("not negative"));
    assert!(with(28, &[128; 4]).contains("zero of Gaussian 0"));
}

#[test]
fn broken_scenes_are_refused() {
    let (_folder, path) = written(&moderate(1), "a.glb");
    let whole = std::fs::read(&path).unwrap();
    for (from, to, expected) in [
        (r#""kernel":"ellipse""#, r#""kernel":"box""#, "kernel: expected ellipse, found box"),
        ("srgb_rec709_display", "lin_rec709_display", "colorSpace: expected srgb_rec709_display"),
        (r#""mode":0"#, r#""mode":4"#, "mode: expected 0"),
        (r#""count":40"#, r#""count":41"#, "bufferView: expected bytes inside its buffer"),
        (r#""count":40"#, r#""count":4000000000000"#, "no more elements than the file can hold"),
        (
            "KHR_gaussian_splatting:SCALE",
            "SCALE",
            "attributes: expected KHR_gaussian_splatting:SCALE, found none of this name",
        ),
        ("SH_DEGREE_1_COEF_2", "_SH", "SH_DEGREE_1_COEF_2"),
        (r#""mesh":0"#, r#""mesh":7"#, "mesh: expected one of the file's, found 7"),
        (r#""nodes":[0]"#, r#""nodes":[]"#, "none in the scene"),
    ] {
        std::fs::write(&path, &whole).unwrap();
        edit(&path, |json| json.replace(from, to));
        let error = read_gaussians(&path).unwrap_err().to_string();
        assert!(error.contains("a.glb: ") && error.contains(expected), "{from}: {error}");
    }
    std::fs::write(&path, &whole[..whole.len() - 1]).unwrap();
    assert!(read_gaussians(&path).unwrap_err().to_string().contains("a.glb: "));
}

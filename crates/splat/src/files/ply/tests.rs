use std::fs;

use glam::Quat;

use super::*;
use crate::tests::scenes::random;

fn in_memory(bytes: &[u8]) -> Result<Gaussians, FileProblem> {
    Ok(decode(&mut &*bytes, bytes.len() as u64, false)?.gaussians)
}

#[track_caller]
fn assert_same(a: &Gaussians, b: &Gaussians) {
    assert_eq!((a.len(), a.sh_degree), (b.len(), b.sh_degree));
    assert_eq!((&a.positions, &a.sh), (&b.positions, &b.sh));
    for i in 0..a.len() {
        let (s, t) = (a.scales[i], b.scales[i]);
        assert!((s - t).abs().max_element() <= 1e-5 * s.max_element(), "scale {i}: {s} {t}");
        assert!((a.opacities[i] - b.opacities[i]).abs() <= 1e-6, "opacity {i}");
        assert!((a.rotations[i] - b.rotations[i]).length() <= 1e-6, "rotation {i}");
    }
}

#[test]
fn every_degree_survives_writing_and_reading() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    for degree in 0..=3 {
        let mut gaussians = random(degree as u64, 50, degree);
        gaussians.opacities[..2].copy_from_slice(&[0.0, 1.0]);
        gaussians.scales[0] = Vec3::new(0.0, 1e-30, 1e30);
        write_ply(&path, &gaussians).unwrap();
        let back = read_ply(&path).unwrap();
        assert_same(&gaussians, &back);
        assert_eq!((back.opacities[0], back.opacities[1], back.scales[0].x), (0.0, 1.0, 0.0));
        let stride = 4 * (17 + 3 * (gaussians.sh_len() - 1));
        let text = fs::read(&path).unwrap();
        let header = String::from_utf8_lossy(&text[..text.len() - 50 * stride]).into_owned();
        assert!(
            header.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 50\nproperty float x\n")
        );
        assert!(header.ends_with("property float rot_3\nend_header\n"), "{header}");
    }
}

/// A file as written by another program: one Gaussian of degree 1, with other types, another order and more properties.
fn foreign(encoding: &str) -> Vec<u8> {
    let mut header = format!("ply\r\nformat {encoding} 1.0\r\ncomment made elsewhere\nelement vertex 1\n");
    let mut names: Vec<String> = (0..9).rev().map(|i| format!("f_rest_{i}")).collect();
    let others =
        ["opacity", "rot_0", "rot_1", "rot_2", "rot_3", "z", "y", "x", "scale_2", "scale_1", "scale_0"];
    names.extend(others.map(String::from));
    names.extend(["f_dc_2", "f_dc_1", "f_dc_0", "segment"].map(String::from));
    let values = [
        8., 7., 6., 5., 4., 3., 2., 1., 0., 0., 2., 0., 0., 0., 30., 20., 10., -3., -2., -1., 0.3, 0.2, 0.1,
        7.,
    ];
    let mut body = Vec::new();
    for (name, value) in names.iter().zip(values) {
        header += &format!("property double {name}\n");
        match encoding {
            "ascii" => body.extend(format!("{value} ").bytes()),
            "binary_big_endian" => body.extend(f64::to_be_bytes(value)),
            _ => body.extend(f64::to_le_bytes(value)),
        }
    }
    header += "property uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    body.extend(if encoding == "ascii" { b"255\n".to_vec() } else { vec![255] });
    body.extend(b"3 0 0 0\n");
    [header.into_bytes(), body].concat()
}

#[test]
fn other_orders_types_and_encodings_are_read() {
    for encoding in ["binary_little_endian", "binary_big_endian", "ascii"] {
        let gaussians = in_memory(&foreign(encoding)).unwrap();
        assert_eq!(gaussians.positions, [Vec3::new(10.0, 20.0, 30.0)], "{encoding}");
        assert_eq!(gaussians.rotations, [Quat::IDENTITY]);
        assert_eq!(gaussians.opacities, [0.5]);
        assert!((gaussians.scales[0] - Vec3::new(-1.0, -2.0, -3.0).exp()).length() < 1e-6);
        // Channel by channel: coefficient k of red is f_rest_k, of green f_rest_(3 + k), of blue f_rest_(6 + k).
        assert_eq!(gaussians.sh, [[0.1, 0.2, 0.3], [0., 3., 6.], [1., 4., 7.], [2., 5., 8.]]);
    }
}

#[test]
fn a_file_cut_anywhere_is_refused_without_a_panic() {
    for encoding in ["binary_little_endian", "ascii"] {
        let whole = foreign(encoding);
        // The missing bytes may belong to the face, or in ASCII to the last value: a shorter number is still a number.
        let undetected = if encoding == "ascii" { "255\n3 0 0 0\n".len() } else { "3 0 0 0\n".len() };
        for len in 0..whole.len() - undetected {
            assert!(in_memory(&whole[..len]).is_err(), "{encoding}, {len} bytes");
        }
    }
}

#[test]
fn flipped_bytes_never_panic() {
    let whole = foreign("binary_little_endian");
    for at in 0..whole.len() {
        for flip in [1, 0x20, 0x80, 0xFF] {
            let mut bytes = whole.clone();
            bytes[at] ^= flip;
            let _ = in_memory(&bytes);
        }
    }
}

fn message(bytes: &[u8]) -> String {
    in_memory(bytes).unwrap_err().to_string()
}

#[test]
fn errors_say_what_was_expected_and_found() {
    assert_eq!(
        message(b"PNG\n"),
        "magic: expected `ply` on the first line (formats by ending: .ply, .splat, .spz, .glb, .ksplat, .sog), found \"PNG\""
    );
    let text = String::from_utf8(foreign("ascii")).unwrap();
    let lie = text.replace("element vertex 1\n", "element vertex 9000000000000000000\n");
    assert!(message(lie.as_bytes()).contains("9000000000000000000 of vertex, 1 of face, found"), "{lie}");
    let cloud = text.replace("double opacity", "double confidence");
    let cloud = message(cloud.as_bytes());
    assert!(
        cloud.contains("`opacity`, a required property of 3D Gaussians, found 25 properties: f_rest_8"),
        "{cloud}"
    );
    let rest = text.replace("double f_rest_8", "double other");
    assert_eq!(
        message(rest.as_bytes()),
        "f_rest: expected 0, 9, 24 or 45 properties (degree 0 to 3), found 8 properties"
    );
    let word = text.replace(" 30 ", " thirty ");
    assert_eq!(message(word.as_bytes()), "body: expected a number, found \"thirty\" in row 0 of \"vertex\"");
    let zero = text.replace("0 2 0 0 0 30", "0 0 0 0 0 30");
    assert_eq!(
        message(zero.as_bytes()),
        "rotation: expected a quaternion that is not zero, found zero of Gaussian 0"
    );
    let large = text.replace(" -3 ", " 300 ");
    assert!(message(large.as_bytes()).starts_with("scale: expected logarithms of lengths"));
    let list = text.replace("property double opacity", "property list uchar int opacity");
    assert_eq!(
        message(list.as_bytes()),
        "vertex properties: expected single numbers, found the list `opacity`"
    );
    assert!(message(&[b"ply\n".as_slice(), &[b'x'; 100_000]].concat()).contains("`end_header` within"));
}

/// One of three Gaussians is as a program writes it that computes logit(1), logit(0), ln(0), or has lost a position.
#[test]
fn infinite_opacities_and_scales_are_values_and_numbers_that_are_none_make_a_gaussian_invisible() {
    let scene = random(1, 3, 1);
    let with = |name: &str, value: f32| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        write_ply(&path, &scene).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let header = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let names = String::from_utf8_lossy(&bytes[..header]).into_owned();
        let names: Vec<&str> =
            names.lines().filter_map(|line| line.strip_prefix("property float ")).collect();
        let at = names.iter().position(|property| *property == name).unwrap();
        let at = header + 4 * (names.len() + at);
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        decode(&mut &*bytes, bytes.len() as u64, false).unwrap()
    };
    for (name, value, opacity) in [("opacity", f32::INFINITY, 1.0), ("opacity", f32::NEG_INFINITY, 0.0)] {
        let read = with(name, value);
        assert_eq!((read.gaussians.opacities[1], read.invisible.0), (opacity, 0));
    }
    let flat = with("scale_2", f32::NEG_INFINITY);
    assert_eq!((flat.gaussians.scales[1].z, flat.invisible.0), (0.0, 0));
    assert_eq!(flat.gaussians.opacities[1].to_bits(), with("nx", 1.0).gaussians.opacities[1].to_bits());
    for name in ["x", "opacity", "scale_0", "rot_3", "f_dc_1", "f_rest_8"] {
        let Decoded { gaussians, invisible, .. } = with(name, f32::NAN);
        assert_eq!((gaussians.len(), gaussians.opacities[1], invisible.0), (3, 0.0, 1), "{name}");
        assert_eq!(gaussians.positions[0], scene.positions[0]);
        assert!(super::super::check(&gaussians).is_ok(), "{name}");
    }
}

/// Elements before the vertices are passed over, lists too.
#[test]
fn elements_before_the_vertices_are_skipped() {
    for encoding in ["binary_little_endian", "binary_big_endian", "ascii"] {
        let whole = foreign(encoding);
        let end = whole.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let header = String::from_utf8_lossy(&whole[..end]).into_owned();
        let header = header.replacen(
            "element vertex",
            "element time 2\nproperty short t\nproperty list uchar short parts\nelement vertex",
            1,
        );
        let rows: &[u8] = match encoding {
            "ascii" => b"7 0 8 2 5 6\n",
            "binary_big_endian" => &[0, 7, 0, 0, 8, 2, 0, 5, 0, 6],
            _ => &[7, 0, 0, 8, 0, 2, 5, 0, 6, 0],
        };
        let bytes = [header.as_bytes(), rows, &whole[end..]].concat();
        assert_eq!(in_memory(&bytes).unwrap(), in_memory(&whole).unwrap(), "{encoding}");
        let cut = &bytes[..header.len() + 4];
        assert!(in_memory(cut).is_err());
    }
}

#[test]
fn a_missing_file_is_named() {
    let error = read_ply(Path::new("/nowhere/a.ply")).unwrap_err().to_string();
    assert!(error.starts_with("/nowhere/a.ply: opening: "), "{error}");
}

#[test]
fn a_longer_file_than_its_header_says_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    write_ply(&path, &random(1, 3, 0)).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    bytes.push(0);
    let len = bytes.len();
    assert_eq!(
        message(&bytes),
        format!("file size: expected {} bytes for 3 of vertex, found {len} bytes", len - 1)
    );
}

#[test]
fn values_without_a_raw_form_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let spoil: [fn(&mut Gaussians); 5] = [
        |g| g.positions[2].y = f32::NAN,
        |g| g.scales[2].x = -1.0,
        |g| g.opacities[2] = 1.5,
        |g| g.rotations[2] = Quat::from_array([0.0; 4]),
        |g| g.sh[2][0] = f32::INFINITY,
    ];
    for spoil in spoil {
        let mut gaussians = random(1, 3, 0);
        spoil(&mut gaussians);
        let error = write_ply(&path, &gaussians).unwrap_err().to_string();
        assert!(error.contains("of Gaussian 2"), "{error}");
        assert!(!path.exists());
    }
}

#[test]
fn gaussians_bound_to_a_mesh_are_named_as_such() {
    let text = String::from_utf8(foreign("ascii")).unwrap().replace("segment", "binding_0");
    let error = in_memory(text.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("bound to a triangle") && error.contains("binding_0"), "{error}");
}

#[test]
fn bound_gaussians_survive_writing_and_reading_with_the_properties_of_gaussian_avatars() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("point_cloud.ply");
    for degree in [0, 2, 3] {
        let gaussians = random(degree as u64, 40, degree);
        let triangles: Vec<u32> = (0..40).map(|i| i * 257 % 10_144).collect();
        write_bound_ply(&path, &gaussians, &triangles).unwrap();
        let (back, bound_to) = read_bound_ply(&path).unwrap();
        assert_eq!((bound_to, back.sh_degree), (triangles, 3));
        let mut filled = Gaussians { sh_degree: 3, sh: Vec::new(), ..gaussians.clone() };
        for sh in gaussians.sh.chunks(gaussians.sh_len()) {
            filled.sh.extend(sh.iter().copied().chain(std::iter::repeat([0.0; 3])).take(16));
        }
        assert_same(&filled, &back);
    }
    let bytes = fs::read(&path).unwrap();
    let header = String::from_utf8_lossy(&bytes[..bytes.len() - 40 * 63 * 4]).into_owned();
    let names: Vec<&str> = header.lines().filter_map(|line| line.strip_prefix("property float ")).collect();
    assert_eq!((names.len(), &names[..6]), (63, &["x", "y", "z", "nx", "ny", "nz"][..]));
    assert_eq!(names[9..11], ["f_rest_0", "f_rest_1"]);
    assert_eq!(
        names[54..],
        ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "binding_0"]
    );
    assert!(read_ply(&path).unwrap_err().to_string().contains("bound to a triangle"));
}

#[test]
fn antialiased_gaussians_stay_antialiased() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    for antialiased in [false, true] {
        write_ply(&path, &Gaussians { antialiased, ..random(1, 2, 0) }).unwrap();
        assert_eq!(read_ply(&path).unwrap().antialiased, antialiased);
        let text = String::from_utf8_lossy(&fs::read(&path).unwrap()).into_owned();
        assert_eq!(text.contains("\ncomment SplatRenderMode: mip\n"), antialiased);
    }
    // As Brush marks others.
    let text = String::from_utf8(foreign("ascii")).unwrap();
    let other = text.replacen("element", "comment SplatRenderMode: default\nelement", 1);
    assert!(!in_memory(other.as_bytes()).unwrap().antialiased);
}

#[test]
fn bindings_that_are_no_triangle_are_refused() {
    let text = String::from_utf8(foreign("ascii")).unwrap().replace("segment", "binding_0");
    let read = |text: &str| {
        let bytes = text.as_bytes();
        decode(&mut &*bytes, bytes.len() as u64, true)
            .map(|read| read.triangles)
            .map_err(|error| error.to_string())
    };
    assert_eq!(read(&text), Ok(vec![7]));
    for value in ["-1", "7.5", "NaN", "16777217", "1e30"] {
        let error = read(&text.replace(" 7 255", &format!(" {value} 255"))).unwrap_err();
        assert!(error.contains("binding_0: expected the number of a triangle"), "{error}");
    }
    let free = read(&text.replace("binding_0", "segment")).unwrap_err();
    assert!(free.contains("these Gaussians are bound to no mesh"), "{free}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let error =
        |triangles: &[u32]| write_bound_ply(&path, &random(1, 2, 0), triangles).unwrap_err().to_string();
    assert!(error(&[1]).contains("one triangle for each of 2"));
    assert!(error(&[1, 1 << 25]).contains("up to 16777216"));
}

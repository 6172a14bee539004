//! Each format projects one world point to the same pixel as the program it comes from.
//!
//! The camera is at [`POSITION`] with the orientation [`OPENGL`]. The expected pixels are computed in numpy from that
//! program's projection: 3DGS, `ndc2Pix`; nerfstudio, the inverse of a ray through `x + 0.5`; COLMAP, `f x / z + c` from the
//! corner of the first pixel.

use std::fs;
use std::path::Path;

use glam::{DVec2, DVec3};
use serde_json::json;

use super::*;
use crate::Gaussians;

const POINT: DVec3 = DVec3::new(0.1, -0.05, 0.2);
const DEPTH: f64 = 1.860_780_644_740_283_3;
const POSITION: [f64; 3] = [0.5, 0.25, 2.0];
/// World from camera, x right, y up, z backward.
const OPENGL: [[f64; 3]; 3] = [
    [0.955336489125606, -0.05871080169382652, 0.28962947762551555],
    [0.0, 0.9800665778412416, 0.19866933079506122],
    [-0.29552020666133955, -0.18979606097868743, 0.9362933635841992],
];

fn matrix(rows: usize) -> Vec<[f64; 4]> {
    let row = |i: usize| match i {
        3 => [0.0, 0.0, 0.0, 1.0],
        _ => [OPENGL[i][0], OPENGL[i][1], OPENGL[i][2], POSITION[i]],
    };
    (0..rows).map(row).collect()
}

#[track_caller]
fn read(name: &str, text: impl AsRef<[u8]>) -> Result<Vec<NamedCamera>, String> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join(name), text).unwrap();
    read_cameras(&folder.path().join(name), None).map_err(|error| error.to_string())
}

#[track_caller]
fn assert_sees(named: &NamedCamera, name: &str, x: f64, y: f64) {
    let (pixel, depth) = named.camera.project(POINT).expect("in front");
    assert!(pixel.distance(DVec2::new(x, y)) < 1e-9, "{pixel}");
    assert!((depth - DEPTH).abs() < 1e-12, "{depth}");
    assert_eq!((named.name.as_str(), named.camera.width, named.camera.height), (name, 640, 480));
    assert!((named.camera.position() - DVec3::from_array(POSITION)).length() < 1e-12);
}

#[test]
fn cameras_of_3d_gaussian_splatting() {
    let opencv = OPENGL.map(|[x, y, z]| [x, -y, -z]);
    let camera = json!({"id": 0, "img_name": "00001", "width": 640, "height": 480, "position": POSITION,
        "rotation": opencv, "fy": 710.0, "fx": 700.0});
    let cameras = read("cameras.json", json!([camera, camera]).to_string()).unwrap();
    assert_eq!(cameras.len(), 2);
    assert_sees(&cameras[0], "00001", 375.8533610124981, 212.37211006073724);
}

#[test]
fn transforms_of_nerfstudio_with_intrinsics_at_the_root_and_in_frames() {
    let shared = json!({"camera_model": "OPENCV", "fl_x": 700.0, "fl_y": 710.0, "cx": 330.25, "cy": 235.5, "w": 640.0,
        "h": 480, "k1": 0.0, "frames": [{"file_path": "images/a.png", "transform_matrix": matrix(4)}]});
    let cameras = read("transforms.json", shared.to_string()).unwrap();
    assert_sees(&cameras[0], "images/a.png", 386.1033610124981, 207.87211006073724);
    assert_eq!(cameras[0].distortion, None);

    let own = json!({"fl_x": 1.0, "w": 640, "h": 480, "k1": 0.5, "frames": [{"file_path": "b", "fl_x": 700.0,
        "fl_y": 710.0, "cx": 330.25, "cy": 235.5, "k1": -0.25, "p2": 0.125, "transform_matrix": matrix(3)}]});
    let cameras = read("transforms.json", own.to_string()).unwrap();
    assert_sees(&cameras[0], "b", 386.1033610124981, 207.87211006073724);
    assert_eq!(cameras[0].distortion.as_deref(), Some("k1 = -0.25, p2 = 0.125"));
}

/// NeRF's files have a field of view in place of a focal length, and no size: it is that of the pictures.
/// Each the only camera of its file, with 640x480 pixels and one more line.
fn one_transform(of_root: serde_json::Value, of_frame: serde_json::Value) -> serde_json::Value {
    let mut frame = json!({"file_path": "images\\1.png", "transform_matrix": matrix(4)});
    frame.as_object_mut().unwrap().extend(of_frame.as_object().unwrap().clone());
    let mut root = json!({"w": 640, "h": 480, "frames": [frame]});
    root.as_object_mut().unwrap().extend(of_root.as_object().unwrap().clone());
    root
}

#[test]
fn a_frames_own_focal_length_or_angle_is_taken() {
    let focal_lengths = |root, frame| {
        let cameras = read("transforms.json", one_transform(root, frame).to_string()).unwrap();
        assert_eq!(cameras[0].name, "images/1.png");
        let Camera { fx, fy, .. } = cameras[0].camera;
        [fx.round(), fy.round()]
    };
    let angle = 2.0 * (320.0_f64 / 700.0).atan();
    assert_eq!(
        focal_lengths(json!({"fl_x": 500, "fl_y": 510}), json!({"camera_angle_x": angle})),
        [700.0, 700.0]
    );
    assert_eq!(focal_lengths(json!({"camera_angle_x": angle}), json!({"fl_x": 500})), [500.0, 500.0]);
    assert_eq!(focal_lengths(json!({"fl_x": 500, "fl_y": 510}), json!({"fl_x": 600})), [600.0, 510.0]);
}

#[test]
fn lenses_that_are_no_pinholes_are_refused_and_distortion_is_kept_for_a_note() {
    let read = |root| read("transforms.json", one_transform(root, json!({"fl_x": 500})).to_string());
    for flag in ["is_fisheye", "latlong", "equirectangular", "orthographic"] {
        let error = read(json!({ flag: true })).unwrap_err();
        assert!(error.contains(&format!("{flag}: expected a pinhole camera, found another lens")), "{error}");
        assert!(read(json!({ flag: false })).is_ok());
    }
    assert!(read(json!({"camera_model": "OPENCV_FISHEYE"})).is_err());
    let distorted = read(json!({"camera_model": "SIMPLE_RADIAL", "k1": 0.1})).unwrap();
    assert_eq!(distorted[0].distortion.as_deref(), Some("k1 = 0.1"));
    let marked = format!("\u{feff}{}", one_transform(json!({"fl_x": 500}), json!({})));
    assert_eq!(self::read("transforms.json", marked).unwrap().len(), 1);
}

#[test]
fn transforms_of_nerf_take_their_size_from_the_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("transforms_train.json");
    let frames = json!([{"file_path": "./train/r_0", "rotation": 0.01, "transform_matrix": matrix(4)}]);
    fs::write(&file, json!({"camera_angle_x": 0.8, "frames": frames}).to_string()).unwrap();
    let error = read_cameras(&file, None).unwrap_err().to_string();
    assert!(error.contains("w and h") && error.contains("`size`") && error.contains("r_0"), "{error}");
    let given = read_cameras(&file, Some(Size::new(640, 480))).unwrap();
    assert_sees(&given[0], "./train/r_0", 380.43176361660267, 210.58124236948836);
    fs::create_dir(folder.path().join("train")).unwrap();
    let picture = srflow_core::Image::new(640, 480);
    srflow_files::write_image_png(&folder.path().join("train/r_0.png"), &picture).unwrap();
    assert_eq!(read_cameras(&file, None).unwrap(), given);
}

fn nersemble(intrinsics: [[f64; 3]; 3]) -> serde_json::Value {
    let opencv = DMat3::from_cols_array_2d(&OPENGL.map(|[x, y, z]| [x, -y, -z])); // camera from world
    let place = -(opencv * DVec3::from_array(POSITION));
    let row = |i: usize| [opencv.row(i).x, opencv.row(i).y, opencv.row(i).z, place[i]];
    let w2c = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
    json!({"world_2_cam": {"222200037": w2c, "220700191": w2c}, "intrinsics": intrinsics, "width": 640, "height": 480})
}

#[test]
fn cameras_of_nersemble() {
    let cameras = nersemble([[700.0, 0.0, 330.25], [0.0, 710.0, 235.5], [0.0, 0.0, 1.0]]);
    let read_back = read("camera_params.json", cameras.to_string()).unwrap();
    assert_eq!(read_back.len(), 2);
    assert_sees(&read_back[0], "220700191", 386.1033610124981, 207.87211006073724);
    let mut unsized_ = cameras.clone();
    unsized_.as_object_mut().unwrap().remove("height");
    let full = read("camera_params.json", unsized_.to_string()).unwrap()[0].camera;
    assert_eq!((full.width, full.height), (2200, 3208), "NeRSemble's own size");
    let skewed = nersemble([[700.0, 1.0, 330.25], [0.0, 710.0, 235.5], [0.0, 0.0, 1.0]]).to_string();
    assert!(read("camera_params.json", skewed).unwrap_err().contains("intrinsics"));
    let mut mirrored = cameras;
    let x = mirrored["world_2_cam"]["222200037"][0].as_array_mut().unwrap();
    x.iter_mut().for_each(|value| *value = json!(-value.as_f64().unwrap()));
    let error = read("camera_params.json", mirrored.to_string()).unwrap_err();
    assert!(error.contains("222200037") && error.contains("mirrors the world"), "{error}");
}

/// In every format that counts from the corner of the first pixel, a principal point at the centre of pixel (12, 34) is written
/// as (12.5, 34.5); VHAP counts its rows from the bottom.
#[test]
fn principal_points_from_the_corner_are_converted_by_half_a_pixel() {
    let ahead = DVec3::from_array(POSITION) - DVec3::from_array(OPENGL.map(|[.., back]| back)); // on the optical axis
    let frame = |more: serde_json::Value| {
        let mut frame = json!({"file_path": "a", "transform_matrix": matrix(4), "w": 640, "h": 480, "fl_x": 700.0,
            "fl_y": 710.0, "cx": 12.5});
        frame.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        json!({"frames": [frame]}).to_string()
    };
    let folder = tempfile::tempdir().unwrap();
    colmap_text(folder.path(), "3 PINHOLE 640 480 700 710 12.5 34.5");
    let matrix = [[700.0, 0.0, 12.5], [0.0, 710.0, 34.5], [0.0, 0.0, 1.0]];
    for (program, cameras) in [
        ("nerfstudio", read("transforms.json", frame(json!({"cy": 34.5})))),
        (
            "VHAP",
            read(
                "transforms.json",
                frame(json!({"cy": 480.0 - 34.5, "timestep_index": 0, "camera_index": 3})),
            ),
        ),
        ("NeRSemble", read("camera_params.json", nersemble(matrix).to_string())),
        ("COLMAP", read_cameras(folder.path(), None).map_err(|error| error.to_string())),
    ] {
        let camera = cameras.unwrap()[0].camera;
        let (pixel, _) = camera.project(ahead).expect("in front");
        assert!(pixel.distance(DVec2::new(12.0, 34.0)) < 1e-9, "{program}: {pixel}");
    }
}

#[test]
fn camera_paths_of_nerfstudio() {
    let stop = json!({"camera_to_world": matrix(4).as_flattened(), "fov": 40.0, "aspect": 1.0});
    let path = json!({"camera_type": "perspective", "render_width": 640, "render_height": 480, "fps": 24,
        "camera_path": [stop, stop]});
    let cameras = read("path.json", path.to_string()).unwrap();
    assert_sees(&cameras[1], "1", 372.5844297916159, 214.30565688600294);
    let fisheye = path.to_string().replace("perspective", "fisheye");
    assert!(read("path.json", fisheye).unwrap_err().contains("fisheye"));
}

const QUATERNION: [f64; 4] =
    [0.0987123949919223, -0.9838313410528056, -0.014918919342160747, 0.14869156426260063];
const TRANSLATION: [f64; 3] = [0.1133721687598761, -0.1639308783439777, 2.0670687986799217];

fn colmap_text(folder: &Path, camera: &str) {
    let words = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let pose = format!("{} {}", words(&QUATERNION), words(&TRANSLATION));
    let images = format!("# Image list\n7 {pose} 3 b c.jpg\n1.5 2.5 -1 3 4 8\n9 {pose} 3 a.jpg\n\n");
    fs::write(folder.join("cameras.txt"), format!("# Camera list\n\n{camera}\n")).unwrap();
    fs::write(folder.join("images.txt"), images).unwrap();
}

fn colmap_binary(folder: &Path) {
    let mut cameras = [1_u64.to_le_bytes(), [3, 0, 0, 0, 1, 0, 0, 0]].concat(); // one camera, number 3, a PINHOLE
    cameras.extend([640_u64, 480].map(u64::to_le_bytes).as_flattened());
    cameras.extend([700_f64, 710.0, 330.25, 235.5].map(f64::to_le_bytes).as_flattened());
    let mut images = 2_u64.to_le_bytes().to_vec();
    for (name, points) in [("b c.jpg", 2_u64), ("a.jpg", 0)] {
        images.extend(7_i32.to_le_bytes());
        images.extend(QUATERNION.map(f64::to_le_bytes).as_flattened());
        images.extend(TRANSLATION.map(f64::to_le_bytes).as_flattened());
        images.extend(3_i32.to_le_bytes());
        images.extend(name.bytes().chain([0]));
        images.extend(points.to_le_bytes());
        images.extend(vec![1; 24 * points as usize]);
    }
    fs::write(folder.join("cameras.bin"), cameras).unwrap();
    fs::write(folder.join("images.bin"), images).unwrap();
}

#[test]
fn models_of_colmap_as_text_and_binary() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    colmap_text(&model, "3 PINHOLE 640 480 700 710 330.25 235.5");
    let of_text = read_cameras(&model.join("images.txt"), None).unwrap();
    let names: Vec<&str> = of_text.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["a.jpg", "b c.jpg"]);
    assert_sees(&of_text[0], "a.jpg", 386.1033610124981, 207.87211006073724);
    colmap_binary(&model);
    assert_eq!(read_cameras(folder.path(), None).unwrap(), of_text, "the binary files of sparse/0");

    fs::remove_file(model.join("images.bin")).unwrap();
    colmap_text(&model, "3 SIMPLE_RADIAL 640 480 700 320 240 -0.125");
    let bent = read_cameras(&model, None).unwrap();
    assert_eq!(bent[0].distortion.as_deref(), Some("k = -0.125"));
    assert_eq!((bent[0].camera.fx, bent[0].camera.fy, bent[0].camera.cx), (700.0, 700.0, 319.5));
    for (camera, reason) in [
        ("3 OPENCV_FISHEYE 640 480 700 700 320 240 0 0 0 0", "OPENCV_FISHEYE, a fisheye lens"),
        ("3 PINHOLE 640 480 700 700 320", "fx fy cx cy for PINHOLE"),
        ("3 CUBE 640 480 700", "SIMPLE_PINHOLE"),
        ("4 PINHOLE 640 480 700 700 320 240", "CAMERA_ID"),
        ("3 PINHOLE 0 480 700 700 320 240", "0x480"),
    ] {
        colmap_text(&model, camera);
        let error = read_cameras(&model, None).unwrap_err().to_string();
        assert!(error.contains(reason), "{camera}: {error}");
    }
}

#[test]
fn text_models_take_any_white_space_and_need_both_lines_of_an_image() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("cameras.txt"), "1 PINHOLE 640 480 700 710 320 240\n").unwrap();
    let read = |images: &str| {
        fs::write(folder.path().join("images.txt"), images).unwrap();
        let cameras = read_cameras(folder.path(), None).map_err(|error| error.to_string())?;
        Ok::<_, String>(cameras.into_iter().map(|camera| camera.name).collect::<Vec<_>>())
    };
    let line = |name: &str| format!("1 1 0 0 0 0 0 1.5 1 {name}\n");
    let two = ["a b.png", "c.png"].map(line);
    let names = Ok(vec!["a b.png".to_owned(), "c.png".to_owned()]);
    assert_eq!(read(&two.join("\n")), names);
    assert_eq!(read(&format!("\u{feff}# IMAGE_ID ...\r\n{}1.5 2 -1 3e1 4 5\r\n{}", two[0], two[1])), names);
    assert_eq!(read(&two.join("\n").replace(' ', "\t").replace("a\tb", "a b")), names);
    assert_eq!(read(&two.join("\n").replace(' ', "  ").replace("a  b", "a b")), names);
    let error = read(&two.concat()).unwrap_err();
    assert!(
        error.contains("points: expected the points of a b.png as X Y POINT3D_ID, or an empty line"),
        "{error}"
    );
}

#[test]
fn a_binary_model_may_end_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    colmap_binary(folder.path());
    for name in ["cameras.bin", "images.bin"] {
        let whole = fs::read(folder.path().join(name)).unwrap();
        for len in 0..whole.len() {
            fs::write(folder.path().join(name), &whole[..len]).unwrap();
            assert!(read_cameras(folder.path(), None).is_err(), "{name} cut to {len} bytes");
        }
        let mut endless = whole.clone();
        endless[..8].fill(0xff);
        fs::write(folder.path().join(name), endless).unwrap();
        assert!(read_cameras(folder.path(), None).is_err(), "{name} of 2^64 entries");
        fs::write(folder.path().join(name), whole).unwrap();
    }
}

#[test]
fn invalid_camera_files_are_reported() {
    for (text, reason) in [
        ("hello", "not a JSON object"),
        ("{}", "without any of these keys"),
        ("[]", "found none"),
        (r#"{"frames": []}"#, "found none"),
        (r#"{"frames": [{"file_path": "a"}]}"#, "transform_matrix"),
        (r#"{"w2c": 3}"#, "line 1"),
    ] {
        let error = read("a.json", text).unwrap_err();
        assert!(error.contains("a.json") && error.contains(reason), "{text}: {error}");
    }
    let frame = |matrix: &[[f64; 4]]| {
        json!({"w": 4, "h": 4, "fl_x": 1, "frames": [{"file_path": "a", "transform_matrix": matrix}]})
            .to_string()
    };
    assert!(read("a.json", frame(&matrix(2))).unwrap_err().contains("3 rows of 4 numbers"));
    assert!(read("a.json", frame(&[])).unwrap_err().contains("3 rows of 4 numbers"));
    let mut scaled = matrix(4);
    scaled[0][0] = 2.0;
    assert!(read("a.json", frame(&scaled)).unwrap_err().contains("not a rigid motion"));
}

#[test]
fn an_orbit_keeps_its_distance_and_looks_where_it_looked() {
    let start = Camera::centred(Size::new(640, 480), [700.0; 2])
        .placed(DMat3::from_cols_array_2d(&OPENGL.map(|[x, y, z]| [x, -y, -z])).transpose(), POSITION.into());
    let circle = start.orbit(POINT, 360.0, 8);
    assert_eq!((circle.len(), circle[0]), (8, start));
    let (pixel, depth) = start.project(POINT).unwrap();
    for camera in &circle {
        camera.validate().unwrap();
        let (found, found_depth) = camera.project(POINT).unwrap();
        assert!((found - pixel).length() < 1e-9 && (found_depth - depth).abs() < 1e-9);
    }
    // A quarter of the way to the right, the camera moves along its own right.
    let right = start.camera_from_world.row(0).truncate();
    assert!((circle[1].position() - start.position()).dot(right) > 0.1);
    assert!((circle[4].position() - start.position()).length() > 1.5, "behind it");
}

#[test]
fn a_camera_faces_all_but_strays_from_the_front() {
    let mut gaussians = Gaussians::default();
    for i in 0..500 {
        let angle = f64::from(i);
        gaussians.positions.push(glam::Vec3::new(
            angle.cos() as f32 + 5.0,
            angle.sin() as f32,
            (0.1 * angle).sin() as f32,
        ));
    }
    gaussians.positions.push(glam::Vec3::splat(1e6));
    gaussians.scales = vec![glam::Vec3::splat(0.01); gaussians.positions.len()];
    let seen = Surroundings::of(&gaussians).unwrap();
    let cameras = [Camera::facing(seen, Size::new(300, 200)), Camera::facing_down(seen, Size::new(300, 200))];
    for (camera, high) in cameras.into_iter().zip([1.0, -1.0]) {
        camera.validate().unwrap();
        for position in &gaussians.positions[..500] {
            let (pixel, _) = camera.project(position.as_dvec3()).unwrap();
            assert!((0.0..300.0).contains(&pixel.x) && (0.0..200.0).contains(&pixel.y), "{pixel}");
        }
        let (above, _) = camera.project(DVec3::new(5.0, high, 0.0)).unwrap();
        assert!(above.y < 60.0, "{high} y is up: {above}");
        assert_eq!(camera.position().z.signum(), high, "seen from the front");
    }
    assert_eq!(Surroundings::of(&Gaussians::default()), None);
}

#[test]
fn a_resized_camera_sees_the_same() {
    let camera = Camera { cx: 100.0, ..Camera::centred(Size::new(640, 480), [700.0, 600.0]) };
    let half = camera.resized(Size::new(320, 240));
    let (pixel, _) = camera.project(DVec3::new(0.1, 0.2, 1.0)).unwrap();
    let (halved, _) = half.project(DVec3::new(0.1, 0.2, 1.0)).unwrap();
    assert!(((pixel + 0.5) / 2.0 - 0.5 - halved).length() < 1e-12, "{pixel} {halved}");
}

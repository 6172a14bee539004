//! Dressed heads are complete and without holes, and the same seed gives the same person.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use glam::{DMat4, DVec3, Quat, Vec3};
use srflow_avatar::capture::HeadRecord;
use srflow_avatar::{Avatar, AvatarError, AvatarFiles, HeadSource, PosedHead};
use srflow_core::Size;
use srflow_head::{
    HeadError, HeadModel, HeadParameters, HeadPose, JointRole, Look, PoseParameters, Region, Side,
};
use srflow_splat::{Camera, Frame, Gaussians, Options, Rasterizer, write_bound_ply};

fn ict_folder() -> Option<PathBuf> {
    let folder = Path::new("../../../shared/data").join("ict-facekit/FaceXModel");
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: shared-data: no ICT-FaceKit at {}", folder.display());
    None
}

fn ict_avatar(folder: &Path, seed: u64) -> Result<Avatar, AvatarError> {
    format!("ict:{}", folder.display()).parse::<HeadSource>().expect("a head").avatar(seed)
}

/// Two built-in people and one of ICT-FaceKit's, shared by the tests: building takes longer than testing.
static FIRST: LazyLock<Avatar> = LazyLock::new(|| Avatar::builtin(1).expect("an avatar"));
static SECOND: LazyLock<Avatar> = LazyLock::new(|| Avatar::builtin(8).expect("an avatar"));
static ICT: LazyLock<Option<Avatar>> =
    LazyLock::new(|| ict_folder().map(|folder| ict_avatar(&folder, 2).expect("an avatar")));

fn gaussians(avatar: &Avatar, pose: &HeadPose) -> (Gaussians, PosedHead) {
    let (mut head, mut out) = (PosedHead::default(), Gaussians::default());
    avatar.gaussians_into(pose, &mut head, &mut out);
    (out, head)
}

/// Poses that stretch and fold a face: everything at once, mouth wide open, a grin, closed eyes, extreme joints.
fn extreme_poses(avatar: &Avatar) -> Vec<HeadPose> {
    let model = avatar.model();
    let show = |numbers: &[u8]| {
        let listed: Vec<(u8, Side, f32)> = model
            .action_units
            .iter()
            .filter(|unit| numbers.is_empty() || numbers.contains(&unit.number))
            .map(|unit| (unit.number, unit.side, 1.0))
            .collect();
        model.pose_of_action_units(&listed).expect("the model's own units")
    };
    let mut turned = show(&[26]);
    *turned.joint_mut(JointRole::Neck as usize) = Quat::from_rotation_y(0.4) * Quat::from_rotation_x(0.25);
    *turned.joint_mut(JointRole::LeftEye as usize) = Quat::from_rotation_y(0.4);
    *turned.joint_mut(JointRole::RightEye as usize) = Quat::from_rotation_y(0.4);
    turned.translation = Vec3::new(0.02, -0.01, 0.03);
    vec![HeadPose::default(), show(&[]), show(&[26]), show(&[6, 12, 25]), show(&[4, 9, 43]), turned]
}

fn camera(width: usize, height: usize) -> Camera {
    let eye = DVec3::new(0.0, 0.0, 1.1);
    // The x axes of world and camera agree, y and z are reversed.
    let axes = DMat4::from_cols_array(&[
        1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
    ]);
    let centred = Camera::centred(Size { width, height }, [width as f64 * 3.4; 2]);
    Camera { camera_from_world: axes * DMat4::from_translation(-eye), ..centred }
}

/// `true` on pixels covered by the closed skin of the face, except for two pixels at its outline.
fn inside_of_face(avatar: &Avatar, vertices: &[Vec3], camera: &Camera) -> Vec<bool> {
    let Size { width, height } = camera.size();
    let mut covered = vec![false; width * height];
    let model = avatar.model();
    for (triangle, region) in model.triangles.iter().zip(&model.regions) {
        if !matches!(region, Region::Skin | Region::Brow | Region::Lips | Region::Scalp | Region::Eyeball) {
            continue;
        }
        let [a, b, c] =
            triangle.map(|v| camera.project(vertices[v as usize].as_dvec3()).expect("in front").0);
        let area = (b - a).perp_dot(c - a);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        for y in low.y.ceil().max(0.0) as usize..=(high.y.floor().min(height as f64 - 1.0)) as usize {
            for x in low.x.ceil().max(0.0) as usize..=(high.x.floor().min(width as f64 - 1.0)) as usize {
                let p = glam::DVec2::new(x as f64, y as f64);
                let sides = [(b - a).perp_dot(p - a), (c - b).perp_dot(p - b), (a - c).perp_dot(p - c)];
                covered[y * width + x] |= sides.iter().all(|s| s * area >= 0.0);
            }
        }
    }
    let eroded =
        |x: usize, y: usize| (y - 2..=y + 2).all(|v| (x - 2..=x + 2).all(|u| covered[v * width + u]));
    (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            x >= 2 && y >= 2 && x + 2 < width && y + 2 < height && eroded(x, y)
        })
        .collect()
}

fn assert_whole(avatar: &Avatar, name: &str) {
    let camera = camera(440, 640);
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::new();
    let count = avatar.bound().len();
    assert!((100_000..=215_000).contains(&count), "{name}: {count} Gaussians");
    for (number, pose) in extreme_poses(avatar).iter().enumerate() {
        let (gaussians, head) = gaussians(avatar, pose);
        assert_eq!(gaussians.len(), count);
        assert!(gaussians.positions.iter().all(|p| p.is_finite()), "{name}, pose {number}: position");
        assert!(
            gaussians.scales.iter().all(|s| s.is_finite() && s.min_element() >= 0.0),
            "{name}, pose {number}"
        );
        assert!(gaussians.rotations.iter().all(|q| q.is_normalized()), "{name}, pose {number}: rotation");
        assert!(gaussians.sh.iter().flatten().all(|c| c.is_finite()), "{name}, pose {number}: colour");
        rasterizer.render(&gaussians, &camera, None, &Options::default(), &mut frame).expect("renders");
        let inside = inside_of_face(avatar, head.vertices(), &camera);
        let face = inside.iter().filter(|inside| **inside).count();
        assert!(face > 20_000, "{name}, pose {number}: the face covers {face} pixels only");
        let alphas = frame.alpha.pixels().iter().zip(&inside).filter(|(_, inside)| **inside);
        let holes = alphas.filter(|(alpha, _)| **alpha < 0.97).count();
        assert_eq!(holes, 0, "{name}, pose {number}: pixels of {face} that the background shines through");
    }
}

#[test]
fn built_in_heads_are_whole_in_every_pose() {
    assert_whole(&FIRST, "built-in 1");
    assert_whole(&SECOND, "built-in 8");
}

#[test]
fn ict_heads_are_whole_in_every_pose() {
    if let Some(avatar) = &*ICT {
        assert_whole(avatar, "ICT 2");
    }
}

#[test]
fn a_seed_is_a_person() {
    let rest = HeadPose::default();
    let one = gaussians(&FIRST, &rest).0;
    let same = gaussians(&Avatar::builtin(1).expect("an avatar"), &rest).0;
    let other = gaussians(&SECOND, &rest).0;
    assert!(one == same, "the same seed gives the same bytes");
    let mean = |g: &Gaussians| g.sh.iter().map(|c| c[0]).sum::<f32>() / g.len() as f32;
    assert!((mean(&one) - mean(&other)).abs() > 1e-3 && one.positions != other.positions);
}

#[test]
fn eyeballs_turn_and_carry_their_irises() {
    let avatar = &*FIRST;
    let mut pose = HeadPose::default();
    let (rest, _) = gaussians(avatar, &pose);
    *pose.joint_mut(JointRole::LeftEye as usize) = Quat::from_rotation_y(0.3);
    let (looking, _) = gaussians(avatar, &pose);
    let eye = avatar.shaped().joints[JointRole::LeftEye as usize];
    let moved: Vec<usize> =
        (0..rest.len()).filter(|&i| rest.positions[i].distance(looking.positions[i]) > 1e-3).collect();
    assert!(moved.len() > 1000, "{} Gaussians moved", moved.len());
    // The line of sight turns to the subject's left, and nothing else of the face moves.
    assert!(moved.iter().all(|&i| rest.positions[i].distance(eye) < 0.03));
    let drift: f32 = moved.iter().map(|&i| looking.positions[i].x - rest.positions[i].x).sum();
    assert!(drift > 0.0);
}

fn ict_error(folder: &Path) -> String {
    match ict_avatar(folder, 1) {
        Ok(_) => panic!("{} makes an avatar", folder.display()),
        Err(error) => error.to_string(),
    }
}

#[test]
fn ict_folders_that_are_not_name_the_file() {
    let Some(published) = ict_folder() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let copy = |name: &str| std::fs::copy(published.join(name), folder.path().join(name)).expect("a copy");
    assert!(ict_error(folder.path()).contains("vertex_indices.json"));
    copy("vertex_indices.json");
    let message = ict_error(folder.path());
    assert!(message.contains("generic_neutral_mesh.obj") && message.contains("FaceXModel"), "{message}");
    let neutral = folder.path().join("generic_neutral_mesh.obj");
    std::fs::write(&neutral, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("written");
    let message = ict_error(folder.path());
    assert!(message.contains("3 vertices") && message.contains("26719"), "{message}");
    std::fs::remove_file(&neutral).expect("removed");
    copy("generic_neutral_mesh.obj");
    std::fs::write(folder.path().join("jawOpen.obj"), "v 0 0 0\n").expect("written");
    let error = ict_avatar(folder.path(), 1).expect_err("a shape of one vertex");
    assert!(
        matches!(error, AvatarError::Head(HeadError::VertexCount { found: 1, expected: 26_719, .. })),
        "{error}"
    );
    assert!(
        error.to_string().contains("jawOpen.obj") && error.to_string().contains("generic_neutral_mesh.obj")
    );
    std::fs::write(
        folder.path().join("vertex_indices.json"),
        r#"{"expressions": ["../x"], "idx_to_landmark_verts": [1]}"#,
    )
    .expect("written");
    assert!(ict_error(folder.path()).contains("68 landmark vertices"));
}

#[test]
fn ict_action_units_are_those_of_the_files_present() {
    let Some(avatar) = &*ICT else { return };
    let model = avatar.model();
    let has = |number, side| model.pose_of_action_units(&[(number, side, 1.0)]).is_ok();
    for number in [1, 2, 4, 5, 6, 9, 12, 14, 15, 20, 26, 45] {
        assert!(has(number, Side::Left) && has(number, Side::Right), "AU{number}");
    }
    assert!(has(24, Side::Left));
    // mouthPress_R.obj is not in the folder, nor is any of these.
    for (number, side) in [(24, Side::Right), (10, Side::Both), (17, Side::Both)] {
        assert!(!has(number, side), "AU{number} {side:?}");
    }
    let smile = model.pose_of_action_units(&[(12, Side::Left, 1.0)]).expect("a smile");
    let (_, rest) = gaussians(avatar, &HeadPose::default());
    let (_, smiling) = gaussians(avatar, &smile);
    let corner =
        |landmark: usize, head: &PosedHead| head.frames()[model.landmarks[landmark].0 as usize].origin;
    let [right, left] = [48, 54].map(|landmark| corner(landmark, &smiling) - corner(landmark, &rest));
    assert!(left.y > 0.004 && left.length() > 5.0 * right.length(), "left {left}, right {right}");
}

/// The pictures of an avatar that was written as GaussianAvatars' files and read again, in its own motion, are those of the
/// original to rounding.
#[test]
fn a_frown_folds_the_skin_in_light_and_moves_no_gaussian_from_its_triangle() {
    let avatar = &*FIRST;
    let model = avatar.model();
    let frown = model.pose_of_action_units(&[(4, Side::Both, 1.0)]).unwrap();
    let (shown, head) = gaussians(avatar, &frown);
    let mut bound = Gaussians::default();
    avatar.bound().world_into(head.frames(), &mut bound);
    assert_eq!((&shown.positions, &shown.scales), (&bound.positions, &bound.scales));
    // Between the brows, where the groove is, against the chin.
    let landmarks: Vec<Vec3> = model.landmarks_on(head.vertices()).collect();
    let darkest = |place: Vec3| {
        let near = shown.positions.iter().zip(shown.sh.iter().zip(&bound.sh));
        near.filter(|(p, _)| p.distance(place) < 0.012)
            .map(|(_, (after, before))| after[1] - before[1])
            .fold(0.0, f32::min)
    };
    let (brows, chin) = (darkest((landmarks[21] + landmarks[22]) * 0.5), darkest(landmarks[8]));
    assert!(brows < -0.15 && brows < 2.0 * chin, "{brows} {chin}");
}

#[test]
fn an_avatar_survives_its_files() {
    let folder = tempfile::tempdir().unwrap();
    // Its colours do not change with the pose, as those of files.
    let avatar = &HeadSource::builtin().with_look(Look::First).avatar(1).unwrap();
    let model = avatar.model();
    let poses: Vec<PoseParameters> =
        extreme_poses(avatar).iter().skip(1).map(|pose| PoseParameters::of(model, pose)).collect();
    let parameters = HeadParameters { poses, ..HeadParameters::default() };
    let record = HeadRecord::new("builtin".into(), 1, model);
    let dir = folder.path().join("point_cloud/iteration_30000");
    std::fs::create_dir_all(folder.path().join("point_cloud/iteration_7000")).unwrap();
    avatar.write(&dir, &parameters, Some(&record)).unwrap();

    let files = AvatarFiles::read(folder.path()).unwrap();
    assert_eq!((files.head.as_ref(), &files.parameters, &files.dir), (Some(&record), &parameters, &dir));
    assert_eq!(files.gaussians.sh_degree, 3);
    let again = files.on(HeadModel::builtin_with(1, Look::First)).unwrap();
    let camera = camera(220, 320);
    let mut pictures = [Frame::new(), Frame::new()];
    for pose in again.own_motion() {
        let pose = pose.pose(model);
        for (avatar, picture) in [avatar, &again].into_iter().zip(&mut pictures) {
            let (gaussians, _) = gaussians(avatar, &pose);
            Rasterizer::new().render(&gaussians, &camera, None, &Options::default(), picture).unwrap();
        }
        let [a, b] = &pictures;
        let difference =
            |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
        let greatest = a.color.iter().zip(&b.color).map(difference).fold(0.0, f32::max);
        assert!(greatest < 2e-3, "{greatest}");
    }
}

#[test]
fn files_of_another_head_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let avatar = &*FIRST;
    let parameters = HeadParameters {
        poses: vec![PoseParameters::default()],
        shape: vec![1.0],
        ..HeadParameters::default()
    };
    avatar.write(folder.path(), &parameters, None).unwrap();
    let on = |model: HeadModel| AvatarFiles::read(folder.path()).unwrap().on(model).unwrap_err().to_string();
    let error = on(HeadModel::builtin(1));
    assert!(error.contains("shape: the parameters have 1, the head model builtin has 0"), "{error}");
    HeadParameters { shape: vec![], ..parameters }
        .write(&folder.path().join("flame_param.npz"), 0, true)
        .unwrap();
    let mut few = HeadModel::builtin(1);
    few.triangles.truncate(9000);
    few.regions.truncate(9000);
    few.landmarks.clear();
    let error = on(few);
    assert!(error.contains("but the head model has 9000 triangles"), "{error}");
    std::fs::remove_file(folder.path().join("flame_param.npz")).unwrap();
    assert!(AvatarFiles::read(folder.path()).unwrap_err().to_string().contains("flame_param.npz: opening"));
    let nowhere = AvatarFiles::read(&folder.path().join("nowhere")).unwrap_err().to_string();
    assert!(
        nowhere.contains("nowhere: opening: ")
            && nowhere.contains("with point_cloud.ply and flame_param.npz"),
        "{nowhere}"
    );
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    let empty = AvatarFiles::read(&folder.path().join("empty")).unwrap_err().to_string();
    assert!(
        empty.contains("with point_cloud.ply and flame_param.npz") && empty.ends_with("found neither"),
        "{empty}"
    );
}

/// Gaussians in GaussianAvatars' files follow the triangles of FLAME, posed by the `flame_param.npz` beside them: `x' = k R x + T`
/// on the vertices that `tools/golden/flame.py` computed.
#[test]
fn gaussians_follow_flame_in_the_motion_of_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let data = Path::new("../head/tests/data/flame");
    std::fs::copy(data.join("parameters.npz"), folder.path().join("flame_param.npz")).unwrap();
    let text = format!("flame-toothless:{}", data.join("python2.pkl").display());
    let count = text.parse::<HeadSource>().unwrap().model(0).unwrap().triangles.len();
    let triangles: Vec<u32> = (0..200).map(|i| i % count as u32).collect();
    let n = triangles.len();
    let local = Gaussians {
        positions: (0..n)
            .map(|i| Vec3::new((i % 7) as f32 - 3.0, (i % 5) as f32, (i % 3) as f32) * 0.3)
            .collect(),
        scales: vec![Vec3::splat(0.5); n],
        rotations: vec![Quat::from_rotation_z(0.3); n],
        opacities: vec![0.8; n],
        sh_degree: 1,
        sh: vec![[0.5, 0.25, -0.5]; 4 * n],
        antialiased: false,
    };
    write_bound_ply(&folder.path().join("point_cloud.ply"), &local, &triangles).unwrap();
    let unnamed: HeadSource = format!("avatar:{}", folder.path().display()).parse().unwrap();
    let error = unnamed.avatar(1).unwrap_err().to_string();
    assert!(error.contains("the files name no head model, so it is FLAME's"), "{error}");

    let source: HeadSource = format!("{unnamed}@{text}").parse().unwrap();
    let paths = source.paths();
    let named = |name: &str| paths.iter().any(|path| path.ends_with(name));
    assert!(["point_cloud.ply", "flame_param.npz", "python2.pkl"].into_iter().all(named), "{paths:?}");
    let avatar = source.avatar(1).unwrap();
    assert_eq!(avatar.own_motion().len(), 2);
    let pose = avatar.own_motion()[1].pose(avatar.model());
    let (posed, _) = gaussians(&avatar, &pose);
    let expected: serde_json::Value =
        serde_json::from_slice(&std::fs::read(data.join("expected.json")).unwrap()).unwrap();
    let vertices: Vec<DVec3> = serde_json::from_value(expected["vertices"].clone()).unwrap();
    for (i, &triangle) in triangles.iter().enumerate() {
        let [a, b, c] = avatar.model().triangles[triangle as usize].map(|vertex| vertices[vertex as usize]);
        let a0 = (b - a).normalize();
        let a1 = a0.cross(c - a).normalize();
        let a2 = -a1.cross(a0).normalize();
        let k = ((b - a).length() + a2.dot(c - a).abs()) / 2.0;
        let x = local.positions[i].as_dvec3();
        let at = k * (a0 * x.x + a1 * x.y + a2 * x.z) + (a + b + c) / 3.0;
        assert!(posed.positions[i].as_dvec3().distance(at) < 2e-5, "{i}: {} {at}", posed.positions[i]);
        assert!((f64::from(posed.scales[i].x) - 0.5 * k).abs() < 1e-5);
    }
    assert_eq!((posed.sh_degree, posed.sh.len()), (3, 16 * n));
}

use std::fs::{self, File};
use std::io::Write as _;

use glam::Quat;
use srflow_files::write_zip;
use zip::write::SimpleFileOptions;

use super::*;
use crate::{HeadPose, Look, Side, TriangleFrame, dress};

fn avatar() -> Option<PathBuf> {
    let folder = Path::new("../../../shared/data/lam/p2-1");
    if folder.is_dir() {
        return Some(folder.to_owned());
    }
    eprintln!("skipped: shared-data: no avatar of LAM at {}", folder.display());
    None
}

/// The Gaussians in a pose: where they are, and how far they have turned.
fn carried(model: &HeadModel, pose: &HeadPose) -> Vec<(Vec3, Quat)> {
    let shaped = model.shaped(&[]);
    let frames = |vertices: &[Vec3]| -> Vec<TriangleFrame> {
        let of = |triangle: &[u32; 3]| triangle.map(|v| vertices[v as usize]);
        model.triangles.iter().map(of).map(|[a, b, c]| TriangleFrame::of(a, b, c)).collect()
    };
    let mut vertices = Vec::new();
    model.vertices(&shaped, pose, &mut vertices);
    let (rest, posed) = (frames(&shaped.vertices), frames(&vertices));
    let splats = dress(model, &shaped, 1, Look::default()).unwrap().splats;
    let of = |(triangle, splat): (u32, Splat)| {
        let (rest, posed) = (&rest[triangle as usize], &posed[triangle as usize]);
        (posed.point(rest.local_from_world(splat.position)), posed.rotation * rest.rotation.inverse())
    };
    splats.into_iter().map(of).collect()
}

#[test]
fn gaussians_are_at_the_offsets_of_their_vertices_and_follow_shapes_and_joints() {
    let Some(folder) = avatar() else { return };
    let model = load(&folder).unwrap();
    let ply = folder.join(GAUSSIANS);
    let file = parse_ply(&ply, &fs::read(&ply).unwrap()).unwrap();
    let (surface, triangles) = model.surface(&model.template);
    assert_eq!((surface.len(), triangles.len()), LAM_MESH);
    assert_eq!(
        (model.carried.len(), model.expressions.len(), model.landmarks.len()),
        (surface.len(), 51, 68)
    );

    let jaw_open = model.expressions.iter().position(|shape| shape.name == "jawOpen").unwrap();
    let mut pose = HeadPose { expressions: vec![0.0; 51], ..HeadPose::default() };
    pose.expressions[jaw_open] = 0.8;
    let mut shifts = vec![Vec3::ZERO; surface.len()];
    for (vertex, offset) in model.expressions[jaw_open].offsets.iter() {
        if let Some(shift) = shifts.get_mut(vertex as usize) {
            *shift = offset * 0.8;
        }
    }
    let neck = model.joint(JointRole::Neck).unwrap();
    assert_eq!(model.joints[neck].name, "head");
    let turn = Quat::from_rotation_y(0.4);
    *pose.joint_mut(neck) = turn;
    let about = model.joints[neck].position;
    let (rest, posed) = (carried(&model, &HeadPose::default()), carried(&model, &pose));
    let mut on_head = 0;
    for (vertex, ((at_rest, _), (moved, turned))) in rest.into_iter().zip(posed).enumerate() {
        let expected = surface[vertex] + file.positions[vertex];
        assert!(at_rest.distance(expected) < 1e-6, "{vertex}: {at_rest} instead of {expected}");
        assert_eq!(model.carried[vertex].color.to_array(), file.sh[vertex]);
        if model.skinning.weight(vertex, neck) > 0.9999 {
            on_head += 1;
            let expected = turn * (expected + shifts[vertex] - about) + about;
            assert!(moved.distance(expected) < 4e-5, "{vertex}: {moved} instead of {expected}");
            assert!(turned.angle_between(turn) < 2e-3, "{vertex}: {turned}");
        }
    }
    assert!(on_head > 10_000, "{on_head}");
}

#[test]
fn eyes_turn_in_their_centres_and_units_have_their_names() {
    let Some(folder) = avatar() else { return };
    let model = load(&folder).unwrap();
    for (side, role) in [JointRole::LeftEye, JointRole::RightEye].into_iter().enumerate() {
        assert_eq!(model.eyeballs[side].len(), 2178);
        let centre = model.joints[model.joint(role).unwrap()].position;
        let radii = model.eyeballs[side].iter().map(|v| model.template[*v as usize].distance(centre));
        let radii: Vec<f32> = radii.collect();
        assert!(radii.iter().all(|radius| (0.010..0.016).contains(radius)), "{radii:?}");
    }
    for number in [1, 2, 4, 6, 12, 15, 26, 45] {
        assert!(model.pose_of_action_units(&[(number, Side::Both, 1.0)]).is_ok(), "{number}");
    }
}

fn write(path: &Path, entries: &[(&str, &[u8])]) {
    let fill = |archive: &mut zip::ZipWriter<File>| {
        entries.iter().try_for_each(|(name, bytes)| {
            archive.start_file(*name, SimpleFileOptions::default())?;
            archive.write_all(bytes)
        })
    };
    write_zip(File::create(path).unwrap(), fill).unwrap();
}

#[test]
fn a_zip_file_is_read_as_its_folder_is() {
    let folder = tempfile::tempdir().unwrap();
    let zip = folder.path().join("a.zip");
    write(&zip, &[("p/offset.ply", b"ply")]);
    let error = load(&zip).unwrap_err().to_string();
    assert!(error.contains("a.zip") && error.contains("`skin.glb`"), "{error}");
    let error = load(folder.path()).unwrap_err().to_string();
    assert!(error.contains(SKIN), "{error}");

    let Some(avatar) = avatar() else { return };
    let [skin, gaussians] = [SKIN, GAUSSIANS].map(|name| fs::read(avatar.join(name)).unwrap());
    write(&zip, &[("p/skin.glb", &skin), ("p/offset.ply", &gaussians)]);
    let (zipped, plain) = (load(&zip).unwrap(), load(&avatar).unwrap());
    assert_eq!((zipped.template, zipped.carried), (plain.template, plain.carried));
}

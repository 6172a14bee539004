use std::path::PathBuf;

use glam::DVec3;
use serde::Deserialize;

use super::*;
use crate::{HeadParameters, JointRole};

/// Files that `tools/golden/gnm.py` wrote.
fn data(name: &str) -> PathBuf {
    Path::new("tests/data/gnm").join(name)
}

#[derive(Deserialize)]
struct Expected {
    vertices: Vec<DVec3>,
    landmarks: Vec<DVec3>,
}

/// The size of the test's head: its vertices are normal with a deviation of 0.1 m.
const SIZE: f64 = 0.4;

#[test]
fn vertices_and_landmarks_equal_gnms_equations() {
    let expected: Expected = serde_json::from_slice(&std::fs::read(data("expected.json")).unwrap()).unwrap();
    let model = load(&data("gnm_head.npz"), Look::default()).unwrap();
    let parameters = HeadParameters::read(&data("parameters.json")).unwrap();
    parameters.check(&model).unwrap();
    let mut vertices = Vec::new();
    model.vertices(&model.shaped(&parameters.shape), &parameters.poses[0].pose(&model), &mut vertices);
    let landmarks: Vec<Vec3> = model.landmarks_on(&vertices).collect();
    for (found, expected) in [(&vertices, &expected.vertices), (&landmarks, &expected.landmarks)] {
        assert_eq!(found.len(), expected.len());
        for (number, (found, expected)) in found.iter().zip(expected).enumerate() {
            let error = found.as_dvec3().distance(*expected);
            assert!(error < 1e-6 * SIZE, "{number}: {error} m");
        }
    }
}

#[test]
fn names_groups_and_roles_are_read() {
    let model = load(&data("gnm_head.npz"), Look::default()).unwrap();
    let roles: Vec<Option<JointRole>> = model.joints.iter().map(|joint| joint.role).collect();
    let expected = [JointRole::Root, JointRole::Neck, JointRole::LeftEye, JointRole::RightEye];
    assert_eq!(roles, expected.map(Some));
    assert_eq!(model.eyeballs, [vec![17, 18], vec![19, 20]]);
    assert_eq!((model.vertex_groups["upper_lip"].len(), model.vertex_groups["lower_lip"].len()), (4, 0));
    assert_eq!(model.expressions[4].name, "lower_face_region_4");
    assert!(matches!(model.identities[1].offsets, Offsets::Sparse(_)), "a local shape takes little memory");
    let corrected: Vec<usize> = model.pose_correctives.iter().map(|corrective| corrective.joint).collect();
    assert_eq!(corrected, [0, 2, 3], "joint 1 has none");
    let lips = model.regions.iter().filter(|region| **region == Region::Lips).count();
    assert_eq!(lips, 2, "the triangles of vertices 0 to 3");
}

#[test]
fn a_landmark_on_a_quad_that_is_cut_the_other_way_is_on_the_surface() {
    let template = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
    let triangles = [[0, 1, 2], [2, 3, 0]];
    let (triangle, weights) = on_triangle(&([1, 2, 3], Vec3::new(0.25, 0.25, 0.5)), &template, &triangles);
    let corners = triangles[triangle as usize].map(|vertex| template[vertex as usize]);
    let place = corners[0] * weights.x + corners[1] * weights.y + corners[2] * weights.z;
    assert!(place.distance(Vec3::new(0.5, 0.75, 0.0)) < 1e-6, "{place}");
}

#[test]
fn errors_name_the_array_or_the_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gnm_head.npz");
    std::fs::copy(data("gnm_head.npz"), &path).unwrap();
    assert!(load(&path, Look::default()).unwrap().landmarks.is_empty(), "landmarks are optional");
    let rows = std::fs::read_to_string(data("head_sparse_68.txt")).unwrap();
    let error = |text: &str| {
        std::fs::write(folder.path().join("head_sparse_68.txt"), text).unwrap();
        load(&path, Look::default()).unwrap_err().to_string()
    };
    assert!(error("1 0.5 2 0.5").contains("head_sparse_68.txt:1: expected three vertices"));
    let beyond = error("28 1 0 0 1 0");
    assert!(beyond.contains("the vertex 28, but the mesh has 28 vertices"), "{beyond}");
    assert!(error("1 0.9 0 0.9 1 0").contains(":1:"));
    assert!(error("1 nan 0 1 1 0").contains(":1:"));
    assert!(error(rows.split_at(rows.len() / 2).0.rsplit_once('\n').unwrap().0).contains("68 rows"));
    let flame = load(Path::new("tests/data/flame/arrays.npz"), Look::default()).unwrap_err().to_string();
    assert!(flame.contains("one called `template_vertex_positions`"), "{flame}");
}

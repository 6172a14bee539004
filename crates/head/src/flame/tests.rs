use std::path::PathBuf;

use serde::Deserialize;
use srflow_core::random::Key;
use srflow_files::{NpzArray, write_npz};

use super::*;
use crate::{HeadParameters, HeadPose};

/// Files that `tools/golden/flame.py` wrote.
fn data(name: &str) -> PathBuf {
    Path::new("tests/data/flame").join(name)
}

#[derive(Deserialize)]
struct Expected {
    vertices: Vec<DVec3>,
    landmarks: Vec<DVec3>,
}

fn expected() -> Expected {
    serde_json::from_slice(&std::fs::read(data("expected.json")).unwrap()).unwrap()
}

fn farthest(found: &[Vec3], expected: &[DVec3]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found
        .iter()
        .zip(expected)
        .map(|(found, expected)| found.as_dvec3().distance(*expected))
        .fold(0.0, f64::max)
}

/// The size of the test's head: its vertices are normal with a deviation of 0.1 m.
const SIZE: f64 = 0.4;

#[test]
fn vertices_and_landmarks_equal_flames_equations_whatever_wrote_the_file() {
    let expected = expected();
    let json = HeadParameters::read(&data("parameters.json")).unwrap();
    let npz = HeadParameters::read(&data("parameters.npz")).unwrap();
    assert_eq!((json.poses.len(), npz.poses.len()), (1, 2));
    for name in
        ["python2.pkl", "python2-text.pkl", "python3-protocol2.pkl", "python3-protocol5.pkl", "arrays.npz"]
    {
        let model = load(&data(name), false, Look::default()).unwrap();
        assert_eq!((model.identities.len(), model.expressions.len()), (300, 3), "{name}");
        for (parameters, timestep) in [(&json, 0), (&npz, 1)] {
            parameters.check(&model).unwrap();
            let shaped = model.shaped_with_offset(&parameters.shape, &parameters.static_offset);
            let pose = parameters.poses[timestep].pose(&model);
            let mut vertices = Vec::new();
            model.vertices(&shaped, &pose, &mut vertices);
            let error = farthest(&vertices, &expected.vertices);
            assert!(error < 1e-6 * SIZE, "{name}: {error} m");
            let landmarks: Vec<Vec3> = model.landmarks_on(&vertices).collect();
            let error = farthest(&landmarks, &expected.landmarks);
            assert!(landmarks.len() == 70 && error < 1e-6 * SIZE, "{name}: {error} m");
        }
    }
}

#[test]
fn masks_and_joints_have_their_places() {
    let model = load(&data("python2.pkl"), false, Look::default()).unwrap();
    assert_eq!(model.vertex_groups["lips"], [1, 3]);
    assert_eq!(model.vertex_groups["right_eyeball"], [6, 7]);
    assert_eq!(model.eyeballs, [vec![5], vec![6, 7]]);
    let parents: Vec<Option<usize>> = model.joints.iter().map(|joint| joint.parent).collect();
    assert_eq!(parents, [None, Some(0), Some(1), Some(1), Some(1)]);
    assert_eq!(model.joint(JointRole::Jaw), Some(2));
    let open = model.pose_of_action_units(&[(26, Side::Both, 1.0)]).unwrap();
    assert!(open.joint(2).to_scaled_axis().distance(Vec3::X * JAW_DROP) < 1e-6);
}

/// A model of FLAME's size as an archive: random where the teeth look, and zero elsewhere.
fn large_model(folder: &Path) -> PathBuf {
    const VERTICES: usize = 5023;
    const COMPONENTS: usize = 302;
    let mut stream = Key::new(3).stream("flame");
    let template: Vec<f32> = (0..3 * VERTICES).map(|_| 0.1 * stream.normal()).collect();
    let mut shapes = vec![0.0; VERTICES * 3 * COMPONENTS];
    for vertex in [1713, 1576, 3543, 3503] {
        for axis in 0..3 {
            for component in [0, 7, 300] {
                shapes[(vertex * 3 + axis) * COMPONENTS + component] = 0.01 * stream.normal();
            }
        }
    }
    let mut regressor = vec![0.0; 5 * VERTICES];
    (0..5).for_each(|joint| regressor[joint * VERTICES + 10 * joint] = 1.0);
    let weights: Vec<f32> = (0..VERTICES).flat_map(|_| [0.0, 1.0, 0.0, 0.0, 0.0]).collect();
    let arrays = [
        ("v_template", NpzArray::Float(&[VERTICES, 3], &template)),
        ("shapedirs", NpzArray::Float(&[VERTICES, 3, COMPONENTS], &shapes)),
        ("posedirs", NpzArray::Float(&[VERTICES, 3, 36], &vec![0.0; VERTICES * 3 * 36])),
        ("J_regressor", NpzArray::Float(&[5, VERTICES], &regressor)),
        ("kintree_table", NpzArray::Integer(&[2, 5], &[-1, 0, 1, 1, 1, 0, 1, 2, 3, 4])),
        ("weights", NpzArray::Float(&[VERTICES, 5], &weights)),
        ("f", NpzArray::Integer(&[1, 3], &[0, 1, 2])),
    ];
    let path = folder.join("flame.npz");
    write_npz(&path, &arrays).unwrap();
    path
}

#[test]
fn teeth_are_those_of_vhap() {
    let folder = tempfile::tempdir().unwrap();
    let path = large_model(folder.path());
    let model = load(&path, true, Look::default()).unwrap();
    let bare = load(&path, false, Look::default()).unwrap();
    assert_eq!((bare.template.len(), model.template.len()), (5023, 5143));
    assert_eq!(model.triangles.len(), bare.triangles.len() + 168);
    assert_eq!(model.template[..5023], bare.template);

    // Positions, in f64 from VHAP's `add_teeth`; rings of 15 vertices.
    let at = |v: usize| model.template[v].as_dvec3();
    let upper = [1713, 1715, 1716, 1735, 1696, 1694, 1657, 3543, 2774, 2811, 2813, 2850, 2833, 2832, 2830];
    let lower = [1576, 1577, 1773, 1774, 1795, 1802, 1865, 3503, 2948, 2905, 2898, 2881, 2880, 2713, 2712];
    let pairs = || upper.iter().zip(&lower);
    let gap = pairs().map(|(u, l)| at(*u).distance(at(*l))).sum::<f64>() / 15.0;
    let height = pairs().map(|(u, l)| (at(*u).y + at(*l).y) / 2.0).sum::<f64>() / 15.0;
    // Up and back of each row against the middle, in gaps.
    let rows =
        [(2.1, 1.5), (-2.1, 1.9), (0.1, 1.5), (-0.1, 1.9), (2.1, 2.5), (0.1, 2.5), (-2.1, 2.9), (-0.1, 2.9)];
    for (row, (up, back)) in rows.into_iter().enumerate() {
        for (column, (u, l)) in pairs().enumerate() {
            let middle = (at(*u) + at(*l)) / 2.0;
            let expected = DVec3::new(middle.x, height + up * gap, middle.z - back * gap);
            let error = at(5023 + 15 * row + column).distance(expected);
            assert!(error < 1e-6 * SIZE, "row {row}, column {column}: {error} m");
        }
    }

    // The first and last quad of each strip, and the two at the middle tooth, in the order of VHAP's list.
    let teeth: Vec<[u32; 3]> =
        model.triangles[1..].iter().map(|triangle| triangle.map(|v| v - 5023)).collect();
    for (number, expected) in [
        (0, [[0, 31, 30], [0, 1, 31]]),
        (14, [[7, 8, 37], [8, 38, 37]]),
        (26, [[13, 14, 43], [14, 44, 43]]),
        (28, [[60, 75, 76], [60, 76, 61]]),
        (40, [[66, 81, 82], [66, 82, 67]]),
        (42, [[67, 82, 68], [68, 82, 83]]),
        (56, [[75, 30, 76], [76, 30, 31]]),
        (68, [[81, 36, 82], [82, 36, 37]]),
        (70, [[82, 37, 38], [82, 38, 83]]),
        (84, [[45, 46, 15], [46, 16, 15]]),
        (96, [[51, 52, 21], [52, 22, 21]]),
        (98, [[52, 23, 22], [52, 53, 23]]),
        (112, [[90, 106, 105], [90, 91, 106]]),
        (126, [[97, 98, 112], [98, 113, 112]]),
        (140, [[105, 106, 45], [106, 46, 45]]),
        (154, [[112, 53, 52], [112, 113, 53]]),
        (166, [[118, 59, 58], [118, 119, 59]]),
    ] {
        assert_eq!(teeth[number..number + 2], expected, "triangle {number}");
    }
    let mut edges: Vec<[u32; 2]> =
        teeth.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]).collect();
    edges.sort_unstable();
    edges.dedup();
    assert_eq!(edges.len(), 3 * 168, "no edge is used twice in one direction");

    // Each column follows the mean of its vertices on the lips by shapes, and not by expressions; the rows follow neck and jaw.
    let shaped = model.shaped(&[0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]);
    let moved = |v: usize| shaped.vertices[v] - model.template[v];
    for row in 0..8 {
        for (column, u, l) in [(0, 1713, 1576), (7, 3543, 3503)] {
            let tooth = moved(5023 + 15 * row + column);
            assert!(tooth.length() > 1e-3 && tooth.distance((moved(u) + moved(l)) / 2.0) < 1e-7);
        }
        assert_eq!(moved(5023 + 15 * row + 1), Vec3::ZERO);
    }
    let mut smiling = Vec::new();
    let pose = HeadPose { expressions: vec![1.0], ..HeadPose::default() };
    model.vertices(&model.shaped(&[]), &pose, &mut smiling);
    assert!(smiling[1713].distance(model.template[1713]) > 1e-3);
    assert_eq!(smiling[5023..], model.template[5023..]);
    for (row, joint) in [(0, 1), (1, 2), (2, 1), (3, 2), (4, 1), (5, 1), (6, 2), (7, 2)] {
        assert_eq!(model.skinning.of(5023 + 15 * row + 14), [(joint, 1.0)], "row {row}");
    }
    assert_eq!((model.vertex_groups["teeth"].len(), model.vertex_groups["teeth_upper"].len()), (120, 60));
    let is_teeth = |region: &&Region| **region == Region::Teeth;
    assert_eq!(model.regions.iter().filter(is_teeth).count(), 168);
}

#[test]
fn errors_name_the_file_and_what_is_wrong() {
    let error = |path: &Path, teeth: bool| load(path, teeth, Look::default()).unwrap_err().to_string();
    let small = error(&data("python2.pkl"), true);
    assert!(small.contains("python2.pkl: 8 vertices") && small.contains("5023"), "{small}");
    let other = error(&data("landmark_embedding_with_eyes.npy"), false);
    assert!(other.contains("one called `v_template`, found the keys full_lmk_faces_idx"), "{other}");
    let missing = error(&data("none.pkl"), false);
    assert!(missing.contains("none.pkl: opening"), "{missing}");

    let folder = tempfile::tempdir().unwrap();
    for file in ["arrays.npz", "FLAME_masks.pkl", "landmark_embedding_with_eyes.npy"] {
        std::fs::copy(data(file), folder.path().join(file)).unwrap();
    }
    let model = folder.path().join("arrays.npz");
    // Vertex 1 of the lips becomes number 0x7f.
    let masks = std::fs::read(data("FLAME_masks.pkl")).unwrap();
    let raw = [3_i64, 1].map(i64::to_le_bytes).concat();
    let at = masks.windows(16).position(|window| window == raw).unwrap();
    let mut spoiled = masks.clone();
    spoiled[at] = 0x7f;
    std::fs::write(folder.path().join("FLAME_masks.pkl"), spoiled).unwrap();
    let mask = error(&model, false);
    assert!(
        mask.contains("FLAME_masks.pkl: index: expected a number from 0 to 7, found 127 in the array `lips`"),
        "{mask}"
    );
}

/// A surface with FLAME's structure: a tube of 32 columns from the mouth down to the neck, and two eyeballs in sockets.
struct MadeUp {
    template: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

const COLUMNS: u32 = 32;
const RINGS: u32 = 20;

impl MadeUp {
    fn new() -> Self {
        let mut made = Self { template: Vec::new(), triangles: Vec::new() };
        for ring in 0..RINGS {
            // Turned a little from ring to ring, as where edges are not straight.
            let turn = 0.02 * ring as f32;
            let (size, down) = (0.02 + 0.002 * ring as f32, 0.01 * ring as f32);
            for column in 0..COLUMNS {
                let angle = std::f32::consts::TAU * column as f32 / COLUMNS as f32 + turn;
                made.template.push(Vec3::new(size * angle.cos(), 0.6 * size * angle.sin() - down, -down));
            }
        }
        made.quads(0, COLUMNS, RINGS);
        for side in [1.0, -1.0] {
            for radius in [0.012, 0.014] {
                made.sphere(Vec3::new(0.04 * side, 0.06, 0.0), radius);
            }
        }
        made
    }

    fn quads(&mut self, first: u32, columns: u32, rings: u32) {
        for ring in 0..rings - 1 {
            for column in 0..columns {
                let at = |ring: u32, column: u32| first + ring * columns + column % columns;
                let [a, b] = [at(ring, column), at(ring, column + 1)];
                let [c, d] = [at(ring + 1, column + 1), at(ring + 1, column)];
                self.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }

    /// 8 rings of 12 vertices, then the front and the back.
    fn sphere(&mut self, centre: Vec3, radius: f32) {
        let first = self.template.len() as u32;
        for ring in 1..9 {
            let down = std::f32::consts::PI * ring as f32 / 9.0;
            for column in 0..12 {
                let around = std::f32::consts::TAU * column as f32 / 12.0;
                let out = Vec3::new(around.cos() * down.sin(), around.sin() * down.sin(), down.cos());
                self.template.push(centre + out * radius);
            }
        }
        self.template.extend([centre + Vec3::Z * radius, centre - Vec3::Z * radius]);
        self.quads(first, 12, 8);
        for column in 0..12 {
            let next = (column + 1) % 12;
            self.triangles.push([first + 96, first + next, first + column]);
            self.triangles.push([first + 97, first + 84 + column, first + 84 + next]);
        }
    }
}

#[test]
fn groups_follow_from_how_the_mesh_is_connected() {
    let MadeUp { template, triangles } = MadeUp::new();
    let tube = COLUMNS * RINGS;
    let sphere = |number: u32| (tube + 98 * number..tube + 98 * (number + 1)).collect::<Vec<u32>>();
    let mut groups: BTreeMap<String, Vec<u32>> = [
        ("face", vec![0, 1, 2]),
        ("neck", vec![5]),
        ("scalp", vec![1, 5, 6, 7]),
        ("left_ear", vec![9, 10]),
        ("right_ear", vec![8, 9]),
        ("left_eyeball", sphere(0)),
        ("right_eyeball", sphere(2)),
    ]
    .map(|(name, group)| (name.to_owned(), group))
    .into();
    groups::add(&mut groups, &template, &triangles, &[sphere(0), sphere(2)], Some(&template));

    let rings = |rings: std::ops::Range<u32>, columns: &[u32]| -> Vec<u32> {
        rings.flat_map(|ring| columns.iter().map(move |column| ring * COLUMNS + column)).collect()
    };
    let all: Vec<u32> = (0..COLUMNS).collect();
    let (upper, lower): (Vec<u32>, Vec<u32>) = ((1..16).collect(), (17..32).collect());
    let with_corners: Vec<u32> = (0..=16).collect();
    let front = |first: u32| [(0..36).map(|v| first + v).collect(), vec![first + 96]].concat();
    let back = |first: u32| [(60..96).map(|v| first + v).collect(), vec![first + 97]].concat();
    let sclera = |eye: u32| sphere(eye).into_iter().filter(move |v| !front(tube + 98 * eye).contains(v));
    for (name, expected) in [
        ("lip_inside_ring", rings(0..1, &all)),
        ("lip_inside_ring_upper", rings(0..1, &upper)),
        ("lip_inside_ring_lower", rings(0..1, &lower)),
        ("lip_inside", rings(0..4, &all)),
        ("lip_inside_upper", rings(0..3, &with_corners)),
        ("lip_inside_lower", rings(0..3, &lower)),
        ("bottomline", rings(RINGS - 1..RINGS, &all)),
        ("neck_lower", rings(RINGS - 7..RINGS - 2, &all)),
        ("left_iris", front(tube)),
        ("right_iris", front(tube + 196)),
        ("irises", [front(tube), front(tube + 196)].concat()),
        ("sclerae", sclera(0).chain(sclera(2)).collect()),
        ("left_eye_socket", back(tube + 98)),
        ("right_eye_socket", back(tube + 294)),
        ("ears", vec![8, 9, 10]),
        ("hair", vec![6, 7]),
    ] {
        assert_eq!(groups[name], expected, "{name}");
    }
    let halves = ["left_half", "right_half"].map(|name| &groups[name]);
    assert!(halves[0].iter().all(|v| template[*v as usize].x >= 0.0) && halves[0].contains(&0));
    assert!(halves[1].iter().all(|v| template[*v as usize].x <= 0.0));
    assert!(!groups.contains_key("left_eye"), "the masks lack left_eye_region");
    assert!(!groups.contains_key("neck_left_point"), "it is another mesh");
}

#[test]
fn other_meshes_have_none_of_the_groups_that_need_flames_boundaries() {
    let closed = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]];
    let template = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
    // Edges that three triangles have, and triangles of one vertex.
    let wild = [[0, 1, 2], [0, 1, 3], [1, 0, 2], [2, 2, 2]];
    for triangles in [&closed[..], &wild, &[]] {
        let mut groups = BTreeMap::new();
        groups::add(&mut groups, &template, triangles, &[vec![], vec![3]], None);
        assert!(!groups.contains_key("lip_inside") && !groups.contains_key("left_half"), "{groups:?}");
    }
}

/// The lists of a copy of VHAP in the folder `SRFLOW_VHAP`, on its own mesh.
#[test]
fn groups_are_those_of_vhap() {
    let Some(folder) = std::env::var_os("SRFLOW_VHAP").map(PathBuf::from) else {
        eprintln!("skipped: vhap: SRFLOW_VHAP names no copy of VHAP");
        return;
    };
    let code = std::fs::read_to_string(folder.join("vhap/model/flame.py")).unwrap();
    let mesh = read_obj(&folder.join("asset/flame/head_template_mesh.obj")).unwrap();
    let triangles: Vec<[u32; 3]> =
        mesh.polygons.iter().map(|corners| corners.as_slice().try_into().unwrap()).collect();
    let eyeballs = [3931..4477, 4477..5023].map(Iterator::collect);
    let mut groups = BTreeMap::new();
    groups::add(&mut groups, &mesh.positions, &triangles, &eyeballs, Some(&mesh.positions));
    let mut compared = Vec::new();
    for part in code.split("register_buffer(").skip(1) {
        let Some((name, list)) = part.split_once("torch.tensor([") else { continue };
        let Some(name) = name.split('"').nth(1) else { continue };
        let list = list.split(']').next().unwrap().split(',').filter_map(|word| word.trim().parse().ok());
        let mut listed: Vec<u32> = list.collect();
        listed.sort_unstable();
        let Some(found) = groups.get(name).filter(|_| name != "lip_inside_ring") else { continue };
        assert_eq!(*found, listed, "{name}");
        compared.push(name);
    }
    assert_eq!(compared.len(), 17, "{compared:?}");
    let map = texture(&folder, &mesh, &triangles).unwrap().unwrap();
    assert_eq!((map.points.len(), map.triangles.len()), (5118, 9976));
}

#[test]
fn texture_coordinates_are_those_of_the_mesh_beside_it_and_of_vhaps_teeth() {
    let folder = tempfile::tempdir().unwrap();
    let path = large_model(folder.path());
    assert_eq!(load(&path, true, Look::default()).unwrap().texture, None);
    let write = |vertices: usize, faces: &str| {
        let vertices: String = (0..vertices).map(|v| format!("v {} 0 1\n", v as i32 % 3 - 1)).collect();
        let text = format!("{vertices}vt 0.1 0.2\nvt 0.3 0.4\nvt 0.5 0.6\nvt 0.7 0.8\n{faces}");
        std::fs::write(folder.path().join(TEMPLATE), text).unwrap();
    };
    write(5023, "f 2/1 3/2 1/4\n");
    let bare = load(&path, false, Look::default()).unwrap();
    let map = bare.texture.unwrap();
    assert_eq!((map.points.len(), &map.triangles[..]), (4, &[[3, 0, 1]][..]));
    assert_eq!(bare.vertex_groups["left_half"][..3], [1, 2, 4]);
    let model = load(&path, true, Look::default()).unwrap();
    model.validate().unwrap();
    let map = model.texture.unwrap();
    assert_eq!((map.points.len(), map.triangles.len()), (124, 169));
    // linspace(0.62, 0.38, 15) and linspace(0.9917, 0.9575, 7)[[3, 2, 0, 1, 3, 4, 6, 5]].
    for (row, height) in
        [0.9746, 0.9803, 0.9917, 0.986, 0.9746, 0.9689, 0.9575, 0.9632].into_iter().enumerate()
    {
        for (column, along) in [(0, 0.62), (7, 0.5), (14, 0.38)] {
            let found = map.points[4 + 15 * row + column];
            let off = (f64::from(found.x) - along).abs().max((f64::from(found.y) - height).abs());
            assert!(off < 1e-6, "row {row}, column {column}: {found}");
        }
    }
    for (triangle, points) in model.triangles.iter().zip(&map.triangles).skip(1) {
        assert_eq!(points.map(|point| point - 4), triangle.map(|v| v - 5023));
    }
    let half = |name: &str| model.vertex_groups[name].iter().filter(|v| **v >= 5023).count();
    assert_eq!((half("left_half"), half("right_half")), (64, 64));
    assert!(model.vertex_groups["right_half"].contains(&5096));
    assert!(model.vertex_groups["left_half"].is_sorted());

    write(5022, "f 2/1 3/2 1/4\n");
    let short = load(&path, false, Look::default()).unwrap_err().to_string();
    assert!(short.contains("head_template_mesh.obj: 5022 vertices"), "{short}");
    write(5023, "f 2/1 3/2 4/4\n");
    let other = load(&path, false, Look::default()).unwrap_err().to_string();
    assert!(other.contains("none with the vertices 1, 2 and 3"), "{other}");
    write(5023, "f 2 3 1\n");
    assert_eq!(load(&path, false, Look::default()).unwrap().texture, None);
}

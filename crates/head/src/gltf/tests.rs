use glam::Quat;
use serde_json::{Value, json};
use srflow_core::random::Key;

use super::*;
use crate::found_head::COMPANIONS;
use crate::{HeadPose, Side};

/// A buffer with its views and accessors.
#[derive(Default)]
struct Bytes {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Bytes {
    fn view(&mut self, bytes: &[u8]) -> usize {
        self.views.push(json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()}));
        self.bytes.extend(bytes);
        self.views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], component: u32, count: usize, kind: &str) -> usize {
        let view = self.view(bytes);
        self.accessors
            .push(json!({"bufferView": view, "componentType": component, "count": count, "type": kind}));
        self.accessors.len() - 1
    }

    fn vectors(&mut self, vectors: &[Vec3]) -> usize {
        let bytes: Vec<u8> = vectors.iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect();
        self.accessor(&bytes, 5126, vectors.len(), "VEC3")
    }
}

const FACE: [Vec3; 4] =
    [Vec3::ZERO, Vec3::new(0.1, 0.0, 0.0), Vec3::new(0.1, 0.1, 0.02), Vec3::new(0.0, 0.1, 0.01)];
const EYE: [Vec3; 3] = [Vec3::ZERO, Vec3::new(0.01, 0.0, 0.0), Vec3::new(0.0, 0.01, 0.0)];
const SMILE: [Vec3; 4] = [Vec3::new(0.01, 0.0, 0.0), Vec3::ZERO, Vec3::new(0.0, 0.02, 0.0), Vec3::ZERO];

/// A face on the joints Head and Jaw, and an eyeball without a skin that hangs on Head.
fn head() -> (Value, Vec<u8>) {
    let mut b = Bytes::default();
    let face = b.vectors(&FACE);
    let indices: Vec<u8> = [0_u16, 1, 2, 0, 2, 3].into_iter().flat_map(u16::to_le_bytes).collect();
    let face_indices = b.accessor(&indices, 5123, 6, "SCALAR");
    let joints = b.accessor(&[0, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0], 5121, 4, "VEC4");
    let weights: [[f32; 4]; 4] =
        [[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [0.25, 0.75, 0.0, 0.0]];
    let weights: Vec<u8> = weights.as_flattened().iter().flat_map(|w| w.to_le_bytes()).collect();
    let weights = b.accessor(&weights, 5126, 4, "VEC4");
    let bind = [DMat4::from_translation(DVec3::new(0.0, -1.0, 0.0)), DMat4::from_rotation_y(0.3)];
    let bind: Vec<u8> =
        bind.iter().flat_map(|m| m.to_cols_array()).flat_map(|x| (x as f32).to_le_bytes()).collect();
    let bind = b.accessor(&bind, 5126, 2, "MAT4");
    // As Blender writes morph targets: only the vertices that move.
    let places = b.view(&[0, 2]);
    let moved: Vec<u8> =
        [SMILE[0], SMILE[2]].iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect();
    let moved = b.view(&moved);
    b.accessors.push(json!({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": {"count": 2,
        "indices": {"bufferView": places, "componentType": 5121}, "values": {"bufferView": moved}}}));
    let smile = b.accessors.len() - 1;
    let eye = b.vectors(&EYE);
    let blink = b.vectors(&[Vec3::Z * 0.003; 3]);
    let json = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "Armature", "rotation": [0.0, 0.38268343, 0.0, 0.92387953], "scale": [2.0, 2.0, 2.0], "children": [3, 1]},
            {"name": "Head", "translation": [0.0, 1.0, 0.0], "children": [2, 4]},
            {"name": "Jaw", "translation": [0.0, -0.05, 0.02]},
            {"name": "face", "mesh": 0, "skin": 0},
            {"name": "LeftEye", "mesh": 1, "translation": [0.03, 0.1, 0.08]},
        ],
        "meshes": [
            {"name": "Face", "extras": {"targetNames": ["mouthSmileLeft"]}, "primitives": [{
                "attributes": {"POSITION": face, "JOINTS_0": joints, "WEIGHTS_0": weights},
                "indices": face_indices, "targets": [{"POSITION": smile}]}]},
            {"name": "Eyeball", "extras": {"targetNames": ["eyeBlinkLeft", "mouthSmileLeft"]}, "primitives": [{
                "attributes": {"POSITION": eye}, "targets": [{"POSITION": blink}, {"NORMAL": 0}]}]},
        ],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": bind}],
        "accessors": b.accessors,
        "bufferViews": b.views,
        "buffers": [{"byteLength": b.bytes.len()}],
    });
    (json, b.bytes)
}

fn glb(json: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut glb = b"glTF".to_vec();
    for number in [2, 12 + 16 + text.len() + binary.len(), text.len()] {
        glb.extend((number as u32).to_le_bytes());
    }
    glb.extend(b"JSON");
    glb.extend(&text);
    glb.extend((binary.len() as u32).to_le_bytes());
    glb.extend(b"BIN\0");
    glb.extend(&binary);
    glb
}

fn read(name: &str, bytes: &[u8]) -> Result<HeadModel, String> {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    load(&path, Look::default()).map_err(|error| error.to_string())
}

/// The global transforms of Armature, Head, Jaw and LeftEye.
fn globals() -> [DMat4; 4] {
    let armature = DMat4::from_rotation_y(std::f64::consts::FRAC_PI_4) * DMat4::from_scale(DVec3::splat(2.0));
    let head = armature * DMat4::from_translation(DVec3::Y);
    let jaw = head * DMat4::from_translation(DVec3::new(0.0, -0.05, 0.02));
    [armature, head, jaw, head * DMat4::from_translation(DVec3::new(0.03, 0.1, 0.08))]
}

#[test]
fn the_pose_of_the_file_is_the_template() {
    let (json, binary) = head();
    let model = read("head.glb", &glb(&json, &binary)).unwrap();
    let [_, head, jaw, eye] = globals();
    // The skinning of the specification, section 3.7.3.3, in f64.
    let bind = [head * DMat4::from_translation(-DVec3::Y), jaw * DMat4::from_rotation_y(0.3)];
    let shares = [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0], [0.25, 0.75]];
    let blended = shares.map(|[first, second]| bind[0] * first + bind[1] * second);
    for (v, matrix) in blended.iter().enumerate() {
        let expected = matrix.transform_point3(FACE[v].as_dvec3());
        assert!(model.template[v].as_dvec3().distance(expected) < 5e-7, "vertex {v}");
        let moved = model.expressions[0].offsets.iter().find(|(vertex, _)| *vertex == v as u32);
        let offset = matrix.transform_vector3(SMILE[v].as_dvec3());
        let found = moved.map_or(Vec3::ZERO, |(_, offset)| offset);
        assert!(found.as_dvec3().distance(offset) < 1e-7, "vertex {v}: {found} {offset}");
    }
    for (v, at) in EYE.iter().enumerate() {
        let expected = eye.transform_point3(at.as_dvec3());
        assert!(model.template[4 + v].as_dvec3().distance(expected) < 5e-7);
    }
    let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["Head", "Jaw", "LeftEye"]);
    assert_eq!(
        [JointRole::Root, JointRole::Jaw, JointRole::LeftEye].map(|r| model.joint(r)),
        [0, 1, 2].map(Some)
    );
    assert_eq!((&model.eyeballs[0][..], &model.eyeballs[1][..]), (&[4, 5, 6][..], &[][..]));
    assert_eq!(model.regions, [Region::Skin, Region::Skin, Region::Eyeball]);
    assert_eq!(model.triangles, [[0, 1, 2], [0, 2, 3], [4, 5, 6]]);
    let units: Vec<(u8, Side)> = model.action_units.iter().map(|unit| (unit.number, unit.side)).collect();
    assert_eq!(units, [(12, Side::Left), (43, Side::Left), (45, Side::Left)]);
}

#[test]
fn joints_rotate_about_their_places() {
    let (json, binary) = head();
    let model = read("head.glb", &glb(&json, &binary)).unwrap();
    let [_, _, jaw, _] = globals();
    let about = jaw.w_axis.truncate();
    let mut pose = HeadPose::default();
    let turn = Quat::from_rotation_x(0.4);
    *pose.joint_mut(1) = turn;
    let mut vertices = Vec::new();
    model.vertices(&model.shaped(&[]), &pose, &mut vertices);
    assert!(vertices[0].distance(model.template[0]) < 1e-6, "follows Head alone");
    let expected = about + turn.as_dquat() * (model.template[2].as_dvec3() - about);
    assert!(vertices[2].as_dvec3().distance(expected) < 1e-6, "follows Jaw alone");
    assert!(vertices[5].distance(model.template[5]) < 1e-6, "hangs on Head");
}

#[test]
fn documents_with_files_or_data_beside_them_are_read() {
    let (mut json, binary) = head();
    let whole = read("head.glb", &glb(&json, &binary)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("head.gltf");
    std::fs::write(folder.path().join("head data.bin"), &binary).unwrap();
    json["buffers"][0]["uri"] = "head%20data.bin".into();
    std::fs::write(&path, json.to_string()).unwrap();
    assert_eq!(load(&path, Look::default()).unwrap().template, whole.template);
    assert_eq!(files_named_in(&path), [folder.path().join("head data.bin")]);
    for uri in ["../head.bin", "/etc/passwd", "http://a/b", "data:,x", "data:;base64,!", ""] {
        json["buffers"][0]["uri"] = uri.into();
        let error = read("head.gltf", json.to_string().as_bytes()).unwrap_err();
        assert!(error.contains("uri: expected"), "{uri}: {error}");
    }
}

#[test]
fn landmarks_beside_the_file_are_read() {
    let (json, binary) = head();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("head.glb"), glb(&json, &binary)).unwrap();
    std::fs::write(folder.path().join(COMPANIONS[0]), "3 0.25 0 0.5 2 0.25\n".repeat(68)).unwrap();
    let model = load(&folder.path().join("head.glb"), Look::default()).unwrap();
    let place = model.landmarks_on(&model.template).last().unwrap();
    let t = &model.template;
    assert!(place.distance(t[3] * 0.25 + t[0] * 0.5 + t[2] * 0.25) < 1e-6 && model.landmarks.len() == 68);
}

/// Adds an accessor of floats to a document and returns its number.
fn add_floats(json: &mut Value, bytes: &mut Vec<u8>, numbers: &[f32], kind: &str, count: usize) -> usize {
    let view = json!({"buffer": 0, "byteOffset": bytes.len(), "byteLength": 4 * numbers.len()});
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    let mut push = |list: &str, entry: Value| {
        let list = json[list].as_array_mut().unwrap();
        list.push(entry);
        list.len() - 1
    };
    let view = push("bufferViews", view);
    push("accessors", json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind}))
}

/// The face of [`head`] with a texture of two by two pixels and colours of its vertices.
fn textured(image: Value) -> (Value, Vec<u8>) {
    let (mut json, mut bytes) = head();
    let mut add =
        |numbers: &[f32], kind: &str, count: usize| add_floats(&mut json, &mut bytes, numbers, kind, count);
    let places = add(&[0.25, 0.25, 0.75, 0.25, 0.75, 0.75, 0.25, 0.75], "VEC2", 4);
    let colors = add(&[1.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], "VEC3", 4);
    let face = &mut json["meshes"][0]["primitives"][0];
    face["attributes"]["TEXCOORD_0"] = places.into();
    face["attributes"]["COLOR_0"] = colors.into();
    face["material"] = 0.into();
    json["materials"] =
        json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "alphaMode": "BLEND"}]);
    json["textures"] = json!([{"source": 0}]);
    json["images"] = json!([image]);
    json["buffers"][0]["byteLength"] = bytes.len().into();
    (json, bytes)
}

/// Red and green above, blue and white below.
fn picture() -> Value {
    json!({"uri": "data:image/x-portable-pixmap;base64,UDYgMiAyIDI1NQr/AAAA/wAAAP////8="})
}

#[test]
fn textures_and_colours_of_vertices_are_those_of_the_mesh() {
    let (mut json, bytes) = textured(picture());
    let corner = |json: &Value, number: usize| {
        let model = read("head.glb", &glb(json, &bytes)).unwrap();
        model.color_at(0, Vec3::AXES[number]).unwrap()
    };
    // White times green, in linear light.
    assert!((corner(&json, 0) - Vec3::new(1.0, 0.0, 0.0)).length() < 1e-6);
    assert!((corner(&json, 1) - Vec3::new(0.0, 1.0, 0.0)).length() < 1e-6);
    assert!((corner(&json, 2) - Vec3::ONE).length() < 1e-6);
    // v counts from the top, as it does for the texture.
    let texture = "/materials/0/pbrMetallicRoughness/baseColorTexture";
    *json.pointer_mut(texture).unwrap() =
        json!({"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0.0]}}});
    assert!((corner(&json, 1) - Vec3::new(1.0, 0.0, 0.0)).length() < 1e-6);
    *json.pointer_mut(texture).unwrap() = json!({"index": 0, "extensions": {"KHR_texture_transform": {"rotation": std::f32::consts::FRAC_PI_2}}});
    // (0.75, 0.25) turns to (0.25, -0.75), which is red again.
    assert!((corner(&json, 1) - Vec3::new(1.0, 0.0, 0.0)).length() < 1e-5, "{}", corner(&json, 1));
    // The other mesh has no material, and no light but white.
    let model = read("head.glb", &glb(&json, &bytes)).unwrap();
    assert!((model.color_at(2, Vec3::X).unwrap() - Vec3::ONE).length() < 1e-6);
    assert!(read("head.glb", &glb(&head().0, &head().1)).unwrap().colors.is_none());
}

#[test]
fn textures_that_cannot_be_read_are_left_out() {
    for image in [
        json!({}),
        json!({"uri": "none.png"}),
        json!({"bufferView": 99}),
        json!({"uri": "data:;base64,AAAA"}),
    ] {
        let (json, bytes) = textured(image.clone());
        let model = read("head.glb", &glb(&json, &bytes)).unwrap();
        assert!(model.colors.as_ref().is_some_and(|colors| !colors.has_texture(0)), "{image}");
    }
}

/// [`head`] with two clips: `nod` turns Head by 0.4 about x within a second and shows the smile by half, `still` names a node without a joint.
fn with_clips() -> (Value, Vec<u8>) {
    let (mut json, mut bytes) = head();
    let mut add =
        |numbers: &[f32], kind: &str, count: usize| add_floats(&mut json, &mut bytes, numbers, kind, count);
    let times = add(&[0.0, 1.0], "SCALAR", 2);
    let turn = Quat::from_rotation_x(0.4).to_array();
    let turns = add([[0.0, 0.0, 0.0, 1.0], turn].as_flattened(), "VEC4", 2);
    let weights = add(&[0.0, 0.5], "SCALAR", 2);
    json["animations"] = json!([
        {"name": "nod",
         "channels": [
            {"sampler": 0, "target": {"node": 1, "path": "rotation"}},
            {"sampler": 0, "target": {"node": 1, "path": "translation"}},
            {"sampler": 1, "target": {"node": 3, "path": "weights"}}],
         "samplers": [{"input": times, "output": turns}, {"input": times, "output": weights}]},
        {"name": "still",
         "channels": [{"sampler": 0, "target": {"node": 3, "path": "rotation"}}],
         "samplers": [{"input": times, "output": turns}]},
    ]);
    json["buffers"][0]["byteLength"] = bytes.len().into();
    (json, bytes)
}

#[test]
fn clips_turn_joints_as_their_nodes_turn_in_the_scene() {
    let (json, bytes) = with_clips();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("head.glb");
    std::fs::write(&path, glb(&json, &bytes)).unwrap();
    let model = load(&path, Look::default()).unwrap();
    let poses = |clip: &str| {
        crate::Clip::parse(Path::new(&format!("{}{clip}", path.display()))).unwrap().poses(&model, 10.0)
    };
    let nod = poses("@nod").unwrap();
    assert_eq!(nod.len(), 11);
    let pose = nod[5].pose(&model);
    let head = model.joints.iter().position(|joint| joint.name == "Head").unwrap();
    // Head's axes are those of Armature, which turns it by 45 degrees.
    let (_, armature, _) = globals()[0].to_scale_rotation_translation();
    let expected = armature.as_quat() * Quat::from_rotation_x(0.2) * armature.as_quat().inverse();
    assert!(pose.joint(head).angle_between(expected) < 1e-5, "{}", pose.joint(head));
    assert_eq!(pose.expressions[..1], [0.25]);
    let others = (0..model.joints.len()).filter(|joint| *joint != head);
    assert!(others.into_iter().all(|joint| pose.joint(joint).angle_between(Quat::IDENTITY) < 1e-5));
    // The vertices go where the file's own node would take them.
    let mut vertices = Vec::new();
    model.vertices(&model.shaped(&[]), &pose, &mut vertices);
    let eye = globals()[1] * DMat4::from_rotation_x(0.2) * globals()[1].inverse() * globals()[3];
    assert!(vertices[4].distance(eye.transform_point3(DVec3::ZERO).as_vec3()) < 1e-5, "{}", vertices[4]);
    let error = |clip: &str| poses(clip).unwrap_err().to_string();
    assert!(error("@still").contains("rotations of joints of gltf (Head"), "{}", error("@still"));
    assert!(error("").contains("FILE@CLIP with one of its clips: nod, still"), "{}", error(""));
    assert!(
        error("@wave").contains("expected one of its clips: nod, still, found wave"),
        "{}",
        error("@wave")
    );
}

#[test]
fn wrong_references_and_claims_are_named() {
    let refuses = |path: &str, value: Value, expected: &str| {
        let (mut json, binary) = head();
        *json.pointer_mut(path).unwrap() = value;
        let error = read("head.glb", &glb(&json, &binary)).unwrap_err();
        assert!(error.contains("head.glb") && error.contains(expected), "{path}: {error}");
    };
    refuses("/scenes/0/nodes/0", json!(9), "node: expected one of the file's, found 9");
    refuses("/nodes/2", json!({"children": [0]}), "nodes: expected a tree, found node 0 twice");
    refuses("/nodes/0/scale", json!([1e300, 1.0, 1.0]), "a finite transform");
    refuses("/nodes/3/mesh", json!(7), "mesh: expected one of the file's");
    refuses("/nodes/3/skin", json!(7), "skin: expected one of the file's");
    refuses("/skins/0/joints/1", json!(70), "joint: expected a node");
    refuses("/accessors/0/count", json!(1_u64 << 60), "no more elements than the file can hold");
    refuses("/accessors/0/count", json!(1 << 19), "bytes inside its buffer");
    refuses("/accessors/0/type", json!("VEC2"), "elements of 3 numbers, found 4 of type VEC2");
    refuses("/accessors/0/componentType", json!(9), "componentType");
    refuses("/accessors/1/componentType", json!(5126), "bufferView");
    refuses("/bufferViews/0/byteOffset", json!(u64::MAX), "bufferView");
    refuses("/bufferViews/0/buffer", json!(1), "bufferView");
    refuses("/accessors/5/sparse/count", json!(1_u64 << 40), "bufferView");
    refuses("/accessors/5/count", json!(5), "4 elements of 3 numbers, found 5");
    refuses("/meshes/0/primitives/0/attributes", json!({}), "POSITION");
    refuses("/meshes", json!([{}, {}]), "a scene with triangles");
    let (mut json, binary) = head();
    json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    let error = read("head.glb", &glb(&json, &binary)).unwrap_err();
    assert!(error.contains("without compression, found KHR_draco"), "{error}");
    let whole = glb(&json, &binary);
    assert!(read("head.glb", &whole[..30]).unwrap_err().contains("broken or truncated"));
    assert!(read("head.gltf", b"{\"nodes\": 1}").unwrap_err().contains("glTF 2.0"));
}

/// Each hangs on the one before, and has the same mesh on the same skin.
#[test]
fn instances_of_a_mesh_are_read_in_any_depth_until_a_small_file_repeats_too_much() {
    const INSTANCES: usize = 3000;
    let (mut json, binary) = head();
    let nodes = json["nodes"].as_array_mut().unwrap();
    for number in 0..INSTANCES {
        let children = if number + 1 < INSTANCES { vec![6 + number] } else { vec![] };
        nodes.push(json!({"name": "face", "mesh": 0, "skin": 0, "children": children}));
    }
    nodes[4]["children"] = json!([5]);
    let model = read("head.glb", &glb(&json, &binary)).unwrap();
    assert_eq!(model.template.len(), 4 + 3 + 4 * INSTANCES);
    // A skin places its vertices, wherever the node is.
    assert_eq!(model.template[7 + 4 * (INSTANCES - 1)..], model.template[..4]);
    json["meshes"][0]["extras"]["targetNames"] = vec![""; 500].into();
    let error = read("head.glb", &glb(&json, &binary)).unwrap_err();
    assert!(error.contains("primitives and morph targets in all instances"), "{error}");
}

#[test]
fn mutated_files_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("head.glb");
    let mut stream = Key::new(6).stream("mutations");
    for (json, binary) in [head(), textured(picture()), with_clips()] {
        let whole = glb(&json, &binary);
        let mut refused = 0;
        for _ in 0..500 {
            let mut mutated = whole.clone();
            for _ in 0..1 + stream.below(3) {
                let at = stream.below(mutated.len() as u32) as usize;
                mutated[at] = if stream.unit() < 0.6 {
                    b"0123456789"[stream.below(10) as usize]
                } else {
                    stream.below(256) as u8
                };
            }
            std::fs::write(&path, &mutated).unwrap();
            let Ok(model) = load(&path, Look::default()) else {
                refused += 1;
                continue;
            };
            for clip in ["", "@nod"] {
                let clip = crate::Clip::parse(Path::new(&format!("{}{clip}", path.display()))).unwrap();
                drop(clip.poses(&model, 24.0));
            }
            model.color_at(0, Vec3::splat(1.0 / 3.0));
        }
        assert!(refused > 50, "{refused}");
    }
}

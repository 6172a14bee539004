use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::Path;

use serde_json::{Value, json};
use srflow_files::{FileError, write_atomically};

use super::{FLOAT, UNSIGNED_INT, UNSIGNED_SHORT};
use crate::NamedCamera;

/// Nearest depth that a camera shows, in world units.
const Z_NEAR: f64 = 0.01;

const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// A binary glTF file of one scene in the making: the specification of glTF 2.0, section 4. All nodes are in the coordinates of the
/// scene.
#[derive(Debug, Clone, Default)]
pub struct GltfBuilder {
    nodes: Vec<Value>,
    meshes: Vec<Value>,
    cameras: Vec<Value>,
    animations: Vec<Value>,
    accessors: Vec<Value>,
    views: Vec<Value>,
    extensions: BTreeSet<&'static str>,
    binary: Vec<u8>,
}

impl GltfBuilder {
    pub fn new() -> Self {
        Self::default()
    }

    /// An accessor of numbers, vectors or quaternions, with their bounds.
    pub fn floats<const N: usize>(&mut self, elements: impl IntoIterator<Item = [f32; N]>) -> usize {
        self.float_accessor(elements, Some(ARRAY_BUFFER))
    }

    /// An accessor of times or weights of an animation.
    pub fn keys(&mut self, elements: impl IntoIterator<Item = f32>) -> usize {
        self.float_accessor(elements.into_iter().map(|element| [element]), None)
    }

    fn float_accessor<const N: usize>(
        &mut self,
        elements: impl IntoIterator<Item = [f32; N]>,
        target: Option<u32>,
    ) -> usize {
        let start = self.binary.len();
        let (mut low, mut high) = ([f32::INFINITY; N], [f32::NEG_INFINITY; N]);
        for element in elements {
            for (value, (low, high)) in element.iter().zip(low.iter_mut().zip(&mut high)) {
                self.binary.extend(value.to_le_bytes());
                *low = low.min(*value);
                *high = high.max(*value);
            }
        }
        let count = (self.binary.len() - start) / (4 * N);
        let kind = if N == 1 { "SCALAR".to_owned() } else { format!("VEC{N}") };
        let (low, high) = (low.to_vec(), high.to_vec());
        self.accessor(
            start,
            target,
            json!({"componentType": FLOAT, "count": count, "type": kind, "min": low, "max": high}),
        )
    }

    /// An accessor of colours with opacity, linear.
    pub fn colors(&mut self, elements: impl IntoIterator<Item = [u16; 4]>) -> usize {
        let start = self.binary.len();
        self.binary.extend(elements.into_iter().flatten().flat_map(u16::to_le_bytes));
        let count = (self.binary.len() - start) / 8;
        self.accessor(
            start,
            Some(ARRAY_BUFFER),
            json!({"componentType": UNSIGNED_SHORT, "normalized": true, "count": count, "type": "VEC4"}),
        )
    }

    /// An accessor of the vertices of triangles.
    pub fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let start = self.binary.len();
        self.binary.extend(triangles.iter().flatten().flat_map(|index| index.to_le_bytes()));
        let count = 3 * triangles.len();
        self.accessor(
            start,
            Some(ELEMENT_ARRAY_BUFFER),
            json!({"componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"}),
        )
    }

    fn accessor(&mut self, start: usize, target: Option<u32>, mut accessor: Value) -> usize {
        let mut view = json!({"buffer": 0, "byteOffset": start, "byteLength": self.binary.len() - start});
        if let Some(target) = target {
            view["target"] = target.into();
        }
        accessor["bufferView"] = self.views.len().into();
        self.views.push(view);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds a node with a mesh, whose name both get, and returns its number. `mesh` is an object of the specification.
    pub fn add_mesh(&mut self, name: &str, mesh: &Value) -> usize {
        let mut mesh = mesh.clone();
        mesh["name"] = name.into();
        self.meshes.push(mesh);
        self.nodes.push(json!({"name": name, "mesh": self.meshes.len() - 1}));
        self.nodes.len() - 1
    }

    /// Adds a node for each camera. glTF knows no principal point: the angle of view is kept, about the middle of the picture.
    pub fn add_cameras(&mut self, cameras: &[NamedCamera]) {
        for NamedCamera { name, camera, .. } in cameras {
            let [width, height] = [camera.width as f64, camera.height as f64];
            self.cameras.push(json!({
                "name": name,
                "type": "perspective",
                "perspective": {
                    "yfov": 2.0 * libm::atan(height / (2.0 * camera.fy)),
                    "aspectRatio": (width / camera.fx) / (height / camera.fy),
                    "znear": Z_NEAR,
                },
            }));
            // The columns of a rotation's transpose are its rows. glTF's cameras look along -z, and y is up.
            let pose = camera.camera_from_world;
            let axis = |row: usize, sign: f64| (pose.row(row).truncate() * sign).to_array();
            let ([rx, ry, rz], [ux, uy, uz], [bx, by, bz]) = (axis(0, 1.0), axis(1, -1.0), axis(2, -1.0));
            let [x, y, z] = camera.position().to_array();
            let matrix = [rx, ry, rz, 0.0, ux, uy, uz, 0.0, bx, by, bz, 0.0, x, y, z, 1.0];
            // Negative zeros become zeros, for people who read the file.
            let matrix = matrix.map(|entry| entry + 0.0);
            self.nodes.push(json!({"name": name, "camera": self.cameras.len() - 1, "matrix": matrix}));
        }
    }

    /// Adds an animation, an object of the specification.
    pub fn add_animation(&mut self, animation: Value) {
        self.animations.push(animation);
    }

    /// Lists an extension that the file uses, and can be read without.
    pub fn use_extension(&mut self, name: &'static str) {
        self.extensions.insert(name);
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// When it would be larger than 4 GiB, or cannot be written.
    pub fn write(self, path: &Path) -> Result<(), FileError> {
        write_atomically(path, |writer| self.write_to(writer))
    }

    fn write_to(mut self, writer: &mut impl Write) -> io::Result<()> {
        while !self.binary.len().is_multiple_of(4) {
            self.binary.push(0);
        }
        let mut document = json!({
            "asset": {"version": "2.0", "generator": concat!("srflow ", env!("CARGO_PKG_VERSION"))},
            "scene": 0,
            "scenes": [{"nodes": (0..self.nodes.len()).collect::<Vec<_>>()}],
        });
        let lists = [
            ("nodes", self.nodes),
            ("meshes", self.meshes),
            ("cameras", self.cameras),
            ("animations", self.animations),
            ("accessors", self.accessors),
            ("bufferViews", self.views),
            ("extensionsUsed", self.extensions.into_iter().map(Value::from).collect()),
            ("buffers", vec![json!({"byteLength": self.binary.len()})]),
        ];
        // The specification forbids empty lists.
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document[name] = list.into();
        }
        let mut text = document.to_string();
        while !text.len().is_multiple_of(4) {
            text.push(' ');
        }
        let size = |bytes: usize| {
            u32::try_from(bytes)
                .map_err(|_| io::Error::other("a .glb file holds at most 4 GiB; write fewer Gaussians"))
        };
        writer.write_all(b"glTF")?;
        for number in [2, size(12 + 8 + text.len() + 8 + self.binary.len())?, size(text.len())?] {
            writer.write_all(&number.to_le_bytes())?;
        }
        writer.write_all(b"JSON")?;
        writer.write_all(text.as_bytes())?;
        writer.write_all(&size(self.binary.len())?.to_le_bytes())?;
        writer.write_all(b"BIN\0")?;
        writer.write_all(&self.binary)
    }
}

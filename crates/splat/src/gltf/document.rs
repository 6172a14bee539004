//! JSON and the bytes of its buffers. Every reference and length is checked before use.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::{DMat4, DQuat, DVec3};
use serde::Deserialize;
use serde_json::Value;
use srflow_core::excerpt;
use srflow_files::{FileError, FileKind, FileProblem, file_beside, parse_error_in_words, read_file};

use super::animation::Animation;
use super::material::{Material, Texture};

/// Most numbers that a file may expand to, in any case and per byte: accessors may share bytes, or have none, as those of sparse morph
/// targets do.
const MIN_VALUES: usize = 1 << 21;
const MAX_VALUES_PER_BYTE: usize = 16;

/// Extensions without which a file cannot be understood, and which this understands or has no use for.
const KNOWN_EXTENSIONS: [&str; 2] = ["KHR_mesh_quantization", "KHR_gaussian_splatting"];

/// A document; see the specification for its parts.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Json {
    pub scene: Option<usize>,
    pub scenes: Vec<Scene>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<Mesh>,
    pub skins: Vec<Skin>,
    pub materials: Vec<Material>,
    pub animations: Vec<Animation>,
    textures: Vec<Texture>,
    images: Vec<Buffer>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<BufferView>,
    buffers: Vec<Buffer>,
    extensions_required: Vec<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Scene {
    pub nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Node {
    pub name: String,
    pub children: Vec<usize>,
    pub mesh: Option<usize>,
    pub skin: Option<usize>,
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Mesh {
    pub name: String,
    pub primitives: Vec<Primitive>,
    extras: Value,
}

impl Mesh {
    /// Names of the morph targets, where exporters put them.
    pub fn target_names(&self) -> Vec<&str> {
        let names = self.extras.get("targetNames").and_then(Value::as_array);
        names.into_iter().flatten().map(|name| name.as_str().unwrap_or_default()).collect()
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Primitive {
    pub attributes: BTreeMap<String, usize>,
    pub indices: Option<usize>,
    pub mode: Option<u32>,
    pub material: Option<usize>,
    pub targets: Vec<BTreeMap<String, usize>>,
    pub extensions: BTreeMap<String, Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Skin {
    pub joints: Vec<usize>,
    pub inverse_bind_matrices: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    #[serde(default)]
    normalized: bool,
    count: usize,
    #[serde(rename = "type")]
    kind: String,
    sparse: Option<Sparse>,
}

#[derive(Debug, Deserialize)]
struct Sparse {
    count: usize,
    indices: SparseIndices,
    values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct SparseIndices {
    buffer_view: usize,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct SparseValues {
    buffer_view: usize,
    #[serde(default)]
    byte_offset: usize,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct BufferView {
    buffer: usize,
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
}

/// The bytes of a buffer or a picture.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Buffer {
    uri: Option<String>,
    /// Of a picture without a uri.
    buffer_view: Option<usize>,
}

/// A document with the bytes of its buffers.
#[derive(Debug)]
pub struct Document {
    path: PathBuf,
    kind: FileKind,
    pub json: Json,
    buffers: Vec<Vec<u8>>,
    /// Numbers that were read, and how many may be.
    values: Cell<usize>,
    most_values: usize,
}

/// A node of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed {
    /// Its number in the document, which has it.
    pub node: usize,
    /// Its parent, as an index into the nodes of the scene.
    pub parent: Option<usize>,
    /// Scene from node.
    pub global: DMat4,
}

impl Document {
    /// Reads a `.glb` or `.gltf` file, and the files beside it that the latter names; each may be as large as one of its `kind`.
    ///
    /// # Errors
    /// When a file cannot be read, is not glTF 2.0, or requires an extension that is not understood.
    pub fn open(path: &Path, kind: FileKind) -> Result<Self, FileError> {
        let bytes = read_file(path, kind)?;
        Self::parse(path, bytes, kind)
    }

    /// As [`Document::open`], for a file whose bytes are known; `path` names it in errors.
    ///
    /// # Errors
    /// As [`Document::open`].
    pub fn parse(path: &Path, mut bytes: Vec<u8>, kind: FileKind) -> Result<Self, FileError> {
        let in_file = |problem: FileProblem| problem.in_file(path);
        let (text, binary) = if bytes.starts_with(b"glTF") {
            chunks(&bytes).ok_or_else(|| {
                in_file(problem("chunks", "binary glTF 2 with a chunk of JSON", "a broken or truncated file"))
            })?
        } else {
            (0..bytes.len(), None)
        };
        let json: Json = serde_json::from_slice(bytes.get(text).unwrap_or_default())
            .map_err(|error| in_file(problem("JSON", "glTF 2.0", parse_error_in_words(&error))))?;
        let is_known = |name: &str| KNOWN_EXTENSIONS.contains(&name);
        if let Some(extension) = json.extensions_required.iter().find(|name| !is_known(name)) {
            let expected = "a file without required extensions; export it without compression";
            return Err(in_file(problem("extensionsRequired", expected, extension)));
        }
        // In place: the binary chunk is most of the file.
        let mut binary = binary.map(|chunk| {
            bytes.truncate(chunk.end);
            bytes.drain(..chunk.start);
            bytes
        });
        let mut buffers = Vec::new();
        for (number, buffer) in json.buffers.iter().enumerate() {
            buffers.push(match (&buffer.uri, binary.take_if(|_| number == 0)) {
                (None, Some(binary)) => binary,
                (Some(uri), _) => read_uri(path, uri, kind)?,
                _ => return Err(in_file(problem("buffer", "a uri or a binary chunk", "neither"))),
            });
        }
        let bytes: usize = buffers.iter().map(Vec::len).sum();
        let most_values = MIN_VALUES.max(bytes.saturating_mul(MAX_VALUES_PER_BYTE));
        Ok(Self { path: path.to_owned(), kind, json, buffers, values: Cell::new(0), most_values })
    }

    /// The file of a texture's picture, such as a PNG.
    ///
    /// # Errors
    /// When there is no such texture, its picture is of a format that needs another extension, or it cannot be read.
    pub fn picture(&self, texture: usize) -> Result<Cow<'_, [u8]>, FileError> {
        let in_file = |problem: FileProblem| problem.in_file(&self.path);
        let number = self.json.textures.get(texture).and_then(Texture::image);
        let image = number.and_then(|number| self.json.images.get(number)).ok_or_else(|| {
            in_file(problem("texture", "a PNG, JPEG or WebP picture", "another one, or none"))
        })?;
        match (&image.uri, image.buffer_view) {
            (Some(uri), _) => Ok(Cow::Owned(read_uri(&self.path, uri, self.kind)?)),
            (None, Some(view)) => Ok(Cow::Borrowed(self.view(view).map_err(in_file)?.0)),
            (None, None) => Err(in_file(problem("image", "a uri or a buffer view", "neither"))),
        }
    }

    /// The files that buffers and pictures name.
    pub fn files(&self) -> impl Iterator<Item = PathBuf> {
        let uris = self.json.buffers.iter().chain(&self.json.images).filter_map(|bytes| bytes.uri.as_ref());
        uris.filter_map(|uri| beside(&self.path, uri)).filter(|path| path.exists())
    }

    /// The bytes of a view of a buffer, and their stride.
    fn view(&self, number: usize) -> Result<(&[u8], Option<usize>), FileProblem> {
        let wrong =
            || problem("bufferView", "bytes inside its buffer", format!("number {number} beyond them"));
        let view = self.json.buffer_views.get(number).ok_or_else(wrong)?;
        let buffer = self.buffers.get(view.buffer).ok_or_else(wrong)?;
        let end = view.byte_offset.checked_add(view.byte_length).ok_or_else(wrong)?;
        Ok((buffer.get(view.byte_offset..end).ok_or_else(wrong)?, view.byte_stride))
    }

    /// The finite numbers of an accessor of `components` per element; `count` elements if given. Integers are not converted unless they
    /// are normalized.
    ///
    /// # Errors
    /// When there is no such accessor, or its bytes are not all in the file.
    pub fn numbers(
        &self,
        accessor: usize,
        components: usize,
        count: Option<usize>,
    ) -> Result<Vec<f32>, FileProblem> {
        let wrong = |expected: &str, found: String| problem("accessor", expected, found);
        let accessor = self
            .json
            .accessors
            .get(accessor)
            .ok_or_else(|| wrong("one of the file's", accessor.to_string()))?;
        let found = match accessor.kind.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            _ => 0,
        };
        if found != components || count.is_some_and(|count| count != accessor.count) {
            let expected = match count {
                Some(count) => format!("{count} elements of {components} numbers"),
                None => format!("elements of {components} numbers"),
            };
            return Err(wrong(&expected, format!("{} of type {}", accessor.count, excerpt(&accessor.kind))));
        }
        let used = accessor.count.checked_mul(components).and_then(|n| n.checked_add(self.values.get()));
        match used.filter(|used| *used <= self.most_values) {
            Some(used) => self.values.set(used),
            None => {
                return Err(wrong(
                    "no more elements than the file can hold",
                    format!("{} elements", accessor.count),
                ));
            }
        }
        let kind = Kind::of(accessor.component_type, accessor.normalized)?;
        let mut numbers = match accessor.buffer_view {
            Some(view) => self.packed(view, accessor.byte_offset, accessor.count, components, kind)?,
            None => vec![0.0; accessor.count * components],
        };
        if let Some(Sparse { count, indices, values }) = &accessor.sparse {
            let index_kind = Kind::of(indices.component_type, false)?;
            let places = self.packed(indices.buffer_view, indices.byte_offset, *count, 1, index_kind)?;
            let values = self.packed(values.buffer_view, values.byte_offset, *count, components, kind)?;
            for (place, value) in places.iter().zip(values.chunks_exact(components)) {
                let start = (*place as usize).saturating_mul(components);
                let slot = numbers.get_mut(start..start.saturating_add(components));
                let slot = slot.ok_or_else(|| wrong("sparse indices inside it", place.to_string()))?;
                slot.copy_from_slice(value);
            }
        }
        match numbers.iter().find(|number| !number.is_finite()) {
            None => Ok(numbers),
            Some(number) => Err(wrong("finite numbers", number.to_string())),
        }
    }

    /// The colours of an accessor of `count` vertices, linear RGB with alpha.
    ///
    /// # Errors
    /// As [`Document::numbers`].
    pub fn colors(&self, accessor: usize, count: usize) -> Result<Vec<[f32; 4]>, FileProblem> {
        let kind = self.json.accessors.get(accessor).map_or("", |accessor| accessor.kind.as_str());
        if kind == "VEC4" {
            let numbers = self.numbers(accessor, 4, Some(count))?;
            return Ok(numbers.as_chunks().0.to_vec());
        }
        let numbers = self.numbers(accessor, 3, Some(count))?;
        Ok(numbers.as_chunks().0.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect())
    }

    /// The nodes of the scene that is shown, parents first.
    ///
    /// # Errors
    /// When the nodes are not a forest, or one has a transform that is not finite.
    pub fn scene(&self) -> Result<Vec<Placed>, FileProblem> {
        let json = &self.json;
        let roots: Vec<usize> = match json.scenes.get(json.scene.unwrap_or(0)) {
            Some(scene) => scene.nodes.clone(),
            None => {
                let mut is_child = vec![false; json.nodes.len()];
                for child in
                    json.nodes.iter().flat_map(|node| &node.children).filter(|c| **c < json.nodes.len())
                {
                    is_child[*child] = true;
                }
                (0..json.nodes.len()).filter(|node| !is_child[*node]).collect()
            }
        };
        let mut nodes: Vec<Placed> = Vec::new();
        let mut seen = vec![false; json.nodes.len()];
        // In depth, so that the numbers of vertices follow the order of the file.
        let mut left: Vec<(usize, Option<usize>)> =
            roots.into_iter().rev().map(|root| (root, None)).collect();
        while let Some((number, parent)) = left.pop() {
            let seen = seen
                .get_mut(number)
                .ok_or_else(|| problem("node", "one of the file's", number.to_string()))?;
            if std::mem::replace(seen, true) {
                return Err(problem("nodes", "a tree", format!("node {number} twice")));
            }
            let node = &json.nodes[number];
            let local = local(node);
            let global = parent.map_or(local, |parent| nodes[parent].global * local);
            if !global.is_finite() || global.to_cols_array().iter().any(|entry| entry.abs() > 1e9) {
                return Err(problem("node", "a finite transform", format!("that of node {number}")));
            }
            let placed = nodes.len();
            nodes.push(Placed { node: number, parent, global });
            left.extend(node.children.iter().rev().map(|child| (*child, Some(placed))));
        }
        Ok(nodes)
    }

    /// Elements in a view of a buffer.
    fn packed(
        &self,
        view: usize,
        offset: usize,
        count: usize,
        components: usize,
        kind: Kind,
    ) -> Result<Vec<f32>, FileProblem> {
        let wrong = || problem("bufferView", "bytes inside its buffer", format!("number {view} beyond them"));
        let (bytes, stride) = self.view(view)?;
        let bytes = bytes.get(offset..).ok_or_else(wrong)?;
        let element = components * kind.bytes();
        let stride = stride.unwrap_or(element);
        let needed =
            count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(element));
        if stride < element || needed.is_none_or(|needed| needed > bytes.len()) {
            return Err(wrong());
        }
        let mut numbers = Vec::with_capacity(count * components);
        for at in 0..count {
            let element = &bytes[at * stride..at * stride + element];
            numbers.extend(element.chunks_exact(kind.bytes()).map(|bytes| kind.number(bytes)));
        }
        Ok(numbers)
    }
}

/// Parent from node.
fn local(node: &Node) -> DMat4 {
    if let Some(matrix) = node.matrix {
        return DMat4::from_cols_array(&matrix);
    }
    DMat4::from_scale_rotation_translation(
        DVec3::from_array(node.scale.unwrap_or([1.0; 3])),
        unit(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0])),
        DVec3::from_array(node.translation.unwrap_or_default()),
    )
}

/// The rotation of a quaternion of any length.
pub(super) fn unit(quaternion: [f64; 4]) -> DQuat {
    let rotation = DQuat::from_array(quaternion);
    if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY }
}

/// The type of a component (section 3.6.2.2 of the specification).
#[derive(Debug, Clone, Copy)]
struct Kind {
    bytes: usize,
    float: bool,
    signed: bool,
    normalized: bool,
}

impl Kind {
    fn of(code: u32, normalized: bool) -> Result<Self, FileProblem> {
        let integer = |bytes, signed| Ok(Self { bytes, float: false, signed, normalized });
        match code {
            5120 => integer(1, true),
            5121 => integer(1, false),
            5122 => integer(2, true),
            5123 => integer(2, false),
            5125 => integer(4, false),
            5126 => Ok(Self { bytes: 4, float: true, signed: true, normalized: false }),
            other => Err(problem("componentType", "a number from 5120 to 5126", other.to_string())),
        }
    }

    fn bytes(self) -> usize {
        self.bytes
    }

    fn number(self, bytes: &[u8]) -> f32 {
        let mut whole = [0; 4];
        whole[..bytes.len()].copy_from_slice(bytes);
        if self.float {
            return f32::from_le_bytes(whole);
        }
        let bits = u32::from_le_bytes(whole);
        let unused = 32 - 8 * self.bytes as u32;
        let number = if self.signed { ((bits << unused) as i32 >> unused) as f32 } else { bits as f32 };
        if !self.normalized {
            return number;
        }
        let most = (1_u64 << (8 * self.bytes - usize::from(self.signed))) - 1;
        (number / most as f32).max(-1.0)
    }
}

/// Where the chunks of JSON and binary data of a `.glb` file are.
fn chunks(bytes: &[u8]) -> Option<(Range<usize>, Option<Range<usize>>)> {
    let number = |at: usize| Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
    let chunk = |at: usize, kind: &[u8; 4]| {
        let length = number(at)? as usize;
        let start = at.checked_add(8)?;
        (bytes.get(at + 4..start)? == kind).then_some(())?;
        let chunk = start..start.checked_add(length)?;
        bytes.get(chunk.clone()).map(|_| chunk)
    };
    if number(4)? != 2 {
        return None;
    }
    let json = chunk(12, b"JSON")?;
    let binary = chunk(json.end, b"BIN\0");
    Some((json, binary))
}

/// The bytes of a `data:` uri, or of a file beside the document.
fn read_uri(path: &Path, uri: &str, kind: FileKind) -> Result<Vec<u8>, FileError> {
    let refused = |expected: &str| problem("uri", expected, excerpt(uri)).in_file(path);
    if let Some(data) = uri.strip_prefix("data:") {
        let encoded = data.split_once(";base64,").map(|(_, encoded)| encoded);
        return encoded.and_then(from_base64).ok_or_else(|| refused("data in base64"));
    }
    let file =
        beside(path, uri).ok_or_else(|| refused("the name of a file in the same folder, or below it"))?;
    read_file(&file, kind)
}

/// The file of a uri in the folder of a document or below it.
fn beside(path: &Path, uri: &str) -> Option<PathBuf> {
    file_beside(path, &uri.replace("%20", " "))
}

fn from_base64(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut held) = (0_u32, 0);
    for byte in text.trim_end_matches('=').bytes() {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        held += 6;
        if held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
        }
    }
    Some(bytes)
}

pub(super) fn problem(field: &'static str, expected: &str, found: impl Into<String>) -> FileProblem {
    FileProblem::field(field, expected, found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_and_numbers_are_decoded() {
        assert_eq!(from_base64("aGVhZA=="), Some(b"head".to_vec()));
        assert_eq!(from_base64("aGVh"), Some(b"hea".to_vec()));
        assert_eq!(from_base64("a!"), None);
        let number = |code, normalized, bytes: &[u8]| Kind::of(code, normalized).unwrap().number(bytes);
        assert_eq!(number(5120, true, &[0x81]), -1.0);
        assert_eq!(number(5120, true, &[0x80]), -1.0);
        assert_eq!(number(5121, true, &[255]), 1.0);
        assert_eq!(number(5122, false, &[0xfe, 0xff]), -2.0);
        assert_eq!(number(5123, false, &[1, 2]), 513.0);
        assert_eq!(number(5126, false, &0.3_f32.to_le_bytes()), 0.3);
        assert!(Kind::of(5124, false).is_err());
    }
}

//! Any head as glTF 2.0 (`.glb` or `.gltf`), rigged with morph targets and a skin or not.
//!
//! All triangles of the scene become one mesh, in the pose that the file's nodes have. Morph targets of the same name on several meshes are one
//! expression; ARKit's names give action units. The joints of the skins are the joints of the model, and so is every node with a
//! mesh that has no skin, such as an eyeball. They rotate about their positions in the file, in the axes of the model. Textures and
//! colours of vertices are the model's own. What glTF does not say about a head, such as its landmarks, [`found_head`] adds.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::{Affine2, DMat3, DMat4, DVec3, Vec2, Vec3, Vec4};
use srflow_files::{FileError, FileKind, FileProblem};
use srflow_splat::gltf::{Document, Node, Placed, Primitive, TRIANGLES};

use crate::HeadError;
use crate::arkit::action_units;
use crate::found_head::{found_head, region_of_name};
use crate::mesh_colors::{Alpha, Material, MeshColors, Texture, Textures};
use crate::skeleton_names::roles;
use crate::{HeadModel, Joint, JointRole, Look, Offsets, Region, Shape, Skinning, TextureMap};

/// Most primitives and morph targets of all instances of the meshes, which a small file can repeat without end.
const MAX_PARTS: usize = 1 << 20;

/// The joint of the model that each joint of a skin is, and where the joint takes vertices; `None` for joints outside the scene.
type Posed = Rc<[Option<(u32, DMat4)>]>;

/// Reads a model, with its landmarks if they are found.
///
/// # Errors
/// Names the file and the part that is missing or malformed.
pub(crate) fn load(path: &Path, look: Look) -> Result<HeadModel, HeadError> {
    found_head(rigged(&Document::open(path, FileKind::Mesh)?, path)?, path, look)
}

/// The files that a document names, as far as they can be read.
pub(crate) fn files_named_in(path: &Path) -> Vec<PathBuf> {
    Document::open(path, FileKind::Mesh).map(|document| document.files().collect()).unwrap_or_default()
}

/// The model of a document, which `path` names in errors, without landmarks and not yet validated.
///
/// # Errors
/// Names the part that is missing or malformed.
pub(crate) fn rigged(document: &Document, path: &Path) -> Result<HeadModel, FileError> {
    Builder::new(document, path).and_then(Builder::model).map_err(|problem| problem.in_file(path))
}

struct Builder<'a> {
    document: &'a Document,
    path: &'a Path,
    /// The nodes of the scene, parents first.
    nodes: Vec<Placed>,
    /// The joint of each node that is one.
    joint_of: HashMap<usize, u32>,
    /// Scene from node, by the node's number in the document.
    globals: HashMap<usize, DMat4>,
    /// By the number of the skin.
    posed: HashMap<usize, Posed>,
    /// Primitives and morph targets so far.
    parts: usize,
    joints: Vec<Joint>,
    template: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    regions: Vec<Region>,
    /// Texture coordinates of each vertex.
    texture: Vec<Vec2>,
    has_texture: bool,
    colors: MeshColors,
    /// Place in the colours of each material of the document that is used.
    materials: HashMap<Option<usize>, u32>,
    textures: Textures,
    skinning: Skinning,
    expressions: Vec<(String, Vec<(u32, Vec3)>)>,
    numbers: HashMap<String, usize>,
}

impl<'a> Builder<'a> {
    fn new(document: &'a Document, path: &'a Path) -> Result<Self, FileProblem> {
        let nodes = document.scene()?;
        let mut builder = Self {
            document,
            path,
            globals: nodes.iter().map(|placed| (placed.node, placed.global)).collect(),
            nodes,
            joint_of: HashMap::new(),
            posed: HashMap::new(),
            parts: 0,
            joints: Vec::new(),
            template: Vec::new(),
            triangles: Vec::new(),
            regions: Vec::new(),
            texture: Vec::new(),
            has_texture: false,
            colors: MeshColors::default(),
            materials: HashMap::new(),
            textures: Textures::default(),
            skinning: Skinning::default(),
            expressions: Vec::new(),
            numbers: HashMap::new(),
        };
        builder.find_joints()?;
        Ok(builder)
    }

    fn node(&self, placed: usize) -> &'a Node {
        &self.document.json.nodes[self.nodes[placed].node]
    }

    /// Joints of the skins, and nodes with a mesh but no skin; below one root.
    fn find_joints(&mut self) -> Result<(), FileProblem> {
        let json = &self.document.json;
        let mut is_joint = vec![false; json.nodes.len()];
        for placed in 0..self.nodes.len() {
            let node = self.node(placed);
            match (node.mesh, node.skin) {
                (Some(_), Some(skin)) => {
                    let skin = json
                        .skins
                        .get(skin)
                        .ok_or_else(|| problem("skin", "one of the file's", skin.to_string()))?;
                    for &joint in &skin.joints {
                        let found = is_joint.get_mut(joint);
                        *found.ok_or_else(|| problem("joint", "a node of the file", joint.to_string()))? =
                            true;
                    }
                }
                (Some(_), None) => is_joint[self.nodes[placed].node] = true,
                _ => {}
            }
        }
        // The next joint above each node; parents come first.
        let mut above: Vec<Option<usize>> = Vec::with_capacity(self.nodes.len());
        for placed in &self.nodes {
            above.push(placed.parent.and_then(|parent| {
                if is_joint[self.nodes[parent].node] { Some(parent) } else { above[parent] }
            }));
        }
        let listed: Vec<usize> = (0..self.nodes.len()).filter(|&p| is_joint[self.nodes[p].node]).collect();
        let tops = listed.iter().filter(|&&placed| above[placed].is_none()).count();
        if tops != 1 {
            self.joints.extend(Joint::of_roles([Vec3::ZERO; 5]).into_iter().take(1));
        }
        let mut number_of: HashMap<usize, usize> = HashMap::new();
        for placed in listed {
            let Placed { node, global, .. } = self.nodes[placed];
            let number = self.joints.len();
            let parent = above[placed].and_then(|above| number_of.get(&above).copied());
            let name = &json.nodes[node].name;
            self.joints.push(Joint {
                name: if name.is_empty() { format!("node {node}") } else { name.clone() },
                role: None,
                parent: parent.or((number > 0).then_some(0)),
                position: global.w_axis.truncate().as_vec3(),
                follows: Vec::new(),
                identities: Vec::new(),
            });
            number_of.insert(placed, number);
            self.joint_of.insert(node, number as u32);
        }
        let names: Vec<String> = self.joints.iter().map(|joint| joint.name.clone()).collect();
        for (joint, role) in self.joints.iter_mut().zip(roles(&names)) {
            joint.role = role;
        }
        Ok(())
    }

    fn model(mut self) -> Result<HeadModel, FileProblem> {
        for placed in 0..self.nodes.len() {
            if let Some(mesh) = self.node(placed).mesh {
                self.add_mesh(placed, mesh)?;
            }
        }
        if self.triangles.is_empty() {
            return Err(problem("meshes", "a scene with triangles", "none"));
        }
        let expressions: Vec<Shape> = self
            .expressions
            .into_iter()
            .map(|(name, offsets)| Shape::linear(name, Offsets::Sparse(offsets)))
            .collect();
        // One point per vertex; those of meshes without coordinates are (0, 0).
        let texture =
            self.has_texture.then(|| TextureMap { points: self.texture, triangles: self.triangles.clone() });
        let eyeballs = eyeballs(&self.joints, &self.skinning, &self.template, &self.triangles, &self.regions);
        Ok(HeadModel {
            name: "gltf".into(),
            action_units: action_units(expressions.iter().map(|shape| shape.name.as_str())),
            template: self.template,
            triangles: self.triangles,
            regions: self.regions,
            identities: Vec::new(),
            expressions,
            joints: self.joints,
            joints_follow_expressions: false,
            expressions_are_components: false,
            skinning: self.skinning,
            pose_correctives: Vec::new(),
            landmarks: Vec::new(),
            eyeballs,
            texture,
            colors: self.colors.is_detailed().then_some(self.colors),
            vertex_groups: BTreeMap::new(),
            carried: Vec::new(),
        })
    }

    fn add_mesh(&mut self, placed: usize, number: usize) -> Result<(), FileProblem> {
        let json = &self.document.json;
        let mesh = json
            .meshes
            .get(number)
            .ok_or_else(|| problem("mesh", "one of the file's", number.to_string()))?;
        let names = mesh.target_names();
        for primitive in &mesh.primitives {
            // Points and lines are not part of a head.
            if primitive.mode.unwrap_or(TRIANGLES) != TRIANGLES {
                continue;
            }
            self.parts += 1 + primitive.targets.len().max(names.len());
            if self.parts > MAX_PARTS {
                let expected = format!("at most {MAX_PARTS} primitives and morph targets in all instances");
                return Err(problem("meshes", &expected, "more"));
            }
            let material = primitive.material.and_then(|material| json.materials.get(material));
            let words =
                [&mesh.name, &self.node(placed).name, material.map_or(&mesh.name, |named| &named.name)];
            self.add_primitive(
                placed,
                primitive,
                &names,
                region_of_name(&words.map(String::as_str).join(" ")),
            )?;
        }
        Ok(())
    }

    fn add_primitive(
        &mut self,
        placed: usize,
        primitive: &Primitive,
        names: &[&str],
        region: Region,
    ) -> Result<(), FileProblem> {
        let attribute = |name: &str| primitive.attributes.get(name).copied();
        let positions = attribute("POSITION").ok_or_else(|| problem("attributes", "POSITION", "none"))?;
        let positions = self.document.numbers(positions, 3, None)?;
        let count = positions.len() / 3;
        let first = self.template.len();
        if first + count > u32::MAX as usize / 2 {
            return Err(problem("vertices", "a head of sane size", (first + count).to_string()));
        }
        let transforms = self.transforms(placed, primitive, count)?;
        let at = |numbers: &[f32], v: usize| {
            DVec3::new(
                f64::from(numbers[3 * v]),
                f64::from(numbers[3 * v + 1]),
                f64::from(numbers[3 * v + 2]),
            )
        };
        for (v, transform) in transforms.iter().enumerate() {
            self.template.push(transform.transform_point3(at(&positions, v)).as_vec3());
        }
        let material = self.material(primitive.material);
        let described = primitive.material.and_then(|material| self.document.json.materials.get(material));
        let set =
            described.and_then(|material| material.texture()).map_or(0, |texture| texture.coordinates());
        match attribute(&format!("TEXCOORD_{set}")) {
            Some(accessor) => {
                let numbers = self.document.numbers(accessor, 2, Some(count))?;
                // glTF counts from the top.
                self.texture.extend(numbers.as_chunks().0.iter().map(|[u, v]| Vec2::new(*u, 1.0 - v)));
                self.has_texture = true;
            }
            None => self.texture.resize(first + count, Vec2::ZERO),
        }
        if let Some(accessor) = attribute("COLOR_0") {
            self.colors.of_vertices.resize(first, Vec4::ONE);
            self.colors
                .of_vertices
                .extend(self.document.colors(accessor, count)?.into_iter().map(Vec4::from_array));
        } else if !self.colors.of_vertices.is_empty() {
            self.colors.of_vertices.resize(first + count, Vec4::ONE);
        }
        let mirrored = self.nodes[placed].global.determinant() < 0.0 && self.node(placed).skin.is_none();
        let indices: Vec<usize> = match primitive.indices {
            Some(indices) => {
                self.document.numbers(indices, 1, None)?.into_iter().map(|i| i as usize).collect()
            }
            None => (0..count).collect(),
        };
        if let Some(beyond) = indices.iter().find(|index| **index >= count) {
            return Err(problem("indices", &format!("vertices below {count}"), beyond.to_string()));
        }
        for &[a, b, c] in indices.as_chunks().0 {
            let [b, c] = if mirrored { [c, b] } else { [b, c] };
            self.triangles.push([a, b, c].map(|v| (first + v) as u32));
            self.regions.push(region);
            self.colors.of_triangles.push(material);
        }
        for (number, target) in primitive.targets.iter().enumerate() {
            let Some(&accessor) = target.get("POSITION") else { continue };
            let moved = self.document.numbers(accessor, 3, Some(count))?;
            let name = names.get(number).filter(|name| !name.is_empty());
            let name = name.map_or_else(|| format!("target {number}"), |name| (*name).to_owned());
            let next = self.expressions.len();
            let index = *self.numbers.entry(name.clone()).or_insert(next);
            if index == next {
                self.expressions.push((name, Vec::new()));
            }
            let offsets = transforms.iter().enumerate().map(|(v, transform)| {
                let offset = DMat3::from_mat4(*transform) * at(&moved, v);
                ((first + v) as u32, offset.as_vec3())
            });
            self.expressions[index].1.extend(offsets.filter(|(_, offset)| *offset != Vec3::ZERO));
        }
        Ok(())
    }

    /// The place of a material of the document in the colours. One whose picture cannot be read keeps its plain colour.
    fn material(&mut self, number: Option<usize>) -> u32 {
        if let Some(known) = self.materials.get(&number) {
            return *known;
        }
        let mut material = Material::default();
        if let Some(found) = number.and_then(|number| self.document.json.materials.get(number)) {
            material.factor = Vec4::from_array(found.factor());
            material.alpha = match found.alpha_mode.as_str() {
                "MASK" => Alpha::Mask(found.alpha_cutoff.unwrap_or(0.5)),
                "BLEND" => Alpha::Blend,
                _ => Alpha::Opaque,
            };
            if let Some(texture) = found.texture() {
                // Ours count from the bottom.
                let flip = Affine2::from_cols_array(&[1.0, 0.0, 0.0, -1.0, 0.0, 1.0]);
                material.texture_from_coordinates = flip * texture.texture_from_coordinates() * flip;
                let (document, path) = (self.document, self.path);
                material.texture =
                    self.textures.get(format!("{}, texture {}", path.display(), texture.index), || {
                        Texture::parse(&document.picture(texture.index)?)
                            .map_err(|problem| problem.in_file(path))
                    });
            }
        }
        let place = self.colors.materials.len() as u32;
        self.colors.materials.push(material);
        self.materials.insert(number, place);
        place
    }

    /// The joints of a skin in the pose of the file.
    fn posed(&mut self, number: usize) -> Result<Posed, FileProblem> {
        if let Some(posed) = self.posed.get(&number) {
            return Ok(posed.clone());
        }
        let skin = &self.document.json.skins[number];
        let bind: Vec<DMat4> = match skin.inverse_bind_matrices {
            Some(accessor) => {
                let numbers = self.document.numbers(accessor, 16, Some(skin.joints.len()))?;
                numbers.as_chunks().0.iter().map(|m| DMat4::from_cols_array(&m.map(f64::from))).collect()
            }
            None => vec![DMat4::IDENTITY; skin.joints.len()],
        };
        let joints = skin.joints.iter().zip(&bind);
        let posed: Posed = joints
            .map(|(joint, bind)| Some((*self.joint_of.get(joint)?, *self.globals.get(joint)? * *bind)))
            .collect();
        self.posed.insert(number, posed.clone());
        Ok(posed)
    }

    /// Where each vertex goes in the pose of the file, and, in [`Self::skinning`], the joints that it follows.
    fn transforms(
        &mut self,
        placed: usize,
        primitive: &Primitive,
        count: usize,
    ) -> Result<Vec<DMat4>, FileProblem> {
        let Some(skin) = self.node(placed).skin else {
            let joint = self.joint_of.get(&self.nodes[placed].node).copied().unwrap_or(0);
            (0..count).for_each(|_| self.skinning.push([(joint, 1.0)]));
            return Ok(vec![self.nodes[placed].global; count]);
        };
        let posed = self.posed(skin)?;
        let mut influences: Vec<Vec<(usize, f64)>> = vec![Vec::new(); count];
        for set in 0.. {
            let attribute = |name: &str| primitive.attributes.get(&format!("{name}_{set}")).copied();
            let (Some(joints), Some(weights)) = (attribute("JOINTS"), attribute("WEIGHTS")) else { break };
            let joints = self.document.numbers(joints, 4, Some(count))?;
            let weights = self.document.numbers(weights, 4, Some(count))?;
            for (slot, (joint, weight)) in joints.into_iter().zip(weights).enumerate() {
                if weight > 0.0 {
                    influences[slot / 4].push((joint as usize, f64::from(weight)));
                }
            }
        }
        let mut transforms = Vec::with_capacity(count);
        for influences in influences {
            let sum: f64 = influences.iter().map(|(_, weight)| weight).sum();
            let influences = if sum > 0.0 { influences } else { vec![(0, 1.0)] };
            let sum = if sum > 0.0 { sum } else { 1.0 };
            let mut transform = DMat4::ZERO;
            let mut weights = Vec::with_capacity(influences.len());
            for (joint, weight) in influences {
                let found = posed.get(joint).copied().flatten();
                let (joint, matrix) = found.ok_or_else(|| {
                    problem("JOINTS", "joints of the skin, in the scene", joint.to_string())
                })?;
                transform += matrix * (weight / sum);
                weights.push((joint, (weight / sum) as f32));
            }
            self.skinning.push(weights);
            transforms.push(transform);
        }
        Ok(transforms)
    }
}

fn problem(field: &'static str, expected: &str, found: impl Into<String>) -> FileProblem {
    FileProblem::field(field, expected, found)
}

/// Vertices of the eyes' joints, or else of the meshes that are eyeballs, by their side.
fn eyeballs(
    joints: &[Joint],
    skinning: &Skinning,
    template: &[Vec3],
    triangles: &[[u32; 3]],
    regions: &[Region],
) -> [Vec<u32>; 2] {
    let eyeball = triangles.iter().zip(regions).filter(|(_, region)| **region == Region::Eyeball);
    let mut meshes: Vec<u32> = eyeball.flat_map(|(triangle, _)| *triangle).collect();
    meshes.sort_unstable();
    meshes.dedup();
    [(JointRole::LeftEye, 1.0), (JointRole::RightEye, -1.0)].map(|(role, side)| {
        let joint = joints.iter().position(|joint| joint.role == Some(role));
        let of_joint = |v: &u32| joint.is_some_and(|joint| skinning.weight(*v as usize, joint) > 0.5);
        let mut found: Vec<u32> = (0..template.len() as u32).filter(of_joint).collect();
        if found.is_empty() {
            found = meshes.iter().copied().filter(|v| template[*v as usize].x * side > 0.0).collect();
        }
        found
    })
}

#[cfg(test)]
mod tests;

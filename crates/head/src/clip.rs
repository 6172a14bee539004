//! Clips of motion in glTF files, such as the `animation.glb` of LAM's avatars, for heads whose joints and expressions have the same
//! names.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DQuat;
use srflow_core::excerpts;
use srflow_files::{FileError, FileKind, FileProblem};
use srflow_splat::gltf::{Animation, Document, Track};

use crate::{HeadModel, HeadPose, PoseParameters};

/// Most frames of a clip.
const MAX_FRAMES: usize = 100_000;

/// A clip in a glTF file: `talking.glb`, or `talking.glb@idle` if the file has several.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Clip {
    file: PathBuf,
    name: Option<String>,
}

impl Clip {
    /// The clip that a path names; `None` if that is not of a glTF file.
    pub fn parse(path: &Path) -> Option<Self> {
        let is_gltf = |path: &Path| {
            let extension = path.extension().and_then(|extension| extension.to_str());
            extension.is_some_and(|extension| ["glb", "gltf"].contains(&extension.to_lowercase().as_str()))
        };
        if is_gltf(path) {
            return Some(Self { file: path.to_owned(), name: None });
        }
        let (file, name) = path.to_str()?.rsplit_once('@')?;
        is_gltf(Path::new(file)).then(|| Self { file: file.into(), name: Some(name.to_owned()) })
    }

    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Its name, if the path has one.
    pub fn name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// The poses of `model` in the clip, at times 1 / `frames_per_second` apart. Rotations of joints and weights of expressions are those
    /// of the same names; translations and scales are left out.
    ///
    /// A joint turns relative to its parent by as much as its node turns from the pose that the file's nodes have.
    ///
    /// # Errors
    /// When the file cannot be read, has no such clip, or the clip moves nothing of the model.
    pub fn poses(&self, model: &HeadModel, frames_per_second: f32) -> Result<Vec<PoseParameters>, FileError> {
        let document = Document::open(&self.file, FileKind::Mesh)?;
        self.poses_in(&document, model, frames_per_second).map_err(|problem| problem.in_file(&self.file))
    }

    fn poses_in(
        &self,
        document: &Document,
        model: &HeadModel,
        frames_per_second: f32,
    ) -> Result<Vec<PoseParameters>, FileProblem> {
        let tracks = document.tracks(self.find(&document.json.animations)?)?;
        let moving = Moving::new(document, model, &tracks)?;
        let end = tracks.iter().map(Track::end).fold(0.0, f32::max);
        let frames = (end * frames_per_second + 1e-3) as usize + 1;
        if frames > MAX_FRAMES {
            let expected = format!("at most {MAX_FRAMES} frames");
            return Err(FileProblem::field("times of a clip", expected, format!("{end} seconds")));
        }
        let pose = |frame: usize| moving.pose(frame as f32 / frames_per_second);
        Ok((0..frames).map(|frame| PoseParameters::of(model, &pose(frame))).collect())
    }

    fn find<'a>(&self, clips: &'a [Animation]) -> Result<&'a Animation, FileProblem> {
        let found = match (&self.name, clips) {
            (None, [only]) => Some(only),
            (None, _) => None,
            (Some(name), _) => clips.iter().find(|clip| clip.name == *name),
        };
        found.ok_or_else(|| {
            let names = excerpts(clips.iter().map(|clip| clip.name.as_str()), 24);
            let expected = match (clips.len(), &self.name) {
                (0, _) => "a file with a clip".to_owned(),
                (_, None) => format!("FILE@CLIP with one of its clips: {names}"),
                _ => format!("one of its clips: {names}"),
            };
            let found = self.name.clone().unwrap_or_else(|| format!("{} clips", clips.len()));
            FileProblem::field("animation", expected, found)
        })
    }
}

/// What a clip moves of a model.
struct Moving<'a> {
    model: &'a HeadModel,
    nodes: Vec<MovingNode<'a>>,
    /// The node of each joint of the model, as an index into `nodes`.
    of_joints: Vec<Option<usize>>,
    /// Tracks of weights, each with the expression of each weight.
    expressions: Vec<(&'a Track, Vec<Option<usize>>)>,
}

/// A node of the scene, after its parents.
struct MovingNode<'a> {
    parent: Option<usize>,
    /// Of the node in the file's pose, relative to the parent and in all.
    local: DQuat,
    global: DQuat,
    rotation: Option<&'a Track>,
}

impl<'a> Moving<'a> {
    fn new(document: &'a Document, model: &'a HeadModel, tracks: &'a [Track]) -> Result<Self, FileProblem> {
        let placed = document.scene()?;
        let names: HashMap<&str, usize> = (0..placed.len())
            .rev()
            .map(|at| (document.json.nodes[placed[at].node].name.as_str(), at))
            .collect();
        let of_joints: Vec<Option<usize>> =
            model.joints.iter().map(|joint| names.get(joint.name.as_str()).copied()).collect();
        let track = |property: &'a str| {
            tracks.iter().filter(move |track| track.property == property).map(|track| (track.node, track))
        };
        let rotations: HashMap<usize, &Track> = track("rotation").collect();
        let mut nodes: Vec<MovingNode> = Vec::with_capacity(placed.len());
        for node in &placed {
            let (_, global, _) = node.global.to_scale_rotation_translation();
            let local = node.parent.map_or(global, |parent| nodes[parent].global.inverse() * global);
            let rotation = rotations.get(&node.node).copied();
            nodes.push(MovingNode { parent: node.parent, local, global, rotation });
        }
        let number: HashMap<&str, usize> = model
            .expressions
            .iter()
            .enumerate()
            .map(|(number, shape)| (shape.name.as_str(), number))
            .collect();
        let expressions: Vec<(&Track, Vec<Option<usize>>)> = track("weights")
            .filter_map(|(node, track)| {
                let mesh = document.json.meshes.get(document.json.nodes.get(node)?.mesh?)?;
                Some((track, mesh.target_names().iter().map(|name| number.get(name).copied()).collect()))
            })
            .collect();
        let moves_joint = of_joints.iter().flatten().any(|node| {
            std::iter::successors(Some(*node), |node| nodes[*node].parent)
                .any(|node| nodes[node].rotation.is_some())
        });
        if !moves_joint && !expressions.iter().any(|(_, numbers)| numbers.iter().any(Option::is_some)) {
            let joints = model.joints.iter().map(|joint| joint.name.as_str());
            let expected = format!(
                "rotations of joints of {} ({}), or weights of its expressions",
                model.name,
                excerpts(joints, 8)
            );
            return Err(FileProblem::field("animation", expected, "none"));
        }
        Ok(Self { model, nodes, of_joints, expressions })
    }

    fn pose(&self, time: f32) -> HeadPose {
        let mut pose = HeadPose::default();
        let mut globals: Vec<DQuat> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let local = node.rotation.map_or(node.local, |track| track.rotation(time));
            globals.push(node.parent.map_or(local, |parent| globals[parent] * local));
        }
        // How far each joint has turned in all; one that the file does not have turns with its parent.
        let mut turns: Vec<DQuat> = Vec::with_capacity(self.model.joints.len());
        for (joint, node) in self.model.joints.iter().zip(&self.of_joints) {
            let of_parent = joint.parent.map_or(DQuat::IDENTITY, |parent| turns[parent]);
            let turn = node.map_or(of_parent, |node| globals[node] * self.nodes[node].global.inverse());
            *pose.joint_mut(turns.len()) = (of_parent.inverse() * turn).normalize().as_quat();
            turns.push(turn);
        }
        for (track, numbers) in &self.expressions {
            for (weight, number) in track.weights(time).into_iter().zip(numbers) {
                if let Some(number) = number {
                    pose.expressions.resize(pose.expressions.len().max(number + 1), 0.0);
                    pose.expressions[*number] = weight;
                }
            }
        }
        pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_name_clips() {
        let parse = |path: &str| {
            Clip::parse(Path::new(path)).map(|clip| (clip.file.display().to_string(), clip.name))
        };
        assert_eq!(parse("a/talk.GLB"), Some(("a/talk.GLB".into(), None)));
        assert_eq!(parse("a@b/talk.gltf@idle 2"), Some(("a@b/talk.gltf".into(), Some("idle 2".into()))));
        assert_eq!(parse("flame_param.npz"), None);
        assert_eq!(parse("avatar@head.npz"), None);
    }
}

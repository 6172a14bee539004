use std::path::{Path, PathBuf};

use glam::Vec3;
use rayon::prelude::*;
use srflow_field::FileError;
use srflow_field::random::Key;
use srflow_splat::Gaussians;

use crate::binding::{BoundGaussians, TriangleFrame};
use crate::dress::dress;
use crate::{HeadModel, HeadModelError, HeadPose, ShapedHead, ict};

/// Why there is no avatar.
#[derive(Debug, thiserror::Error)]
pub enum AvatarError {
    /// A file could not be read.
    #[error(
        "{0}. An ICT-FaceKit folder (FaceXModel) holds generic_neutral_mesh.obj, vertex_indices.json, identityNNN.obj and one OBJ per expression"
    )]
    Read(FileError),
    /// A file is not what it should be.
    #[error("{}:{line}: {problem}", .path.display())]
    Malformed {
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What was expected and what was found.
        problem: String,
    },
    /// The neutral mesh is not of the published topology.
    #[error("{}: {found} vertices, where the topology of ICT-FaceKit's light model has {expected}; take the file as it is published", .path.display())]
    Topology {
        /// The neutral mesh.
        path: PathBuf,
        /// Vertices of the published topology.
        expected: usize,
        /// Vertices in the file.
        found: usize,
    },
    /// A shape differs from the neutral mesh in its number of vertices.
    #[error("{}: {found} vertices, but {} has {expected}; both must be of the same topology", .path.display(), .reference.display())]
    VertexCount {
        /// The shape.
        path: PathBuf,
        /// Vertices in the shape.
        found: usize,
        /// The neutral mesh.
        reference: PathBuf,
        /// Vertices in the neutral mesh.
        expected: usize,
    },
    /// The head model is inconsistent.
    #[error(transparent)]
    Model(#[from] HeadModelError),
    /// Brows, lashes and the colours of the face are placed by landmarks.
    #[error("the head model {model} has {found} landmarks; dressing it needs the 68 of dlib")]
    Landmarks {
        /// Name of the head model.
        model: String,
        /// How many it has.
        found: usize,
    },
}

/// A person: a head model, the shape of one head, and the Gaussians that ride on its triangles.
#[derive(Debug, Clone)]
pub struct Avatar {
    model: HeadModel,
    shaped: ShapedHead,
    gaussians: BoundGaussians,
}

/// Memory that [`Avatar::gaussians_into`] uses again from frame to frame.
#[derive(Debug, Clone, Default)]
pub struct PosedHead {
    vertices: Vec<Vec3>,
    frames: Vec<TriangleFrame>,
}

impl PosedHead {
    /// Vertices of the last pose, metres.
    pub fn vertices(&self) -> &[Vec3] {
        &self.vertices
    }

    /// Frame of every triangle in the last pose.
    pub fn frames(&self) -> &[TriangleFrame] {
        &self.frames
    }
}

impl Avatar {
    /// The person of `seed` on the built-in head. The seed decides shape, skin, hair and eyes; a seed is the same person
    /// on every machine.
    ///
    /// # Errors
    /// None that a seed can cause; the built-in head is checked like any other.
    pub fn builtin(seed: u64) -> Result<Self, AvatarError> {
        Self::of(HeadModel::builtin(seed), &[], seed)
    }

    /// A person on the head model of the ICT-FaceKit folder `dir` (`FaceXModel` as published, or a part of it). The
    /// seed decides shape, skin, hair and eyes.
    ///
    /// # Errors
    /// Names the file that is missing, malformed or of another topology.
    pub fn ict(dir: &Path, seed: u64) -> Result<Self, AvatarError> {
        let model = ict::load(dir)?;
        let mut stream = Key::new(seed).stream("identity");
        // Principal components: standard normal, kept from the rare extremes.
        let identity: Vec<f32> =
            model.identities.iter().map(|_| stream.normal().clamp(-1.8, 1.8) * 0.8).collect();
        Self::of(model, &identity, seed)
    }

    /// A person on any head model, with the given weights of its identity basis. The seed decides skin, hair and eyes.
    ///
    /// # Errors
    /// When the model is inconsistent or has no landmarks.
    pub fn of(model: HeadModel, identity: &[f32], seed: u64) -> Result<Self, AvatarError> {
        model.validate()?;
        if model.landmarks.len() != 68 {
            return Err(AvatarError::Landmarks { model: model.name, found: model.landmarks.len() });
        }
        let shaped = model.shaped(identity);
        let gaussians = dress(&model, &shaped, seed);
        Ok(Self { model, shaped, gaussians })
    }

    pub fn model(&self) -> &HeadModel {
        &self.model
    }

    /// The head at rest.
    pub fn shaped(&self) -> &ShapedHead {
        &self.shaped
    }

    /// The Gaussians in the frames of the triangles.
    pub fn bound(&self) -> &BoundGaussians {
        &self.gaussians
    }

    /// The Gaussians in `pose`, world metres, into `out`. Of all poses the same number in the same order, so that two
    /// of them are in correspondence. `head` and `out` keep their memory from frame to frame.
    pub fn gaussians_into(&self, pose: &HeadPose, head: &mut PosedHead, out: &mut Gaussians) {
        self.model.vertices(&self.shaped, pose, &mut head.vertices);
        let vertices = &head.vertices;
        self.model
            .triangles
            .par_iter()
            .with_min_len(2048)
            .map(|&[a, b, c]| {
                TriangleFrame::of(vertices[a as usize], vertices[b as usize], vertices[c as usize])
            })
            .collect_into_vec(&mut head.frames);
        self.gaussians.world_into(&head.frames, out);
    }
}

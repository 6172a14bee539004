use std::path::{Path, PathBuf};

use glam::Vec3;
use rayon::prelude::*;
use srflow_files::FileError;
use srflow_splat::{GaussianGradients, Gaussians};

use crate::binding::{BindingError, BoundGaussians, BoundGradients, TriangleFrame, vertex_gradients};
use crate::dress::dress;
use crate::{
    HeadGradient, HeadModel, HeadModelError, HeadParameters, HeadPose, HeadSource, ParametersError,
    PoseParameters, ShapedHead,
};

/// Why an avatar could not be created.
#[derive(Debug, thiserror::Error)]
pub enum AvatarError {
    /// A file could not be read.
    #[error(transparent)]
    Read(#[from] FileError),
    /// A file of ICT-FaceKit's folder could not be read.
    #[error(
        "{0}. An ICT-FaceKit folder (FaceXModel) contains generic_neutral_mesh.obj, vertex_indices.json, identityNNN.obj and one OBJ per expression"
    )]
    IctFolder(#[source] FileError),
    /// A file is malformed.
    #[error("{}:{line}: {problem}", .path.display())]
    Malformed {
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What was expected, and what was found.
        problem: String,
    },
    /// A mesh does not have the published topology.
    #[error("{}: {found} vertices, where the topology of {model} has {expected}; use the published file", .path.display())]
    Topology {
        path: PathBuf,
        /// Whose topology it is.
        model: &'static str,
        /// Vertices of the published topology.
        expected: usize,
        /// Vertices in the file.
        found: usize,
    },
    /// A shape has another number of vertices than the neutral mesh.
    #[error("{}: {found} vertices, but {} has {expected}; both must have the same topology", .path.display(), .reference.display())]
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
    /// Gaussians refer to triangles that the model lacks.
    #[error(transparent)]
    Binding(#[from] BindingError),
    /// Parameters refer to shapes that the model lacks.
    #[error(transparent)]
    Parameters(#[from] ParametersError),
    /// The files of an avatar do not fit the head model.
    #[error("{}: {error}", .dir.display())]
    Misfit {
        dir: PathBuf,
        #[source]
        error: Box<AvatarError>,
    },
    /// An avatar was not trained on this capture.
    #[error("{}: not the capture that the avatar was trained on: {problem}; give the one that it was", .dir.display())]
    OtherCapture {
        dir: PathBuf,
        /// How the two differ.
        problem: String,
    },
    /// The files of an avatar do not name their head model.
    #[error("{}: the files name no head model, so it is FLAME's: give it too, as avatar:{}@flame:FILE", .0.display(), .0.display())]
    NoHeadName(PathBuf),
    /// The files of an avatar name a head model that there is not.
    #[error("{}: head {reason}; give another, as avatar:{}@HEAD", .dir.display(), .dir.display())]
    HeadName { dir: PathBuf, reason: String },
    /// The model has no landmarks, which place brows, lashes and the colours of the face.
    #[error("the head model {model} has {found} landmarks; dressing it needs the 68 of dlib")]
    Landmarks {
        /// Name of the head model.
        model: String,
        /// Number of its landmarks.
        found: usize,
    },
}

/// A person: a head model, the shape of one head, and the Gaussians bound to its triangles.
#[derive(Debug, Clone)]
pub struct Avatar {
    model: HeadModel,
    /// Without poses.
    identity: HeadParameters,
    own_motion: Vec<PoseParameters>,
    shaped: ShapedHead,
    gaussians: BoundGaussians,
}

/// Buffers of [`Avatar::gaussians_into`], reused between frames.
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
    /// The person of `seed` on the built-in head. The seed determines shape, skin, hair and eyes, identically on every
    /// machine.
    ///
    /// # Errors
    /// None that depend on the seed; the built-in head is checked like any other.
    pub fn builtin(seed: u64) -> Result<Self, AvatarError> {
        Self::of(HeadModel::builtin(seed), &[], seed)
    }

    /// A person on the head model of the ICT-FaceKit folder `dir` (`FaceXModel` as published, or a part of it). The seed
    /// determines shape, skin, hair and eyes.
    ///
    /// # Errors
    /// Names the file that is missing, malformed, or has another topology.
    pub fn ict(dir: &Path, seed: u64) -> Result<Self, AvatarError> {
        HeadSource::ict(dir).avatar(seed)
    }

    /// A person on any head model, with the given weights of its identity basis. The seed determines skin, hair and eyes.
    ///
    /// # Errors
    /// When the model is inconsistent or has no landmarks.
    pub fn of(model: HeadModel, identity: &[f32], seed: u64) -> Result<Self, AvatarError> {
        model.validate()?;
        if model.landmarks.len() < 68 {
            return Err(AvatarError::Landmarks { model: model.name, found: model.landmarks.len() });
        }
        let shaped = model.shaped(identity);
        let gaussians = dress(&model, &shaped, seed);
        let identity = HeadParameters { shape: identity.to_vec(), ..HeadParameters::default() };
        Ok(Self { model, identity, own_motion: Vec::new(), shaped, gaussians })
    }

    /// A person whose Gaussians are those of a file, on `model` with the identity and the motion of `parameters`.
    ///
    /// # Errors
    /// When the model is inconsistent, or lacks a triangle or a shape that the Gaussians or the parameters refer to.
    pub fn with_gaussians(
        model: HeadModel,
        parameters: HeadParameters,
        local: Gaussians,
        triangles: Vec<u32>,
    ) -> Result<Self, AvatarError> {
        model.validate()?;
        parameters.check(&model)?;
        let gaussians = BoundGaussians::new(local, triangles, model.triangles.len())?;
        let own_motion = parameters.poses;
        let identity = HeadParameters { poses: Vec::new(), ..parameters };
        let shaped = model.shaped_with_offset(&identity.shape, &identity.static_offset);
        Ok(Self { model, identity, own_motion, shaped, gaussians })
    }

    pub fn model(&self) -> &HeadModel {
        &self.model
    }

    /// The identity of the head, without poses.
    pub fn identity(&self) -> &HeadParameters {
        &self.identity
    }

    /// The poses that the person was recorded in; empty for one that was made up.
    pub fn own_motion(&self) -> &[PoseParameters] {
        &self.own_motion
    }

    pub fn shaped(&self) -> &ShapedHead {
        &self.shaped
    }

    /// Translation that brings the eyes to where the average built-in head has them, metres: the origins of head models differ.
    /// Zero for the built-in head and ICT-FaceKit.
    pub fn home(&self) -> Vec3 {
        const EYES: Vec3 = Vec3::new(0.0, 0.028, 0.0695);
        let is_at_home = ["builtin", "builtin-average", "ict"].contains(&self.model.name.as_str());
        let eyes = self.model.eye_centres(&self.shaped).filter(|_| !is_at_home);
        eyes.map_or(Vec3::ZERO, |[left, right]| EYES - (left + right) * 0.5)
    }

    /// The Gaussians in the local frames of the triangles.
    pub fn bound(&self) -> &BoundGaussians {
        &self.gaussians
    }

    pub(crate) fn bound_mut(&mut self) -> &mut BoundGaussians {
        &mut self.gaussians
    }

    /// Writes the Gaussians in `pose`, in world metres, into `out`. All poses have the same Gaussians in the same order, so any
    /// two are in correspondence. `head` and `out` keep their memory between frames.
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

    /// The backward of [`Avatar::gaussians_into`], which gave `head` in `pose`: from the gradients of the Gaussians in the world to
    /// those of the bound ones, which go into `bound`, and of the head's parameters. `identity` are the weights that the head was
    /// made with. Does not depend on the number of threads.
    ///
    /// Panics when `head` is of another model, or `world` of another number of Gaussians.
    pub fn backward(
        &self,
        identity: &[f32],
        pose: &HeadPose,
        head: &PosedHead,
        world: &GaussianGradients,
        bound: &mut BoundGradients,
    ) -> HeadGradient {
        self.gaussians.backward(&head.frames, world, bound);
        let mut vertices = Vec::new();
        vertex_gradients(&self.model.triangles, &head.vertices, &bound.frames, &mut vertices);
        self.model.backward(identity, &self.shaped, pose, &vertices)
    }
}

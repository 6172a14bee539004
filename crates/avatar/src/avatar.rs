use std::path::PathBuf;

use glam::Vec3;
use rayon::prelude::*;
use srflow_files::FileError;
use srflow_head::{
    Dress, HeadError, HeadGradient, HeadModel, HeadParameters, HeadPose, Look, ParametersError,
    PoseParameters, Shading, ShapedHead, TriangleFrame, dress, vertex_gradients,
};
use srflow_splat::{GaussianGradients, Gaussians};

use crate::binding::{BindingError, BoundGaussians, BoundGradients};

/// Why an avatar could not be created.
#[derive(Debug, thiserror::Error)]
pub enum AvatarError {
    /// A file of the avatar could not be read.
    #[error(transparent)]
    Read(#[from] FileError),
    /// The head model could not be read, or not be dressed.
    #[error(transparent)]
    Head(#[from] HeadError),
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
    /// `None` for Gaussians that were trained.
    shading: Option<Shading>,
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
        Self::of(HeadModel::builtin(seed), &[], seed, Look::default())
    }

    /// A person on any head model, with the given weights of its identity basis. The seed determines skin, hair and eyes.
    ///
    /// # Errors
    /// When the model is inconsistent or has no landmarks.
    pub fn of(model: HeadModel, identity: &[f32], seed: u64, look: Look) -> Result<Self, AvatarError> {
        model.validate().map_err(HeadError::from)?;
        let shaped = model.shaped(identity);
        let mut frames = Vec::new();
        write_frames(&model, &shaped.vertices, &mut frames);
        let mut gaussians = BoundGaussians::default();
        let Dress { splats, shading } = dress(&model, &shaped, seed, look)?;
        for (triangle, splat) in splats {
            gaussians.bind(triangle, &frames[triangle as usize], &splat);
        }
        // Hair and lashes thinner than a pixel must not become as wide and as dark as one.
        gaussians.local_mut().antialiased = look >= Look::Second;
        let identity = HeadParameters { shape: identity.to_vec(), ..HeadParameters::default() };
        Ok(Self { model, identity, own_motion: Vec::new(), shaped, gaussians, shading })
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
        model.validate().map_err(HeadError::from)?;
        parameters.check(&model)?;
        let gaussians = BoundGaussians::new(local, triangles, model.triangles.len())?;
        let own_motion = parameters.poses;
        let identity = HeadParameters { poses: Vec::new(), ..parameters };
        let shaped = model.shaped_with_offset(&identity.shape, &identity.static_offset);
        Ok(Self { model, identity, own_motion, shaped, gaussians, shading: None })
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

    /// Translation that brings the eyes to where the average built-in head has them, or the middle of a mesh without eyes to the origin,
    /// metres: the origins of head models differ. Zero for the built-in head and ICT-FaceKit.
    pub fn home(&self) -> Vec3 {
        const EYES: Vec3 = Vec3::new(0.0, 0.028, 0.0695);
        if ["builtin", "builtin-average", "ict"].contains(&self.model.name.as_str()) {
            return Vec3::ZERO;
        }
        match self.model.eye_centres(&self.shaped) {
            Some([left, right]) => EYES - (left + right) * 0.5,
            None => {
                let vertices = || self.shaped.vertices.iter().copied();
                let (low, high) = (vertices().reduce(Vec3::min), vertices().reduce(Vec3::max));
                low.zip(high).map_or(Vec3::ZERO, |(low, high)| (low + high) * -0.5)
            }
        }
    }

    /// The Gaussians in the local frames of the triangles.
    pub fn bound(&self) -> &BoundGaussians {
        &self.gaussians
    }

    /// How the colours of the Gaussians change with the pose; `None` where they do not.
    pub fn shading(&self) -> Option<&Shading> {
        self.shading.as_ref()
    }

    pub(crate) fn bound_mut(&mut self) -> &mut BoundGaussians {
        &mut self.gaussians
    }

    /// Writes the Gaussians in `pose`, in world metres, into `out`. All poses have the same Gaussians in the same order, so any
    /// two are in correspondence. `head` and `out` keep their memory between frames.
    pub fn gaussians_into(&self, pose: &HeadPose, head: &mut PosedHead, out: &mut Gaussians) {
        self.model.vertices(&self.shaped, pose, &mut head.vertices);
        write_frames(&self.model, &head.vertices, &mut head.frames);
        self.gaussians.world_into(&head.frames, out);
        if let Some(shading) = &self.shading {
            shading.shade(&self.model, pose, &head.vertices, &head.frames, out);
        }
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

/// The frames of all triangles of `model`.
fn write_frames(model: &HeadModel, vertices: &[Vec3], out: &mut Vec<TriangleFrame>) {
    let frame = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
        TriangleFrame::of(a, b, c)
    };
    model.triangles.par_iter().with_min_len(2048).map(frame).collect_into_vec(out);
}

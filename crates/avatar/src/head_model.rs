use std::ops::Range;

use glam::{Quat, Vec3};

/// The joints of every head model, in the order of FLAME.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Joint {
    /// Moves the whole head and neck.
    Root,
    /// Moves the head on the neck.
    Neck,
    /// Opens the mouth.
    Jaw,
    /// Turns the subject's left eyeball.
    LeftEye,
    /// Turns the subject's right eyeball.
    RightEye,
}

/// What a triangle shows, which decides how it is dressed with Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Region {
    /// Facial skin, ears included.
    Skin,
    /// Skin under the hair.
    Scalp,
    /// The red of the lips.
    Lips,
    /// Skin that carries an eyebrow.
    Brow,
    /// Rim of an eyelid that carries the lashes.
    LidMargin,
    /// Neck and shoulders.
    Neck,
    /// Eyeball. The iris is found from the eye joint and the rest gaze (+z).
    Eyeball,
    /// Upper or lower teeth.
    Teeth,
    /// Gums, tongue and the inside of the mouth.
    MouthInside,
}

/// A named displacement of some vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// The name in the model's own terms, e.g. `AU12_L` or `mouthSmile_L`.
    pub name: String,
    /// Vertex number and displacement in metres at weight 1; vertices that do not move are left out.
    pub offsets: Vec<(u32, Vec3)>,
}

/// Which half of the face an action unit moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// Both halves, or an action unit that has none.
    Both,
    /// The subject's left.
    Left,
    /// The subject's right.
    Right,
}

/// A FACS action unit in the terms of one head model.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionUnit {
    /// Number in FACS, e.g. 12.
    pub number: u8,
    /// The half it moves. A unit with halves is listed as `Left` and as `Right`; asked for on both, both are added.
    pub side: Side,
    /// Expression and its weight at full intensity.
    pub expressions: Vec<(usize, f32)>,
    /// Joint and its rotation at full intensity, as axis times angle in radians.
    pub joints: Vec<(Joint, Vec3)>,
}

/// A head that can change shape and move: template, identity and expression bases, joints with linear blend skinning,
/// as FLAME (Li et al. 2017). The built-in head, ICT-FaceKit and FLAME are all this struct.
#[derive(Debug, Clone)]
pub struct HeadModel {
    /// E.g. `builtin`, `ict`.
    pub name: String,
    /// Vertices at rest, metres.
    pub template: Vec<Vec3>,
    /// Vertex numbers, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// What each triangle shows.
    pub regions: Vec<Region>,
    /// Identity basis.
    pub identities: Vec<Shape>,
    /// Expression basis.
    pub expressions: Vec<Shape>,
    /// Rest position of each [`Joint`], in their order. Root is the parent of Neck, Neck of the others.
    pub joints: [Vec3; 5],
    /// Per vertex, the weight of each [`Joint`]; they sum to 1.
    pub skinning: Vec<[f32; 5]>,
    /// Action units in terms of expressions and joints.
    pub action_units: Vec<ActionUnit>,
    /// 68 facial landmarks (dlib order) as triangle and barycentric coordinates; empty when the model has none.
    pub landmarks: Vec<(u32, Vec3)>,
    /// Vertices of the two eyeballs, left and right.
    pub eyeballs: [Range<u32>; 2],
}

/// One moment of a head: what [`HeadModel::vertices`] needs beside the identity.
#[derive(Debug, Clone, PartialEq)]
pub struct HeadPose {
    /// Weight of each expression of the model; shorter than the basis means zero for the rest.
    pub expressions: Vec<f32>,
    /// Rotation of each [`Joint`] about its rest position.
    pub joints: [Quat; 5],
    /// Translation of the whole head, metres, after the rotations.
    pub translation: Vec3,
}

impl Default for HeadPose {
    fn default() -> Self {
        Self { expressions: Vec::new(), joints: [Quat::IDENTITY; 5], translation: Vec3::ZERO }
    }
}

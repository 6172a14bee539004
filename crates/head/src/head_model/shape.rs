use glam::Vec3;

/// Displacements of the vertices of a head model, in metres.
#[derive(Debug, Clone, PartialEq)]
pub enum Offsets {
    /// Vertex index and displacement; vertices that do not move are omitted. For local shapes.
    Sparse(Vec<(u32, Vec3)>),
    /// One displacement per vertex. For bases that move every vertex, such as FLAME's.
    Dense(Vec<Vec3>),
}

impl Default for Offsets {
    fn default() -> Self {
        Self::Sparse(Vec::new())
    }
}

impl Offsets {
    /// The given displacement of each vertex, in whichever of the two forms takes less memory.
    pub fn compact(dense: Vec<Vec3>) -> Self {
        let moving = dense.iter().filter(|offset| **offset != Vec3::ZERO).count();
        if moving * size_of::<(u32, Vec3)>() >= dense.len() * size_of::<Vec3>() {
            return Self::Dense(dense);
        }
        Self::Sparse((0..).zip(dense).filter(|(_, offset)| *offset != Vec3::ZERO).collect())
    }

    /// Vertices and their displacements, in the stored order; all vertices if dense.
    pub fn iter(&self) -> impl Iterator<Item = (u32, Vec3)> + '_ {
        let (sparse, dense) = match self {
            Self::Sparse(offsets) => (offsets.as_slice(), [].as_slice()),
            Self::Dense(offsets) => ([].as_slice(), offsets.as_slice()),
        };
        sparse.iter().copied().chain((0..).zip(dense.iter().copied()))
    }

    /// Adds the displacements times `weight` to `vertices`.
    pub(super) fn add_to(&self, vertices: &mut [Vec3], weight: f32) {
        match self {
            Self::Sparse(offsets) => {
                for &(vertex, offset) in offsets {
                    vertices[vertex as usize] += offset * weight;
                }
            }
            Self::Dense(offsets) => {
                for (vertex, &offset) in vertices.iter_mut().zip(offsets) {
                    *vertex += offset * weight;
                }
            }
        }
    }
}

impl From<Vec<(u32, Vec3)>> for Offsets {
    fn from(offsets: Vec<(u32, Vec3)>) -> Self {
        Self::Sparse(offsets)
    }
}

/// A named displacement of some vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// The model's own name, e.g. `AU12_L` or `mouthSmile_L`.
    pub name: String,
    /// Displacements at weight 1.
    pub offsets: Offsets,
    /// Curvature of the path between weights 0 and 1: the largest deviation from the straight line, at weight 0.5, scaled by
    /// `4w(1 - w)`, and zero outside. An eyelid needs it to slide around the eyeball. Empty for purely linear shapes, as of
    /// FLAME and ICT-FaceKit.
    pub arc: Vec<(u32, Vec3)>,
}

impl Shape {
    /// A linear shape.
    pub fn linear(name: impl Into<String>, offsets: impl Into<Offsets>) -> Self {
        Self { name: name.into(), offsets: offsets.into(), arc: Vec::new() }
    }

    pub(super) fn add_to(&self, vertices: &mut [Vec3], weight: f32) {
        if weight == 0.0 {
            return;
        }
        self.offsets.add_to(vertices, weight);
        if weight > 0.0 && weight < 1.0 {
            let bend = 4.0 * weight * (1.0 - weight);
            for &(vertex, offset) in &self.arc {
                vertices[vertex as usize] += offset * bend;
            }
        }
    }
}

/// Displacements that a joint's rotation R adds before skinning: the sum of nine shapes weighted by the entries of R - I
/// (pose correctives of SMPL, Loper et al. 2015, equation 9; `posedirs` in FLAME's files).
#[derive(Debug, Clone, PartialEq)]
pub struct PoseCorrective {
    /// The joint whose rotation relative to its parent is R.
    pub joint: usize,
    /// One shape for each entry of R - I, row by row.
    pub entries: [Offsets; 9],
}

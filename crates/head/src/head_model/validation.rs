use super::{HeadModel, JointRole, Offsets, Shape, Side};

/// Errors of a head model or its use.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HeadModelError {
    /// A list does not have one entry per vertex or triangle.
    #[error(
        "head model {model}: {list} has {found} entries, expected {expected}; the file is truncated or mixes models"
    )]
    Count {
        /// Name of the model.
        model: String,
        list: &'static str,
        /// Entries found.
        found: usize,
        /// Entries expected.
        expected: usize,
    },
    /// An index refers to a vertex, triangle, joint or expression that does not exist.
    #[error("head model {model}: {what} refers to number {index}, but there are only {count}")]
    Index {
        /// Name of the model.
        model: String,
        /// The part with the index.
        what: String,
        /// The index.
        index: usize,
        /// Number of elements.
        count: usize,
    },
    /// A coordinate or weight is not a finite number.
    #[error("head model {model}: {what} {index} is not a finite number")]
    NotFinite {
        /// Name of the model.
        model: String,
        /// The part with the number.
        what: String,
        /// Its index.
        index: usize,
    },
    /// The joint weights of a vertex, or the barycentric coordinates of a landmark, do not sum to 1.
    #[error("head model {model}: the {what} of {index} sum to {sum}, expected 1")]
    Sum {
        /// Name of the model.
        model: String,
        /// The summed quantity.
        what: &'static str,
        /// Vertex or landmark number.
        index: usize,
        sum: f32,
    },
    /// The first joint is not the root.
    #[error("head model {model}: the first joint is not the root of the others")]
    NoRoot {
        /// Name of the model.
        model: String,
    },
    /// Two joints have the same role.
    #[error("head model {model}: the joint {joint} has the role of another joint")]
    Roles {
        /// Name of the model.
        model: String,
        /// Name of the second joint.
        joint: String,
    },
    /// The model has no such action unit.
    #[error("head model {model} has no action unit {number} ({side:?}); it has {}", list(.available))]
    NoActionUnit {
        /// Name of the model.
        model: String,
        /// Requested number.
        number: u8,
        /// Requested side.
        side: Side,
        /// Available numbers.
        available: Vec<u8>,
    },
}

fn list(numbers: &[u8]) -> String {
    if numbers.is_empty() {
        return "none".to_owned();
    }
    numbers.iter().map(u8::to_string).collect::<Vec<_>>().join(", ")
}

/// Tolerance of a sum of weights read from a file.
const SUM_TOLERANCE: f32 = 1e-3;

impl HeadModel {
    /// Checks that every index is in range, that lists have matching lengths, that weights sum to 1, and that coordinates are
    /// finite. A model that passes can be shaped and posed with any weights without a panic; loaders call it before they
    /// return a model.
    ///
    /// # Errors
    /// The first problem found.
    pub fn validate(&self) -> Result<(), HeadModelError> {
        let vertices = self.template.len();
        self.check_count("skinning", self.skinning.len(), vertices)?;
        self.check_count("regions", self.regions.len(), self.triangles.len())?;
        self.check_finite("vertex", self.template.iter().map(|v| v.is_finite()))?;
        self.check_indices("a triangle", self.triangles.iter().flatten())?;
        for shape in self.identities.iter().chain(&self.expressions) {
            self.check_shape(shape)?;
        }
        self.check_joints()?;
        for corrective in &self.pose_correctives {
            self.check_index("a pose corrective", corrective.joint, self.joints.len())?;
            corrective.entries.iter().try_for_each(|entry| self.check_offsets("a pose corrective", entry))?;
        }
        for (vertex, weights) in self.skinning.iter().enumerate() {
            let joints = weights.iter().map(|(joint, _)| *joint as usize);
            joints
                .clone()
                .try_for_each(|joint| self.check_index("the skinning", joint, self.joints.len()))?;
            self.check_sum("joint weights", vertex, weights.iter().map(|(_, weight)| weight).sum())?;
        }
        self.check_action_units()?;
        self.check_landmarks()?;
        self.check_indices("an eyeball", self.eyeballs.iter().flatten())?;
        if let Some(texture) = &self.texture {
            self.check_count("texture", texture.triangles.len(), self.triangles.len())?;
            self.check_finite("texture coordinate", texture.points.iter().map(|point| point.is_finite()))?;
            let mut corners = texture.triangles.iter().flatten();
            corners.try_for_each(|point| {
                self.check_index("the texture of a triangle", *point as usize, texture.points.len())
            })?;
        }
        if self.carried.len() > self.triangles.len() || 3 * self.carried.len() > vertices {
            let found = self.triangles.len().min(vertices / 3);
            let model = self.name.clone();
            return Err(HeadModelError::Count {
                model,
                list: "carriers",
                found,
                expected: self.carried.len(),
            });
        }
        self.vertex_groups
            .iter()
            .try_for_each(|(name, group)| self.check_indices(&format!("the group {name}"), group))
    }

    fn check_shape(&self, shape: &Shape) -> Result<(), HeadModelError> {
        let what = format!("shape {}", shape.name);
        self.check_offsets(&what, &shape.offsets)?;
        self.check_indices(&what, shape.arc.iter().map(|(vertex, _)| vertex))?;
        self.check_finite(&what, shape.arc.iter().map(|(_, offset)| offset.is_finite()))
    }

    fn check_offsets(&self, what: &str, offsets: &Offsets) -> Result<(), HeadModelError> {
        match offsets {
            Offsets::Sparse(offsets) => self.check_indices(what, offsets.iter().map(|(vertex, _)| vertex))?,
            Offsets::Dense(offsets) => self.check_count("a shape", offsets.len(), self.template.len())?,
        }
        self.check_finite(what, offsets.iter().map(|(_, offset)| offset.is_finite()))
    }

    fn check_joints(&self) -> Result<(), HeadModelError> {
        if self.joint(JointRole::Root) != Some(0) {
            return Err(HeadModelError::NoRoot { model: self.name.clone() });
        }
        self.check_finite("joint", self.joints.iter().map(|joint| joint.position.is_finite()))?;
        for (index, joint) in self.joints.iter().enumerate() {
            match joint.parent {
                // Parents before children; the first joint has none, and all others have one.
                Some(parent) => self.check_index("the parent of a joint", parent, index)?,
                None => self.check_index("a joint without a parent", index, 1)?,
            }
            if joint.role.is_some_and(|role| self.joint(role) != Some(index)) {
                return Err(HeadModelError::Roles { model: self.name.clone(), joint: joint.name.clone() });
            }
            self.check_indices("the joint regressor", joint.follows.iter().map(|(vertex, _)| vertex))?;
            let weights = joint.follows.iter().map(|(_, weight)| weight.is_finite());
            self.check_finite("weight of the joint regressor", weights)?;
            let moved = joint.identities.iter().map(|offset| offset.is_finite());
            self.check_finite("displacement of a joint by identity", moved)?;
        }
        Ok(())
    }

    fn check_action_units(&self) -> Result<(), HeadModelError> {
        for unit in &self.action_units {
            let what = format!("action unit {} ({:?})", unit.number, unit.side);
            for &(expression, _) in &unit.expressions {
                self.check_index(&what, expression, self.expressions.len())?;
            }
            self.check_finite(&what, unit.expressions.iter().map(|(_, weight)| weight.is_finite()))?;
            self.check_finite(&what, unit.joints.iter().map(|(_, turn)| turn.is_finite()))?;
            for &(joint, _) in &unit.joints {
                self.check_index(&what, joint, self.joints.len())?;
            }
        }
        Ok(())
    }

    fn check_landmarks(&self) -> Result<(), HeadModelError> {
        for (number, &(triangle, barycentric)) in self.landmarks.iter().enumerate() {
            self.check_index("a landmark", triangle as usize, self.triangles.len())?;
            self.check_sum("barycentric coordinates", number, barycentric.element_sum())?;
        }
        Ok(())
    }

    fn check_count(&self, list: &'static str, found: usize, expected: usize) -> Result<(), HeadModelError> {
        if found == expected {
            return Ok(());
        }
        Err(HeadModelError::Count { model: self.name.clone(), list, found, expected })
    }

    fn check_indices<'a>(
        &self,
        what: &str,
        vertices: impl IntoIterator<Item = &'a u32>,
    ) -> Result<(), HeadModelError> {
        vertices
            .into_iter()
            .try_for_each(|&vertex| self.check_index(what, vertex as usize, self.template.len()))
    }

    fn check_index(&self, what: &str, index: usize, count: usize) -> Result<(), HeadModelError> {
        if index < count {
            return Ok(());
        }
        Err(HeadModelError::Index { model: self.name.clone(), what: what.to_owned(), index, count })
    }

    fn check_finite(&self, what: &str, finite: impl IntoIterator<Item = bool>) -> Result<(), HeadModelError> {
        match finite.into_iter().position(|finite| !finite) {
            None => Ok(()),
            Some(index) => {
                Err(HeadModelError::NotFinite { model: self.name.clone(), what: what.to_owned(), index })
            }
        }
    }

    fn check_sum(&self, what: &'static str, index: usize, sum: f32) -> Result<(), HeadModelError> {
        // Written such that a NaN sum fails too.
        if (sum - 1.0).abs() <= SUM_TOLERANCE {
            return Ok(());
        }
        Err(HeadModelError::Sum { model: self.name.clone(), what, index, sum })
    }
}

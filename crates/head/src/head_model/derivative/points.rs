use glam::{DMat3, DQuat, DVec3, Vec3};

use super::super::{HeadModel, HeadPose, Shape};
use super::{PosedJoint, entry_derivatives};

/// All parameters of a head model in f64. Missing weights are zero, and missing joints do not rotate.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeadState {
    /// Weights of the identity basis.
    pub identity: Vec<f64>,
    /// Weights of the expression basis.
    pub expressions: Vec<f64>,
    /// Rotation of each joint about its rest position, relative to its parent.
    pub joints: Vec<DQuat>,
    /// Translation of the whole head, metres, after the rotations.
    pub translation: DVec3,
}

impl HeadState {
    /// The rotation of joint number `joint`.
    pub fn joint(&self, joint: usize) -> DQuat {
        self.joints.get(joint).copied().unwrap_or(DQuat::IDENTITY)
    }

    /// The rotation of joint number `joint`, to be changed.
    pub fn joint_mut(&mut self, joint: usize) -> &mut DQuat {
        if self.joints.len() <= joint {
            self.joints.resize(joint + 1, DQuat::IDENTITY);
        }
        &mut self.joints[joint]
    }

    /// Everything but the identity, in the precision of [`HeadModel::vertices`].
    pub fn pose(&self) -> HeadPose {
        HeadPose {
            expressions: self.expressions.iter().map(|weight| *weight as f32).collect(),
            joints: self.joints.iter().map(|rotation| rotation.as_quat()).collect(),
            translation: self.translation.as_vec3(),
            offset: Vec::new(),
        }
    }
}

/// Chosen points on the surface of a head model, prepared for being evaluated many times in f64, with derivatives.
#[derive(Debug, Clone)]
pub struct HeadPoints {
    /// The vertices that the points lie between.
    vertices: Vec<Vertex>,
    /// Up to three of `vertices` with their barycentric coordinates.
    points: Vec<Vec<(usize, f64)>>,
    joints: Vec<Joint>,
    /// The joint of each pose corrective.
    correctives: Vec<usize>,
    identities: usize,
    expressions: usize,
}

#[derive(Debug, Clone)]
struct Vertex {
    rest: Moving,
    /// The nine displacements of each pose corrective.
    correctives: Vec<[DVec3; 9]>,
    skinning: Vec<(usize, f64)>,
}

#[derive(Debug, Clone)]
struct Joint {
    rest: Moving,
    parent: Option<usize>,
}

/// A position at rest, and how each shape moves it: identities, then expressions. The second vector is the arc.
#[derive(Debug, Clone)]
struct Moving {
    template: DVec3,
    shapes: Vec<[DVec3; 2]>,
}

impl Moving {
    fn at(&self, weights: &[Weight]) -> DVec3 {
        let moved = self.shapes.iter().zip(weights);
        moved.fold(self.template, |sum, ([line, arc], weight)| sum + *line * weight.line + *arc * weight.arc)
    }

    fn derivative(&self, shape: usize, weight: &Weight) -> DVec3 {
        let [line, arc] = self.shapes[shape];
        line + arc * weight.arc_slope
    }
}

/// The weight of a shape and of its arc, and the derivative of the latter.
#[derive(Debug)]
struct Weight {
    line: f64,
    arc: f64,
    arc_slope: f64,
}

impl Weight {
    fn of(weight: f64) -> Self {
        // At zero the derivative is that to the right: shapes with arcs are made for weights between 0 and 1.
        let inside = (0.0..1.0).contains(&weight);
        let (arc, arc_slope) =
            if inside { (4.0 * weight * (1.0 - weight), 4.0 - 8.0 * weight) } else { (0.0, 0.0) };
        Self { line: weight, arc, arc_slope }
    }
}

/// Positions of points, and their derivatives.
#[derive(Debug, Clone, PartialEq)]
pub struct PointDerivatives {
    /// Metres.
    pub positions: Vec<DVec3>,
    /// One row per point, one column per parameter; see [`HeadPoints::columns`].
    pub values: Vec<DVec3>,
}

impl HeadPoints {
    /// The model's landmarks.
    pub fn landmarks(model: &HeadModel) -> Self {
        Self::on_triangles(model, &model.landmarks)
    }

    /// These vertices of the model.
    pub fn vertices(model: &HeadModel, vertices: impl IntoIterator<Item = u32>) -> Self {
        Self::prepare(model, vertices.into_iter().map(|vertex| vec![(vertex, 1.0)]).collect())
    }

    /// Points given by triangle and barycentric coordinates, as [`HeadModel::landmarks`].
    pub fn on_triangles(model: &HeadModel, points: &[(u32, Vec3)]) -> Self {
        let corners = |&(triangle, weights): &(u32, Vec3)| {
            let corners = model.triangles[triangle as usize].into_iter().zip(weights.as_dvec3().to_array());
            corners.filter(|(_, weight)| *weight != 0.0).collect()
        };
        Self::prepare(model, points.iter().map(corners).collect())
    }

    fn prepare(model: &HeadModel, points: Vec<Vec<(u32, f64)>>) -> Self {
        let mut used: Vec<u32> = points.iter().flatten().map(|(vertex, _)| *vertex).collect();
        used.sort_unstable();
        used.dedup();
        let place = |vertex: u32| used.partition_point(|other| *other < vertex);

        // Everything that a vertex carries along when a shape moves it: itself, if it is used, and joints by their regressor. The
        // joints come after the vertices.
        let mut carried: Vec<Vec<(usize, f64)>> = vec![Vec::new(); model.template.len()];
        for (place, &vertex) in used.iter().enumerate() {
            carried[vertex as usize].push((place, 1.0));
        }
        let followed = model.joints.iter().enumerate();
        for (joint, (vertex, weight)) in
            followed.flat_map(|(j, joint)| joint.follows.iter().map(move |f| (j, f)))
        {
            carried[*vertex as usize].push((used.len() + joint, f64::from(*weight)));
        }
        let (identities, expressions) = (model.identities.len(), model.expressions.len());
        let still = |template: Vec3| Moving {
            template: template.as_dvec3(),
            shapes: vec![[DVec3::ZERO; 2]; identities + expressions],
        };
        let mut moving: Vec<Moving> =
            used.iter().map(|vertex| still(model.template[*vertex as usize])).collect();
        moving.extend(model.joints.iter().map(|joint| still(joint.position)));
        let mut add = |column: usize, shape: &Shape, most: usize| {
            for (part, (vertex, offset)) in
                shape.offsets.iter().map(|o| (0, o)).chain(shape.arc.iter().map(|o| (1, *o)))
            {
                for &(place, weight) in carried[vertex as usize].iter().filter(|(place, _)| *place < most) {
                    moving[place].shapes[column][part] += offset.as_dvec3() * weight;
                }
            }
        };
        for (column, shape) in model.identities.iter().enumerate() {
            add(column, shape, usize::MAX);
        }
        let most = if model.joints_follow_expressions { usize::MAX } else { used.len() };
        for (column, shape) in (identities..).zip(&model.expressions) {
            add(column, shape, most);
        }
        let rest_of_joints = moving.split_off(used.len());
        let joint = |(mut rest, joint): (Moving, &super::super::Joint)| {
            for (shape, offset) in rest.shapes.iter_mut().zip(&joint.identities) {
                shape[0] += offset.as_dvec3();
            }
            Joint { rest, parent: joint.parent }
        };
        let joints = rest_of_joints.into_iter().zip(&model.joints).map(joint).collect();

        let mut vertices: Vec<Vertex> = used
            .iter()
            .zip(moving)
            .map(|(&vertex, rest)| {
                let weights = model.skinning.of(vertex as usize).iter();
                let skinning = weights.map(|&(joint, weight)| (joint as usize, f64::from(weight))).collect();
                Vertex { rest, correctives: vec![[DVec3::ZERO; 9]; model.pose_correctives.len()], skinning }
            })
            .collect();
        for (number, corrective) in model.pose_correctives.iter().enumerate() {
            for (entry, offsets) in corrective.entries.iter().enumerate() {
                for (vertex, offset) in offsets.iter() {
                    let place = place(vertex);
                    if used.get(place) == Some(&vertex) {
                        vertices[place].correctives[number][entry] += offset.as_dvec3();
                    }
                }
            }
        }
        let points = points
            .into_iter()
            .map(|corners| corners.into_iter().map(|(vertex, weight)| (place(vertex), weight)).collect())
            .collect();
        let correctives = model.pose_correctives.iter().map(|corrective| corrective.joint).collect();
        Self { vertices, points, joints, correctives, identities, expressions }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Columns of the derivatives: one for each identity, one for each expression, three for each joint (a small rotation after
    /// the joint's own, about the axes of its parent, radians) and three for the translation, metres.
    pub fn columns(&self) -> usize {
        self.identities + self.expressions + 3 * self.joints.len() + 3
    }

    /// Where the points are, metres.
    pub fn positions(&self, state: &HeadState) -> Vec<DVec3> {
        let (weights, joints) = self.posed(state);
        let vertices: Vec<DVec3> = self
            .vertices
            .iter()
            .map(|vertex| {
                let rest = vertex.corrected(&weights, &self.correctives, &joints);
                vertex.skinning.iter().map(|&(joint, weight)| joints[joint].point(rest) * weight).sum()
            })
            .collect();
        self.points
            .iter()
            .map(|corners| corners.iter().map(|&(v, weight)| vertices[v] * weight).sum())
            .collect()
    }

    /// Where the points are, and how they move with every parameter.
    pub fn derivatives(&self, state: &HeadState) -> PointDerivatives {
        let linearised = self.linearised(state);
        let mut positions = Vec::with_capacity(self.len());
        let mut values = Vec::with_capacity(self.len() * self.columns());
        for point in 0..self.len() {
            let (position, row) = linearised.point(point);
            positions.push(position);
            values.extend(row);
        }
        PointDerivatives { positions, values }
    }

    /// The points at a state, whose derivatives are asked for one by one.
    pub fn linearised(&self, state: &HeadState) -> LinearisedPoints<'_> {
        let (weights, joints) = self.posed(state);
        let carried = self.carried_joints(&weights, &joints);
        LinearisedPoints { points: self, weights, joints, carried }
    }

    fn posed(&self, state: &HeadState) -> (Vec<Weight>, Vec<PosedJoint>) {
        let padded = |weights: &[f64], count: usize| -> Vec<Weight> {
            (0..count).map(|i| Weight::of(weights.get(i).copied().unwrap_or(0.0))).collect()
        };
        let mut weights = padded(&state.identity, self.identities);
        weights.extend(padded(&state.expressions, self.expressions));
        let rest: Vec<DVec3> = self.joints.iter().map(|joint| joint.rest.at(&weights)).collect();
        let parents = self.joints.iter().map(|joint| joint.parent);
        let joints = PosedJoint::chain(parents, &rest, |joint| state.joint(joint), state.translation);
        (weights, joints)
    }

    /// How each shape changes the translation of each joint's transform: one row per joint.
    fn carried_joints(&self, weights: &[Weight], joints: &[PosedJoint]) -> Vec<Vec<DVec3>> {
        let mut carried: Vec<Vec<DVec3>> = Vec::with_capacity(joints.len());
        for (joint, posed) in self.joints.iter().zip(joints) {
            let lever = posed.parent_rotation - posed.rotation;
            let row = weights.iter().enumerate().map(|(shape, weight)| {
                let of_parent = joint.parent.map_or(DVec3::ZERO, |parent| carried[parent][shape]);
                lever * joint.rest.derivative(shape, weight) + of_parent
            });
            let row = row.collect();
            carried.push(row);
        }
        carried
    }
}

/// Points at one state of the head. Derivatives are computed on demand: those of thousands of points would take a hundred megabytes.
#[derive(Debug)]
pub struct LinearisedPoints<'a> {
    points: &'a HeadPoints,
    weights: Vec<Weight>,
    joints: Vec<PosedJoint>,
    carried: Vec<Vec<DVec3>>,
}

impl LinearisedPoints<'_> {
    /// Where a point is, metres, and how it moves with every parameter: a row of [`PointDerivatives::values`].
    pub fn point(&self, point: usize) -> (DVec3, Vec<DVec3>) {
        let HeadPoints { vertices, points, .. } = self.points;
        if let [(vertex, 1.0)] = points[point][..] {
            return self.vertex(&vertices[vertex]);
        }
        let mut sum = (DVec3::ZERO, vec![DVec3::ZERO; self.points.columns()]);
        for &(vertex, weight) in &points[point] {
            let (position, row) = self.vertex(&vertices[vertex]);
            sum.0 += position * weight;
            sum.1.iter_mut().zip(row).for_each(|(sum, value)| *sum += value * weight);
        }
        sum
    }

    /// Position and derivatives of one vertex.
    fn vertex(&self, vertex: &Vertex) -> (DVec3, Vec<DVec3>) {
        let Self { points, weights, joints, carried } = self;
        let rest = vertex.corrected(weights, &points.correctives, joints);
        let mut position = DVec3::ZERO;
        let mut skin = DMat3::ZERO;
        let mut row = vec![DVec3::ZERO; points.columns()];
        let (of_shapes, of_pose) = row.split_at_mut(weights.len());
        let (of_joints, of_translation) = of_pose.split_at_mut(3 * joints.len());
        for &(joint, weight) in &vertex.skinning {
            let point = joints[joint].point(rest);
            position += point * weight;
            skin += joints[joint].rotation * weight;
            for (sum, value) in of_shapes.iter_mut().zip(&carried[joint]) {
                *sum += *value * weight;
            }
            let mut moved_by = Some(joint);
            while let Some(joint) = moved_by {
                let PosedJoint { parent_rotation, position, .. } = joints[joint];
                let arm = (point - position) * weight;
                for axis in 0..3 {
                    of_joints[3 * joint + axis] += parent_rotation.col(axis).cross(arm);
                }
                moved_by = points.joints[joint].parent;
            }
        }
        for (shape, (sum, weight)) in of_shapes.iter_mut().zip(weights).enumerate() {
            *sum += skin * vertex.rest.derivative(shape, weight);
        }
        for (&joint, entries) in points.correctives.iter().zip(&vertex.correctives) {
            for (axis, slopes) in entry_derivatives(joints[joint].local).into_iter().enumerate() {
                let moved: DVec3 = entries.iter().zip(slopes).map(|(entry, slope)| *entry * slope).sum();
                of_joints[3 * joint + axis] += skin * moved;
            }
        }
        // A vertex whose weights do not sum to 1 exactly in f32 follows the translation by that sum.
        let share: f64 = vertex.skinning.iter().map(|(_, weight)| weight).sum();
        for (value, axis) in of_translation.iter_mut().zip(DVec3::AXES) {
            *value = axis * share;
        }
        (position, row)
    }
}

impl Vertex {
    /// The vertex at rest with shapes and pose correctives.
    fn corrected(&self, weights: &[Weight], correctives: &[usize], joints: &[PosedJoint]) -> DVec3 {
        let mut rest = self.rest.at(weights);
        for (&joint, entries) in correctives.iter().zip(&self.correctives) {
            let turn = (joints[joint].local - DMat3::IDENTITY).transpose().to_cols_array();
            rest += entries.iter().zip(turn).map(|(entry, weight)| *entry * weight).sum::<DVec3>();
        }
        rest
    }
}

//! The built-in head: sculpted by code from a seed.
//!
//! The left half is made in millimetres, stage by stage: the skull's rings, the skin's grid over them with the face's
//! relief, nose, lids and lips, then eyeballs, teeth, tongue and ears. It is mirrored, scaled to metres and given
//! joints and action units.

mod action_units;
mod blob;
mod curves;
mod ears;
mod eyes;
mod face;
mod form;
mod half;
mod identity;
mod landmarks;
mod mouth;
mod neck;
mod nose;
mod skin;
mod skinning;
mod skull;
mod teeth;

use std::collections::BTreeMap;

use glam::Vec3;
use rayon::prelude::*;

use self::form::Form;
use self::half::{Half, Mark};
use self::identity::{OneTrait, Plan, Traits};
use self::landmarks::Landmarks;
use crate::{ActionUnit, HeadModel, Joint, JointRole, Look, Offsets, Shape, Side, Skinning};

const METRES_PER_MILLIMETRE: f32 = 1e-3;

/// Displacements smaller than this, in millimetres, are left out of a shape.
const UNMOVED: f32 = 1e-3;

impl HeadModel {
    /// The built-in head of the person of `seed`.
    ///
    /// All persons share one topology: vertex and triangle numbers mean the same place on every head; only hairline and
    /// brows, that is [`HeadModel::regions`], follow each person. The identity is in the template; there is no basis.
    pub fn builtin(seed: u64) -> Self {
        Self::builtin_with(seed, Look::default())
    }

    /// As [`HeadModel::builtin`], with a look.
    pub fn builtin_with(seed: u64, look: Look) -> Self {
        Self::sculpted(Traits::of(seed, look), look)
    }

    /// The average built-in head, with the traits that persons differ in as its identity basis, in standard deviations: the head of
    /// an unknown person, to be fitted. The basis is linear, and persons of [`HeadModel::builtin`] are not: they also differ by
    /// a fraction of a millimetre in the shapes of their expressions.
    pub fn builtin_average() -> Self {
        Self::builtin_average_with(Look::default())
    }

    /// As [`HeadModel::builtin_average`], with a look.
    pub fn builtin_average_with(look: Look) -> Self {
        let average = Self::sculpted(Traits::default(), look);
        let shape = |(name, of): (String, OneTrait)| {
            let [more, less] = [1.0, -1.0].map(|value| Self::sculpted(of(value), look));
            let halves = |more: &[Vec3], less: &[Vec3]| -> Vec<Vec3> {
                more.iter().zip(less).map(|(more, less)| (*more - *less) * 0.5).collect()
            };
            let positions =
                |model: &Self| model.joints.iter().map(|joint| joint.position).collect::<Vec<_>>();
            let offsets = Offsets::compact(halves(&more.template, &less.template));
            (Shape::linear(name, offsets), halves(&positions(&more), &positions(&less)))
        };
        let shapes: Vec<(Shape, Vec<Vec3>)> = Traits::each(look).into_par_iter().map(shape).collect();
        let mut joints = average.joints;
        for (number, joint) in joints.iter_mut().enumerate() {
            joint.identities = shapes.iter().map(|(_, moved)| moved[number]).collect();
        }
        let identities = shapes.into_iter().map(|(shape, _)| shape).collect();
        Self { name: "builtin-average".to_owned(), identities, joints, ..average }
    }

    /// The average built-in head, without an identity basis.
    pub(crate) fn sculpted_average(look: Look) -> Self {
        Self::sculpted(Traits::default(), look)
    }

    fn sculpted(traits: Traits, look: Look) -> Self {
        let plan = Plan::new(traits, look);
        let Sculpture { mut half, skin, eyeball } = sculpted_half(&plan);
        let landmarks = Landmarks::on(&half, &plan, &skin);

        let whole = Whole::new(&half);
        let right_eyeball = whole.right[eyeball.start as usize]..whole.right[eyeball.end as usize - 1] + 1;
        let left_weights: Vec<[f32; 5]> =
            half.points.iter().zip(&half.marks).map(|(&p, mark)| skinning::weights(&plan, p, mark)).collect();
        let landmarks = landmarks.in_order(|vertex| whole.right[vertex as usize]);
        let (expressions, action_units) = whole.action_units(&plan, &half);
        if look >= Look::Second {
            Form::get().apply(&traits, &mut half.points);
        }
        Self {
            name: "builtin".to_owned(),
            template: whole.points(&half.points).map(|p| p * METRES_PER_MILLIMETRE).collect(),
            skinning: whole.skinning(&left_weights),
            landmarks: landmarks.into_iter().map(|vertex| whole.corner_at(vertex)).collect(),
            regions: half.regions.iter().chain(&half.regions).copied().collect(),
            triangles: whole.triangles,
            identities: Vec::new(),
            expressions,
            joints: Joint::of_roles(skinning::joints(&plan).map(|joint| joint * METRES_PER_MILLIMETRE)),
            joints_follow_expressions: false,
            expressions_are_components: false,
            pose_correctives: Vec::new(),
            action_units,
            eyeballs: [eyeball.collect(), right_eyeball.collect()],
            texture: None,
            colors: None,
            vertex_groups: BTreeMap::new(),
            carried: Vec::new(),
        }
    }
}

/// The left half of a head before it is mirrored.
struct Sculpture {
    half: Half,
    skin: skin::Skin,
    /// Vertices of the eyeball.
    eyeball: std::ops::Range<u32>,
}

fn sculpted_half(plan: &Plan) -> Sculpture {
    let mut half = Half::default();
    let skin = skin::Grid::new(plan).lay(&mut half);
    let eyeball = eyes::add_eyeball(&mut half, plan);
    eyes::add_caruncle(&mut half, plan);
    teeth::add(&mut half, plan, skin.lips);
    mouth::add_tongue(&mut half, plan, skin.lips);
    ears::add(&mut half, plan, skin.ear);
    Sculpture { half, skin, eyeball }
}

fn mirrored(p: Vec3) -> Vec3 {
    Vec3::new(-p.x, p.y, p.z)
}

/// The mapping from the left half to the whole head.
struct Whole {
    /// The right vertex for each left one; the same on the midline.
    right: Vec<u32>,
    /// The left vertex of each right one, in the order of the right ones.
    mirrored: Vec<u32>,
    triangles: Vec<[u32; 3]>,
}

impl Whole {
    fn new(half: &Half) -> Self {
        let left = half.points.len() as u32;
        let mut mirrored = Vec::new();
        let right: Vec<u32> = (0..left)
            .map(|vertex| {
                if half.marks[vertex as usize].midline {
                    return vertex;
                }
                mirrored.push(vertex);
                left + mirrored.len() as u32 - 1
            })
            .collect();
        let flipped = half.triangles.iter().map(|t| [t[0], t[2], t[1]].map(|vertex| right[vertex as usize]));
        let triangles = half.triangles.iter().copied().chain(flipped).collect();
        Self { right, mirrored, triangles }
    }

    /// Points of the left half, then those of the right.
    fn points<'a>(&'a self, left: &'a [Vec3]) -> impl Iterator<Item = Vec3> + 'a {
        left.iter().copied().chain(self.mirrored.iter().map(|&vertex| mirrored(left[vertex as usize])))
    }

    fn skinning(&self, left: &[[f32; 5]]) -> Skinning {
        let swap_eyes = |[root, neck, jaw, left, right]: [f32; 5]| [root, neck, jaw, right, left];
        left.iter()
            .copied()
            .chain(self.mirrored.iter().map(|&vertex| swap_eyes(left[vertex as usize])))
            .collect()
    }

    /// A triangle with `vertex` as a corner, and the barycentric coordinates of that corner.
    fn corner_at(&self, vertex: u32) -> (u32, Vec3) {
        let corner = |triangle: &[u32; 3]| triangle.iter().position(|&corner| corner == vertex);
        let found =
            self.triangles.iter().enumerate().find_map(|(number, t)| corner(t).map(|c| (number as u32, c)));
        found.map_or((0, Vec3::X), |(number, corner)| (number, Vec3::AXES[corner]))
    }

    /// The expressions of all action units, and the units in terms of them.
    fn action_units(&self, plan: &Plan, half: &Half) -> (Vec<Shape>, Vec<ActionUnit>) {
        let mut expressions = Vec::new();
        let mut units = Vec::new();
        for (number, halves) in action_units::EXPRESSIONS {
            let fitted = if plan.look >= Look::Second { Form::get().unit(number) } else { None };
            let moved: Vec<(Vec3, Vec3)> = half
                .points
                .iter()
                .zip(&half.marks)
                .enumerate()
                .map(|(vertex, (&p, mark))| {
                    action_units::displacement(plan, number, p, mark, fitted.map(|fitted| fitted[vertex]))
                })
                .collect();
            let sides: &[(Side, &str)] =
                if halves { &[(Side::Left, "_L"), (Side::Right, "_R")] } else { &[(Side::Both, "")] };
            for &(side, suffix) in sides {
                let expression = expressions.len();
                let unit = |number| ActionUnit {
                    number,
                    side,
                    expressions: vec![(expression, 1.0)],
                    joints: vec![],
                };
                units.push(unit(number));
                if number == 43 {
                    units.push(unit(45));
                }
                expressions.push(self.shape(format!("AU{number}{suffix}"), side, half, &moved));
            }
        }
        let jaw = vec![(JointRole::Jaw as usize, Vec3::new(action_units::JAW_DROP, 0.0, 0.0))];
        units.push(ActionUnit { number: 26, side: Side::Both, expressions: vec![], joints: jaw });
        units.sort_by_key(|unit| unit.number);
        (expressions, units)
    }

    /// One side of a displacement defined on the left half.
    fn shape(&self, name: String, side: Side, half: &Half, moved: &[(Vec3, Vec3)]) -> Shape {
        let (mut offsets, mut arcs) = (Vec::new(), Vec::new());
        let mut push = |vertex: usize, (offset, arc): (Vec3, Vec3)| {
            if offset.length() > UNMOVED {
                offsets.push((vertex as u32, offset * METRES_PER_MILLIMETRE));
            }
            if arc.length() > UNMOVED {
                arcs.push((vertex as u32, arc * METRES_PER_MILLIMETRE));
            }
        };
        for (vertex, (p, &(offset, arc))) in half.points.iter().zip(moved).enumerate() {
            let Mark { midline, .. } = half.marks[vertex];
            let share = action_units::share(side, p.x);
            let flat = if midline { Vec3::new(0.0, 1.0, 1.0) } else { Vec3::ONE };
            push(vertex, (offset * flat * share, arc * flat * share));
        }
        for (number, &vertex) in self.mirrored.iter().enumerate() {
            let (offset, arc) = moved[vertex as usize];
            let share = action_units::share(side, -half.points[vertex as usize].x);
            push(half.points.len() + number, (mirrored(offset) * share, mirrored(arc) * share));
        }
        Shape { arc: arcs, ..Shape::linear(name, offsets) }
    }
}

#[cfg(test)]
mod tests;

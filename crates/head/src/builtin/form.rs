//! The form of faces, beyond what is sculpted: smooth displacements that were fitted to ICT-FaceKit (Li et al. 2020) by tools/head_form.py,
//! and are sums of Gaussian kernels on the skin of the average sculpted head.

use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;

use super::curves::smoothstep;
use super::half::{Half, Mark, Part};
use super::identity::{Plan, Traits};
use super::mouth;
use super::skin::TRAGUS;
use crate::Look;

/// Smaller displacements by units are errors of the fit, millimetres: they fade out from the second to the first.
const LEAST: (f32, f32) = (0.1, 0.5);

/// How much farther behind the lips the teeth are than as sculpted, millimetres.
const TEETH_BACK: f32 = 1.6;
/// And how much lower, so that the upper ones show where lips part.
const TEETH_DOWN: f32 = 1.2;

/// Number of the ways in which faces differ.
pub(super) const MODES: usize = 10;

/// Displacements in millimetres of the vertices of the left half, which are the same on all persons.
pub(super) struct Form {
    /// From the sculpted average to the average of people.
    average: Vec<Vec3>,
    /// The ways in which faces differ, one standard deviation each, the most frequent first.
    modes: Vec<Vec<Vec3>>,
    /// What action units do on both halves.
    units: Vec<(u8, Vec<Vec3>)>,
}

impl Form {
    pub(super) fn get() -> &'static Self {
        static FORM: OnceLock<Form> = OnceLock::new();
        FORM.get_or_init(|| Self::on(&average_half(), &Plan::new(Traits::default(), Look::First)))
    }

    fn on(half: &Half, plan: &Plan) -> Self {
        let table = Table::parse(include_str!("form.txt"));
        let places = Places::of(half, plan);
        let mut form = Self { average: Vec::new(), modes: Vec::new(), units: Vec::new() };
        let closed = table.weights(&half.points, |kernel| kernel.centre);
        let charted: Vec<Vec3> =
            half.points.iter().zip(&half.marks).map(|(p, mark)| chart(plan, *p, mark)).collect();
        let opened = table.weights(&charted, |kernel| kernel.charted);
        for (name, coefficients) in &table.sections {
            match name.strip_prefix("unit ").and_then(|number| number.trim().parse().ok()) {
                Some(number) => {
                    form.units.push((number, places.unit(half, number, &field(&opened, coefficients))))
                }
                None => {
                    let shape = places.shape(half, &field(&closed, coefficients));
                    if name == "average" { form.average = shape } else { form.modes.push(shape) }
                }
            }
        }
        // Behind lips that a smile draws back.
        for (offset, mark) in form.average.iter_mut().zip(&half.marks) {
            match mark.part {
                Part::UpperTeeth => *offset -= Vec3::new(0.0, TEETH_DOWN, TEETH_BACK),
                Part::LowerTeeth | Part::Tongue => *offset -= Vec3::new(0.0, 1.5 * TEETH_DOWN, TEETH_BACK),
                _ => {}
            }
        }
        form
    }

    /// Moves the points of a half by the average form and the person's.
    pub(super) fn apply(&self, traits: &Traits, points: &mut [Vec3]) {
        for (p, offset) in points.iter_mut().zip(&self.average) {
            *p += *offset;
        }
        for (mode, weight) in self.modes.iter().zip(traits.form) {
            for (p, offset) in points.iter_mut().zip(mode) {
                *p += *offset * weight;
            }
        }
    }

    /// What an action unit does to the skin, if it was fitted.
    pub(super) fn unit(&self, number: u8) -> Option<&[Vec3]> {
        self.units.iter().find(|(unit, _)| *unit == number).map(|(_, moved)| moved.as_slice())
    }
}

/// The left half of the average head as it is sculpted.
pub(super) fn average_half() -> Half {
    super::sculpted_half(&Plan::new(Traits::default(), Look::First)).half
}

/// The place of a vertex for fields that part the lips: upper and lower lip are moved away from each other.
fn chart(plan: &Plan, p: Vec3, mark: &Mark) -> Vec3 {
    if !mark.mouth.is_finite() {
        return p;
    }
    let along = (p.x / plan.mouth_half_width).min(1.0);
    let apart = 7.0 * (1.0 - along * along) * (1.0 - smoothstep(4.0, 14.0, mark.mouth.abs()));
    p + Vec3::Y * apart.copysign(mark.mouth)
}

struct Kernel {
    centre: Vec3,
    charted: Vec3,
    width: f32,
}

/// A kernel and its coefficient, millimetres.
type Coefficients = Vec<(usize, Vec3)>;

/// The contents of `form.txt`.
struct Table {
    kernels: Vec<Kernel>,
    sections: Vec<(String, Coefficients)>,
}

impl Table {
    fn parse(text: &str) -> Self {
        let mut table = Self { kernels: Vec::new(), sections: Vec::new() };
        for line in text.lines() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let numbers: Vec<f32> = line.split(' ').filter_map(|number| number.parse().ok()).collect();
            match (numbers.as_slice(), table.sections.last_mut()) {
                (&[x, y, z, u, v, w, width], None) => table.kernels.push(Kernel {
                    centre: Vec3::new(x, y, z) * 0.1,
                    charted: Vec3::new(u, v, w) * 0.1,
                    width: width * 0.1,
                }),
                (&[kernel, x, y, z], Some((_, coefficients))) => {
                    coefficients.push((kernel as usize, Vec3::new(x, y, z) * 0.01));
                }
                _ if line.is_empty() => {}
                _ => table.sections.push((line.to_owned(), Vec::new())),
            }
        }
        table
    }

    /// Weights of all kernels and of their mirror images at points.
    fn weights(&self, points: &[Vec3], place: impl Fn(&Kernel) -> Vec3 + Sync) -> Vec<Vec<[f32; 2]>> {
        let bell = |p: Vec3, kernel: &Kernel| {
            let q = p.distance_squared(place(kernel)) / (2.0 * kernel.width * kernel.width);
            if q < 14.0 { libm::expf(-q) } else { 0.0 }
        };
        let at = |p: &Vec3| {
            let kernels = self.kernels.iter();
            kernels.map(|kernel| [bell(*p, kernel), bell(super::mirrored(*p), kernel)]).collect()
        };
        points.par_iter().map(at).collect()
    }
}

/// The displacement of each point: symmetric, so the middle stays in the middle.
fn field(weights: &[Vec<[f32; 2]>], coefficients: &Coefficients) -> Vec<Vec3> {
    let at = |weights: &Vec<[f32; 2]>| {
        coefficients
            .iter()
            .map(|&(kernel, offset)| {
                let [here, there] = weights[kernel];
                offset * Vec3::new(here - there, here + there, here + there)
            })
            .sum()
    };
    weights.par_iter().map(at).collect()
}

/// A displacement of each vertex that keeps the middle where it is.
fn symmetric(half: &Half, of: impl Fn(usize, Part) -> Vec3) -> Vec<Vec3> {
    let at = |(v, mark): (usize, &Mark)| {
        of(v, mark.part) * if mark.midline { Vec3::new(0.0, 1.0, 1.0) } else { Vec3::ONE }
    };
    half.marks.iter().enumerate().map(at).collect()
}

/// Where vertices that are not skin take their displacements from.
struct Places {
    /// For each vertex, the skin in front of it.
    skin: Vec<usize>,
    /// Skin in the middle of the mouth, and at the root of the ear.
    mouth: usize,
    ear: usize,
    /// 0 at the eye, which keeps its shape, 1 away from it; for shapes, and wider for units.
    beyond_eye: Vec<f32>,
    beyond_lids: Vec<f32>,
}

impl Places {
    fn of(half: &Half, plan: &Plan) -> Self {
        let skin: Vec<usize> = (0..half.points.len()).filter(|&v| half.marks[v].part == Part::Skin).collect();
        let nearest = |wanted: &dyn Fn(usize) -> bool, distance: &dyn Fn(Vec3) -> f32| {
            let candidates = skin.iter().copied().filter(|&v| wanted(v));
            candidates
                .min_by(|&a, &b| distance(half.points[a]).total_cmp(&distance(half.points[b])))
                .unwrap_or(0)
        };
        let before = |v: usize| {
            let (p, mark) = (half.points[v], half.marks[v]);
            match mark.part {
                Part::MouthLining { .. } => nearest(
                    &|other| {
                        let side = half.marks[other].mouth;
                        side.abs() < 12.0 && (side > 0.0) == (mark.mouth > 0.0)
                    },
                    &|q| q.truncate().distance_squared(p.truncate()),
                ),
                _ => v,
            }
        };
        let lips = Vec3::new(0.0, mouth::slit(plan, 0.0), 100.0);
        Self {
            skin: (0..half.points.len()).map(before).collect(),
            mouth: nearest(&|_| true, &|q| q.distance_squared(lips)),
            ear: nearest(&|_| true, &|q| q.distance_squared(TRAGUS)),
            beyond_eye: half.points.iter().map(|p| smoothstep(14.0, 20.0, p.distance(plan.eye))).collect(),
            beyond_lids: half.points.iter().map(|p| smoothstep(12.5, 25.0, p.distance(plan.eye))).collect(),
        }
    }

    /// The shape of a head from a field on its skin: eyes stay, teeth and tongue go with the lips, and the ear with its root.
    fn shape(&self, half: &Half, field: &[Vec3]) -> Vec<Vec3> {
        let mouth = field[self.mouth] * Vec3::new(0.0, 1.0, 1.0);
        symmetric(half, |v, part| match part {
            Part::Skin => field[v] * self.beyond_eye[v],
            Part::LidLining | Part::Eyeball => Vec3::ZERO,
            Part::MouthLining { depth } => {
                field[self.skin[v]].lerp(mouth, smoothstep(4.0, 8.0, f32::from(depth)))
            }
            Part::UpperTeeth | Part::LowerTeeth | Part::Tongue => mouth,
            Part::Ear => field[self.ear],
        })
    }

    /// What a unit does from its field on the skin: the inside of the mouth follows the lips, the deeper the less.
    fn unit(&self, half: &Half, number: u8, field: &[Vec3]) -> Vec<Vec3> {
        // Units of the upper face and the nose, and from 10 on of the lower face.
        let part = |y: f32| match number {
            // The raised cheek pulls at the skin over the jaw.
            6 => smoothstep(-72.0, -57.0, y),
            0..=9 => smoothstep(-70.0, -50.0, y),
            _ => 1.0 - smoothstep(35.0, 48.0, y),
        };
        let of_skin = |v: usize| {
            let faded = smoothstep(LEAST.0, LEAST.1, field[v].length());
            field[v] * (faded * part(half.points[v].y) * smoothstep(-15.0, 5.0, half.points[v].z))
        };
        symmetric(half, |v, part| match part {
            Part::Skin => of_skin(v) * self.beyond_lids[v],
            Part::MouthLining { depth } => {
                let lips = of_skin(self.skin[v]);
                // It stays behind them.
                let behind = Vec3::Z * (0.12 * lips.length() * smoothstep(0.0, 2.0, f32::from(depth)));
                (lips - behind) * (1.0 - smoothstep(5.0, 8.0, f32::from(depth)))
            }
            _ => Vec3::ZERO,
        })
    }
}
